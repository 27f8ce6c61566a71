"""From a recording to what the solver sees: every view with the mocap's ref_T_body at its time stamp."""

from __future__ import annotations

import numpy as np

from factors.board_shape import outline_of
from gtcal.board import Board
from gtcal.camera import BoolArray, FloatArray
from gtcal.errors import GtcalError
from gtcal.observed.views import Dropped as Dropped
from gtcal.observed.views import Observations as Observations
from gtcal.observed.views import Views as Views
from gtcal.observed.views import pooled as pooled
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import CameraDetections, IntArray
from gtcal.recordings.recording import Recording
from gtcal.recordings.trajectory import Gap

_TIME_UNITS = {3: "1,000", 6: "1,000,000", 9: "1,000,000,000"}


def board_turns(board: Board) -> FloatArray:
    """(G, 4, 4) the rigid transforms of ``board.turns``, in the board's plane about the middle of its corners."""
    corners_m = board.corners_m
    middle_m = 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))
    T = np.tile(np.eye(4), (len(board.turns), 1, 1))
    for turned, pose in zip(board.turns, T, strict=True):
        about, onto = (corners_m - middle_m)[:, :2], (corners_m[turned] - middle_m)[:, :2]
        angle = np.arctan2(np.sum(about[:, 0] * onto[:, 1] - about[:, 1] * onto[:, 0]), np.sum(about * onto))
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose[:3, 3] = middle_m - pose[:3, :3] @ middle_m
    return T


def synchronise(recording: Recording, *, min_corners: int = 4) -> Observations:
    """Give every view with ``min_corners`` or more the mocap's ref_T_body at its time stamp, interpolated; drop
    and count the others. Four corners, a tag's, are the fewest that fix a pose.

    Raises GtcalError where a camera has no detections, shares no time with a trajectory, or keeps no view."""
    kept: dict[str, CameraDetections] = {}
    dropped: list[Dropped] = []
    for name in recording.cameras:
        detections = _detections(recording, name)
        for body, trajectory in ({} if recording.numbered else recording.motion.trajectories).items():
            check_overlap(name, detections.stamps_ns, body, trajectory.stamps_ns)
        reasons = _reasons_to_drop(recording.motion, detections, min_corners)
        dropped_here = _count(name, detections, reasons)
        keep = ~np.any(list(reasons.values()), axis=0)
        if not keep.any():
            raise GtcalError(_nothing_left(name, dropped_here, recording.motion))
        kept[name] = detections if keep.all() else detections.select_views(keep)
        dropped += dropped_here
    frames = np.unique(np.concatenate([detections.stamps_ns for detections in kept.values()]))
    views = {name: _views(recording, name, detections, frames) for name, detections in kept.items()}
    return Observations(views, recording.capture, recording.board, tuple(dropped), frames, recording.motion)


def _views(recording: Recording, name: str, detections: CameraDetections, frame_stamps_ns: IntArray) -> Views:
    outline_m = outline_of(recording.board.corners_m)
    return Views(
        camera=recording.cameras[name],
        stamps_ns=detections.stamps_ns,
        frame_index=np.searchsorted(frame_stamps_ns, detections.stamps_ns),
        ref_T_body=recording.motion.at(detections.stamps_ns).ref_T_body,
        view_start=detections.view_start,
        corner_ids=detections.corner_ids,
        corners_m=recording.board.corners_m[detections.corner_ids],
        corners_px=detections.corners_px,
        outline_m=outline_m,
        shape_sigmas=recording.board_tolerance.shape_sigmas(outline_m),
        board_turns=board_turns(recording.board),
    )


def _detections(recording: Recording, name: str) -> CameraDetections:
    if name not in recording.detections:
        raise GtcalError(f"camera {name!r} has images but no detections yet; detect the board in them first")
    detections = recording.detections[name]
    if detections.n_views == 0:
        raise GtcalError(
            f"camera {name!r} has no views: the board was not found in any of its images; "
            "check the board's type and ids, or leave the camera out"
        )
    return detections


def _reasons_to_drop(motion: RefMotion, detections: CameraDetections, min_corners: int) -> dict[str, BoolArray]:
    """For each reason the mask (V,) of the views that it drops; each view counts for the first reason only."""
    reasons = {f"fewer than {min_corners} corners": np.diff(detections.view_start) < min_corners}
    gaps = motion.at(detections.stamps_ns).gaps
    for name, trajectory in motion.trajectories.items():
        if motion.numbered:
            reasons[f"no pose of its number in {name}"] = gaps[name] != Gap.NONE
            continue
        limit_ms = 1e3 * motion.gap_limit_s(trajectory)
        reasons[f"outside the {name} trajectory"] = gaps[name] == Gap.OUTSIDE
        reasons[f"gap > {limit_ms:.4g} ms in {name}"] = gaps[name] == Gap.TOO_LONG
    seen = np.zeros(detections.n_views, dtype=bool)
    for reason, mask in reasons.items():
        reasons[reason] = mask & ~seen
        seen |= mask
    return reasons


def _count(name: str, detections: CameraDetections, reasons: dict[str, BoolArray]) -> list[Dropped]:
    n_corners = np.diff(detections.view_start)
    return [
        Dropped(name, reason, int(mask.sum()), int(n_corners[mask].sum()))
        for reason, mask in reasons.items()
        if mask.any()
    ]


def check_overlap(camera: str, camera_ns: IntArray, body: str, body_ns: IntArray) -> None:
    """Raises GtcalError where a camera's images and a body's trajectory share no time."""
    if camera_ns[-1] >= body_ns[0] and camera_ns[0] <= body_ns[-1]:
        return
    raise GtcalError(
        f"camera {camera!r} and the {body} trajectory share no time: the camera has {_range(camera_ns)}, "
        f"the trajectory {_range(body_ns)}" + _time_base_hint(camera_ns, body, body_ns)
    )


def _range(stamps_ns: IntArray) -> str:
    return f"{stamps_ns[0] * 1e-9:.3f} s to {stamps_ns[-1] * 1e-9:.3f} s"


def _time_base_hint(camera_ns: IntArray, body: str, body_ns: IntArray) -> str:
    """What a ratio of a thousand, a million or a thousand million between the two clocks tells."""
    ends = abs(float(camera_ns[-1])), abs(float(body_ns[-1]))
    power = np.log10(ends[0] / ends[1]) if min(ends) > 0 else 0.0
    nearest = round(abs(power) / 3) * 3
    if nearest in _TIME_UNITS and abs(abs(power) - nearest) < 0.15:
        relation = "larger" if power > 0 else "smaller"
        return f"; the camera's are about {_TIME_UNITS[nearest]} times {relation}: check {body}.time_unit"
    return (
        "; are they from two recordings, or from clocks that start at different times? If it is one recording: "
        f"{int(camera_ns[0]) - int(body_ns[0])} ns more in {body}.stamp_offset_ns would have both start together; "
        "'gtcal doctor' finds the offset of a calibration's"
    )


def _nothing_left(name: str, dropped: list[Dropped], motion: RefMotion) -> str:
    counted = ", ".join(f"{drop.n_views} {drop.reason}" for drop in dropped)
    if motion.numbered:
        return f"camera {name!r} has no views left to calibrate from: {counted}"
    rates = ", ".join(
        f"{body} every {trajectory.median_interval_s:.3g} s" for body, trajectory in motion.trajectories.items()
    )
    return f"camera {name!r} has no views left to calibrate from: {counted} (sampled: {rates})"
