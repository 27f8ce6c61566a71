"""gtcal uncertainty: how sure a calibration is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

if TYPE_CHECKING:
    from rich.table import Table

    from gtcal.results.calibration import Calibration


def uncertainty(
    calibration: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CALIBRATION")],
    *,
    distances_m: tuple[float, ...] = (0.5, 1.0, 2.0),
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    json: bool = False,
) -> None:
    """Say how sure a calibration is: its 1-sigma by each kind of covariance, over each image, and where it is weak.

    Three covariances: naive (corners independent, mocap exact: too small wherever the mocap is noisy), frame-clustered
    (cluster-robust: a cluster per frame) and errors in variables (with the mocap's noise modelled). Over the image: the
    pixel of a point that is known in ref, and the point in space of a pixel that is known. Weakest directions: the ways
    in which all of it can move at once, each with the motion to record that would fix it. 'gtcal report' draws it.

    Args:
        calibration: File that 'gtcal calibrate' wrote.
        distances_m: Distances from the camera at which its image is looked at.
        output: JSON file to write with all of it.
        json: Print the result as JSON in place of tables ('gtcal schema uncertainty').
    """
    from json import dumps

    from gtcal.cli.json_output import print_json
    from gtcal.cli.terminal import Terminal
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, write_text
    from gtcal.report.uncertainty_part import KIND_NAMES, noise_lines, sigma_rows
    from gtcal.results.calibration_file import read_calibration
    from gtcal.uncertainty.weak_directions import least_sure

    found = read_calibration(calibration)
    check_outputs([output], [calibration])
    if found.covariance is None:
        raise GtcalError(f"{calibration}: has no covariance; calibrate with all the stages")
    kinds = [kind for kind in KIND_NAMES if kind in found.covariances]
    rows = sigma_rows(found)
    images = _images(found, distances_m)
    directions = least_sure(found)
    document = {
        "gtcal_uncertainty": 1,
        "calibration": str(calibration),
        "covariance_kind": found.covariance_kind,
        "largest_sigma": {row.name: dict(zip(kinds, row.cells, strict=True)) for row in rows},
        "images": images,
        "least_sure": [{"grade": str(d.grade), "sentence": d.sentence} for d in directions],
    }
    if output is not None:
        write_text(output, dumps(document, indent=1, allow_nan=False) + "\n")
    if json:
        print_json(document)
        return
    console = Terminal()
    console.print(_sigma_table(kinds, found.covariance_kind, [(row.name, row.cells) for row in rows]))
    console.print(_image_table(images))
    for line in (*noise_lines(found.mocap_noise), "Weakest directions:", *(f"- {d.sentence}" for d in directions)):
        console.print(line, highlight=False, soft_wrap=True)
    if output is not None:
        console.print(f"written: {output}", highlight=False)


def _images(calibration: Calibration, distances_m: tuple[float, ...]) -> list[dict[str, Any]]:
    import numpy as np

    from gtcal.uncertainty.projected import image_uncertainty

    rows = []
    for name in calibration.cameras:
        for distance_m in distances_m:
            found = image_uncertainty(calibration, name, distance_m, across=24)
            seen = np.isfinite(found.sigma_px)
            rows.append(
                {
                    "camera": name,
                    "distance_m": distance_m,
                    "median_px": float(np.median(found.sigma_px[seen])),
                    "worst_px": float(found.sigma_px[seen].max()),
                    "median_mm": float(np.nanmedian(found.sigma_mm)),
                    "worst_mm": float(np.nanmax(found.sigma_mm)),
                }
            )
    return rows


def _sigma_table(kinds: list[str], taken: str, rows: list[tuple[str, tuple[str, ...]]]) -> Table:
    from gtcal.cli.tables import new_table

    table = new_table("largest 1-sigma of each pose: mm, deg")
    for kind in kinds:
        table.add_column(kind.replace("_", " ") + (" (taken)" if kind == taken else ""), justify="right")
    for name, cells in rows:
        table.add_row(name, *(cell.replace(" mm", "").removesuffix(" deg") for cell in cells))
    return table


def _image_table(rows: list[dict[str, Any]]) -> Table:
    from gtcal.cli.tables import new_table

    table = new_table(
        "1-sigma over the image",
        caption="px: of the pixel of a point known in ref; mm: of the point in ref of a pixel and distance known",
    )
    for heading in ("at, m", "median, px", "worst, px", "median, mm", "worst, mm"):
        table.add_column(heading, justify="right")
    for row in rows:
        cells = (f"{row[name]:.3f}" for name in ("median_px", "worst_px", "median_mm", "worst_mm"))
        table.add_row(row["camera"], f"{row['distance_m']:g}", *cells)
    return table
