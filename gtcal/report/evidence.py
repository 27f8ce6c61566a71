"""What a recording says of a calibration: the residual of every corner through the calibration's chain.

A calibration on disk keeps statistics, not residuals. They are computed again from a recording: its own, which gives
the residuals that the statistics were taken from, or another one, which makes them hold-out errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.clock.shift import on_clock_of
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Dropped, Views, synchronise
from gtcal.estimation.residuals import chain_residuals_px, norms
from gtcal.estimation.screening import keep_all, screen
from gtcal.estimation.told_apart import told_apart_by
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import IntArray
from gtcal.recordings.numbering import numbers_of
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import Calibration, ResidualStatistics
from gtcal.workflow import detected


@dataclass(frozen=True)
class CameraEvidence:
    """How the corners of one camera fit.

    camera: as calibrated.
    views: all V views with a mocap pose, with all their N corners.
    residuals_px: (N, 2) projection less measurement, NaN where the model has no pixel.
    keep_view, keep_corner: (V,), (N,) what the screening for gross errors left in.
    numbered: whether the views go by number, and not by time."""

    camera: Camera
    views: Views
    residuals_px: FloatArray
    keep_view: BoolArray
    keep_corner: BoolArray
    numbered: bool = False

    @cached_property
    def shown(self) -> BoolArray:
        """(N,) the corners that stay and have a pixel: M of them."""
        return self.keep_corner & np.isfinite(self.residuals_px).all(axis=1)

    @cached_property
    def corners_px(self) -> FloatArray:
        """(M, 2) where the corners that are shown were measured."""
        return self.views.corners_px[self.shown]

    @cached_property
    def kept_residuals_px(self) -> FloatArray:
        """(M, 2) of the corners that are shown."""
        return self.residuals_px[self.shown]

    @cached_property
    def lengths_px(self) -> FloatArray:
        """(M,) norms of ``kept_residuals_px``."""
        return norms(self.kept_residuals_px)

    @cached_property
    def rmse_of_views_px(self) -> FloatArray:
        """(V,) RMSE of each view over its corners that stay, of a view that was left out over all its corners; those
        without a pixel aside. Infinite where no corner is left."""
        counted = self.keep_corner | ~self.keep_view[self.views.view_of_corner]
        squares = norms(self.residuals_px) ** 2
        counted &= np.isfinite(squares)
        start = self.views.view_start[:-1]
        sums = np.add.reduceat(np.where(counted, squares, 0.0), start)
        counts = np.add.reduceat(counted.astype(np.int64), start)
        return np.where(counts > 0, np.sqrt(sums / np.maximum(counts, 1)), np.inf)

    @property
    def times_s(self) -> FloatArray:
        """(V,) since the first view; the images' numbers where they go by these."""
        stamps_ns: IntArray = self.views.stamps_ns
        if self.numbered:
            return numbers_of(stamps_ns).astype(np.float64)
        return (stamps_ns - stamps_ns[0]) * 1e-9

    @property
    def statistics(self) -> ResidualStatistics:
        """Of the corners that stay."""
        lengths_px = norms(self.residuals_px[self.keep_corner])
        return ResidualStatistics.of(lengths_px, int(self.keep_view.sum()))


@dataclass(frozen=True)
class Evidence:
    """The residuals of a recording under a calibration.

    changed_inputs: files of the recording that are not, or no longer, those that the calibration was computed from;
        None where the calibration or the recording does not say what files it has.
    dropped: views without a mocap pose, and what was gross."""

    recording: Path | None
    cameras: dict[str, CameraEvidence]
    changed_inputs: tuple[Path, ...] | None
    dropped: tuple[Dropped, ...]

    @property
    def is_hold_out(self) -> bool:
        """Whether these are data that the calibration has not seen."""
        return bool(self.changed_inputs)


def gather_evidence(calibration: Calibration, recording: Recording, *, progress: Progress = silent) -> Evidence:
    """The residuals of ``recording`` under ``calibration``; cameras with images only are detected first. Screened
    as the calibration's options say.

    Raises GtcalError where the two are of different rigs: another capture, board, set of cameras or image size."""
    _check_same_rig(calibration, recording)
    # With the recording's own lenses, as the calibration detected: what was found then is kept for them.
    recording = detected(_with_cameras(recording, list(calibration.cameras)), progress=progress)
    lenses = {name: calibrated.camera for name, calibrated in calibration.cameras.items()}
    estimate = calibration.estimate
    synchronised = told_apart_by(synchronise(replace(recording, cameras=lenses)), estimate)
    observations = on_clock_of(calibration, synchronised)
    screening = screen if calibration.provenance.options.get("screen", True) else keep_all
    screened = screening(observations.views, estimate)
    cameras = {
        name: CameraEvidence(
            camera=calibration.cameras[name].camera,
            views=views,
            residuals_px=chain_residuals_px(views, estimate),
            keep_view=screened.keep_view[name],
            keep_corner=screened.keep_corner[name],
            numbered=recording.numbered,
        )
        for name, views in observations.views.items()
    }
    _check_pixels(cameras)
    dropped = observations.dropped + screened.dropped(observations.views)
    return Evidence(recording.path, cameras, _changed_inputs(calibration, recording), dropped)


def _with_cameras(recording: Recording, names: list[str]) -> Recording:
    """The recording with these of its cameras only."""
    return replace(
        recording,
        cameras={name: recording.cameras[name] for name in names},
        detections={name: found for name, found in recording.detections.items() if name in names},
        images={name: images for name, images in recording.images.items() if name in names},
    )


def _check_pixels(cameras: dict[str, CameraEvidence]) -> None:
    for name, evidence in cameras.items():
        if not evidence.shown.any():
            raise GtcalError(
                f"camera {name!r}: the calibration places every corner of the recording outside of the lens's field; "
                "is it a recording of the calibrated rig?"
            )


def _check_same_rig(calibration: Calibration, recording: Recording) -> None:
    where = recording.path or "the recording"
    if recording.capture != calibration.capture:
        raise GtcalError(
            f"{where}: its capture is {recording.capture.value}, the calibration's {calibration.capture.value}; "
            "give a recording of the calibrated rig"
        )
    if recording.board.to_manifest() != calibration.board:
        raise GtcalError(
            f"{where}: its board ({recording.board.describe()}) is not the calibration's; body_T_board holds for "
            "the board it was found with"
        )
    for name, calibrated in calibration.cameras.items():
        if name not in recording.cameras:
            raise GtcalError(
                f"{where}: lacks camera {name!r} of the calibration; cameras: {', '.join(recording.cameras)}"
            )
        _check_same_size(str(where), calibrated.camera, recording.cameras[name])


def _check_same_size(where: str, calibrated: Camera, recorded: Camera) -> None:
    sizes = [(camera.image_width_px, camera.image_height_px) for camera in (calibrated, recorded)]
    if sizes[0] != sizes[1]:
        raise GtcalError(
            f"{where}: images of camera {calibrated.name!r} are {sizes[1][0]} x {sizes[1][1]} pixels, the calibration "
            f"is for {sizes[0][0]} x {sizes[0][1]}"
        )


def _changed_inputs(calibration: Calibration, recording: Recording) -> tuple[Path, ...] | None:
    known = {entry.sha256 for entry in calibration.provenance.inputs}
    if not known or not recording.inputs:
        return None
    return tuple(entry.path for entry in recording.inputs if entry.sha256 not in known)
