"""All cameras and every board's X in one estimate.

Each board is calibrated by itself first, which screens its views and tells the noise of its mocap. What its corners
then say of X_b, every Y_c and theta_c, linearised again at each step, is added up, with what is known of each lens
counted once, and solved together by Gauss-Newton. Boards on bodies of their own have mocap noise of their own; that of
a platform that all share is taken as independent from board to board.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.stats import chi2

from factors import GAUSSIAN
from factors.board_shape import N_SHAPE
from gtcal.blas import on_one_blas_thread
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.errors_in_variables import prior_information
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import BOARD_SHAPE, BODY_T_BOARD, camera_T_ref_key, theta_key, to_values
from gtcal.estimation.linear import squared_distance
from gtcal.estimation.marginals import covariance_of, shared_normal_equations
from gtcal.estimation.observations import pooled
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import chain_residuals_px, norms
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import IntArray
from gtcal.recordings.recording import Recording
from gtcal.results.calibration import (
    Calibration,
    CameraCalibration,
    PoseEstimate,
    ResidualStatistics,
    Solution,
    StageReport,
)
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE, JointCovariance
from gtcal.results.other_board import OtherBoard
from gtcal.results.provenance import provenance
from gtcal.workflow import calibrate, detected

_MOST_STEPS = 12
_STILL = 1e-4
"""A step of so many sigmas, of all unknowns together, is none."""

_CONTRADICTION = 1e-4
"""Chance under which boards are said to contradict each other."""


@on_one_blas_thread
def calibrate_boards(
    recordings: Mapping[str, Recording], options: CalibrationOptions | None = None, *, progress: Progress = silent
) -> Calibration:
    """Calibrate the recordings of several boards (``load_boards``) together: the result is mainly of the first of them,
    with the others in ``other_boards``.

    Raises GtcalError, which names the board, where one can't be calibrated by itself, and for options that several
    boards have no use for."""
    started, options = time.perf_counter(), options or CalibrationOptions()
    _check_options(options)
    alone: dict[str, Calibration] = {}
    by_views = sorted(recordings, key=lambda name: -_n_views(recordings[name]))  # of images nothing is known yet
    found_lenses: dict[str, Camera] = {}
    for name in by_views:
        seen = detected(recordings[name], progress=progress, label=f"_{name}")
        cameras = {n: found_lenses.get(n, c) if c.parameters is None else c for n, c in seen.cameras.items()}
        try:
            alone[name] = calibrate(replace(seen, cameras=cameras), options, progress=progress)
        except GtcalError as error:
            raise GtcalError(f"board {name!r}: {error}") from None
        found_lenses |= {n: c.camera for n, c in alone[name].cameras.items() if n not in found_lenses}
    progress("all boards together", 0, 1)
    at = time.perf_counter()
    joint = solved_together({name: alone[name] for name in recordings}, options)
    progress("all boards together", 1, 1)
    report = StageReport(
        4, "all boards together", joint.steps, float("nan"), float("nan"), "", float("nan"), time.perf_counter() - at
    )
    return _calibration(joint, options, report, started)


def _n_views(recording: Recording) -> int:
    return sum(len(found.stamps_ns) for found in recording.detections.values())


def _check_options(options: CalibrationOptions) -> None:
    refused = {
        "stages": options.stages != (1, 2, 3),
        "priors": bool(options.priors),
        "segments": options.segments == "auto",
        "a robust kernel": options.robust != GAUSSIAN,
        "intrinsics to be found first": options.intrinsics in ("calibrate", "calibrate+refine"),
        "intrinsics held with their sigmas": options.intrinsics == "fixed",
    }
    for what, given in refused.items():
        if given:
            raise GtcalError(f"several boards together can't be calibrated with {what}: leave it out")


@dataclass(frozen=True)
class _Part:
    """What one board says. columns: where its unknowns stand among all. share: what its information is to be multiplied
    by, for what it does not know of its own noise."""

    name: str
    alone: Calibration
    solution: Solution
    columns: IntArray
    share: float

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.alone.cameras)


@dataclass(frozen=True)
class TogetherSolved:
    """boards: each by itself. body_T_board, board_shape: by board; camera_T_ref, theta: by camera. covariance: (P, P),
    columns each X, each Y_c, each theta_c that was solved for, each board's shape. steps: of Gauss-Newton.
    doubts: boards that contradict each other, a line each."""

    alone: Mapping[str, Calibration]
    body_T_board: dict[str, FloatArray]
    board_shape: dict[str, FloatArray]
    camera_T_ref: dict[str, FloatArray]
    theta: dict[str, FloatArray]
    theta_sizes: dict[str, int]
    covariance: FloatArray
    steps: int
    doubts: tuple[str, ...] = ()

    def estimate_of(self, board: str) -> Estimate:
        """Of the cameras that saw it."""
        names = self.alone[board].cameras
        return Estimate(
            self.body_T_board[board],
            {name: self.camera_T_ref[name] for name in names},
            {name: self.theta[name] for name in names},
            self.board_shape[board],
        )

    @property
    def _edges(self) -> tuple[int, int, int]:
        """Where the cameras begin, the intrinsics, and the shapes."""
        cameras = 6 * len(self.body_T_board)
        thetas = cameras + 6 * len(self.camera_T_ref)
        return cameras, thetas, thetas + sum(self.theta_sizes.values())

    def columns_of_board(self, board: str) -> IntArray:
        return np.arange(6) + 6 * list(self.body_T_board).index(board)

    def columns_of_camera(self, camera: str) -> IntArray:
        return self._edges[0] + np.arange(6) + 6 * list(self.camera_T_ref).index(camera)

    def columns_of_theta(self, camera: str) -> IntArray:
        before = list(self.theta_sizes).index(camera)
        start = self._edges[1] + sum(list(self.theta_sizes.values())[:before])
        return np.arange(start, start + self.theta_sizes[camera])

    def columns_of_shape(self, board: str) -> IntArray:
        with_shape = [name for name, one in self.alone.items() if one.board_shape is not None]
        if board not in with_shape:
            return np.arange(0)
        return self._edges[2] + N_SHAPE * with_shape.index(board) + np.arange(N_SHAPE)

    def columns_of(self, board: str) -> IntArray:
        """Of a board's own problem, in its order: X, each Y_c, each theta_c, the shape."""
        names = list(self.alone[board].cameras)
        return np.concatenate(
            [
                self.columns_of_board(board),
                *map(self.columns_of_camera, names),
                *map(self.columns_of_theta, names),
                self.columns_of_shape(board),
            ]
        ).astype(np.int64)

    def moved(self, step: FloatArray) -> TogetherSolved:
        """By a step (P,) in the tangents."""

        def pose(a_T_b: FloatArray, columns: IntArray) -> FloatArray:
            return np.asarray(a_T_b @ gtsam.Pose3.Expmap(step[columns]).matrix())

        theta = {
            name: value + step[self.columns_of_theta(name)] if self.theta_sizes[name] else value
            for name, value in self.theta.items()
        }
        shapes = {
            name: value + step[self.columns_of_shape(name)] if len(self.columns_of_shape(name)) else value
            for name, value in self.board_shape.items()
        }
        return replace(
            self,
            body_T_board={name: pose(T, self.columns_of_board(name)) for name, T in self.body_T_board.items()},
            camera_T_ref={name: pose(T, self.columns_of_camera(name)) for name, T in self.camera_T_ref.items()},
            theta=theta,
            board_shape=shapes,
        )


def solved_together(alone: Mapping[str, Calibration], options: CalibrationOptions) -> TogetherSolved:
    """The joint estimate of boards that were calibrated by themselves, in this process.

    Raises GtcalError where one was read from a file, or a direction is open."""
    at = _start(alone)
    parts = [_part(name, one, at) for name, one in alone.items()]
    known = _lens_priors(parts, at, options)
    for done in range(_MOST_STEPS):
        information, descent = _sums(parts, at, options, known)
        covariance = covariance_of(information)
        if covariance is None:
            raise GtcalError("several boards together: the data leave a direction open")
        step = covariance @ descent
        at = replace(at.moved(step), covariance=covariance, steps=done + 1)
        if float(np.sqrt(max(float(step @ information @ step), 0.0) / len(step))) < _STILL:
            break
    return replace(at, doubts=_doubts(parts, at))


def _start(alone: Mapping[str, Calibration]) -> TogetherSolved:
    """Each camera as the board has it of which it saw most."""
    best: dict[str, CameraCalibration] = {}
    sizes: dict[str, int] = {}
    for one in alone.values():
        if one.covariance is None:
            raise GtcalError("several boards together: one of them leaves a direction open by itself")
        for name, camera in one.cameras.items():
            if name not in best or camera.residuals.n_views > best[name].residuals.n_views:
                best[name] = camera
            sizes[name] = one.covariance.theta_sizes[name]
    return TogetherSolved(
        alone,
        {name: one.body_T_board.a_T_b for name, one in alone.items()},
        {name: one.estimate.board_shape for name, one in alone.items()},
        {name: camera.camera_T_ref.a_T_b for name, camera in best.items()},
        {name: camera.camera.theta for name, camera in best.items()},
        {name: sizes[name] for name in best},
        np.zeros((0, 0)),
        0,
    )


def _part(name: str, alone: Calibration, at: TogetherSolved) -> _Part:
    solution = alone.solution
    if solution is None or alone.covariance is None:
        raise GtcalError(f"board {name!r}: a calibration that was read from a file can't be joined with others")
    share = 1.0 / solution.covariance_factor
    if alone.covariance_kind != ERRORS_IN_VARIABLES and NAIVE in alone.covariances:
        naive, taken = alone.covariances[NAIVE].matrix, alone.covariance.matrix
        scale = 1.0 / np.sqrt(np.diag(naive))
        unit = np.outer(scale, scale)
        share = float(len(naive)) / float(np.trace(np.linalg.solve(naive * unit, taken * unit)))
    return _Part(name, alone, solution, at.columns_of(name), share)


def _lens_priors(parts: list[_Part], at: TogetherSolved, options: CalibrationOptions) -> dict[str, _Part]:
    """By camera whose intrinsics are solved for the part by whose stated lens it is known."""
    owners: dict[str, _Part] = {}
    for part in parts:
        for name in part.cameras:
            if options.refine_intrinsics and at.theta_sizes[name]:
                owners.setdefault(name, part)
    return owners


def _sums(
    parts: list[_Part], at: TogetherSolved, options: CalibrationOptions, owners: Mapping[str, _Part]
) -> tuple[FloatArray, FloatArray]:
    """(P, P) information of all boards and (P,) what they pull by."""
    size = at._edges[2] + sum(len(at.columns_of_shape(part.name)) for part in parts)
    information, descent = np.zeros((size, size)), np.zeros(size)
    for part in parts:
        H, d = _of_board(part, at, options)
        known, pull = _known_of_lenses(part, at, options)
        H, d = part.share * (H - known), part.share * (d - pull)
        own = [name for name in part.cameras if owners.get(name) is part]
        once, pulled = _known_of_lenses(part, at, options, own, weight=1.0)
        information[np.ix_(part.columns, part.columns)] += H + once
        descent[part.columns] += d + pulled
    return information, descent


def _of_board(part: _Part, at: TogetherSolved, options: CalibrationOptions) -> tuple[FloatArray, FloatArray]:
    """(p, p) and (p,) of its own unknowns, its priors among them."""
    free_theta = any(at.theta_sizes[name] for name in part.cameras)
    with_shape = len(at.columns_of_shape(part.name)) > 0
    values = gtsam.Values(part.solution.values)
    values.update(to_values(at.estimate_of(part.name), with_theta=free_theta, with_shape=with_shape))
    keys = [BODY_T_BOARD, *map(camera_T_ref_key, range(len(part.cameras)))]
    keys += [theta_key(i) for i, name in enumerate(part.cameras) if at.theta_sizes[name]]
    keys += [BOARD_SHAPE] if with_shape else []
    return shared_normal_equations(part.solution.graph.linearize(values), keys)


def _known_of_lenses(
    part: _Part,
    at: TogetherSolved,
    options: CalibrationOptions,
    cameras: list[str] | None = None,
    weight: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """(p, p) and (p,) of the priors of these cameras' intrinsics, all by default, as the board alone weighs them."""
    size = len(part.columns)
    H, d = np.zeros((size, size)), np.zeros(size)
    if not options.refine_intrinsics:
        return H, d
    whole = prior_information(
        part.solution.views,
        at.estimate_of(part.name),
        options,
        part.solution.lens_weight if weight is None else weight,
    )
    place = {int(column): i for i, column in enumerate(part.columns)}
    chosen = part.cameras if cameras is None else cameras
    rows = [place[int(column)] for name in chosen for column in at.columns_of_theta(name)]
    H[np.ix_(rows, rows)] = whole[np.ix_(rows, rows)]
    d[rows] = -whole[rows, -1]
    return H, d


def _doubts(parts: list[_Part], at: TogetherSolved) -> tuple[str, ...]:
    """Cameras about which a board by itself says otherwise than all together, by more than both know: the difference of
    an estimate and a better one has the difference of their covariances (Hausman 1978)."""
    lines = []
    for part in parts:
        for name, camera in part.alone.cameras.items():
            own = camera.camera_T_ref
            columns = at.columns_of_camera(name)
            assert own.covariance is not None  # _part has seen to it
            apart = np.asarray(
                gtsam.Pose3.Logmap(gtsam.Pose3(np.linalg.inv(own.a_T_b) @ at.camera_T_ref[name])), dtype=np.float64
            )
            surplus = own.covariance - at.covariance[np.ix_(columns, columns)]
            floor = 0.1 * own.covariance  # where it is nearly the whole of what is known
            eigen, axes = np.linalg.eigh(surplus - floor)
            known = floor + (axes * np.maximum(eigen, 0.0)) @ axes.T
            chance = float(chi2.sf(squared_distance(apart, known), 6))
            if chance * sum(len(p.cameras) for p in parts) < _CONTRADICTION:
                mm = 1e3 * float(
                    np.linalg.norm(
                        PoseEstimate(at.camera_T_ref[name], None).position_of_a_in_b_m - own.position_of_a_in_b_m
                    )
                )
                lines.append(
                    f"board {part.name!r} by itself puts camera {name!r} {mm:.2f} mm from where all boards do, more "
                    "than chance: one of the boards or its markers is not as stated, or moved"
                )
    return tuple(lines)


def _calibration(
    joint: TogetherSolved, options: CalibrationOptions, report: StageReport, started: float
) -> Calibration:
    main_name, *other_names = joint.alone
    main = joint.alone[main_name]
    sigmas = _joint_covariance(joint, main_name)
    residuals = {name: _residuals(joint, name) for name in joint.alone}
    cameras = {
        name: _camera(joint, name, sigmas, {board: of[name] for board, of in residuals.items() if name in of})
        for name in joint.camera_T_ref
    }
    warnings = [f"board {name!r}: {line}" for name, one in joint.alone.items() for line in one.warnings]
    shape = main.board_shape
    if shape is not None:
        rows = joint.columns_of_shape(main_name)
        covariance = joint.covariance[np.ix_(rows, rows)]
        shape = replace(shape, shape=joint.board_shape[main_name], covariance=covariance)
    inputs = tuple(dict.fromkeys(entry for one in joint.alone.values() for entry in one.provenance.inputs))
    whole = Estimate(joint.body_T_board[main_name], joint.camera_T_ref, joint.theta, joint.board_shape[main_name])
    return replace(
        main,
        cameras=cameras,
        body_T_board=PoseEstimate(joint.body_T_board[main_name], sigmas.body_T_board),
        board_shape=shape,
        covariance_kind=sigmas.kind,
        covariances={sigmas.kind: sigmas},
        estimates={4: whole},
        stages=(*main.stages, report),
        dropped=pooled(entry for one in joint.alone.values() for entry in one.dropped),
        warnings=(*warnings, *joint.doubts),
        provenance=provenance(options, inputs, time.perf_counter() - started),
        other_boards=tuple(
            OtherBoard(
                name,
                joint.alone[name].board,
                joint.alone[name].capture,
                PoseEstimate(joint.body_T_board[name], _block(joint, joint.columns_of_board(name))),
                {camera: ResidualStatistics.of(*of) for camera, of in residuals[name].items()},
            )
            for name in other_names
        ),
        solution=None,
    )


def _block(joint: TogetherSolved, columns: IntArray) -> FloatArray:
    return joint.covariance[np.ix_(columns, columns)]


def _joint_covariance(joint: TogetherSolved, main: str) -> JointCovariance:
    """Of the main board's X, every Y_c and theta_c, and that board's shape."""
    columns = np.concatenate(
        [
            joint.columns_of_board(main),
            *map(joint.columns_of_camera, joint.camera_T_ref),
            *map(joint.columns_of_theta, joint.camera_T_ref),
            joint.columns_of_shape(main),
        ]
    ).astype(np.int64)
    modelled = any(one.covariance_kind == ERRORS_IN_VARIABLES for one in joint.alone.values())
    kind = ERRORS_IN_VARIABLES if modelled else CLUSTERED
    return JointCovariance.of(kind, joint.theta_sizes, _block(joint, columns))


def _residuals(joint: TogetherSolved, board: str) -> dict[str, tuple[FloatArray, int]]:
    """By camera that saw the board the residuals' norms, and of how many views."""
    solution = joint.alone[board].solution
    assert solution is not None  # as _part has seen to
    estimate = joint.estimate_of(board)
    return {name: (norms(chain_residuals_px(views, estimate)), views.n_views) for name, views in solution.views.items()}


def _camera(
    joint: TogetherSolved, name: str, sigmas: JointCovariance, seen: Mapping[str, tuple[FloatArray, int]]
) -> CameraCalibration:
    """Its residuals are those of all boards."""
    one = next(one.cameras[name] for one in joint.alone.values() if name in one.cameras)
    lengths = np.concatenate([of for of, _ in seen.values()])
    return CameraCalibration(
        camera=replace(one.camera, parameters=joint.theta[name]),
        camera_T_ref=PoseEstimate(joint.camera_T_ref[name], sigmas.camera_T_ref(name)),
        theta_covariance=sigmas.theta(name),
        residuals=ResidualStatistics.of(lengths, sum(n for _, n in seen.values())),
        lens_moves=one.lens_moves,
    )
