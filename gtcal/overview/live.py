"""A recording while it is being made: what is still weak, what to show next, and when it is enough.

The folder is looked at again whenever one of its files has changed. A few frames of each camera, evenly spread, with
what all cameras saw in them, are calibrated, the mocap's noise modelled: that takes about a second however long the
recording is. The sigmas of all frames follow from those by the root of their number.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gtcal.blas import on_one_blas_thread
from gtcal.cores import all_cores
from gtcal.detection.detect import CACHE_FOLDER
from gtcal.detection.view_detection import detect_view
from gtcal.errors import GtcalError
from gtcal.estimation.frame_statistics import evenly
from gtcal.estimation.observations import Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import select_views
from gtcal.estimation.solver import calibrate_observations
from gtcal.recordings.detections import CameraDetections, IntArray
from gtcal.recordings.images import Images
from gtcal.recordings.manifest import find_manifest, read_manifest
from gtcal.recordings.recording import Recording, load_recording
from gtcal.results.calibration import Calibration
from gtcal.results.covariance import NAIVE
from gtcal.uncertainty.coverage import coverage_of_views
from gtcal.uncertainty.weak_directions import least_sure
from gtcal.workflow import prepared

MOST_VIEWS = 6
"""Of each camera, whose frames are calibrated at each look, with what the other cameras saw in them."""

APART_S = 0.5
"""Views are looked at so far apart: more of the same moment say little, and detection has to keep up."""

_POLL_S = 0.2
_MOST_SHOWN = 4


@dataclass(frozen=True)
class Enough:
    """When a recording is enough: the largest 1-sigma of any camera's place and attitude.

    Raises GtcalError for a number that is not positive."""

    mm: float = 0.2
    deg: float = 0.02

    def __post_init__(self) -> None:
        for name in ("mm", "deg"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise GtcalError(f"enough: {name} is {getattr(self, name)}, not a positive number")


@dataclass(frozen=True)
class Look:
    """A recording as it is now.

    n_views: by camera, those with a pose of every body. sigma_mm, sigma_deg: by camera, its largest 1-sigma; empty
    where nothing can be said yet, and why is in ``problem``. missing: what it lacks, a line each. weak: its least sure
    directions, in words. seconds: what looking took."""

    n_views: dict[str, int]
    sigma_mm: dict[str, float]
    sigma_deg: dict[str, float]
    missing: tuple[str, ...]
    weak: tuple[str, ...]
    problem: str
    enough: Enough
    seconds: float

    @property
    def is_enough(self) -> bool:
        return bool(self.sigma_mm) and (
            max(self.sigma_mm.values()) < self.enough.mm and max(self.sigma_deg.values()) < self.enough.deg
        )

    @property
    def advice(self) -> tuple[str, ...]:
        """What to do next, the most urgent first."""
        if self.is_enough:
            return ("enough: every camera is as sure as was asked for",)
        lines = (*((self.problem,) if self.problem else ()), *self.weak, *self.missing)
        return tuple(dict.fromkeys(lines))[:_MOST_SHOWN] or ("go on: more of the same makes it surer",)


def watch(folder: Path, enough: Enough | None = None, *, poll_s: float = _POLL_S) -> Iterator[Look]:
    """A look at the recording as it is, and another whenever a file has changed; without end.

    Raises GtcalError where there is no manifest of a recording of a board, which is written before all else."""
    read_manifest(find_manifest(folder))
    watcher, before = Watcher(folder, enough or Enough()), None
    while True:
        now = _state_of(folder)
        if now != before:
            before = now
            yield watcher.look()
        else:
            time.sleep(poll_s)


def _state_of(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Every file of a recording with its size and time of change; the cache of detections is none of it."""
    root = path if path.is_dir() else path.parent
    found = []
    for file in root.rglob("*"):
        if CACHE_FOLDER in file.parts:
            continue
        try:
            known = file.stat()
        except OSError:  # taken away in between
            continue
        found.append((str(file), known.st_size, known.st_mtime_ns))
    return tuple(sorted(found))


@dataclass
class Watcher:
    """Keeps what was detected from look to look. seen: by camera, by stamp, the corner ids and corners of an image."""

    path: Path
    enough: Enough
    seen: dict[str, dict[int, tuple[IntArray, np.ndarray]]] = field(default_factory=dict)

    @on_one_blas_thread
    def look(self) -> Look:
        """The recording as it is now; what can't be read yet, as half-written files, is the look's ``problem``."""
        started = time.perf_counter()
        views: dict[str, Views] = {}
        calibration: Calibration | None = None
        missing: tuple[str, ...] = ()
        used: dict[str, Views] = {}
        problem = ""
        try:
            observations, _ = prepared(self._detected(load_recording(self.path)), _OPTIONS)
            views = {name: _those_apart(of_camera) for name, of_camera in observations.views.items()}
            used = _thinned(views)
            calibration = calibrate_observations(replace(observations, views=used), _OPTIONS)
            missing = coverage_of_views(views, calibration.estimate, observations.capture).missing
        except GtcalError as error:
            problem = str(error)
        counts = {name: of_camera.n_views for name, of_camera in views.items()}
        shares = {name: used[name].n_views / n_views for name, n_views in counts.items()} if calibration else {}
        sigma_mm, sigma_deg = _sigmas(calibration, shares)
        weak = () if calibration is None else tuple(found.sentence for found in least_sure(calibration))
        seconds = time.perf_counter() - started
        return Look(counts, sigma_mm, sigma_deg, missing, weak, problem, self.enough, seconds)

    def _detected(self, recording: Recording) -> Recording:
        """With corners for the cameras that have images, of as many images as there was time for."""
        found = {
            name: self._of_camera(recording, name, images)
            for name, images in recording.images.items()
            if name not in recording.detections
        }
        return replace(recording, detections=recording.detections | found)

    def _of_camera(self, recording: Recording, name: str, images: Images) -> CameraDetections:
        known = self.seen.setdefault(name, {})
        camera = recording.cameras[name]
        wanted = [index for index in _apart(images.stamps_ns) if int(images.stamps_ns[index]) not in known]

        def detected(index: int) -> tuple[int, tuple[IntArray, np.ndarray]] | None:
            try:
                return int(images.stamps_ns[index]), detect_view(images.read(index), recording.board, camera)
            except GtcalError:  # half-written: the next look finds it whole
                return None

        with all_cores() as pool:
            known.update(one for one in pool.map(detected, wanted) if one is not None)
        shown = [(stamp, *known[stamp]) for stamp in sorted(known) if len(known[stamp][0])]
        return CameraDetections.from_views(shown)


_OPTIONS = CalibrationOptions(effects=False, clock="trust", pnp_views=2 * MOST_VIEWS)


def _apart(stamps_ns: IntArray) -> Iterator[int]:
    """Of the images in order of time, each that is far enough after the last one taken."""
    last_ns = None
    for index, stamp_ns in enumerate(stamps_ns.tolist()):
        if last_ns is None or stamp_ns - last_ns >= 1e9 * APART_S:
            last_ns = stamp_ns
            yield index


def _those_apart(views: Views) -> Views:
    return select_views(views, np.fromiter(_apart(views.stamps_ns), dtype=np.int64))


def _thinned(views: dict[str, Views]) -> dict[str, Views]:
    chosen = [evenly(of_camera.frame_index, MOST_VIEWS) for of_camera in views.values()]
    frames = np.unique(np.concatenate(chosen))
    return {
        name: select_views(of_camera, np.flatnonzero(np.isin(of_camera.frame_index, frames)))
        for name, of_camera in views.items()
    }


def _sigmas(calibration: Calibration | None, shares: dict[str, float]) -> tuple[dict[str, float], dict[str, float]]:
    """By camera the largest 1-sigma of its place in mm and of its attitude in deg, of all views of which ``shares``
    were used. None where frames were too few for a covariance with the mocap's noise in it."""
    mm: dict[str, float] = {}
    deg: dict[str, float] = {}
    if calibration is None or calibration.covariance_kind == NAIVE:
        return mm, deg
    for name, camera in calibration.cameras.items():
        of_place, of_attitude = camera.camera_T_ref.position_of_a_in_b_sigma_mm, camera.camera_T_ref.rotation_sigma_deg
        if of_place is not None and of_attitude is not None:
            root = float(np.sqrt(shares[name]))
            mm[name], deg[name] = root * float(of_place.max()), root * float(of_attitude.max())
    return mm, deg
