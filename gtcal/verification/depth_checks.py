"""Two checks that see along the ray, where e_3D is blind: triangulation, and the pose of a device with many faces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from factors import CornerViews
from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.estimation.pnp import refine_poses
from gtcal.recordings.detections import IntArray
from gtcal.verification.error_statistics import error_statistics
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.verification import LeftOut, PoseCheck, Sightings, TriangulationCheck, VerificationOptions

_FEWEST_FACES = 2


def triangulate(
    sightings: Mapping[str, Sightings], options: VerificationOptions
) -> tuple[TriangulationCheck, tuple[LeftOut, ...]]:
    """Where two or more cameras see a face at the same stamp: the point nearest to their rays, each weighed by its
    distance, against the mocap's centre; and the groups left out for a small parallax."""
    names = tuple(sightings)
    rays = _rays(sightings)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(rays.key) > 0])) if len(rays.key) else np.zeros(0, int)
    counts = np.diff(np.append(starts, len(rays.key)))
    starts, counts = starts[counts >= 2], counts[counts >= 2]
    group = np.repeat(np.arange(len(starts)), counts)
    rows = np.repeat(starts - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts) + np.arange(len(group))
    seen_by = np.zeros((len(starts), len(names)), dtype=bool)
    seen_by[group, rays.camera[rows]] = True
    parallax = _parallax_deg(group, rays.direction[rows], len(starts))
    enough = parallax >= options.min_parallax_deg
    error = _nearest_points(group, rays, rows, len(starts)) - rays.mocap[starts]
    sight = np.zeros((len(starts), 3))
    np.add.at(sight, group, rays.direction[rows])
    sight /= np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-12)
    depth = (error * sight).sum(axis=1)
    across = np.linalg.norm(error - depth[:, None] * sight, axis=1)
    norms_mm = 1e3 * np.linalg.norm(error[enough], axis=1)
    frames = rays.frame[starts][enough]
    few = int((~enough).sum())
    left_out = (LeftOut("several", f"rays less than {options.min_parallax_deg:g} deg apart: no triangulation", few),)
    return TriangulationCheck(
        cameras=names,
        stamps_ns=rays.stamps_ns[starts][enough],
        seen_by=seen_by[enough],
        parallax_deg=parallax[enough],
        errors_in_ref_mm=1e3 * error[enough],
        depth_mm=1e3 * depth[enough],
        across_mm=1e3 * across[enough],
        statistics=error_statistics(norms_mm, frames, "mm", options.confidence) if len(norms_mm) else None,
        depth_rmse_mm=_rms(1e3 * depth[enough]),
        depth_bias_mm=1e3 * float(depth[enough].mean()) if enough.any() else float("nan"),
        across_rmse_mm=_rms(1e3 * across[enough]),
    ), left_out if few else ()


class _Rays:
    """The sightings of all cameras as rays in ref, sorted by frame and face. key: (S,) one for each frame and face."""

    def __init__(self, sightings: Mapping[str, Sightings]) -> None:
        seen = list(sightings.values())
        n_faces = 1 + max((int(s.face_index.max()) for s in seen if len(s)), default=0)
        key = np.concatenate([s.frame_index * n_faces + s.face_index for s in seen])
        order = np.argsort(key, kind="stable")
        ref_T_camera = [inverse(s.camera_T_ref) for s in seen]
        pairs = list(zip(seen, ref_T_camera, strict=True))
        self.key = key[order]
        self.frame = np.concatenate([s.frame_index for s in seen])[order]
        self.stamps_ns = np.concatenate([s.stamps_ns for s in seen])[order]
        self.camera = np.repeat(np.arange(len(seen)), [len(s) for s in seen])[order]
        self.direction = np.concatenate([s.image_bearings @ T[:3, :3].T for s, T in pairs])[order]
        self.origin = np.concatenate([np.broadcast_to(T[:3, 3], (len(s), 3)) for s, T in pairs])[order]
        self.mocap = np.concatenate([s.mocap_centre_in_camera_m @ T[:3, :3].T + T[:3, 3] for s, T in pairs])[order]


def _rays(sightings: Mapping[str, Sightings]) -> _Rays:
    return _Rays(sightings)


def _nearest_points(group: IntArray, rays: _Rays, rows: IntArray, n: int) -> FloatArray:
    """(G, 3) the points with the least sum of squared angles to the rays, to first order."""
    direction, origin = rays.direction[rows], rays.origin[rows]
    range2 = ((rays.mocap[rows] - origin) ** 2).sum(axis=1)
    off = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / range2[:, None, None]
    A, b = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(A, group, off)
    np.add.at(b, group, np.einsum("sij,sj->si", off, origin))
    # Parallel rays have no nearest point; they are left out by their parallax.
    A += 1e-12 * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(A, b[:, :, None])[:, :, 0], dtype=np.float64) if n else np.zeros((0, 3))


def _parallax_deg(group: IntArray, direction: FloatArray, n: int) -> FloatArray:
    """(G,) the largest angle between two rays of a group."""
    largest = np.zeros(n)
    for apart in range(1, int(np.bincount(group).max()) if len(group) else 0):
        same = group[apart:] == group[:-apart]
        a, b = direction[apart:][same], direction[:-apart][same]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        np.maximum.at(largest, group[apart:][same], np.rad2deg(angle))
    return largest


def check_poses(recording: LollypopRecording, sightings: Mapping[str, Sightings]) -> tuple[PoseCheck, ...]:
    """For a device with several faces: in every image with two faces or more, its pose from all their corners against
    the one by mocap and calibration."""
    if len(recording.device.faces) < _FEWEST_FACES:
        return ()
    return tuple(_check_poses_of(recording, name, seen) for name, seen in sightings.items())


def _check_poses_of(recording: LollypopRecording, name: str, seen: Sightings) -> PoseCheck:
    detections, device = recording.detections[name], recording.device
    stamps_ns, first, n_faces = np.unique(seen.stamps_ns, return_index=True, return_counts=True)
    stamps_ns, first = stamps_ns[n_faces >= _FEWEST_FACES], first[n_faces >= _FEWEST_FACES]
    calibrated = seen.camera_T_ref @ seen.ref_T_body[first]
    found = calibrated
    if len(stamps_ns):
        chosen = detections.select_views(np.isin(detections.stamps_ns, stamps_ns))
        corners = CornerViews(chosen.view_start, device.corners_m[chosen.corner_ids], chosen.corners_px)
        found = refine_poses(corners, seen.camera, calibrated).camera_T_board
    difference = inverse(calibrated) @ found
    turns = Rotation.from_matrix(difference[:, :3, :3]).as_rotvec()
    shift_m = found[:, :3, 3] - calibrated[:, :3, 3]
    sight = calibrated[:, :3, 3] / np.linalg.norm(calibrated[:, :3, 3], axis=1, keepdims=True)
    depth_m = (shift_m * sight).sum(axis=1)
    across_m = np.linalg.norm(shift_m - depth_m[:, None] * sight, axis=1)
    rotation_deg = np.rad2deg(np.linalg.norm(turns, axis=1))
    return PoseCheck(
        camera=name,
        stamps_ns=stamps_ns,
        errors=np.concatenate([turns, difference[:, :3, 3]], axis=1),
        depth_mm=1e3 * depth_m,
        across_mm=1e3 * across_m,
        rotation_deg=rotation_deg,
        count=len(stamps_ns),
        depth_rmse_mm=_rms(1e3 * depth_m),
        across_rmse_mm=_rms(1e3 * across_m),
        rotation_rmse_deg=_rms(rotation_deg),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
