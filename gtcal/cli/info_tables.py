"""What the terminal shows of a recording."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gtcal.cli.tables import new_table
from gtcal.cli.terminal import Terminal
from gtcal.overview.live import Look
from gtcal.overview.summary import BodySummary, CameraSummary, RecordingSummary, Times
from gtcal.readers import MocapSummary
from gtcal.recordings.numbering import numbers_of
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
    Terminal().print(Group(*parts))


def summary_document(summary: RecordingSummary) -> dict[str, Any]:
    """The same for ``--json``."""
    return {
        "gtcal_summary": 1,
        "what": summary.what,
        "numbered": summary.numbered,
        "cameras": {name: _camera_document(camera, summary) for name, camera in summary.cameras.items()},
        "bodies": {
            name: {
                "n_poses": body.trajectory.n_samples,
                "times": _span(body.times, summary),
                "range_mm": body.range_mm.tolist(),
                "largest_turn_deg": body.largest_turn_deg,
            }
            for name, body in summary.bodies.items()
        },
        "remarks": list(summary.remarks),
    }


def _camera_document(found: CameraSummary, summary: RecordingSummary) -> dict[str, Any]:
    camera, detections = found.camera, found.detections
    return {
        "model": camera.model.name,
        "image_size_px": [camera.image_width_px, camera.image_height_px],
        "intrinsics_stated": camera.parameters is not None,
        "source": found.source,
        "n_images": found.n_images,
        "times": _span(found.times, summary),
        "share_with_pose": found.with_pose,
        "n_views": None if detections is None else detections.n_views,
        "n_corners": None if detections is None else detections.n_corners,
        "covered": None if found.coverage is None else found.coverage.share,
    }


def _span(times: Times, summary: RecordingSummary) -> dict[str, Any]:
    ends = times.stamps_ns[[0, -1]]
    first, last = numbers_of(ends) if summary.numbered else (ends - summary.start_ns) * 1e-9
    return {
        "rate_hz": None if summary.numbered else times.rate_hz,
        "first": float(first),
        "last": float(last),
        "n_gaps": 0 if summary.numbered else len(times.gaps_s),
        "longest_gap_s": None if summary.numbered or not len(times.gaps_s) else float(times.gaps_s.max()),
        "n_lost": 0 if summary.numbered else times.n_lost,
    }


def print_provenance(provenance: Provenance) -> None:
    """Print how a result was made."""
    versions = ", ".join(f"{name} {version}" for name, version in provenance.versions.items())
    lines = [
        f"made {provenance.created_utc} in {provenance.duration_s:.1f} s with {versions}",
        f"by: {' '.join(provenance.command_line)}",
        *(f"from {entry.path}  sha256 {entry.sha256[:12]}" for entry in provenance.inputs),
    ]
    Terminal().print(Group(*(Text(line, style="dim") for line in lines)))


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
    for heading in ("images", *_time_headings(summary), "with pose", "with board", "corners", "covered"):
        table.add_column(heading, justify="right")
    for name, camera in summary.cameras.items():
        images = "-" if camera.n_images is None else str(camera.n_images)
        table.add_row(name, images, *_times(camera.times, summary), f"{camera.with_pose:.0%}", *_corners(camera))
    return table


def _corners(camera: CameraSummary) -> tuple[str, str, str]:
    if camera.detections is None or camera.coverage is None:
        return "?", "?", "?"
    return str(camera.detections.n_views), str(camera.detections.n_corners), f"{camera.coverage.share:.0%}"


def _body_table(summary: RecordingSummary) -> Table:
    table = new_table("tracked bodies")
    lost = () if summary.numbered else ("lost",)
    for heading in ("poses", *_time_headings(summary), *lost, "range x, y, z, mm", "turned, deg"):
        table.add_column(heading, justify="right")
    for name, body in summary.bodies.items():
        poses = str(body.trajectory.n_samples)
        lost = () if summary.numbered else (_lost(body.times),)
        table.add_row(name, poses, *_times(body.times, summary), *lost, *_motion(body))
    return table


def _time_headings(summary: RecordingSummary) -> tuple[str, ...]:
    return ("from number", "to") if summary.numbered else ("Hz", "from, s", "to, s", "gaps (longest)")


def _times(times: Times, summary: RecordingSummary) -> tuple[str, ...]:
    if summary.numbered:
        first, last = numbers_of(times.stamps_ns[[0, -1]])
        return str(first), str(last)
    first_s, last_s = (times.stamps_ns[[0, -1]] - summary.start_ns) * 1e-9
    gaps = f"{len(times.gaps_s)} ({_duration(float(times.gaps_s.max()))})" if len(times.gaps_s) else "-"
    rate = "-" if np.isnan(times.rate_hz) else f"{times.rate_hz:.4g}"
    return rate, f"{first_s:.1f}", f"{last_s:.1f}", gaps


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"


def _lost(times: Times) -> str:
    return f"{times.n_lost} ({times.n_lost / (times.n_lost + len(times.stamps_ns)):.1%})" if times.n_lost else "-"


def _motion(body: BodySummary) -> tuple[str, str]:
    return ", ".join(f"{mm:.0f}" for mm in body.range_mm), f"{body.largest_turn_deg:.0f}"


def print_mocap_file(summary: MocapSummary) -> None:
    """Print what a file of mocap data holds, and what a manifest has to say beside it."""
    rate = "rate not stated" if summary.rate_hz is None else f"{summary.rate_hz:.4g} Hz"
    lasts = "" if summary.duration_s is None else f", {summary.duration_s:.1f} s"
    unit = "unit not stated" if summary.length_unit is None else summary.length_unit
    n_markers = f"{len(summary.markers)} labelled markers"
    parts: list[RenderableType] = [
        Text(f"{summary.format}: {summary.n_frames} frames at {rate}{lasts}; {unit}; {n_markers}"),
        _bodies_of_file(summary) if summary.bodies else _no_bodies(summary),
    ]
    if summary.open_fields:
        parts.append(Text(f"the manifest has to state: {', '.join(summary.open_fields)}"))
    parts += [Text(f"note: {note}", style="cyan") for note in summary.notes]
    Terminal().print(Group(*parts))


def mocap_file_document(summary: MocapSummary) -> dict[str, Any]:
    """The same for ``--json``."""
    return {"gtcal_mocap_file": 1, **asdict(summary), "path": str(summary.path)}


def _no_bodies(summary: MocapSummary) -> Text:
    if not summary.markers:
        return Text("no bodies and no labelled markers: export the rigid bodies too")
    return Text(f"no bodies; one can be solved from three or more of the markers {', '.join(summary.markers)}")


def _bodies_of_file(summary: MocapSummary) -> Table:
    table = new_table("bodies")
    for heading in ("frames seen", "gaps", "longest, s", "rotation", "markers"):
        table.add_column(heading, justify="left" if heading in ("rotation", "markers") else "right")
    for body in summary.bodies:
        longest = "-" if body.longest_gap_s is None else f"{body.longest_gap_s:.3g}"
        rotation = "of its markers" if body.from_markers else body.rotation or "to be stated"
        table.add_row(body.name, str(body.n_seen), str(body.n_gaps), longest, rotation, ", ".join(body.markers) or "-")
    return table


def look_shown(look: Look) -> RenderableType:
    """A recording that is being made: a row per camera, and what to do next."""
    table = new_table(f"so far; looked at in {look.seconds:.2f} s")
    for heading in ("views", "1-sigma, mm", "deg"):
        table.add_column(heading, justify="right")
    for name, n_views in look.n_views.items():
        known = name in look.sigma_mm
        sigmas = (f"{look.sigma_mm[name]:.3f}", f"{look.sigma_deg[name]:.4f}") if known else ("-", "-")
        table.add_row(name, str(n_views), *sigmas)
    asked = f"asked for: {look.enough.mm:g} mm, {look.enough.deg:g} deg"
    style = "green" if look.is_enough else "yellow"
    advice = (Text(f"- {line}", style=style) for line in look.advice)
    return Group(*([table] if look.n_views else []), Text(asked), *advice)
