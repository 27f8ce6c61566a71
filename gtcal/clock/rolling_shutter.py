"""Rolling shutters: every corner is seen when its own row is exposed, and the mocap's body has moved on by then.

The corners are moved to where they would be had all rows been exposed at the image's stamp: by the difference of two
projections through the chain, at the two times. What is left over is the residual at the row's own time. How the body
moves meanwhile is a parabola through the mocap's poses around the image (``gtcal.clock.local_motion``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from factors.moments import chain
from gtcal.camera import FloatArray
from gtcal.clock.local_motion import parabolas
from gtcal.errors import GtcalError
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations, Views
from gtcal.recordings.capture import RefMotion

_STEP_S = 1e-4  # of the central difference for a velocity in the image


def rolling(observations: Observations) -> tuple[str, ...]:
    """The cameras with a rolling shutter."""
    return tuple(name for name, views in observations.views.items() if views.camera.rolling_shutter is not None)


def without_readout(observations: Observations) -> tuple[str, ...]:
    """The cameras with a rolling shutter whose readout time is to be found."""
    return tuple(name for name in rolling(observations) if readout_s_of(observations.views[name]) is None)


def readout_s_of(views: Views) -> float | None:
    """The readout time of a camera; None where it is to be found, or where there is none."""
    shutter = views.camera.rolling_shutter
    return None if shutter is None else shutter.readout_s


def with_readouts(observations: Observations, readout_s: Mapping[str, float]) -> Observations:
    """The observations with these cameras' readout times."""
    views = dict(observations.views)
    for name, seconds in readout_s.items():
        camera = views[name].camera
        assert camera.rolling_shutter is not None
        shutter = replace(camera.rolling_shutter, readout_s=seconds)
        views[name] = replace(views[name], camera=replace(camera, rolling_shutter=shutter))
    return replace(observations, views=views)


def straightened(observations: Observations, estimate: Estimate) -> Observations:
    """The observations with the corners of every rolling-shutter camera where they would be at their image's stamp.

    Raises GtcalError where a readout time is unknown."""
    views = dict(observations.views)
    for name in rolling(observations):
        shifts_px = row_shifts_px(views[name], estimate, observations.motion)
        views[name] = replace(views[name], corners_px=views[name].corners_px - shifts_px)
    return replace(observations, views=views)


def row_shifts_px(views: Views, estimate: Estimate, motion: RefMotion) -> FloatArray:
    """(N, 2) by how much each corner moves from the image's stamp to the exposure of its row; 0 where it has no pixel.

    Raises GtcalError where the readout time is unknown."""
    readout_s = readout_s_of(views)
    if readout_s is None:
        raise GtcalError(
            f"camera {views.camera.name!r} has a rolling shutter without readout_ms; give it in the manifest, or find "
            "it with --clock estimate"
        )
    moving = _parabolas(views, motion, readout_s)
    after_s = readout_s * _readout_shares(views)
    still = _projected(views, estimate, moving, np.zeros(views.n_corners))
    return np.nan_to_num(_projected(views, estimate, moving, after_s) - still)


def readout_columns_px_per_s(views: Views, estimate: Estimate, motion: RefMotion) -> FloatArray:
    """(N, 2) by how much each corner moves for every second of readout; 0 where it has no pixel."""
    readout_s = readout_s_of(views) or 0.0
    moving, shares = _parabolas(views, motion, readout_s), _readout_shares(views)
    before, after = (_projected(views, estimate, moving, readout_s * shares + dt) for dt in (-_STEP_S, _STEP_S))
    return np.nan_to_num((after - before) / (2.0 * _STEP_S) * shares[:, None])


def _readout_shares(views: Views) -> FloatArray:
    """(N,) of the corners of a camera with a rolling shutter."""
    shutter = views.camera.rolling_shutter
    assert shutter is not None
    return shutter.readout_shares(views.corners_px[:, 1], views.camera.image_height_px)


def _parabolas(views: Views, motion: RefMotion, readout_s: float) -> FloatArray:
    """(V, 2, 6) of the body's motion during each view's readout."""
    shutter = views.camera.rolling_shutter
    assert shutter is not None
    first_s = -0.5 * readout_s if shutter.stamped_row == "middle" else 0.0
    return parabolas(motion, views.stamps_ns, first_s=first_s, last_s=first_s + readout_s)


def _projected(views: Views, estimate: Estimate, moving: FloatArray, after_s: FloatArray) -> FloatArray:
    """(N, 2) of the corners so long (N,) after their view's stamp; NaN where they have no pixel."""
    X, camera_T_ref = estimate.body_T_board, estimate.camera_T_ref[views.camera.name]
    in_body_m = views.corners_m @ X[:3, :3].T + X[:3, 3]
    view, dt = views.view_of_corner, after_s[:, None]
    moved = dt * moving[view, 0] + dt**2 * moving[view, 1]
    in_body_m = Rotation.from_rotvec(moved[:, :3]).apply(in_body_m) + moved[:, 3:]
    camera_T_body = chain(camera_T_ref, views.ref_T_body, np.eye(4))[view]
    in_camera_m = np.einsum("nij,nj->ni", camera_T_body[:, :3, :3], in_body_m) + camera_T_body[:, :3, 3]
    return views.camera.model.project(in_camera_m, estimate.theta[views.camera.name])[0]
