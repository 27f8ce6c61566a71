"""Whether the recorded motion can tell X and Y_c apart at all.

Camera extrinsic and board-to-marker transform are both found only if ref_T_body turns about two different axes
(Tsai and Lenz 1989, lemma 1 to 3). What a poorer motion leaves open is named here before anything is inverted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError

MIN_TURN_RAD = np.deg2rad(1.0)
"""Less than this rms turn is no turn: mocap noise and a hand that tries to hold still come near it."""

WEAK_TURN_RAD = np.deg2rad(8.0)
"""Below this the second axis is there but weak."""


@dataclass(frozen=True)
class Turning:
    """How much the board's body turned in ref.

    axes_in_body: (3, 3) unit rows, the axis of most turning first.
    rms_rad: (3,) root mean square turn about each axis, from the mean attitude."""

    axes_in_body: FloatArray
    rms_rad: FloatArray


def turning(ref_T_body_by_camera: Iterable[FloatArray]) -> Turning:
    """Pooled over cameras, each about its own mean attitude: what counts are turns between views of one camera."""
    turns = np.concatenate([_turns(ref_T_body[:, :3, :3]) for ref_T_body in ref_T_body_by_camera])
    variances, axes = np.linalg.eigh(turns.T @ turns / len(turns))
    return Turning(axes.T[::-1], np.sqrt(np.maximum(variances[::-1], 0.0)))


def _turns(ref_R_body: FloatArray) -> FloatArray:
    rotations = Rotation.from_matrix(ref_R_body)
    turns: FloatArray = (rotations.mean().inv() * rotations).as_rotvec()
    return turns


def check_turning(found: Turning) -> str | None:
    """A warning where the motion is weak, None where it is rich.

    Raises GtcalError where it is degenerate, naming what cannot be found."""
    first, second = np.rad2deg(found.rms_rad[:2])
    if found.rms_rad[0] < MIN_TURN_RAD:
        raise GtcalError(
            f"the motion is a pure translation (turns of {first:.2f} deg rms): the position of the board in its "
            "body, and with it every camera's position, cannot be found; turn the board (or the platform) about "
            "two different axes while you record"
        )
    axis = _words(found.axes_in_body[0])
    if found.rms_rad[1] < MIN_TURN_RAD:
        raise GtcalError(
            f"the motion turns about a single axis, {axis} of the body frame ({first:.1f} deg rms, {second:.2f} about "
            "any other): the translation of the board along that axis, and with it every camera's position, cannot "
            "be found; turn the board (or the platform) about a second axis too"
        )
    if found.rms_rad[1] < WEAK_TURN_RAD:
        return (
            f"the motion turns mostly about one axis, {axis} of the body frame ({first:.1f} deg rms, {second:.1f} "
            "about the next): the translation along it is weakly determined; turn about a second axis by 20 deg or more"
        )
    return None


def _words(axis: FloatArray) -> str:
    signed = axis * np.sign(axis[np.argmax(np.abs(axis))])
    return "(" + ", ".join(f"{component:.2f}" for component in signed) + ")"
