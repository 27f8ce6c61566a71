"""When a sighting was, by the mocap's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration, Clock
from gtcal.verification.faults import find_clock_offset
from gtcal.verification.verification import Sightings, VerificationOptions

STEPS = 3
"""Rounds of looking at the mocap at corrected times; each leaves a hundredth of what the one before left."""


@dataclass(frozen=True)
class SightingTimes:
    """From the cameras' stamps to the mocap's clock.

    clock: the calibration's, where it is to be applied. more_s: added on top, for all cameras."""

    clock: Clock | None
    more_s: float = 0.0

    def mocap_ns(self, camera: Camera, stamps_ns: IntArray, rows_px: FloatArray | None = None) -> IntArray:
        """(N,) the mocap's time of images stamped so; with ``rows_px`` (N,), of the exposure of these rows.

        Raises GtcalError where a rolling shutter's readout time is unknown."""
        moved_ns = stamps_ns if self.clock is None else self.clock.mocap_ns(camera.name, stamps_ns)
        after_s = np.full(len(stamps_ns), self.more_s)
        if camera.rolling_shutter is not None and rows_px is not None:
            if camera.rolling_shutter.readout_s is None:
                raise GtcalError(
                    f"camera {camera.name!r}: the calibration knows no readout time of its rolling shutter; calibrate "
                    "with readout_ms in the manifest, or with --clock estimate"
                )
            shares = camera.rolling_shutter.readout_shares(rows_px, camera.image_height_px)
            after_s = after_s + camera.rolling_shutter.readout_s * shares
        return moved_ns + np.rint(1e9 * after_s).astype(np.int64)


def sighting_times(calibration: Calibration, options: VerificationOptions) -> SightingTimes:
    """What the calibration found, unless the stamps are to be trusted."""
    clock = calibration.clock
    return SightingTimes(clock if clock is not None and clock.corrected and options.clock != "trust" else None)


def remaining_offset_s(
    sightings: Mapping[str, Sightings], calibration: Calibration, options: VerificationOptions
) -> tuple[float, float]:
    """What these sightings want added to their times, in s, with its 1-sigma.

    Raises GtcalError where there are too few, or the device did not move."""
    found = find_clock_offset(sightings, calibration, options)
    if found is None or not found[1] < np.inf:
        raise GtcalError("the sightings are too few, or too still, to find the clock offset; move the device faster")
    return found
