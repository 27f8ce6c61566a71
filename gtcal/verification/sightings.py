"""Where the image and the mocap see the Lollypop's centre: the errors of every frame and camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gtcal.camera import BoolArray, FloatArray
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import CameraDetections, IntArray
from gtcal.recordings.trajectory import Gap
from gtcal.results.calibration import CameraCalibration
from gtcal.verification.clock import SightingTimes
from gtcal.verification.face_centres import face_centres
from gtcal.verification.lollypop import Lollypop
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.verification import LeftOut, Sightings

_FEWEST_CORNERS = 4
_STEP_NS = 10_000_000  # of the central difference for a velocity: from nearer poses it would be mostly their noise


@dataclass(frozen=True)
class Path3D:
    """Where one camera has the device, whether or not the two agree: N places in the camera frame.

    by_image_m: (N, 3) by image and the face's stated size. by_mocap_m: (N, 3) by mocap and calibration."""

    by_image_m: FloatArray
    by_mocap_m: FloatArray

    def __len__(self) -> int:
        return len(self.by_image_m)

    @property
    def distance_ratios(self) -> FloatArray:
        """(N,) the mocap's distance over that by the stated size."""
        return np.asarray(np.linalg.norm(self.by_mocap_m, axis=1) / np.linalg.norm(self.by_image_m, axis=1))

    @property
    def angle_apart_rad(self) -> float:
        """Median angle between the two."""
        cross = np.linalg.norm(np.cross(self.by_image_m, self.by_mocap_m), axis=1)
        return float(np.median(np.arctan2(cross, (self.by_image_m * self.by_mocap_m).sum(axis=1))))


@dataclass(frozen=True)
class _Seen:
    """The faces in the views of one camera: G groups of corners, N corners sorted by view and face.

    view, face: (G,). start: (G + 1,). corner_ids: (N,). corners_px: (N, 2)."""

    view: IntArray
    face: IntArray
    start: IntArray
    corner_ids: IntArray
    corners_px: FloatArray

    def select(self, keep: BoolArray) -> _Seen:
        counts = np.diff(self.start)
        rows = np.repeat(keep, counts)
        start = np.concatenate([[0], np.cumsum(counts[keep])])
        return _Seen(self.view[keep], self.face[keep], start, self.corner_ids[rows], self.corners_px[rows])


def sightings_of(
    recording: LollypopRecording,
    name: str,
    calibrated: CameraCalibration,
    frame_stamps_ns: IntArray,
    times: SightingTimes,
    *,
    max_viewing_angle_deg: float,
) -> tuple[Sightings, Path3D, tuple[LeftOut, ...]]:
    """The sightings of one camera; its path of the device, also where image and mocap have nothing in common; and what
    was left out and why.

    frame_stamps_ns: (F,) the distinct stamps of all cameras, increasing. times: what the stamps are by the mocap."""
    detections, device = recording.detections[name], recording.device
    camera, camera_T_ref = calibrated.camera, calibrated.camera_T_ref.a_T_b
    left_out: list[LeftOut] = []

    def leave_out(reason: str, mask: BoolArray) -> None:
        if mask.any():
            left_out.append(LeftOut(name, reason, int(mask.sum())))

    unseen = n_frames(recording, name, frame_stamps_ns) - detections.n_views
    if unseen > 0:
        left_out.append(LeftOut(name, "the device is not found in the image", unseen))
    gaps = recording.motion.at(times.mocap_ns(camera, detections.stamps_ns)).gaps
    has_pose = _with_pose(recording.motion, gaps, leave_out)
    seen = _faces_seen(detections, device)
    seen = seen.select(has_pose[seen.view])

    few = np.diff(seen.start) < _FEWEST_CORNERS
    leave_out(f"fewer than {_FEWEST_CORNERS} corners of a face", few)
    seen = seen.select(~few)
    bearings, valid = camera.unproject(seen.corners_px)
    beyond = ~np.logical_and.reduceat(valid, seen.start[:-1]) if len(seen.view) else np.zeros(0, dtype=bool)
    leave_out("corners beyond the lens's field", beyond)
    bearings = bearings[np.repeat(~beyond, np.diff(seen.start))]
    seen = seen.select(~beyond)

    centres = face_centres(bearings, device.corners_in_face_m[seen.corner_ids], seen.start)
    leave_out("corners that no flat face seen from its front has", ~centres.ok)
    angle = centres.viewing_angle_rad
    oblique = centres.ok & (angle > np.deg2rad(max_viewing_angle_deg))
    leave_out(f"seen at more than {max_viewing_angle_deg:g} deg from the face's normal", oblique)
    poses, in_camera, velocity = _mocap_centres(recording, times, detections, seen, calibrated)
    mocap_px, has_pixel = camera.project(in_camera)
    used = centres.ok & ~oblique
    readout = used & np.isnan(in_camera[:, 0])
    leave_out("no mocap pose when the row was read out", readout)
    used &= ~readout
    path = Path3D(centres.centre_in_camera_m[used], in_camera[used])
    leave_out("the mocap's centre is beyond the lens's field", used & ~has_pixel)
    used &= has_pixel
    # The centre lies between the corners, so where they have bearings it has a pixel, but for the field's very rim.
    bearing = centres.centre_in_camera_m / np.linalg.norm(centres.centre_in_camera_m, axis=1, keepdims=True)
    image_px, image_ok = camera.project(bearing)
    leave_out("the image centre is beyond the lens's field", used & ~image_ok)
    used &= image_ok
    stamps_ns = detections.stamps_ns[seen.view]
    sightings = Sightings(
        camera=camera,
        camera_T_ref=camera_T_ref,
        stamps_ns=stamps_ns[used],
        frame_index=np.searchsorted(frame_stamps_ns, stamps_ns[used]),
        face_index=seen.face[used],
        ref_T_body=poses[used],
        image_centre_px=image_px[used],
        image_bearings=bearing[used],
        mocap_centre_px=mocap_px[used],
        mocap_centre_in_camera_m=in_camera[used],
        mocap_velocity_in_camera_m_s=velocity[used],
        tag_centre_in_camera_m=centres.centre_in_camera_m[used],
        viewing_angle_rad=angle[used],
    )
    return sightings, path, tuple(left_out)


def n_frames(recording: LollypopRecording, name: str, frame_stamps_ns: IntArray) -> int:
    """The images of a camera, or where it has none the distinct stamps of all cameras."""
    return len(recording.images[name]) if name in recording.images else len(frame_stamps_ns)


def _with_pose(motion: RefMotion, gaps: dict[str, IntArray], leave_out: Callable[[str, BoolArray], None]) -> BoolArray:
    """(V,) the views at whose time stamp the mocap has every body, by the gaps (V,) of each."""
    ok = np.ones(len(next(iter(gaps.values()))), dtype=bool)
    for name, trajectory in motion.trajectories.items():
        limit_ms = 1e3 * motion.gap_limit_s(trajectory)
        leave_out(f"outside the {trajectory.body} trajectory", ok & (gaps[name] == Gap.OUTSIDE))
        leave_out(f"gap > {limit_ms:.4g} ms in {trajectory.body}", ok & (gaps[name] == Gap.TOO_LONG))
        ok &= gaps[name] == Gap.NONE
    return ok


def _faces_seen(detections: CameraDetections, device: Lollypop) -> _Seen:
    view, face = detections.view_of_corner, device.corner_faces[detections.corner_ids]
    order = np.lexsort((detections.corner_ids, view))
    key = (view * len(device.faces) + face)[order]
    groups, counts = np.unique(key, return_counts=True)
    start = np.concatenate([[0], np.cumsum(counts)])
    return _Seen(
        groups // len(device.faces),
        groups % len(device.faces),
        start,
        detections.corner_ids[order],
        detections.corners_px[order],
    )


def _mocap_centres(
    recording: LollypopRecording,
    times: SightingTimes,
    detections: CameraDetections,
    seen: _Seen,
    calibrated: CameraCalibration,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ref_T_body (G, 4, 4) when each face was seen, and the faces' centres and velocities (G, 3) in the camera."""
    rows_px = np.add.reduceat(seen.corners_px[:, 1], seen.start[:-1]) / np.diff(seen.start) if len(seen.view) else None
    mocap_ns = times.mocap_ns(calibrated.camera, detections.stamps_ns[seen.view], rows_px)
    in_body_m, camera_T_ref = recording.device.centres_in_body_m[seen.face], calibrated.camera_T_ref.a_T_b

    def in_camera_at(stamps_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        poses = recording.motion.at(stamps_ns).ref_T_body
        in_ref_m = np.einsum("gij,gj->gi", poses[:, :3, :3], in_body_m) + poses[:, :3, 3]
        return poses, in_ref_m @ camera_T_ref[:3, :3].T + camera_T_ref[:3, 3]

    poses, in_camera_m = in_camera_at(mocap_ns)
    before_m, after_m = (in_camera_at(mocap_ns + step_ns)[1] for step_ns in (-_STEP_NS, _STEP_NS))
    velocity_m_s = (after_m - before_m) / (2e-9 * _STEP_NS)
    return poses, in_camera_m, np.nan_to_num(velocity_m_s)  # still, as far as is known, beside a gap
