"""A calibration over successive recordings of the Lollypop: when it ceased to hold, and whether it is on its way."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy import special

from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import InputFile, write_text
from gtcal.plain import csv_cell
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import Images
from gtcal.results.calibration import Calibration, Provenance
from gtcal.results.presented import Presented
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.verdict import overall_verdict
from gtcal.verification.verification import ErrorStatistics, Verdict, Verification, VerificationOptions
from gtcal.verification.workflow import verify

SCHEMA_VERSION = 1
POOLED = "all cameras"
_FEWEST_FOR_TREND = 3
_SIGNIFICANCE = 0.05


@dataclass(frozen=True)
class Trend:
    """Whether a camera's RMSE grows or falls from recording to recording.

    camera: a name, or ``POOLED``.
    slope_per_recording: in ``unit``; NaN, like the rest, where fewer than three recordings tell.
    slope_sigma_per_recording: 1-sigma. p_value: that there is none, two-sided.
    significant: at 5 % over all trends of this unit together."""

    camera: str
    unit: Literal["px", "mm"]
    slope_per_recording: float
    slope_sigma_per_recording: float
    p_value: float
    significant: bool


@dataclass(frozen=True, repr=False)
class Drift(Presented):
    """names, verifications: one for each recording, in their order.

    first_failing: the place of the first recording whose verdict is fail, None where there is none."""

    names: tuple[str, ...]
    verifications: tuple[Verification, ...]
    trends: tuple[Trend, ...]
    options: VerificationOptions

    @property
    def first_failing(self) -> int | None:
        failing = [i for i, found in enumerate(self.verifications) if found.verdict is Verdict.FAIL]
        return failing[0] if failing else None

    @property
    def verdict(self) -> Verdict:
        """Over all recordings."""
        return overall_verdict(found.verdict for found in self.verifications)

    @property
    def cameras(self) -> tuple[str, ...]:
        """All that any recording has, in the order in which they first appear."""
        return tuple(dict.fromkeys(name for found in self.verifications for name in found.cameras))

    def series(self, camera: str, unit: Literal["px", "mm"]) -> tuple[ErrorStatistics | None, ...]:
        """A camera's statistics (or, for ``POOLED``, those of all) in every recording; None where it is not in it."""
        return tuple(_statistics(found, camera, unit) for found in self.verifications)


def verify_series(
    recordings: Sequence[tuple[str, LollypopRecording]],
    calibration: Calibration,
    options: VerificationOptions | None = None,
    *,
    progress: Progress = silent,
    inputs: tuple[InputFile, ...] = (),
) -> Drift:
    """Verify one calibration with several recordings, given with their names in the order in which they were taken.

    Raises GtcalError as ``verify`` does, naming the recording; where there is none, or one is given twice."""
    if not recordings:
        raise GtcalError("there are no recordings to verify with; give one or more")
    _check_distinct(recordings)
    options = options or VerificationOptions()
    verifications = []
    for done, (name, recording) in enumerate(recordings):
        progress("verifying", done, len(recordings))
        try:
            verifications.append(verify(recording, calibration, options, progress=progress, inputs=inputs))
        except GtcalError as error:
            raise GtcalError(f"{name}: {error}") from error
    progress("verifying", len(recordings), len(recordings))
    drift = Drift(tuple(name for name, _ in recordings), tuple(verifications), (), options)
    return Drift(drift.names, drift.verifications, _trends(drift), options)


def _check_distinct(recordings: Sequence[tuple[str, LollypopRecording]]) -> None:
    """By what was recorded, whatever the folder is called: the same twice would count as two of a series."""
    for (first, one), (second, other) in combinations(recordings, 2):
        if _stamps_of(one) == _stamps_of(other) and _same_motion(one, other):
            raise GtcalError(
                f"{second}: is the same recording as {first}: the same images, and the same motion of the Lollypop; "
                "give each recording once"
            )


def _same_motion(one: LollypopRecording, other: LollypopRecording) -> bool:
    a, b = one.device_body, other.device_body
    return np.array_equal(a.stamps_ns, b.stamps_ns) and np.array_equal(a.world_T_body, b.world_T_body)


def _stamps_of(recording: LollypopRecording) -> dict[str, list[int]]:
    """When each camera saw something."""
    seen: dict[str, CameraDetections | Images] = {**recording.images, **recording.detections}
    return {name: of_camera.stamps_ns.tolist() for name, of_camera in seen.items()}


def _statistics(found: Verification, camera: str, unit: Literal["px", "mm"]) -> ErrorStatistics | None:
    if camera == POOLED:
        return found.pooled_px if unit == "px" else found.pooled_mm
    if camera not in found.cameras:
        return None
    return found.cameras[camera].px if unit == "px" else found.cameras[camera].mm


def _trends(drift: Drift) -> tuple[Trend, ...]:
    names = (*drift.cameras, POOLED)
    units: tuple[Literal["px", "mm"], ...] = ("px", "mm")
    level = _SIGNIFICANCE / len(names)
    return tuple(
        _trend(name, unit, drift.series(name, unit), drift.options.confidence, level)
        for unit in units
        for name in names
    )


def _trend(
    camera: str,
    unit: Literal["px", "mm"],
    series: Sequence[ErrorStatistics | None],
    confidence: float,
    level: float,
) -> Trend:
    """The straight line through the RMSEs, each with the weight of its bounds. What the recordings scatter about it
    beyond their bounds (a headset is never worn twice the same) widens its uncertainty."""
    known = [(i, s) for i, s in enumerate(series) if s is not None and np.isfinite(s.rmse_high - s.rmse_low)]
    nan = float("nan")
    if len(known) < _FEWEST_FOR_TREND:
        return Trend(camera, unit, nan, nan, nan, False)
    x = np.array([i for i, _ in known], dtype=np.float64)
    rmse = np.array([s.rmse for _, s in known])
    width = np.array([s.rmse_high - s.rmse_low for _, s in known])
    sigma = np.maximum(width / (2.0 * special.ndtri(confidence)), 1e-9)
    slope, slope_sigma = _line(x, rmse, sigma)
    p_value = float(2.0 * special.stdtr(len(x) - 2, -abs(slope) / slope_sigma))
    return Trend(camera, unit, slope, slope_sigma, p_value, p_value < level)


def _line(x: FloatArray, y: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    """Slope and its 1-sigma, by weighted least squares."""
    A = np.stack([np.ones_like(x), x], axis=1) / sigma[:, None]
    covariance = np.linalg.inv(A.T @ A)
    estimate = covariance @ (A.T @ (y / sigma))
    scatter = float(((A @ estimate - y / sigma) ** 2).sum()) / (len(x) - 2)
    return float(estimate[1]), float(np.sqrt(covariance[1, 1] * max(scatter, 1.0)))


_COLUMNS = (
    "recording,camera,verdict,sightings,rmse_px,rmse_px_low,rmse_px_high,p95_px,worst_px,rmse_mm,rmse_mm_low,"
    "rmse_mm_high,finding"
)


def write_drift_csv(path: Path, drift: Drift) -> None:
    """Write a row per recording and camera, whole or not at all. Raises GtcalError where it can't be written."""
    lines = [_COLUMNS]
    for name, found in zip(drift.names, drift.verifications, strict=True):
        finding = csv_cell("; ".join(fault.sentence for fault in found.faults))
        for camera in found.cameras.values():
            px, mm = camera.px, camera.mm
            numbers = (px.rmse, px.rmse_low, px.rmse_high, px.p95, px.worst, mm.rmse, mm.rmse_low, mm.rmse_high)
            row = (f"{x:.6g}" if np.isfinite(x) else "" for x in numbers)
            texts = csv_cell(name), csv_cell(camera.camera), str(camera.verdict), str(camera.n_sightings)
            lines.append(",".join((*texts, *row, finding)))
    write_text(path, "\n".join(lines) + "\n")


def write_drift_json(path: Path, drift: Drift, provenance: Provenance) -> None:
    """Write the series, its trends and the first recording that fails, whole or not at all.

    Raises GtcalError where it can't be written."""
    write_text(path, json.dumps(drift_document(drift, provenance), indent=1, allow_nan=False) + "\n")


def drift_document(drift: Drift, provenance: Provenance) -> dict[str, Any]:
    """As it stands in drift.json."""
    document = {
        "gtcal_drift": SCHEMA_VERSION,
        "verdict": str(drift.verdict),
        "first_failing": None if drift.first_failing is None else drift.names[drift.first_failing],
        "recordings": [
            {
                "name": name,
                "verdict": str(found.verdict),
                "reasons": list(found.reasons),
                "findings": [fault.sentence for fault in found.faults],
                "cameras": {
                    camera: {unit: asdict(s) for unit in ("px", "mm") if (s := _statistics(found, camera, unit))}
                    for camera in (*found.cameras, POOLED)
                },
            }
            for name, found in zip(drift.names, drift.verifications, strict=True)
        ],
        "trends": [asdict(trend) for trend in drift.trends],
        "options": asdict(drift.options),
        "provenance": asdict(provenance)
        | {"inputs": [{"path": str(entry.path), "sha256": entry.sha256} for entry in provenance.inputs]},
    }
    found: dict[str, Any] = _without_nan(document)
    return found


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
