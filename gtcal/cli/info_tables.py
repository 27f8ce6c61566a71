"""What the terminal shows of a recording."""

from __future__ import annotations

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from gtcal.cli.tables import new_table
from gtcal.overview.summary import BodySummary, CameraSummary, RecordingSummary, Times
from gtcal.results.calibration import Provenance


def print_summary(summary: RecordingSummary) -> None:
    """Print what a recording holds, and what is worth knowing about it."""
    parts: list[RenderableType] = [
        Text(summary.what),
        _lens_table(summary),
        _camera_table(summary),
        _body_table(summary),
    ]
    parts += [Text(f"note: {remark}", style="cyan") for remark in summary.remarks]
    Console().print(Group(*parts))


def print_provenance(provenance: Provenance) -> None:
    """Print how a result was made."""
    versions = ", ".join(f"{name} {version}" for name, version in provenance.versions.items())
    lines = [
        f"made {provenance.created_utc} in {provenance.duration_s:.1f} s with {versions}",
        f"by: {' '.join(provenance.command_line)}",
        *(f"from {entry.path}  sha256 {entry.sha256[:12]}" for entry in provenance.inputs),
    ]
    Console().print(Group(*(Text(line, style="dim") for line in lines)))


def _lens_table(summary: RecordingSummary) -> Table:
    table = new_table("cameras")
    for heading in ("model", "size, px", "intrinsics", "images from"):
        table.add_column(heading)
    for name, found in summary.cameras.items():
        camera = found.camera
        size = f"{camera.image_width_px} x {camera.image_height_px}"
        table.add_row(name, camera.model.name, size, "none" if camera.parameters is None else "stated", found.source)
    return table


def _camera_table(summary: RecordingSummary) -> Table:
    table = new_table("images")
    for heading in (
        "images",
        "Hz",
        "from, s",
        "to, s",
        "gaps (longest)",
        "with pose",
        "with board",
        "corners",
        "covered",
    ):
        table.add_column(heading, justify="right")
    for name, camera in summary.cameras.items():
        images = "-" if camera.n_images is None else str(camera.n_images)
        table.add_row(
            name, images, *_times(camera.times, summary.start_ns), f"{camera.with_pose:.0%}", *_corners(camera)
        )
    return table


def _corners(camera: CameraSummary) -> tuple[str, str, str]:
    if camera.detections is None or camera.coverage is None:
        return "?", "?", "?"
    return str(camera.detections.n_views), str(camera.detections.n_corners), f"{camera.coverage.share:.0%}"


def _body_table(summary: RecordingSummary) -> Table:
    table = new_table("tracked bodies")
    for heading in ("poses", "Hz", "from, s", "to, s", "gaps (longest)", "lost", "range x, y, z, mm", "turned, deg"):
        table.add_column(heading, justify="right")
    for name, body in summary.bodies.items():
        poses = str(body.trajectory.n_samples)
        table.add_row(name, poses, *_times(body.times, summary.start_ns), _lost(body.times), *_motion(body))
    return table


def _times(times: Times, start_ns: int) -> tuple[str, str, str, str]:
    first_s, last_s = (times.stamps_ns[[0, -1]] - start_ns) * 1e-9
    gaps = f"{len(times.gaps_s)} ({_duration(float(times.gaps_s.max()))})" if len(times.gaps_s) else "-"
    rate = "-" if np.isnan(times.rate_hz) else f"{times.rate_hz:.4g}"
    return rate, f"{first_s:.1f}", f"{last_s:.1f}", gaps


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"


def _lost(times: Times) -> str:
    return f"{times.n_lost} ({times.n_lost / (times.n_lost + len(times.stamps_ns)):.1%})" if times.n_lost else "-"


def _motion(body: BodySummary) -> tuple[str, str]:
    return ", ".join(f"{mm:.0f}" for mm in body.range_mm), f"{body.largest_turn_deg:.0f}"
