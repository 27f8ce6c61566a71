"""What is wrong with a recording of poses: the readings that ``gtcal.doctor`` tries of the mocap's poses, and the same
of the cameras'; clocks and lengths too. One thing after another is put right until nothing makes the rest agree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from factors import CAMERA_MODELS
from gtcal.blas import on_one_blas_thread
from gtcal.camera import Camera, FloatArray
from gtcal.doctor.chain_search import CONVINCING, CONVINCING_NUMBER, FEWEST_VIEWS, ChainSearch, Explained
from gtcal.doctor.diagnose import clock_finding
from gtcal.doctor.findings import Diagnosis, Finding
from gtcal.doctor.fit import VIEWS_PER_CAMERA, ChainFit
from gtcal.doctor.manifest_lines import line_of
from gtcal.doctor.mocap_readings import INVERSE, SUSPICIONS, Suspicion
from gtcal.doctor.time_readings import ENOUGH
from gtcal.errors import GtcalError
from gtcal.estimation.alignment import GuideViews
from gtcal.estimation.observations import Views
from gtcal.estimation.pose_joint import lever_moments
from gtcal.estimation.solver import DISAGREEMENT_RAD
from gtcal.pose_recordings.recording import ViewsEntry, load_pose_parts
from gtcal.progress import Progress, silent
from gtcal.recordings.capture import RefMotion
from gtcal.recordings.detections import IntArray

MISFIT = "median misfit of the mocap and the cameras' poses"

_NO_LENS = CAMERA_MODELS["pinhole_radtan"]  # poses were seen through none
_MOST_FINDINGS = 6
_APART = 2.0
"""A camera whose poses are so many times further off than the best one's is looked at by itself."""

_BODY_POSE, _VIEWS_POSE = ("world_T_body", INVERSE), ("camera_T_board", "board_T_camera")


@dataclass(frozen=True)
class _Patient:
    """The poses as they are read so far, some of each camera. body_offsets_ns: what the manifest adds to the stamps of
    each body."""

    entries: Mapping[str, ViewsEntry]
    stamps_ns: Mapping[str, IntArray]
    camera_T_board: Mapping[str, FloatArray]
    motion: RefMotion
    body_offsets_ns: Mapping[str, int]

    @property
    def search(self) -> ChainSearch:
        return ChainSearch(
            {name: _guide(name, self.stamps_ns[name], poses) for name, poses in self.camera_T_board.items()}
        )

    def fit(self) -> ChainFit:
        return self.search.fit(self.motion)

    def reread(self, cameras: tuple[str, ...], suspicion: Suspicion) -> _Patient:
        """With the poses of these cameras read otherwise."""
        other = {name: suspicion.reread(self.camera_T_board[name]) for name in cameras}
        return replace(self, camera_T_board={**self.camera_T_board, **other})

    def later(self, shift_s: float, cameras: tuple[str, ...]) -> _Patient:
        """With the stamps of these cameras put later."""
        moved = {name: self.stamps_ns[name] + round(1e9 * shift_s) for name in cameras}
        return replace(self, stamps_ns={**self.stamps_ns, **moved})


@on_one_blas_thread
def diagnose_poses(path: Path | str, *, progress: Progress = silent) -> Diagnosis:
    """What is wrong with the recording of poses at ``path``, with the manifest's lines to change.

    Raises GtcalError where there is no manifest of such a recording."""
    try:
        parts = load_pose_parts(path)
    except GtcalError as error:
        return Diagnosis((), str(error), (), None, None)
    rows = {name: _spread(poses.n_samples) for name, poses in parts.seen.items()}
    patient = _Patient(
        parts.entries,
        {name: parts.seen[name].stamps_ns[row] for name, row in rows.items()},
        {name: parts.seen[name].world_T_body[row] for name, row in rows.items()},
        parts.motion,
        parts.body_offsets_ns,
    )
    findings: list[Finding] = []
    for done in range(_MOST_FINDINGS):
        progress("mocap and poses together", done, _MOST_FINDINGS)
        mended = _other_clock(patient) or _otherwise(patient) or _one_camera(patient)
        if mended is None:
            break
        patient, found = mended
        findings += found
    progress("mocap and poses together", 1, 1)
    return _diagnosis(patient, tuple(findings), _notes(patient))


def _spread(n: int) -> IntArray:
    """Rows of some poses, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, VIEWS_PER_CAMERA)).round().astype(np.int64))


def _guide(name: str, stamps_ns: IntArray, camera_T_board: FloatArray) -> GuideViews:
    """Poses as PnP would have found them, of corners at a lever's length about the board's origin."""
    n = len(stamps_ns)
    views = Views(
        stamps_ns=stamps_ns,
        view_start=np.arange(n + 1),
        corner_ids=np.zeros(n, dtype=np.int64),
        corners_px=np.zeros((n, 2)),
        camera=Camera(name, _NO_LENS, np.zeros(_NO_LENS.n_parameters), 1, 1),
        frame_index=np.arange(n),
        ref_T_body=np.tile(np.eye(4), (n, 1, 1)),
        corners_m=np.zeros((n, 3)),
        outline_m=np.ones(4),
        shape_sigmas=np.ones(5),
    )
    return GuideViews(views, camera_T_board[:, None], np.zeros(n), lever_moments(n))


def _diagnosis(patient: _Patient, findings: tuple[Finding, ...], notes: tuple[str, ...]) -> Diagnosis:
    fit = patient.fit()
    known, unexplained = bool(np.isfinite(fit.angle_rad)), None
    if not known:
        unexplained = "fewer than three poses of each camera have one of the mocap's at their time"
    elif fit.angle_rad > DISAGREEMENT_RAD:
        unexplained = (
            f"the mocap and the cameras' poses are {np.rad2deg(fit.angle_rad):.1f} deg apart, typically, and no other "
            "reading of the files brings them together; are they of one recording?"
        )
    angle_deg = float(np.rad2deg(fit.angle_rad)) if known else None
    return Diagnosis(findings, unexplained, notes, fit.misfit_mm if known else None, angle_deg)


def _notes(patient: _Patient) -> tuple[str, ...]:
    n = sum(len(stamps) for stamps in patient.stamps_ns.values())
    return (f"only {n} poses: too few to tell what is wrong with them",) if n < FEWEST_VIEWS else ()


_Mended = tuple[_Patient, list[Finding]]


def _other_clock(patient: _Patient) -> _Mended | None:
    """Clocks that count from elsewhere: any offset at which the turns agree."""
    stated = patient.fit()
    if patient.motion.numbered or stated.n_views >= ENOUGH * stated.n_asked:
        return None
    first, last = (pick(int(s[i]) for s in patient.stamps_ns.values()) for pick, i in ((min, 0), (max, -1)))
    bodies = [body.stamps_ns for body in patient.motion.trajectories.values()]
    start, end = max(int(s[0]) for s in bodies), min(int(s[-1]) for s in bodies)
    reach_s = 0.5e-9 * (end - start + last - first)
    shift_s = patient.search.far_shift_s(patient.motion, 0.5e-9 * (start + end - first - last), reach_s)
    return None if shift_s is None else _shifted(patient, shift_s, stated, tuple(patient.stamps_ns))


def _otherwise(patient: _Patient) -> _Mended | None:
    """Another reading of the cameras' poses, or of the mocap's, lengths and clock."""
    stated = patient.fit()
    if stated.n_views < FEWEST_VIEWS:
        return None
    names = tuple(patient.camera_T_board)
    if found := _best_reading(patient, stated, names):
        return found
    explained = patient.search.explain(patient.motion, stated)
    return None if explained is None else _explained(patient, explained, stated)


def _one_camera(patient: _Patient) -> _Mended | None:
    """A camera whose poses alone are read wrongly, or whose clock is its own."""
    stated = patient.fit()
    if len(stated.by_camera_rad) < 2:
        return None
    least = min(stated.by_camera_rad.values())
    for name in [name for name, angle in stated.by_camera_rad.items() if angle > _APART * least]:
        if found := _best_reading(patient, stated, (name,)):
            return found
        search = ChainSearch({name: patient.search.guides[name]})
        alone = search.fit(patient.motion)
        shifted = search.shifted(patient.motion, alone)
        if shifted.shift_s and shifted.fit.angle_rad <= CONVINCING_NUMBER * alone.angle_rad:
            return _shifted(patient, shifted.shift_s, alone, (name,))
    return None


def _best_reading(patient: _Patient, stated: ChainFit, cameras: tuple[str, ...]) -> _Mended | None:
    tried = [(suspicion, patient.reread(cameras, suspicion)) for suspicion in SUSPICIONS]
    fits = [other.fit() for _, other in tried]
    best = int(np.argmin([fit.angle_rad for fit in fits]))
    if not fits[best].angle_rad <= min(CONVINCING * stated.angle_rad, DISAGREEMENT_RAD):
        return None
    suspicion, other = tried[best]
    finding = Finding(
        suspicion.fault,
        suspicion.says.format(body=_called(patient, cameras)),
        tuple(_line(suspicion, patient.entries[name], name) for name in cameras) if suspicion.line else (),
        () if suspicion.line else (suspicion.advice.format(body=_called(patient, cameras)),),
        MISFIT,
        stated.misfit_mm,
        fits[best].misfit_mm,
        "mm",
    )
    return other, [finding]


def _called(patient: _Patient, cameras: tuple[str, ...]) -> str:
    return "the views of " + ("all cameras" if len(cameras) == len(patient.entries) else " and ".join(cameras))


def _line(suspicion: Suspicion, entry: ViewsEntry, name: str) -> str:
    """The views of a camera as they should be said, whole."""
    field, value = suspicion.line.format(body="views").removeprefix("views.").split(": ")
    if field == "pose":
        value = next(pose for pose in _VIEWS_POSE if pose != entry.pose)
    said = entry.model_dump(exclude_none=True, exclude_defaults=True)
    return line_of(f"cameras.{name}.views", {"file": entry.file, "format": entry.format, **said, field: value})


def _explained(patient: _Patient, explained: Explained, stated: ChainFit) -> _Mended:
    after, findings = patient, []
    for reading in explained.readings:
        after = replace(after, motion=reading.reread(after.motion))
        advice = () if reading.lines else reading.advice
        others = tuple(" and ".join((*other.lines, *other.advice)) for other in explained.others)
        numbers = (stated.misfit_mm, explained.fit.misfit_mm)
        findings.append(Finding(reading.fault, reading.says, reading.lines, advice, MISFIT, *numbers, "mm", others))
    if explained.board_scale != 1.0:
        scale = explained.board_scale
        longer = Suspicion("scale", "", "", "", lambda poses: _scaled(poses, scale))
        after = after.reread(tuple(after.camera_T_board), longer)
        says = f"the lengths of the cameras' poses are to be {scale:.4f} times what they are"
        advice = (
            "measure the board: its poses are as large as it was said to be",
            f"or multiply the mocap's positions by {1.0 / scale:.4f}: its own calibration may be off",
        )
        findings.append(Finding("scale", says, (), advice, MISFIT, stated.misfit_mm, explained.fit.misfit_mm, "mm"))
    if explained.shift_s:
        after, found = _shifted(after, explained.shift_s, stated, tuple(after.stamps_ns))
        findings += found
    return after, findings


def _scaled(poses: FloatArray, scale: float) -> FloatArray:
    scaled = poses.copy()
    scaled[:, :3, 3] *= scale
    return scaled


def _shifted(patient: _Patient, shift_s: float, stated: ChainFit, cameras: tuple[str, ...]) -> _Mended:
    other = patient.later(shift_s, cameras)
    everyone = len(cameras) == len(patient.entries)
    finding = clock_finding(
        shift_s,
        stated.misfit_mm,
        other.fit().misfit_mm,
        patient.body_offsets_ns if everyone else {},
        None if everyone else cameras[0],
    )
    return other, [replace(finding, measure=MISFIT)]
