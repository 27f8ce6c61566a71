"""A rig over months: what its calibrations and verifications found, each since the last accepted calibration; which of
it is no chance any more, and when it will leave the tolerance."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.fleet import index
from gtcal.fleet.control_chart import FEWEST, Chart, autocorrelation_of, chart
from gtcal.fleet.jobs import utc
from gtcal.fleet.measures import BOARD, RIG, Pose, as_pose
from gtcal.fleet.record import Record
from gtcal.fleet.store import Store
from gtcal.fleet.trend import Change, DaysLeft, change_of, days_left, drift_tolerance
from gtcal.results.calibration import PoseEstimate
from gtcal.verification.verification import VerificationOptions

if TYPE_CHECKING:
    import pandas

RUN_LENGTH = 1000.0
"""Where nothing has changed, all charts of a store together give one false alarm in so many rounds, in each of which
every rig is recorded once."""

DAY_NS = 86_400_000_000_000

VECTORS: dict[str, tuple[str, ...]] = {
    "bias": ("bias_x_px", "bias_y_px"),
    "radial bias": ("bias_radial_px",),
    "turned bias": ("bias_tangential_px",),
    "place": ("moved_x_mm", "moved_y_mm", "moved_z_mm"),
    "attitude": ("turned_x_deg", "turned_y_deg", "turned_z_deg"),
    "focal length": ("focal_percent",),
}
"""What is followed of each camera: by name, its quantities, the first two as verifications see it, and the rest as
calibrations find it against the accepted one."""

COLUMNS = (
    "rig",
    "recording",
    "kind",
    "taken_utc",
    "verdict",
    "camera",
    "quantity",
    "value",
    "sigma",
    "key",
    "created_utc",
    "gtcal_version",
)
"""Of the table of measures."""

_MOVED = VECTORS["place"]
_TURNED = VECTORS["attitude"]


@dataclass(frozen=True)
class Event:
    """A recording of a rig: its record, what was measured, and what there was to say.

    measures: value and sigma (NaN where nobody knows) by camera and quantity."""

    record: Record
    measures: Mapping[tuple[str, str], tuple[float, float]]
    poses: Mapping[str, Pose]
    remarks: tuple[str, ...]

    @property
    def taken_ns(self) -> int:
        assert self.record.taken_ns is not None
        return self.record.taken_ns


@dataclass(frozen=True)
class Series:
    """What is followed of a camera since the accepted calibration: ``what`` of ``VECTORS``, N values of K quantities.

    days: (N,) since 1970. values, sigmas: (N, K)."""

    camera: str
    what: str
    days: FloatArray
    values: FloatArray
    sigmas: FloatArray

    @property
    def quantities(self) -> tuple[str, ...]:
        return VECTORS[self.what]

    @property
    def unit(self) -> str:
        return {"percent": "%"}.get(unit := self.quantities[0].rsplit("_", 1)[1], unit)


@dataclass(frozen=True)
class Finding:
    """A camera that is no longer what it was. chart: the one that says so. alarm_ns: since when it says so. change: how
    it changed; None where that is not clear. left: of a drift, until its tolerance is left."""

    camera: str
    what: str
    chart: Chart
    alarm_ns: int
    change: Change | None
    unit: str
    tolerance: str
    left: DaysLeft | None

    def sentence(self, rig: str) -> str:
        """For people."""
        called = f"{'the board' if self.camera == BOARD else self.camera} of {rig}"
        change = self.change
        if change is None or not change.significant:
            return f"{called}: its {self.what} is no longer what it was (noticed {_date(self.alarm_ns)})"
        since = _date(round(change.since_day * DAY_NS))
        if change.kind == "step":
            return (
                f"{called}: its {self.what} changed by {change.rate:.2g} ± {change.rate_sigma:.1g} {self.unit} "
                f"at once, before {since}"
            )
        drifts = (
            f"{called} drifts: its {self.what} by {change.rate:.2g} ± {change.rate_sigma:.1g} {self.unit} a day since "
            f"{since}"
        )
        return f"{drifts}; {self._outlook}" if self.left is not None else drifts

    @property
    def _outlook(self) -> str:
        left = self.left
        assert left is not None
        if not np.isfinite(left.middle):
            return f"it may never leave the tolerance of {self.tolerance}"
        if left.high < 1.0:
            return f"it leaves the tolerance of {self.tolerance} now"
        high = f"to {left.high:.0f}" if np.isfinite(left.high) else "or never"
        return (
            f"it will leave the tolerance of {self.tolerance} in about {left.middle:.0f} days ({left.low:.0f} {high})"
        )


def _date(stamp_ns: int) -> str:
    return f"{utc(stamp_ns):%-d %b %Y}"


Status = Literal["fails", "changed", "can't tell", "holds", "not verified"]
"""fails: the last verification says so, or found what moved. changed: a chart says that it is no longer what it was,
though the last verification may pass. can't tell: the last verification was inconclusive."""


@dataclass(frozen=True)
class History:
    """A rig's history. events: in order of time. accepted: the calibration in use, None where there is none. series:
    since then. findings: what a chart says of it. n_watched: so many charts of the store are watched together.
    autocorrelation: of values that follow each other, over the store. failures: the recordings without a result."""

    rig: str
    events: tuple[Event, ...]
    accepted: Event | None
    series: tuple[Series, ...]
    charts: Mapping[tuple[str, str], tuple[Chart, ...]]
    findings: tuple[Finding, ...]
    n_watched: int
    autocorrelation: float
    failures: tuple[Record, ...]

    @property
    def verifications(self) -> tuple[Event, ...]:
        return tuple(event for event in self.events if event.record.kind == "verify")

    @property
    def calibrations(self) -> tuple[Event, ...]:
        return tuple(event for event in self.events if event.record.kind == "calibrate")

    @cached_property
    def cameras(self) -> tuple[str, ...]:
        """All that any recording has, in the order in which they first appear."""
        names = (camera for event in self.events for camera, _ in event.measures if camera not in (RIG, BOARD))
        return tuple(dict.fromkeys(names))

    @property
    def last_verified(self) -> Event | None:
        """The last verification of the calibration in use."""
        since = self.accepted.taken_ns if self.accepted is not None else 0
        later = [event for event in self.verifications if event.taken_ns >= since]
        return later[-1] if later else None

    @property
    def status(self) -> Status:
        last = self.last_verified
        if last is not None and last.record.verdict == "fail":
            return "fails"
        if self.findings:
            return "changed"
        if last is None:
            return "not verified"
        return "holds" if last.record.verdict == "pass" else "can't tell"

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is to be said of it: what the charts found, the likeliest of each camera first, and what the last
        verification makes of it."""
        lines = [finding.sentence(self.rig) for finding in self.findings]
        last = self.last_verified
        if last is not None and (lines or last.record.verdict == "fail"):
            lines += [f"{self.rig}, {last.record.name}: {remark}" for remark in last.remarks[:2]]
        return tuple(lines)

    def frame(self) -> pandas.DataFrame:
        """All measures: a row per recording, camera and quantity."""
        return frame_of([self])


def frame_of(histories: Sequence[History]) -> pandas.DataFrame:
    """All measures of several rigs: a row per rig, recording, camera and quantity, with its provenance. Raises
    GtcalError where pandas isn't installed."""
    try:
        import pandas
    except ImportError:
        raise GtcalError("histories as tables need pandas: pip install 'gtcal[fleet]'") from None
    rows = [
        (
            history.rig,
            event.record.name,
            event.record.kind,
            utc(event.taken_ns),
            event.record.verdict,
            camera,
            quantity,
            value,
            sigma,
            event.record.key,
            event.record.created_utc,
            event.record.versions.get("gtcal", ""),
        )
        for history in histories
        for event in history.events
        for (camera, quantity), (value, sigma) in event.measures.items()
    ]
    return pandas.DataFrame(rows, columns=COLUMNS)


def histories(store: Store, *, run_length: float = RUN_LENGTH) -> dict[str, History]:
    """Of all rigs of a store, whose charts are watched together. Raises GtcalError where the index can't be read."""
    with index.opened_index(store.index_path) as connection:
        parts = {rig: _Part.of(store, connection, rig) for rig in index.rigs(connection)}
    series = [one for part in parts.values() for one in part.series]
    watched = [one.values[:, axis] for one in series for axis in range(one.values.shape[1]) if len(one.days) >= FEWEST]
    autocorrelation = autocorrelation_of(watched)
    of_each = run_length * max(len(watched), 1)
    return {rig: _history(part, of_each, autocorrelation, len(watched)) for rig, part in parts.items()}


def history(store: Store, rig: str, *, run_length: float = RUN_LENGTH) -> History:
    """Of one rig. Raises GtcalError where the store has none of this name."""
    found = histories(store, run_length=run_length)
    if rig not in found:
        raise GtcalError(f"{store.path}: has no rig {rig!r}; rigs: {', '.join(found) or 'none yet'}")
    return found[rig]


@dataclass(frozen=True)
class _Part:
    """A rig's events and series, before the charts of all are drawn."""

    rig: str
    events: tuple[Event, ...]
    accepted: Event | None
    series: tuple[Series, ...]
    failures: tuple[Record, ...]
    tolerance_px: float
    tolerance_mm: float

    @staticmethod
    def of(store: Store, connection: sqlite3.Connection, rig: str) -> _Part:
        records = list(index.records(connection, rig=rig))
        events = tuple(_events(connection, [(n, r) for n, r in records if r.state == "done" and r.kind != "drift"]))
        accepted = _accepted(events, store.accepted_names(rig))
        since = accepted.taken_ns if accepted is not None else 0
        later = [event for event in events if event.taken_ns >= since]
        if accepted is not None:
            later = [_against(event, accepted) for event in later]
        verified = [event.record for event in later if event.record.kind == "verify"]
        options = verified[-1].options if verified else {}
        return _Part(
            rig,
            tuple(event if event.taken_ns < since else _against(event, accepted) for event in events)
            if accepted is not None
            else events,
            accepted,
            tuple(_series(later)),
            tuple(record for _, record in records if record.state != "done"),
            float(options.get("max_rmse_px", VerificationOptions.max_rmse_px)),
            float(options.get("max_rmse_mm", VerificationOptions.max_rmse_mm)),
        )


def _events(connection: sqlite3.Connection, records: Sequence[tuple[int, Record]]) -> Iterator[Event]:
    numbers = [number for number, _ in records]
    measures: dict[int, dict[tuple[str, str], tuple[float, float]]] = {number: {} for number in numbers}
    poses: dict[int, dict[str, Pose]] = {number: {} for number in numbers}
    remarks: dict[int, list[str]] = {number: [] for number in numbers}
    for number, camera, quantity, value, sigma in index.rows_of(connection, "measure", numbers):
        measures[number][camera, quantity] = value, float("nan") if sigma is None else sigma
    for number, what, matrix, covariance in index.rows_of(connection, "pose", numbers):
        poses[number][what] = as_pose(what, json.loads(matrix), None if covariance is None else json.loads(covariance))
    for number, _, text in index.rows_of(connection, "remark", numbers):
        remarks[number].append(text)
    for number, record in records:
        if record.taken_ns is not None:
            yield Event(record, measures[number], poses[number], tuple(remarks[number]))


def _accepted(events: Sequence[Event], named: frozenset[str]) -> Event | None:
    """The last accepted calibration: the first, or one that was said to be."""
    made = [event for event in events if event.record.kind == "calibrate"]
    chosen = [e for place, e in enumerate(made) if place == 0 or e.record.accept or e.record.name in named]
    return chosen[-1] if chosen else None


def _against(event: Event, accepted: Event) -> Event:
    """A calibration with how its cameras moved against the accepted one; any other event as it is."""
    if event.record.kind != "calibrate":
        return event
    more = dict(event.measures)
    for what, pose in event.poses.items():
        if what in accepted.poses:
            more |= {(what, name): found for name, found in _moved(pose, accepted.poses[what], event is accepted)}
    for (camera, quantity), (value, sigma) in event.measures.items():
        if quantity == "fx" and (camera, "fx") in accepted.measures:
            before, before_sigma = accepted.measures[camera, "fx"]
            both = float(np.hypot(sigma, before_sigma))
            more[camera, "focal_percent"] = 100.0 * (value / before - 1.0), 100.0 * both / before
    return replace(event, measures=more)


def _moved(pose: Pose, accepted: Pose, same: bool) -> Iterator[tuple[str, tuple[float, float]]]:
    """By how much a camera moved, in mm along the axes of ref, and turned, in deg about its own, with 1-sigma by both
    covariances; the board likewise, in its body."""
    now, before = _in_ref(pose), _in_ref(accepted)
    place_mm = 1e3 * (now.a_T_b[:3, 3] - before.a_T_b[:3, 3])
    turn_deg = np.rad2deg(Rotation.from_matrix(before.a_T_b[:3, :3].T @ now.a_T_b[:3, :3]).as_rotvec())
    sigma_mm = _both(now.position_of_b_in_a_sigma_mm, before.position_of_b_in_a_sigma_mm)
    sigma_deg = _both(now.rotation_sigma_deg, before.rotation_sigma_deg)
    for names, values, sigmas in ((_MOVED, place_mm, sigma_mm), (_TURNED, turn_deg, sigma_deg)):
        for name, value, sigma in zip(names, values, sigmas, strict=True):
            yield name, (float(value), 0.0 if same else float(sigma))


def _in_ref(pose: Pose) -> PoseEstimate:
    """ref_T_camera with its covariance, or body_T_board."""
    if pose.what == BOARD:
        return PoseEstimate(pose.matrix, pose.covariance)
    if pose.covariance is None:
        return PoseEstimate(inverse(pose.matrix), None)
    import gtsam

    adjoint = gtsam.Pose3(pose.matrix).AdjointMap()  # (a_T_b Exp(xi))^-1 = b_T_a Exp(-Ad xi)
    return PoseEstimate(inverse(pose.matrix), adjoint @ pose.covariance @ adjoint.T)


def _both(one: FloatArray | None, other: FloatArray | None) -> FloatArray:
    return np.full(3, np.nan) if one is None or other is None else np.hypot(one, other)


def _series(events: Sequence[Event]) -> Iterator[Series]:
    cameras = dict.fromkeys(camera for event in events for camera, _ in event.measures if camera != RIG)
    for camera in cameras:
        for what, quantities in VECTORS.items():
            having = [event for event in events if all((camera, name) in event.measures for name in quantities)]
            if having:
                numbers = np.array([[event.measures[camera, name] for name in quantities] for event in having])
                days = np.array([event.taken_ns / DAY_NS for event in having])
                yield Series(camera, what, days, numbers[..., 0], numbers[..., 1])


def _history(part: _Part, run_length: float, autocorrelation: float, n_watched: int) -> History:
    charts = {
        (one.camera, one.what): tuple(
            chart(values, run_length=run_length, autocorrelation=autocorrelation) for values in one.values.T
        )
        for one in part.series
        if len(one.days) >= FEWEST
    }
    found = [
        _finding(part, one, of_axis)
        for one in part.series
        for of_axis in charts.get((one.camera, one.what), ())
        if of_axis.alarm is not None
    ]
    return History(
        part.rig,
        part.events,
        part.accepted,
        part.series,
        charts,
        tuple(_first_of_each(found)),
        n_watched,
        autocorrelation,
        part.failures,
    )


def _first_of_each(found: Sequence[Finding]) -> Iterator[Finding]:
    """Of each camera the finding that chance explains least."""
    by_camera: dict[str, list[Finding]] = {}
    for finding in found:
        by_camera.setdefault(finding.camera, []).append(finding)
    for findings in by_camera.values():
        yield min(findings, key=lambda f: (f.change.chance if f.change else 1.0, f.alarm_ns))


def _finding(part: _Part, series: Series, of_axis: Chart) -> Finding:
    assert of_axis.alarm is not None
    sigmas = np.where(np.isfinite(series.sigmas) & (series.sigmas > 0.0), series.sigmas, np.nan)
    sigmas = np.where(np.isnan(sigmas), np.nanmedian(sigmas) if np.isfinite(sigmas).any() else 1.0, sigmas)
    change = change_of(series.days, series.values, sigmas)
    limit, tolerance = _tolerance(part, series, change)
    return Finding(
        series.camera,
        series.what,
        of_axis,
        round(float(series.days[of_axis.alarm]) * DAY_NS),
        change,
        series.unit,
        tolerance,
        None if change is None or limit is None else days_left(change, limit),
    )


def _tolerance(part: _Part, series: Series, change: Change | None) -> tuple[float | None, str]:
    """At which value of what drifts the tolerance is left, and which that is. None where there is none of it."""
    if series.what == "place":
        return part.tolerance_mm, f"{part.tolerance_mm:g} mm"
    if series.unit != "px" or change is None:
        return None, ""
    days = {float(day): place for place, day in enumerate(series.days)}
    rmse = np.full(len(series.days), np.nan)
    for event in part.events:
        place = days.get(event.taken_ns / DAY_NS)
        if place is not None and event.record.kind == "verify" and (series.camera, "rmse_px") in event.measures:
            rmse[place] = event.measures[series.camera, "rmse_px"][0]
    known = np.isfinite(rmse)
    drifting = series.values @ change.direction
    if not known.any():
        return None, ""
    return drift_tolerance(rmse[known], drifting[known], part.tolerance_px), f"{part.tolerance_px:g} px RMSE"
