"""What to simulate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from gtcal.board import PAPER_A2, Board
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.simulation.corners import CornerNoise
from gtcal.simulation.noise import MocapNoise
from gtcal.simulation.rendering import ImageOptions
from gtcal.simulation.rig import Rig, quest3_like_rig
from gtcal.simulation.visibility import ViewLimits
from gtcal.simulation.waypoints import MotionKind

IntrinsicsGiven = Literal["true", "perturbed", "none"]
"""The intrinsics that the recording states: the true ones, wrong ones, or none."""


@dataclass(frozen=True)
class IntrinsicsError:
    """How wrong perturbed intrinsics are, 1-sigma: the focal length and each distortion coefficient by a share
    of itself, the principal point in px."""

    focal_share: float = 0.005
    centre_px: float = 3.0
    distortion_share: float = 0.05


@dataclass(frozen=True)
class SimulationOptions:
    """A recording to simulate.

    duration_s, camera_rate_hz: the camera takes frames at this rate, all cameras at the same moments.
    n_frames: keep this many of them, evenly spread, as a person picks key frames; None for all.
    limits, corners: what the detector reads and how well, where detections stand in for images.
    mocap_rate_hz: the mocap samples at its own rate, at other moments than the cameras.
    swap_share, swap_duration_s: share of the frames spoilt by grossly wrong mocap poses, and how long one lasts.
    clock_offset_s: the stamps of the cameras run ahead of the mocap's clock: one number for all, or one each.
    intrinsics: which ones the recording states.
    images: how images come about, where they are rendered.
    Raises GtcalError where a value is out of range.
    """

    rig: Rig = field(default_factory=quest3_like_rig)
    board: Board = PAPER_A2
    capture: Capture = Capture.TRACKED_PLATFORM
    motion: MotionKind = "free"
    duration_s: float = 60.0
    camera_rate_hz: float = 30.0
    n_frames: int | None = 80
    limits: ViewLimits = field(default_factory=ViewLimits)
    corners: CornerNoise = field(default_factory=CornerNoise)
    mocap_rate_hz: float = 120.0
    mocap: MocapNoise = field(default_factory=MocapNoise)
    swap_share: float = 0.0
    swap_duration_s: float = 0.1
    clock_offset_s: float | tuple[float, ...] = 0.0
    intrinsics: IntrinsicsGiven = "true"
    intrinsics_error: IntrinsicsError = field(default_factory=IntrinsicsError)
    images: ImageOptions = field(default_factory=ImageOptions)

    def __post_init__(self) -> None:
        for name in ("duration_s", "camera_rate_hz", "mocap_rate_hz", "swap_duration_s"):
            if not getattr(self, name) > 0.0:
                raise GtcalError(f"{name} is {getattr(self, name)}; expected a number above 0")
        self._check_shares()
        self._check_noise()
        available = self.n_frames_taken
        if not 1 <= (available if self.n_frames is None else self.n_frames) <= available:
            raise GtcalError(
                f"n_frames is {self.n_frames}; expected 1 to {available}, what {self.duration_s:g} s at "
                f"{self.camera_rate_hz:g} Hz have: lengthen duration_s or ask for fewer"
            )
        if len(self.clock_offsets_s) != len(self.rig.cameras):
            raise GtcalError(
                f"clock_offset_s has {len(self.clock_offsets_s)} values for {len(self.rig.cameras)} cameras; "
                "give one number, or one for each camera"
            )

    def _check_shares(self) -> None:
        shares = {
            "swap_share": self.swap_share,
            "mocap.gap_share": self.mocap.gap_share,
            "corners.missed_share": self.corners.missed_share,
            "corners.wrong_tag_share": self.corners.wrong_tag_share,
            "corners.wrong_corner_share": self.corners.wrong_corner_share,
        }
        for name, share in shares.items():
            if not 0.0 <= share < 1.0:
                raise GtcalError(f"{name} is {share}; expected a share, from 0 to below 1")

    def _check_noise(self) -> None:
        limits = {
            "corners.pixel_px": (self.corners.pixel_px, 100.0),
            "mocap.translation_mm": (self.mocap.translation_mm, 1000.0),
            "mocap.rotation_deg": (self.mocap.rotation_deg, 180.0),
            "mocap.correlation_s": (self.mocap.correlation_s, math.inf),
            "mocap.jitter_s": (self.mocap.jitter_s, 0.05),
            "images.blur_px": (self.images.blur_px, 20.0),
            "images.exposure_s": (self.images.exposure_s, 0.2),
            "images.dark_noise_grey": (self.images.dark_noise_grey, 255.0),
            "images.light_noise_grey": (self.images.light_noise_grey, 255.0),
        }
        for name, (value, most) in limits.items():
            if not 0.0 <= value <= most:
                raise GtcalError(f"{name} is {value}; expected 0 to {most:g}")

    @property
    def n_frames_taken(self) -> int:
        """Frames that a camera takes, before ``n_frames`` of them are kept."""
        return int(self.duration_s * self.camera_rate_hz)

    @property
    def clock_offsets_s(self) -> tuple[float, ...]:
        """One for each camera."""
        if isinstance(self.clock_offset_s, tuple):
            return self.clock_offset_s
        return (self.clock_offset_s,) * len(self.rig.cameras)
