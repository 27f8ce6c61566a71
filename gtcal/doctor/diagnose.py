"""What is wrong with a recording: first what each view alone tells of lens and board, then what the chain of mocap and
images tells of the trajectories, the clocks and the board's size. One thing after another is put right until nothing
makes the rest agree better."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gtcal.blas import on_one_blas_thread
from gtcal.doctor.alone_search import (
    AloneSearch,
    Mended,
    board_under_any_lens,
    with_board,
    with_found_intrinsics,
)
from gtcal.doctor.board_in_images import board_in_images, board_lines
from gtcal.doctor.board_readings import BoardReading, board_readings, scaled_board
from gtcal.doctor.calibrated import NOT_AS_STATED, look_at_calibration
from gtcal.doctor.chain_search import (
    AS_GOOD,
    CONVINCING,
    CONVINCING_NUMBER,
    FEWEST_VIEWS,
    HOPELESS_RAD,
    ChainSearch,
    Explained,
)
from gtcal.doctor.findings import ALONE, BACKS, LEFT_OUT, MISFIT, POSED, SEEN, Diagnosis, Finding
from gtcal.doctor.fit import NO_CHAIN, AloneFit, ChainFit
from gtcal.doctor.lens_readings import mirrored
from gtcal.doctor.manifest_lines import ManifestFile, line_of
from gtcal.doctor.mocap_readings import MocapReading, stands_still
from gtcal.doctor.opening import fault_of, opened, source_lines
from gtcal.doctor.time_readings import ENOUGH, posed_share, shifted, spans_ns, time_readings, with_motion
from gtcal.errors import GtcalError
from gtcal.estimation.alignment import GuideViews
from gtcal.estimation.solver import DISAGREEMENT_RAD
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import IntArray
from gtcal.recordings.manifest import find_manifest, load_fields
from gtcal.recordings.recording import Recording
from gtcal.workflow import detected

_MOST_FINDINGS = 6
_OTHER_CLOCK = 2.0
_BEHIND, _FITTING_PX = 0.8, 10.0
"""A share of views from behind that is no accident of PnP, where the corners lie nearly where they should."""


@on_one_blas_thread
def diagnose(path: Path | str, *, progress: Progress = silent) -> Diagnosis:
    """What is wrong with the recording in the folder (or with the manifest file) ``path``, with the manifest's lines to
    change. Cameras that have only images are detected first.

    Raises GtcalError where there is no manifest, or what is there is none."""
    manifest_path = find_manifest(Path(path))
    file = ManifestFile(manifest_path, load_fields(manifest_path))
    file.manifest()
    progress("reading", 0, 1)
    try:
        readings = opened(file)
    except GtcalError as error:
        return Diagnosis((), str(error), (), None, None)
    progress("reading", 1, 1)
    try:
        patients = [
            Patient(reading.file, reading.recording, progress, refusals=reading.refusals) for reading in readings
        ]
    except GtcalError as error:
        return Diagnosis((), str(error), (), None, None)
    patient, alternatives = _chosen(patients)
    return patient.examined(alternatives)


@on_one_blas_thread
def diagnose_recording(recording: Recording, *, progress: Progress = silent) -> Diagnosis:
    """``diagnose`` of a recording in memory: its findings have advice, but no lines of a manifest where these depend on
    the files."""
    return Patient(None, recording, progress).examined()


@dataclass(frozen=True)
class _Part:
    """One of the changes that explain the data together."""

    apply: Callable[[Recording], Recording]
    finding: Callable[[float, float], Finding]


class Patient:
    """A recording under examination, with what was found so far put right. file: its manifest so far, None for a
    recording in memory."""

    def __init__(
        self,
        file: ManifestFile | None,
        recording: Recording,
        progress: Progress,
        refusals: tuple[tuple[str, tuple[str, ...]], ...] = (),
    ) -> None:
        self.file = file
        self.refusals = refusals
        self.progress = progress
        self.findings: list[Finding] = []
        self.notes: list[str] = [note for images in recording.images.values() for note in images.notes]
        self.unexplained: str | None = None
        self.used_ns: Mapping[str, IntArray] | None = None
        self.recording = self._seeing(self._with_board_of_images(detected(recording, progress=progress)))
        self.free = frozenset(name for name, camera in self.recording.cameras.items() if camera.parameters is None)
        self.alone = AloneSearch(self.free, lambda name, other: source_lines(self.file, name, other))
        self._find_intrinsics()
        self._fits: dict[str, AloneFit] | None = None

    @property
    def said(self) -> dict[str, object]:
        """The manifest's fields."""
        return {} if self.file is None else self.file.fields

    @property
    def _body_offsets_ns(self) -> dict[str, int]:
        """What the manifest adds to the stamps of each body; of none where there is no manifest."""
        if self.file is None:
            return {}
        return {body: entry.stamp_offset_ns for body, entry in self.file.manifest().bodies.items()}

    @property
    def fits(self) -> dict[str, AloneFit]:
        """The views of each camera by themselves, as the recording is now."""
        if self._fits is None:
            self._fits = self.alone.fits(self.recording)
        return self._fits

    @property
    def guides(self) -> dict[str, GuideViews]:
        """The views that PnP solves, less those that contradict the others once these are known."""
        solved = {name: fit.guide for name, fit in self.fits.items() if fit.guide is not None}
        if self.used_ns is None:
            return solved
        return {
            name: guide.select(np.flatnonzero(np.isin(guide.views.stamps_ns, self.used_ns[name])))
            for name, guide in solved.items()
        }

    def chain(self) -> ChainFit:
        """Mocap and images together, as the recording is now."""
        return ChainSearch(self.guides).fit(self.recording.motion)

    def examined(self, alternatives: tuple[str, ...] = ()) -> Diagnosis:
        """All that is found, one thing after another."""
        self._look_at_times()
        self._look_at_backs()
        self._look_at_views()
        if self.unexplained is None:
            self._look_at_chain()
            self._look_at_calibration()
        self._note_what_cannot_be_told()
        fit = self.chain()
        known = np.isfinite(fit.angle_rad)
        misfit_mm = fit.misfit_mm if known else None
        refused = [
            Finding(fault_of(lines), why, lines, (), MISFIT, None, misfit_mm, "mm", alternatives)
            for why, lines in self.refusals
        ]
        return Diagnosis(
            (*refused, *self.findings),
            self.unexplained,
            tuple(self.notes),
            misfit_mm,
            float(np.rad2deg(fit.angle_rad)) if known else None,
        )

    def _with_board_of_images(self, recording: Recording) -> Recording:
        """Where no camera sees the board that was said, with the one that the images show."""
        if any(of_camera.n_views for of_camera in recording.detections.values()):
            return recording
        found = board_in_images(recording)
        if found is None:
            return recording
        board, says = found
        given = {name: seen for name, seen in recording.detections.items() if name not in recording.images}
        other = detected(replace(recording, board=board, detections=given), progress=self.progress)
        n_views = sum(of_camera.n_views for of_camera in other.detections.values())
        if n_views:
            lines = board_lines(recording.board, board)
            self._add(Mended(other, Finding("board", says, lines, (), SEEN, 0.0, float(n_views), "views")))
        return other if n_views else recording

    def _seeing(self, recording: Recording) -> Recording:
        """Without the cameras that have no view. Raises GtcalError where that is all of them."""
        seeing = {name for name in recording.cameras if recording.detections[name].n_views}
        for name in sorted(recording.cameras.keys() - seeing):
            self.notes.append(f"camera {name!r} has no view of the board, and is left out")
        if not seeing:
            raise GtcalError(
                "no camera has a view of the board: check the board's type, dictionary and first id against the print"
            )
        return _only(recording, seeing)

    def _find_intrinsics(self) -> None:
        if not self.free:
            return
        self.progress("intrinsics", 0, 1)
        refused: dict[str, str] = {}
        for name in sorted(self.free):
            try:
                self.recording = with_found_intrinsics(self.recording, frozenset({name}))
            except GtcalError as error:
                refused[name] = str(error)
        if len(refused) == len(self.recording.cameras):
            self._find_intrinsics_and_board(next(iter(refused.values())))
        elif refused:
            self.notes += [f"left out: {why}" for why in refused.values()]
            self.recording = _only(self.recording, self.recording.cameras.keys() - refused.keys())
        self.progress("intrinsics", 1, 1)

    def _find_intrinsics_and_board(self, refusal: str) -> None:
        reading = board_under_any_lens(self.recording)
        if reading is None:
            raise GtcalError(refusal)
        mended = with_found_intrinsics(with_board(self.recording, reading), self.free)
        after_px = float(np.median([fit.typical_px for fit in self.alone.fits(mended).values()]))
        finding = Finding(reading.fault, reading.says, reading.lines, reading.advice, ALONE, np.inf, after_px, "px")
        self._add(Mended(mended, finding))

    def _add(self, mended: Mended) -> None:
        """Take a finding as put right, with lines that the manifest takes."""
        self.recording, self._fits = mended.recording, None
        finding = mended.finding
        if self.file is not None:
            finding = self._settled(self.file, finding, mended.recording)
            self.file = self.file.changed(finding.lines)
        self.findings.append(finding)

    @staticmethod
    def _settled(file: ManifestFile, finding: Finding, recording: Recording) -> Finding:
        """A preset takes no other fields; what a file's header states can't be contradicted in the manifest."""
        lines, advice = [], list(finding.advice)
        for line in finding.lines:
            body, _, _ = line.partition(".")
            if body == "board" and "preset" in file.fields["board"]:
                whole = line_of("board", recording.board.to_manifest())
                lines += [whole] if whole not in lines else []
            elif body not in ("platform", "board_body") or file.changed([line]).reads(body):
                lines.append(line)
            else:
                name = file.fields[body]["trajectory"]
                advice.append(f"correct the header of {name}, which states otherwise, or take it away and write {line}")
        return replace(finding, lines=tuple(lines), advice=tuple(advice))

    def _look_at_views(self) -> None:
        """Lens and board, from each view alone."""
        for done in range(_MOST_FINDINGS):
            self.progress("lens and board, by each view alone", done, _MOST_FINDINGS)
            mended = self.alone.explain(self.recording, self.fits)
            if mended is None:
                break
            self._add(mended)
        for mended in self.alone.wrong_intrinsics(self.recording, self.fits):
            self._add(mended)
        self.progress("lens and board, by each view alone", 1, 1)

    def _look_at_times(self) -> None:
        share = posed_share(self.recording)
        if share >= ENOUGH or self.recording.numbered:
            return
        n_views = sum(of_camera.n_views for of_camera in self.recording.detections.values())
        tried = [(reading, posed_share(reading.recording)) for reading in time_readings(self.recording, self.file)]
        most = max((found for _, found in tried), default=0.0)
        if most < max(ENOUGH, 2.0 * share):
            self._look_for_other_clock()
            return
        good = [(reading, found) for reading, found in tried if found > 0.9 * most]
        angles = [self._angle(reading.recording) if len(good) > 1 else 0.0 for reading, _ in good]
        reading, found = good[int(np.argmin(angles))]
        finding = Finding(
            "time unit",
            reading.says,
            reading.lines,
            reading.advice,
            POSED,
            round(share * n_views),
            round(found * n_views),
            "views",
        )
        self._add(Mended(reading.recording, finding))

    def _angle(self, recording: Recording) -> float:
        fits = self.alone.fits(recording)
        guides = {name: fit.guide for name, fit in fits.items() if fit.guide is not None}
        return ChainSearch(guides).fit(recording.motion).angle_rad

    def _look_for_other_clock(self) -> None:
        """Clocks that count from elsewhere: any offset at which the turns agree."""
        (first_ns, last_ns), (mocap_first_ns, mocap_last_ns) = spans_ns(self.recording)
        about_s = 0.5e-9 * (mocap_first_ns + mocap_last_ns - first_ns - last_ns)
        reach_s = 0.5e-9 * (mocap_last_ns - mocap_first_ns + last_ns - first_ns)
        search, motion = ChainSearch(self.guides), self.recording.motion
        shift_s = search.far_shift_s(motion, about_s, reach_s)
        fit = NO_CHAIN if shift_s is None else search.fit(motion, shift_s=shift_s)
        if shift_s is None or not fit.angle_rad < HOPELESS_RAD:
            self.unexplained = (
                f"cameras and mocap share no time: the images were taken from {1e-9 * first_ns:.3f} s to "
                f"{1e-9 * last_ns:.3f} s, the mocap's poses from {1e-9 * mocap_first_ns:.3f} s to "
                f"{1e-9 * mocap_last_ns:.3f} s, and at no other unit or offset do they agree"
            )
            return
        self._add(
            Mended(
                shifted(self.recording, shift_s), clock_finding(shift_s, np.inf, fit.misfit_mm, self._body_offsets_ns)
            )
        )

    def _look_at_backs(self) -> None:
        """Views from behind: mirrored images, or corners counted the other way round."""
        behind = tuple(name for name, fit in self.fits.items() if fit.behind > _BEHIND and fit.typical_px < _FITTING_PX)
        if not behind:
            return
        stated = self.chain()
        tried = [(axis, _mirrored(self.recording, behind, axis)) for axis in range(2)]
        axis, other = min(tried, key=lambda one: self._typical_px(one[1]))
        angle_rad = self._angle(other)
        names = "all cameras" if len(behind) == len(self.recording.cameras) else " and ".join(behind)
        if angle_rad <= CONVINCING * min(stated.angle_rad, np.pi):
            there = Patient(None, other, silent)
            sides = ("left for right", "top for bottom")
            finding = Finding(
                "mirrored images",
                f"the images of {names}, or the corners found in them, are mirrored, {sides[axis]}",
                (),
                (f"mirror the images (or the corners' pixels) of {names} {sides[axis]}",),
                MISFIT,
                stated.misfit_mm,
                there.chain().misfit_mm,
                "mm",
                (f"mirror them {sides[1 - axis]}: it is as good if the lens is centred",),
            )
            self._add(Mended(other, finding))
            return
        if len(behind) < len(self.recording.cameras):
            self.notes.append(f"{names} see the board from behind, and no other reading of it does not")
            return
        self._look_at_counting()

    def _typical_px(self, recording: Recording) -> float:
        return float(np.sum([fit.typical_px for fit in self.alone.fits(recording).values()]))

    def _look_at_counting(self) -> None:
        """Other ways to count tags and corners under which the views see the board's front, and fit as well."""
        stated_px = self._typical_px(self.recording)
        good: list[tuple[BoardReading, Recording]] = []
        for reading in board_readings(self.recording.board):
            other = with_board(self.recording, reading)
            fits = self.alone.fits(other).values()
            if sum(fit.typical_px for fit in fits) < 1.1 * stated_px and all(fit.behind < 0.5 for fit in fits):
                good.append((reading, other))
                if len(good) > 2:
                    break
        if not good:
            self.notes.append("the views see the board from behind, and no other way to count its corners does not")
            return
        (reading, other), *others = good
        finding = Finding(
            reading.fault,
            reading.says,
            reading.lines,
            reading.advice,
            BACKS,
            100.0 * float(np.mean([fit.behind for fit in self.fits.values()])),
            100.0 * float(np.mean([fit.behind for fit in self.alone.fits(other).values()])),
            "%",
            tuple(other_reading.says for other_reading, _ in others),
        )
        self._add(Mended(other, finding))

    def _look_at_chain(self) -> None:
        """Trajectories, clocks and the board's size, from mocap and images together."""
        for done in range(_MOST_FINDINGS):
            self.progress("mocap and images together", done, _MOST_FINDINGS)
            search, stated = ChainSearch(self.guides), self.chain()
            explained = search.explain(self.recording.motion, stated)
            if explained is None:
                break
            self._explain(explained, stated)
        self._look_at_each_clock()
        self.progress("mocap and images together", 1, 1)
        fit = self.chain()
        if np.isfinite(fit.angle_rad) and fit.angle_rad > DISAGREEMENT_RAD:
            self.unexplained = (
                f"mocap and images are {np.rad2deg(fit.angle_rad):.1f} deg apart, typically, and no other reading of "
                "the files brings them together; are they of one recording?"
            )

    def _look_at_calibration(self) -> None:
        """What is left when all is read rightly; views that contradict the others explain what no reading does."""
        self.progress("a calibration of what is right now", 0, 1)
        as_given = {
            name: replace(camera, parameters=None) if name in self.free else camera
            for name, camera in self.recording.cameras.items()
        }
        try:
            found = look_at_calibration(replace(self.recording, cameras=as_given), silent)
        except GtcalError as error:
            if self.unexplained is None:
                self.notes.append(f"no calibration yet: {error}")
            return
        finally:
            self.progress("a calibration of what is right now", 1, 1)
        # what was put right is so to a few digits, which lenses and boards then make good
        small = NOT_AS_STATED if self.findings else ()
        self.findings += [finding for finding in found.findings if finding.fault not in small]
        self.notes += found.notes
        if any(finding.measure == LEFT_OUT for finding in found.findings):
            self.unexplained, self.used_ns = None, found.used_ns

    def _explain(self, explained: Explained, stated: ChainFit) -> None:
        parts = [self._reading_part(reading, explained) for reading in explained.readings]
        if explained.board_scale != 1.0:
            parts.append(self._scale_part(explained.board_scale))
        if explained.shift_s != 0.0:
            parts.append(_shift_part(explained.shift_s, self._body_offsets_ns))
        before_mm = []
        for part in parts:
            without = self.recording
            for other in parts:
                without = without if other is part else other.apply(without)
            before_mm.append(stated.misfit_mm if len(parts) == 1 else Patient(None, without, silent).chain().misfit_mm)
        for part, before in zip(parts, before_mm, strict=True):
            self._add(Mended(part.apply(self.recording), part.finding(before, explained.fit.misfit_mm)))

    def _reading_part(self, reading: MocapReading, explained: Explained) -> _Part:
        lines = reading.lines
        others = [" and ".join((*other.lines, *other.advice)) for other in explained.others]
        if reading.scale != 1.0:
            others += self._board_instead(1.0 / reading.scale)
        if self.file is not None:
            if reading.fault == "inverse poses":
                lines = tuple(self._inverse_line(self.file, body) for body in reading.bodies)
            if reading.fault == "swapped bodies":
                fields = self.file.fields
                lines = line_of("platform", fields["board_body"]), line_of("board_body", fields["platform"])
        advice = () if lines else reading.advice

        def finding(before: float, after: float) -> Finding:
            return Finding(reading.fault, reading.says, lines, advice, MISFIT, before, after, "mm", tuple(others))

        return _Part(lambda recording: with_motion(recording, reading.reread(recording.motion)), finding)

    @staticmethod
    def _inverse_line(file: ManifestFile, body: str) -> str:
        inverted = file.stated(body, "pose", ("world_T_body", "body_T_world")) == "body_T_world"
        return f"{body}.pose: " + ("world_T_body" if inverted else "body_T_world")

    def _board_instead(self, factor: float) -> list[str]:
        try:
            return [" and ".join(scaled_board(self.recording.board, factor)[1])]
        except GtcalError:
            return []

    def _scale_part(self, scale: float) -> _Part:
        board, lines = scaled_board(self.recording.board, scale)
        others = [f"multiply the mocap's positions by {1.0 / scale:.4f}: its own calibration may be off"]
        if not self.free and abs(scale - 1.0) < 0.1:
            others.append(f"multiply fx and fy of every camera by {1.0 / scale:.4f}, if its views allow it")
        says = f"the board is {scale:.4f} times the size that was said"

        def finding(before: float, after: float) -> Finding:
            return Finding("board scale", says, lines, (), MISFIT, before, after, "mm", tuple(others))

        return _Part(lambda recording: replace(recording, board=board), finding)

    def _look_at_each_clock(self) -> None:
        """A camera whose clock is not that of the others."""
        fit = self.chain()
        if len(fit.by_camera_rad) < 2:
            return
        least = min(fit.by_camera_rad.values())
        for name in [name for name, angle in fit.by_camera_rad.items() if angle > _OTHER_CLOCK * least]:
            search, motion = ChainSearch({name: self.guides[name]}), self.recording.motion
            stated = search.fit(motion)
            found = search.shifted(motion, stated)
            if found.shift_s == 0.0 or not found.fit.angle_rad <= CONVINCING_NUMBER * stated.angle_rad:
                continue
            finding = clock_finding(found.shift_s, stated.misfit_mm, found.fit.misfit_mm, {}, name)
            self._add(Mended(shifted(self.recording, found.shift_s, (name,)), finding))

    def _note_what_cannot_be_told(self) -> None:
        n_views = sum(guide.views.n_views for guide in self.guides.values())
        if n_views < FEWEST_VIEWS:
            self.notes.append(f"only {n_views} usable views: too few to tell what is wrong with the mocap's files")
        for body, trajectory in self.recording.motion.trajectories.items():
            if stands_still(trajectory):
                self.notes.append(f"{body} stands still, so this recording can't tell its units, order or direction")
        alike = self.alone.alike(self.recording)
        if alike:
            self.notes.append(
                f"the lenses of {', '.join(alike)} are so alike that this recording can't tell whether their images "
                "are swapped: only their names would be"
            )


def _only(recording: Recording, names: Set[str]) -> Recording:
    """The recording of these cameras."""
    return replace(
        recording,
        cameras={name: camera for name, camera in recording.cameras.items() if name in names},
        detections={name: found for name, found in recording.detections.items() if name in names},
        images={name: images for name, images in recording.images.items() if name in names},
    )


def _mirrored(recording: Recording, cameras: tuple[str, ...], axis: int) -> Recording:
    moved = {name: mirrored((recording.cameras[name], recording.detections[name]), axis=axis)[1] for name in cameras}
    return replace(recording, detections=recording.detections | moved)


def _shift_part(shift_s: float, body_offsets_ns: Mapping[str, int]) -> _Part:
    return _Part(
        lambda recording: shifted(recording, shift_s),
        lambda before, after: clock_finding(shift_s, before, after, body_offsets_ns),
    )


def clock_finding(
    shift_s: float,
    before_mm: float,
    after_mm: float,
    body_offsets_ns: Mapping[str, int],
    camera: str | None = None,
) -> Finding:
    """A clock that is off. body_offsets_ns: what the manifest adds to each body's stamps; the mocap's put earlier are
    the cameras' put later."""
    whose = f"the clock of {camera}" if camera else "the cameras' clock"
    stamps = f"the time stamps of {camera}" if camera else "the time stamps of all cameras"
    says = f"{whose} is {abs(shift_s):.3f} s {'behind' if shift_s > 0 else 'ahead of'} the mocap's"
    lines: tuple[str, ...] = ()
    advice = f"add {shift_s:+.4f} s to {stamps}"
    if abs(shift_s) < 0.5:
        advice = f"gtcal calibrate --clock {'per_camera' if camera else 'estimate'} or {advice}"
    elif body_offsets_ns:
        shift_ns = round(1e9 * shift_s)
        lines = tuple(f"{body}.stamp_offset_ns: {offset_ns - shift_ns}" for body, offset_ns in body_offsets_ns.items())
    return Finding("clock offset", says, lines, () if lines else (advice,), MISFIT, before_mm, after_mm, "mm")


def _chosen(patients: list[Patient]) -> tuple[Patient, tuple[str, ...]]:
    """Of several ways to read it that under which mocap and images agree best, and the lines of those that do as
    well."""
    angles = [patient.chain().angle_rad for patient in patients]
    best = int(np.argmin(angles))
    others = tuple(
        " and ".join(line for _, lines in patient.refusals for line in lines)
        for patient, angle in zip(patients, angles, strict=True)
        if patient.said != patients[best].said and angle <= AS_GOOD * angles[best] < np.inf
    )
    return patients[best], others
