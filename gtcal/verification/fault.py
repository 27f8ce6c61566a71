"""A finding: a correction that explains the errors of a verification better than chance does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from gtcal.camera import FloatArray

if TYPE_CHECKING:
    pass


FaultKind = Literal["markers_moved", "camera_moved", "lens_changed", "device_centre", "clock_offset"]
"""markers_moved: a rigid correction that all cameras share: the markers of the headset (or, with fixed cameras, the
mocap's world) moved against the cameras. camera_moved: one camera's own. lens_changed: one camera's focal length, as
when it warms up. device_centre: the Lollypop's centre is not where its body's origin is. clock_offset: the stamps of
all cameras are off by the same time."""


MAIN_CAUSE = 0.5
"""A finding that explains this share of the squared error, or more, is its main cause."""


@dataclass(frozen=True)
class Fault:
    """A correction that explains the errors significantly better than chance.

    camera: for camera_moved and lens_changed.
    correction: (4, 4). markers_moved: camera_T_ref * correction is every camera's better extrinsic. camera_moved:
        correction * camera_T_ref is this camera's. device_centre: a shift in the device's body. Else none.
    focal_share: for lens_changed, by what share of itself the focal length is larger; else 0.
    offset_s: for clock_offset, what is to be added to the cameras' stamps; else 0.
    shift_mm, turn_deg: its size: of the ref body's origin, of the camera's centre, or of the device's centre.
    shift_sigma_mm, turn_sigma_deg: 1-sigma of the same (of the most uncertain direction).
    p_value: of the test that there is no such correction, before accounting for the number of tests.
    rmse_before_px, rmse_after_px: e_2D RMSE of the sightings it concerns, without and with the correction.
    also_possible: other explanations that the data do not tell apart from this one.
    sentence: for people, as "camera 'cam2' moved by 1.02 mm and 0.013 deg"."""

    kind: FaultKind
    camera: str | None
    correction: FloatArray
    focal_share: float
    offset_s: float
    shift_mm: float
    turn_deg: float
    shift_sigma_mm: float
    turn_sigma_deg: float
    p_value: float
    rmse_before_px: float
    rmse_after_px: float
    also_possible: tuple[str, ...]
    sentence: str

    @property
    def explained_share(self) -> float:
        """Of the squared error, 0 to 1."""
        return 1.0 - (self.rmse_after_px / self.rmse_before_px) ** 2 if self.rmse_before_px > 0.0 else 0.0

    @property
    def caveat(self) -> str:
        """What to mind where the finding is real but explains less than half of the squared error; else empty."""
        if self.explained_share >= MAIN_CAUSE:
            return ""
        return (
            f"it explains only {self.explained_share:.0%} of the squared error: the rest is noise, or another cause "
            "behind it, such as a wrong lens"
        )
