"""Direct calibration on retroreflective markers that a camera sees: no board, and no X.

As Chiodini et al. and Schofield et al.: the mocap knows where the markers are, the image shows them as bright spots;
P3P in a RANSAC loop on marker centres of known position finds the pose, the reprojection error refines it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from factors import CornerViews
from factors.reprojection import residuals_px
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.pnp import MAX_OFF_MEAN_RAD, refine_poses

GATE_PX = 5.0
"""A marker within this distance of its projection supports a pose."""

_FEWEST = 6
_SURE = 0.999
_MOST_DRAWS = 2_000


@dataclass(frozen=True)
class MarkerSightings:
    """Markers seen by one camera, each with the position that the mocap gives the marker of the same label then.

    position_in_ref_m: (N, 3), ref being the frame that the camera is fixed in. centre_px: (N, 2)."""

    camera: Camera
    position_in_ref_m: FloatArray
    centre_px: FloatArray


@dataclass(frozen=True)
class MarkerCalibration:
    """camera_T_ref: (4, 4). inlier: (N,) the sightings that support it. rmse_px: of those."""

    camera_T_ref: FloatArray
    inlier: BoolArray
    rmse_px: float


def calibrate_on_markers(sightings: MarkerSightings, *, seed: int = 0) -> MarkerCalibration:
    """The pose that most sightings support, refined on them.

    Raises GtcalError where fewer than six sightings support any pose."""
    rays = _rays(sightings)
    usable = np.flatnonzero(np.isfinite(rays).all(axis=1))
    name = sightings.camera.name
    if len(usable) < _FEWEST:
        raise GtcalError(f"camera {name!r}: {len(usable)} usable sightings of markers; at least {_FEWEST} are needed")
    rng, best, n_draws, draw = np.random.default_rng(seed), np.zeros(len(rays), dtype=bool), _MOST_DRAWS, 0
    pose = np.eye(4)
    while draw < n_draws:
        draw += 1
        for candidate in _p3p(sightings, rays, rng.choice(usable, 3, replace=False)):
            inlier = _lengths_px(sightings, candidate) < GATE_PX
            if inlier.sum() > best.sum():
                pose, best = candidate, inlier
                n_draws = min(_MOST_DRAWS, _draws_needed(float(inlier.mean())))
    if best.sum() < _FEWEST:
        raise GtcalError(
            f"camera {name!r}: at most {best.sum()} sightings of markers support one pose; are labels, units and "
            "clocks right?"
        )
    for _ in range(3):
        pose = _refined(sightings, pose, best)
        best = _lengths_px(sightings, pose) < GATE_PX
    return MarkerCalibration(pose, best, float(np.sqrt((_lengths_px(sightings, pose)[best] ** 2).mean())))


def _rays(sightings: MarkerSightings) -> FloatArray:
    """(N, 2) normalised coordinates; NaN where the ray is too far off the axis for any."""
    bearings, valid = sightings.camera.unproject(sightings.centre_px)
    usable = valid & (bearings[:, 2] > math.cos(MAX_OFF_MEAN_RAD))
    return np.where(usable[:, None], bearings[:, :2] / np.where(usable, bearings[:, 2], 1.0)[:, None], np.nan)


def _p3p(sightings: MarkerSightings, rays: FloatArray, rows: FloatArray) -> list[FloatArray]:
    """The up to four poses that three sightings allow."""
    points = sightings.position_in_ref_m[rows]
    try:
        _, rotations, translations = cv2.solveP3P(points, rays[rows], np.eye(3), None, flags=cv2.SOLVEPNP_P3P)
    except cv2.error:  # three markers on a line
        return []
    poses = []
    for rotation, translation in zip(rotations, translations, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation)[0], np.ravel(translation)
        if np.isfinite(pose).all():
            poses.append(pose)
    return poses


def _lengths_px(sightings: MarkerSightings, camera_T_ref: FloatArray) -> FloatArray:
    """(N,) infinite where a marker has no pixel."""
    camera = sightings.camera
    found = residuals_px(_as_view(sightings), camera_T_ref[None], camera.model, camera.theta)
    return np.nan_to_num(np.linalg.norm(found, axis=1), nan=np.inf)


def _refined(sightings: MarkerSightings, camera_T_ref: FloatArray, inlier: BoolArray) -> FloatArray:
    kept = MarkerSightings(sightings.camera, sightings.position_in_ref_m[inlier], sightings.centre_px[inlier])
    return refine_poses(_as_view(kept), kept.camera, camera_T_ref[None]).camera_T_board[0]


def _as_view(sightings: MarkerSightings) -> CornerViews:
    """All sightings as one view of a board whose frame is ref."""
    n = len(sightings.centre_px)
    return CornerViews(np.array([0, n]), sightings.position_in_ref_m, sightings.centre_px, 1.0)


def _draws_needed(share: float) -> int:
    """So many that one of them is of inliers only, surely enough."""
    return math.ceil(math.log(1.0 - _SURE) / math.log(1.0 - min(max(share, 1e-3), 0.999) ** 3))
