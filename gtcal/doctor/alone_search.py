"""What each view alone tells, by PnP: swapped cameras, another lens, another board. The mocap plays no part."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize_scalar

from gtcal.board import AprilGrid, ArucoGrid, Board
from gtcal.camera import Camera, FloatArray
from gtcal.doctor.board_readings import BoardReading, Grid, board_readings, with_gap
from gtcal.doctor.findings import ALONE, Finding
from gtcal.doctor.fit import AloneFit, fit_alone, views_of
from gtcal.doctor.lens_readings import LensReading, camera_lines, lens_readings
from gtcal.doctor.manifest_lines import line_of
from gtcal.errors import GtcalError
from gtcal.estimation.intrinsics import calibrate_intrinsics, equidistant_lenses
from gtcal.estimation.observations import Views
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.recording import Recording

CLEARLY, SLIGHTLY = 0.5, 0.9
"""Another reading is believed where it halves the distance of the corners, or takes a tenth of it and is as good as a
lens that is free to fit."""

AS_GOOD_AS_FREE = 1.15
AS_GOOD = 1.05
"""Readings that fit within this share of the best are equally good: the first of them is taken."""

ALIKE = 1.3
"""Lenses are too alike to tell swapped cameras by where the other one's fits within this factor."""

SUSPICIOUS_PX = 1.0
"""Four corners in five keep within a fraction of a pixel where lens and board are right."""

NO_LENS, NO_LENS_PX = 3.0, 0.7
"""The intrinsics are called wrong where free ones are so many times, and so many pixels, better."""

_FEW_VIEWS = 10
# A board's misfit under every third lens ranks it; the right one is then among so many.
_EVERY_LENS, _HOPEFUL_BOARDS = 3, 12

R = TypeVar("R", LensReading, BoardReading)


@dataclass(frozen=True)
class Mended:
    """A recording with one thing put right, and what that was."""

    recording: Recording
    finding: Finding


@dataclass(frozen=True)
class _Believed:
    """A reading of a camera, how well its views fit by it, and what other readings do as well, in words."""

    reading: LensReading
    after_px: float
    others: tuple[str, ...]


@dataclass
class AloneSearch:
    """Searches over lenses and boards. free: cameras whose intrinsics were found from the views, not stated. sources:
    the manifest's lines by which a camera takes the images of another."""

    free: frozenset[str]
    sources: Callable[[str, str], tuple[str, ...]]
    _floors_px: dict[str, float] = field(default_factory=dict)

    def fits(self, recording: Recording) -> dict[str, AloneFit]:
        """Each camera's views by themselves."""
        return {name: _fit(recording, name) for name in recording.cameras}

    def explain(self, recording: Recording, fits: dict[str, AloneFit]) -> Mended | None:
        """What makes the views fit clearly better, one thing; None where nothing does."""
        if swapped := self._swapped(recording, fits):
            return swapped
        found = [mended] if (mended := self._lenses(recording, fits)) else []
        if all(fit.typical_px > SUSPICIOUS_PX for fit in fits.values()):
            found += [mended] if (mended := self._board(recording, fits)) else []
        return min(found, key=lambda mended: _ratio(mended.finding), default=None)

    def wrong_intrinsics(self, recording: Recording, fits: dict[str, AloneFit]) -> Iterator[Mended]:
        """The cameras whose views fit a lens that they find themselves far better than the one stated."""
        for name in [name for name in recording.cameras if name not in self.free]:
            before_px = fits[name].typical_px
            if before_px < SUSPICIOUS_PX:
                continue
            try:
                found = calibrate_intrinsics(_views(recording, name)).camera
            except GtcalError:
                continue
            recording_there = _with_camera(recording, found)
            after_px = _fit(recording_there, name).typical_px
            if before_px < max(NO_LENS * after_px, after_px + NO_LENS_PX):
                continue
            says = f"the intrinsics of {name} are not those of its images"
            finding = Finding(
                "intrinsics",
                says,
                camera_lines(recording.cameras[name], found),
                (),
                f"{name}: {ALONE}",
                before_px,
                after_px,
                "px",
                ("leave the parameters out, and 'gtcal calibrate --calibrate-intrinsics'",),
            )
            yield Mended(recording_there, finding)
            recording = recording_there

    def _believed(self, recording: Recording, name: str, before_px: float, after_px: float) -> bool:
        if not after_px <= SLIGHTLY * before_px:
            return False
        return after_px <= CLEARLY * before_px or after_px <= AS_GOOD_AS_FREE * self._floor_px(recording, name)

    def _floor_px(self, recording: Recording, name: str) -> float:
        """What a lens that is free to fit leaves; 0 where none does."""
        if name not in self._floors_px:
            try:
                camera = calibrate_intrinsics(_views(recording, name)).camera
                self._floors_px[name] = _fit(_with_camera(recording, camera), name).typical_px
            except GtcalError:
                self._floors_px[name] = 0.0
        return self._floors_px[name]

    def _lenses(self, recording: Recording, fits: dict[str, AloneFit]) -> Mended | None:
        """The reading that helps one of the cameras most. How a file was written is alike for all cameras, so it is
        taken for those too that fit better by it, if only by a little."""
        best = {name: self._lens(recording, fits, name) for name in recording.cameras if name not in self.free}
        believed = {name: found for name, found in best.items() if found is not None}
        if not believed:
            return None
        name = min(believed, key=lambda one: believed[one].after_px / fits[one].typical_px)
        reading, after_px = believed[name].reading, believed[name].after_px
        alike = {name: reading} | self._alike_readings(recording, fits, reading, believed)
        cameras = {
            other: of_other.reread((recording.cameras[other], recording.detections[other]))
            for other, of_other in alike.items()
        }
        lines = (camera_lines(recording.cameras[other], camera) for other, camera in cameras.items())
        finding = Finding(
            reading.fault,
            f"{', '.join(alike)}: {reading.says}",
            tuple(line for of_camera in lines for line in of_camera),
            (),
            f"{name}: {ALONE}",
            fits[name].typical_px,
            after_px,
            "px",
            (*believed[name].others, *(other for of_camera in alike.values() for other in of_camera.alternatives)),
        )
        return Mended(replace(recording, cameras=recording.cameras | cameras), finding)

    def _alike_readings(
        self,
        recording: Recording,
        fits: dict[str, AloneFit],
        reading: LensReading,
        believed: Mapping[str, _Believed],
    ) -> dict[str, LensReading]:
        """The same reading of other cameras, where it is believed or helps."""
        found = {}
        for name, camera in recording.cameras.items():
            seen = camera, recording.detections[name]
            same = [other for other in lens_readings(camera) if other.says == reading.says]
            if not same or name in self.free:
                continue
            if name in believed and believed[name].reading.says == reading.says:
                found[name] = same[0]
            elif name not in believed and reading.of_file:
                after_px = _fit_seen(same[0].reread(seen), seen[1], recording.board)
                found |= {name: same[0]} if after_px < fits[name].typical_px else {}
        return found

    def _lens(self, recording: Recording, fits: dict[str, AloneFit], name: str) -> _Believed | None:
        """The reading of one camera that is believed."""
        camera, detections, board = recording.cameras[name], recording.detections[name], recording.board
        few_px = _few(camera, detections, board)
        tried = [
            (reading, _fit_seen(reading.reread((camera, detections)), detections, board))
            for reading in lens_readings(camera)
            if _few(reading.reread((camera, detections)), detections, board) < few_px
        ]
        if not tried:
            return None
        reading, after_px = _first_of_the_best(tried)
        if not self._believed(recording, name, fits[name].typical_px, after_px):
            return None
        others = tuple(other.says for other, px in tried if px <= AS_GOOD * after_px and other is not reading)
        return _Believed(reading, after_px, others)

    def _swapped(self, recording: Recording, fits: dict[str, AloneFit]) -> Mended | None:
        """Images that fit each other's lens: two cameras of unlike lenses, exchanged."""
        names, typical_px = self._exchanged_px(recording)
        if len(names) < 2:
            return None
        rows, columns = linear_sum_assignment(np.log(np.minimum(typical_px, 1e6)))
        moved = [(names[i], names[j]) for i, j in zip(rows, columns, strict=True) if i != j]
        if not moved:
            return None
        after_px = {
            of: _fit_seen(replace(recording.cameras[lens], name=of), recording.detections[of], recording.board)
            for of, lens in moved
        }
        if not all(self._believed(recording, of, fits[of].typical_px, px) for of, px in after_px.items()):
            return None
        detections = recording.detections | {lens: recording.detections[of] for of, lens in moved}
        images = recording.images | {lens: recording.images[of] for of, lens in moved if of in recording.images}
        worst = max(moved, key=lambda pair: fits[pair[0]].typical_px)
        finding = Finding(
            "swapped cameras",
            "the images of " + " and ".join(of for of, _ in moved) + " are interchanged, or their intrinsics",
            tuple(line for of, lens in moved for line in self.sources(lens, of)),
            (),
            f"{worst[0]}: {ALONE}",
            fits[worst[0]].typical_px,
            after_px[worst[0]],
            "px",
            tuple(line_of(f"cameras.{of}.parameters", _parameters(recording.cameras[lens])) for of, lens in moved),
        )
        return Mended(replace(recording, detections=detections, images=images), finding)

    def alike(self, recording: Recording) -> tuple[str, ...]:
        """Cameras that could be swapped without being noticed: another's lens fits their views about as well."""
        names, typical_px = self._exchanged_px(recording)
        as_good = typical_px <= ALIKE * np.diag(typical_px)[:, None]
        pairs = np.argwhere(as_good & as_good.T & ~np.eye(len(names), dtype=bool))
        return tuple(names[i] for i in sorted(set(pairs.ravel().tolist())))

    def _exchanged_px(self, recording: Recording) -> tuple[list[str], FloatArray]:
        """How well a few views of each camera (rows) fit the lens of each (columns)."""
        names = [name for name in recording.cameras if name not in self.free]
        typical_px = np.diag(
            [_few(recording.cameras[name], recording.detections[name], recording.board) for name in names]
        )
        for i, j in permutations(range(len(names)), 2):
            lens = replace(recording.cameras[names[j]], name=names[i])
            typical_px[i, j] = _few(lens, recording.detections[names[i]], recording.board)
        return names, typical_px

    def _board(self, recording: Recording, fits: dict[str, AloneFit]) -> Mended | None:
        name = max(recording.cameras, key=lambda camera: recording.detections[camera].n_corners)
        seen = recording.cameras[name], recording.detections[name]
        stated_px = _few(*seen, recording.board)
        tried = [(reading, _few_reread(reading, *seen)) for reading in board_readings(recording.board)]
        if isinstance(recording.board, ArucoGrid | AprilGrid):
            tried += _gap(recording.board, *seen)
        if not tried:
            return None
        reading, few_px = _first_of_the_best(tried)
        if not few_px <= CLEARLY * stated_px:
            return None
        mended = with_board(recording, reading)
        if free := self.free.intersection(recording.cameras):
            try:
                mended = with_found_intrinsics(mended, free)
            except GtcalError:
                return None
        after = self.fits(mended)
        before_px, after_px = (float(np.median([fit.typical_px for fit in of.values()])) for of in (fits, after))
        if not after_px <= CLEARLY * before_px:
            return None
        finding = Finding(
            reading.fault,
            reading.says,
            reading.lines,
            reading.advice,
            ALONE,
            before_px,
            after_px,
            "px",
        )
        return Mended(mended, finding)


def with_board(recording: Recording, reading: BoardReading) -> Recording:
    """The recording with its board and its corners read otherwise."""
    detections = {name: reading.reread(of_camera) for name, of_camera in recording.detections.items()}
    return replace(recording, board=reading.board, detections=detections)


def board_under_any_lens(recording: Recording) -> BoardReading | None:
    """The reading of the board under which the views of a camera without intrinsics fit some equidistant lens, at least
    twice as well as under the one stated: under a few lenses first, the most hopeful ones then under all."""
    name = max(recording.cameras, key=lambda camera: recording.detections[camera].n_corners)
    detections = recording.detections[name]
    lenses = equidistant_lenses(recording.cameras[name])

    def misfit_px(board: Board, seen: CameraDetections, lenses: list[Camera]) -> float:
        return min(_few(lens, seen, board) for lens in lenses)

    readings = [(reading, reading.reread(detections)) for reading in board_readings(recording.board)]
    if not readings:
        return None
    roughly_px = [misfit_px(reading.board, seen, lenses[1::_EVERY_LENS]) for reading, seen in readings]
    hopeful = sorted(np.argsort(roughly_px, kind="stable")[:_HOPEFUL_BOARDS])
    tried = [(reading, misfit_px(reading.board, seen, lenses)) for reading, seen in (readings[i] for i in hopeful)]
    reading, after_px = _first_of_the_best(tried)
    return reading if after_px <= CLEARLY * misfit_px(recording.board, detections, lenses) else None


def with_found_intrinsics(recording: Recording, names: frozenset[str]) -> Recording:
    """With the intrinsics of these cameras found from their views. Raises GtcalError where they fit no lens."""
    found = {name: calibrate_intrinsics(_views(recording, name)).camera for name in names}
    return replace(recording, cameras=recording.cameras | found)


def _ratio(finding: Finding) -> float:
    assert finding.before is not None
    assert finding.after is not None
    return finding.after / finding.before


def _parameters(camera: Camera) -> dict[str, float]:
    return dict(zip(camera.model.parameter_names, camera.theta.tolist(), strict=True))


def _views(recording: Recording, name: str) -> Views:
    return views_of(recording.cameras[name], recording.board, recording.detections[name])


def _fit(recording: Recording, name: str) -> AloneFit:
    return fit_alone(_views(recording, name))


def _fit_seen(camera: Camera, detections: CameraDetections, board: Board) -> float:
    return fit_alone(views_of(camera, board, detections)).typical_px


def _few(camera: Camera, detections: CameraDetections, board: Board) -> float:
    return fit_alone(views_of(camera, board, detections, most=_FEW_VIEWS)).typical_px


def _few_reread(reading: BoardReading, camera: Camera, detections: CameraDetections) -> float:
    return _few(camera, reading.reread(detections), reading.board)


def _with_camera(recording: Recording, camera: Camera) -> Recording:
    return replace(recording, cameras=recording.cameras | {camera.name: camera})


def _first_of_the_best(tried: list[tuple[R, float]]) -> tuple[R, float]:
    least = min(px for _, px in tried)
    return next((reading, px) for reading, px in tried if px <= AS_GOOD * least)


def _gap(board: Grid, camera: Camera, detections: CameraDetections) -> list[tuple[BoardReading, float]]:
    """The gap between the tags that fits best, to three digits, or to two where that is as good."""

    def misfit_px(log_spacing: float) -> float:
        with suppress(GtcalError):  # no board has such a gap
            return _few(camera, detections, with_gap(board, float(np.exp(log_spacing))).board)
        return np.inf

    wide: FloatArray = np.log(np.geomspace(0.06, 1.5, 12))
    start = float(wide[int(np.argmin([misfit_px(x) for x in wide]))])
    near = float(wide[1] - wide[0])
    found = minimize_scalar(misfit_px, bounds=(start - near, start + near), method="bounded", options={"xatol": 1e-4})
    if not np.isfinite(found.fun):
        return []
    best = float(np.exp(found.x))
    readings = [with_gap(board, spacing) for spacing in (*(round(best, n) for n in (2, 3)), best) if spacing >= 0.05]
    return [(reading, _few(camera, detections, reading.board)) for reading in readings]
