"""gtcal diff: what moved between two calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from rich.table import Table

    from gtcal.differences.difference import Change, Difference


def diff(
    first: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="A")],
    second: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="B")],
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    figure: Path | None = None,
    max_mm: float = 1.0,
    max_px: float = 0.5,
    distance_m: float = 1.0,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Compare two calibrations of one rig, from recordings of their own: what moved, what is the same, and what they
    are too uncertain to tell apart.

    Each camera's place, its intrinsics and the board's place on its body are held against the covariances of both
    calibrations: 'moved' is what chance hardly explains (1 in 100, over all that is compared), 'the same' what can
    differ by no more than the tolerance, 'not told apart' the rest. Where most cameras moved alike, the markers that
    they are measured from have moved, or their body was defined anew; that is said once, and the cameras are compared
    without it.

        gtcal diff monday/calibration.json friday/calibration.json --figure moved.png

    Exit codes: 0 nothing moved by more than the tolerance, 3 something did, 4 not told apart.

    Args:
        first: calibration.json of the earlier calibration.
        second: Of the later one.
        output: JSON file to write with all of it.
        figure: Figure to write, .png or .svg: how far pixels moved over each image, and what is expected.
        max_mm: Tolerance on the place of a camera or the board; that of 'gtcal verify'.
        max_px: Tolerance on the pixels of points in ref, RMS over the image; that of 'gtcal verify'.
        distance_m: Of these points from the camera.
        json: Print the result as JSON in place of tables ('gtcal schema difference').
        quiet: Print nothing; the exit code tells.
    """
    import time

    from gtcal.cli.json_output import print_json
    from gtcal.cli.terminal import Terminal
    from gtcal.differences.difference import DifferenceOptions, difference
    from gtcal.differences.difference_file import difference_document, write_difference
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, fingerprint
    from gtcal.results.calibration_file import provenance_document, read_calibration
    from gtcal.results.provenance import provenance

    started = time.perf_counter()
    options = DifferenceOptions(max_mm, max_px, distance_m)
    check_outputs((output, figure), (first, second))
    inputs = fingerprint(first), fingerprint(second)
    if inputs[0].sha256 == inputs[1].sha256:
        raise GtcalError(f"{first} and {second} are the same calibration")
    a, b = read_calibration(first), read_calibration(second)
    for path, calibration in ((first, a), (second, b)):
        if calibration.covariance is None:
            raise GtcalError(f"{path}: has no covariance, so what moved can't be told; calibrate with all the stages")
    found = difference(a, b, options)
    if figure is not None:
        from gtcal.differences.difference_figure import draw_difference

        draw_difference(figure, found, {name: camera.camera for name, camera in a.cameras.items()})
    made = provenance(options, inputs, time.perf_counter() - started)
    if output is not None:  # after the figure, which may be refused for its suffix
        write_difference(output, found, made)
    if json:
        print_json(difference_document(found) | {"provenance": provenance_document(made)})
    elif not quiet:
        console = Terminal()
        console.print(difference_table(found))
        for line in (f"{found.verdict}", *found.statements, *(f"note: {note}" for note in found.notes)):
            console.print(line, highlight=False, soft_wrap=True)
        written = [str(path) for path in (output, figure) if path is not None]
        if written:
            console.print("written: " + ", ".join(written), highlight=False, soft_wrap=True)
    return _exit_code(found)


def _exit_code(found: Difference) -> int:
    from gtcal.differences.difference import Verdict

    return {Verdict.MOVED: 3, Verdict.UNTOLD: 4}.get(found.verdict, 0)


def difference_table(found: Difference) -> Table:
    """A row per change."""
    from gtcal.cli.tables import new_table

    table = new_table(
        "from the first calibration to the second",
        caption=f"±: 1-sigma by both covariances; px: of points at {found.options.distance_m:g} m, RMS over the image, "
        "and what is expected; chance: of a difference as large or larger where nothing moved",
    )
    for heading in ("mm", "± mm", "deg", "± deg", "px", "± px", "chance"):
        table.add_column(heading, justify="right")
    table.add_column("")
    for change in found.changes:
        table.add_row(change.what, *_cells(change), _chance(change.probability), change.verdict(found.options))
    return table


def _chance(probability: float) -> str:
    return f"{probability:.2g}" if probability >= _NO_CHANCE else f"< {_NO_CHANCE:g}"


_NO_CHANCE = 1e-6


def _cells(change: Change) -> list[str]:
    from math import isnan

    values = (
        (change.moved_mm, 3),
        (change.sigma_mm, 3),
        (change.turned_deg, 4),
        (change.sigma_deg, 4),
        (change.rms_px, 3),
        (change.expected_px, 3),
    )
    return ["" if isnan(value) else f"{value:.{digits}f}" for value, digits in values]
