"""How far the intrinsics moved from what is stated, in sigmas of it, in pixels, and in what it did to the camera."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import special

from gtcal.camera import Camera, FloatArray
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.lens_sigmas import lens_sigmas, moves_px
from gtcal.estimation.linear import scaled_inverse
from gtcal.estimation.options import CalibrationOptions
from gtcal.results.calibration import pose_moved
from gtcal.results.covariance import JointCovariance
from gtcal.results.lens_move import LensMove

GROUPS = {"focal length": slice(0, 2), "principal point": slice(2, 4), "distortion": slice(4, None)}

UNLIKELY = 1e-4
"""That a group of intrinsics moves so far by chance, if the sigmas of what is stated are true."""


def lens_moves(
    cameras: Mapping[str, Camera], estimate: Estimate, joint: JointCovariance, options: CalibrationOptions
) -> dict[str, tuple[LensMove, ...]]:
    """By camera. cameras: as stated. joint: the estimate's covariance, by which poses follow intrinsics: to first order
    a camera moves by C_ytheta C_thetatheta^-1 where its intrinsics move by 1.

    Raises numpy.linalg.LinAlgError where the intrinsics' covariance is singular."""
    found = {}
    first = 6 + 6 * len(cameras)
    follow = joint.matrix[:, first:] @ scaled_inverse(joint.matrix[first:, first:])
    for name, camera in cameras.items():
        of_theta = joint.columns_of_theta(name)
        of_pose = follow[joint.columns_of_camera_T_ref(name), of_theta.start - first : of_theta.stop - first]
        change = estimate.theta[name] - camera.theta
        sigmas = lens_sigmas(camera, options)
        found[name] = tuple(
            _move(group, columns, change, sigmas, camera, estimate.camera_T_ref[name], of_pose)
            for group, columns in GROUPS.items()
        )
    return found


def _move(
    group: str,
    columns: slice,
    change: FloatArray,
    sigmas: FloatArray,
    camera: Camera,
    camera_T_ref: FloatArray,
    of_pose: FloatArray,
) -> LensMove:
    """change, sigmas: (K,). of_pose: (6, K) by how much the pose follows."""
    xi = of_pose[:, columns] @ change[columns]
    pixels = np.linalg.norm(moves_px(camera)[:, :, columns] @ change[columns], axis=1)
    largest_px = float(pixels.max()) if len(pixels) else 0.0
    in_sigmas = float(np.sqrt(np.mean((change / sigmas)[columns] ** 2)))
    return LensMove(group, in_sigmas, largest_px, *pose_moved(camera_T_ref, xi))


def lens_warnings(cameras: Mapping[str, Camera], moves: Mapping[str, tuple[LensMove, ...]]) -> tuple[str, ...]:
    """A line on the cameras whose intrinsics ended further from what is stated than its sigmas allow."""
    far = {
        name: [move for move in of_camera if _is_far(move, cameras[name])]
        for name, of_camera in moves.items()
        if any(_is_far(move, cameras[name]) for move in of_camera)
    }
    if not far:
        return ()
    name, worst = max(
        ((name, move) for name, of_camera in far.items() for move in of_camera), key=lambda found: found[1].sigmas
    )
    names = ", ".join(map(repr, far))
    return (
        f"the intrinsics of {names} ended far from where they started (at worst the {worst.group} of {name!r}, by "
        f"{worst.sigmas:.1f} sigma or {worst.largest_px:.2g} px, which moved the camera by {worst.camera_mm:.2g} mm): "
        "state others, or larger parameter_sigmas, or find them with --calibrate-intrinsics",
    )


def _is_far(move: LensMove, camera: Camera) -> bool:
    size = len(camera.theta[GROUPS[move.group]])
    return move.sigmas**2 * size > float(special.chdtri(size, UNLIKELY))
