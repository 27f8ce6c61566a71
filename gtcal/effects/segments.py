"""A calibration of each stretch between changes on unknowns of its own, all that did not move shared.

A camera that moved is two cameras, one before and one after. A body whose markers moved by D measures wrong poses after
it; they are put right by D, which is found with all else: the solution is repeated at the poses put right until no more
of D is left, and what is not known of D goes into the covariance. What is put right is in the bodies' frames of the
first stretch; the later ones follow from D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from factors.rigid import adjoint, inverse
from gtcal.camera import FloatArray
from gtcal.effects.change_points import ChangePoint, parts
from gtcal.effects.evidence import Sums
from gtcal.effects.find import effect_warnings, find_effects, frames_of, with_found
from gtcal.effects.frames import Frames
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import select_views
from gtcal.recordings.detections import IntArray
from gtcal.recordings.trajectory import Trajectory
from gtcal.results.calibration import Calibration, PoseEstimate, Segment
from gtcal.results.covariance import NAIVE, JointCovariance
from gtcal.results.effect_finding import EffectFinding

Solve = Callable[[Observations], Calibration]

MOST_ROUNDS = 4
SETTLED_SIGMAS = 0.1
"""What is left of a slip, in sigmas, that needs no other round."""


@dataclass(frozen=True)
class _Slips:
    """The changes of bodies, in order of time. corrections: (m, 4, 4) D of each body in the stretch from the change on:
    its markers' frame as measured is true_T_measured = D."""

    changes: tuple[ChangePoint, ...]
    corrections: FloatArray

    def of_body(self, name: str) -> list[int]:
        return [index for index, change in enumerate(self.changes) if change.part.name == name]

    def at(self, name: str, stamps_ns: IntArray) -> FloatArray:
        """(N, 4, 4) the body's D at N times; the identity before its first slip."""
        own = self.of_body(name)
        starts = np.array([self.changes[index].after_ns for index in own], dtype=np.int64)
        stretches = np.concatenate([np.eye(4)[None], self.corrections[own]])
        return stretches[np.searchsorted(starts, stamps_ns, side="right")]

    def further(self, left: FloatArray) -> _Slips:
        """With what is left (m, 6) of each slip put right too; every stretch holds all slips of its body before it."""
        corrections = self.corrections.copy()
        for index, change in enumerate(self.changes):
            own = [other for other in self.of_body(change.part.name) if other <= index]
            step = gtsam.Pose3.Expmap(left[own].sum(axis=0)).matrix()
            corrections[index] = step @ corrections[index]
        return replace(self, corrections=corrections)


def in_segments(
    calibration: Calibration, observations: Observations, options: CalibrationOptions, solve: Solve
) -> Calibration:
    """The calibration with what else the data want; where something moved, with a ``Segment`` for each stretch.

    observations: those that it was computed from. solve: calibrates observations."""
    found = find_effects(calibration, observations, options)
    if not found.changes:
        return with_found(calibration, found)
    changes = found.changes
    cameras, slips = _sorted_out(changes)
    split = _split(observations, cameras)
    settled = _settled(split, _Slips(slips, np.tile(np.eye(4), (len(slips), 1, 1))), options, solve)
    effects = _effects(found.effects, settled, options, tuple(calibration.cameras))
    segments = _segments(settled, changes, observations)
    merged = _merged(settled.calibration, tuple(calibration.cameras))
    return replace(
        merged,
        clock=calibration.clock,
        effects=effects,
        segments=segments,
        warnings=(*merged.warnings, *effect_warnings(effects)),
    )


def _sorted_out(changes: Sequence[ChangePoint]) -> tuple[tuple[ChangePoint, ...], tuple[ChangePoint, ...]]:
    """Those of cameras, and those of bodies."""
    cameras = tuple(change for change in changes if change.part.is_camera)
    return cameras, tuple(change for change in changes if not change.part.is_camera)


def _later(change: ChangePoint) -> str:
    """What a camera is called from a move on."""
    return f"{change.part.name} after {change.moment.at_s:.2f} s"


def _split(observations: Observations, changes: Sequence[ChangePoint]) -> Observations:
    """With a camera of its own for each stretch; the later ones come last, so that the others keep their places."""
    views, later = dict(observations.views), {}
    for change in sorted(changes, key=lambda change: -change.after_ns):
        of_camera = views[change.part.name]
        after = of_camera.stamps_ns >= change.after_ns
        views[change.part.name] = select_views(of_camera, np.flatnonzero(~after))
        name = _later(change)
        moved = select_views(of_camera, np.flatnonzero(after))
        later[name] = replace(moved, camera=replace(of_camera.camera, name=name))
    return replace(observations, views=views | later)


@dataclass(frozen=True)
class _Settled:
    """Where the rounds ended. joint: (F + 6 m, F + 6 m) covariance of the unknowns and of what is left of each of the m
    slips; None without slips, or where the noise is not known."""

    calibration: Calibration
    observations: Observations
    slips: _Slips
    joint: FloatArray | None


def _settled(observations: Observations, slips: _Slips, options: CalibrationOptions, solve: Solve) -> _Settled:
    """Put right, solve, look what is left, and again."""
    for _ in range(MOST_ROUNDS):
        corrected = _put_right(observations, slips)
        calibration = solve(corrected)
        frames = frames_of(calibration, corrected, options)
        if frames is None or not slips.changes:
            return _Settled(calibration, corrected, slips, None)
        left, joint = _left(frames, slips.changes)
        sigmas = np.sqrt(np.diag(joint)[-left.size :]).reshape(left.shape)
        if (np.abs(left) < SETTLED_SIGMAS * sigmas).all():
            break
        slips = slips.further(left)
    return _Settled(_with_slips_unknown(calibration, joint, left.size), corrected, slips, joint)


def _left(frames: Frames, changes: Sequence[ChangePoint]) -> tuple[FloatArray, FloatArray]:
    """What is left of each slip (m, 6), and the covariance of all unknowns with it."""
    by_name = {part.name: part for part in parts(frames)}
    here = [
        replace(change, part=by_name[change.part.name], index=int(np.searchsorted(frames.stamps_ns, change.after_ns)))
        for change in changes
    ]
    sums = Sums.of(frames, here)
    solved, covariance, _ = sums.solution(np.arange(sums.noisy.shape[1] - 1))
    return solved[len(frames.free) :].reshape(-1, 6), covariance


def _put_right(observations: Observations, slips: _Slips) -> Observations:
    """At the poses that the bodies would have been measured at, had their markers not moved."""
    if not slips.changes:
        return observations
    motion = observations.motion
    bodies = {name: _body_put_right(name, body, slips) for name, body in motion.trajectories.items()}
    right = replace(motion, platform=bodies.get("platform"), board_body=bodies.get("board_body"))
    return replace(
        observations,
        motion=right,
        views={name: _views_put_right(views, slips) for name, views in observations.views.items()},
    )


def _body_put_right(name: str, body: Trajectory, slips: _Slips) -> Trajectory:
    world_T_body = body.world_T_body @ inverse(slips.at(name, body.stamps_ns))
    return replace(body, world_T_body=np.ascontiguousarray(world_T_body))


def _views_put_right(views: Views, slips: _Slips) -> Views:
    platform, board = (slips.at(name, views.stamps_ns) for name in ("platform", "board_body"))
    return replace(views, ref_T_body=np.ascontiguousarray(platform @ views.ref_T_body @ inverse(board)))


def _with_slips_unknown(calibration: Calibration, joint: FloatArray, n_slips: int) -> Calibration:
    """With covariances that know that the slips were estimated: larger by what freeing them adds."""
    n = len(joint) - n_slips
    added = joint[:n, :n] - np.linalg.inv(np.linalg.inv(joint)[:n, :n])
    covariances = {
        kind: found if kind == NAIVE else _grown(found, added) for kind, found in calibration.covariances.items()
    }
    return _with_covariances(calibration, covariances)


def _grown(joint: JointCovariance, added: FloatArray) -> JointCovariance:
    """added: of the unknowns of a ``JointCovariance`` and, behind them, of the board's shape."""
    n = len(joint.matrix)
    return replace(joint, matrix=joint.matrix + added[:n, :n])


def _with_covariances(calibration: Calibration, covariances: dict[str, JointCovariance]) -> Calibration:
    own = covariances.get(calibration.covariance_kind)
    if own is None:
        return calibration
    return replace(calibration, covariances=covariances).with_covariance(own)


def _effects(
    found: Sequence[EffectFinding], settled: _Settled, options: CalibrationOptions, cameras: tuple[str, ...]
) -> tuple[EffectFinding, ...]:
    """The changes, as found before they were put right, and what else is wanted after."""
    changes = [
        replace(finding, advice="each stretch was calibrated on its own, see 'segments'; the poses are the first's")
        for finding in found
        if finding.moment
    ]
    rest = find_effects(settled.calibration, settled.observations, options).effects
    return tuple(
        replace(
            finding,
            moves_mm={name: mm for name, mm in finding.moves_mm.items() if name in cameras},
            moves_deg={name: deg for name, deg in finding.moves_deg.items() if name in cameras},
        )
        for finding in (*changes, *rest)
    )


def _segments(settled: _Settled, changes: Sequence[ChangePoint], observations: Observations) -> tuple[Segment, ...]:
    """One from each change to the next."""
    stamps_ns = observations.frame_stamps_ns
    changes = sorted(changes, key=lambda change: change.after_ns)
    starts = [int(stamps_ns[0]), *(change.after_ns for change in changes)]
    ends = [*starts[1:], int(stamps_ns[-1])]
    moved = ["", *(change.part.name for change in changes)]
    names = tuple(observations.views)
    return tuple(
        Segment(
            1e-9 * (start - starts[0]),
            1e-9 * (end - starts[0]),
            what,
            _board_at(settled, start),
            {name: _camera_at(settled, changes, name, start) for name in names},
        )
        for start, end, what in zip(starts, ends, moved, strict=True)
    )


def _board_at(settled: _Settled, at_ns: int) -> PoseEstimate:
    """body_T_board in the stretch that begins then: D^-1 * X, as markers that moved by D give their body another
    frame."""
    pose = settled.calibration.body_T_board
    (body_D,) = settled.slips.at("board_body", np.array([at_ns]))
    moved = _carried(settled, "board_body", at_ns, slice(0, 6), -adjoint(inverse(pose.a_T_b)[None])[0])
    return PoseEstimate(inverse(body_D) @ pose.a_T_b, _sum(pose.covariance, moved))


def _camera_at(settled: _Settled, changes: Sequence[ChangePoint], camera: str, at_ns: int) -> PoseEstimate:
    """camera_T_ref in the stretch that begins then: Y_c * D."""
    own = [change for change in changes if change.part.name == camera and change.after_ns <= at_ns]
    name = _later(own[-1]) if own else camera
    pose = settled.calibration.cameras[name].camera_T_ref
    (platform_D,) = settled.slips.at("platform", np.array([at_ns]))
    start = 6 + 6 * list(settled.calibration.cameras).index(name)
    moved = _carried(settled, "platform", at_ns, slice(start, start + 6), np.eye(6))
    covariance = _sum(pose.covariance, moved)
    into = adjoint(inverse(platform_D)[None])[0]
    return PoseEstimate(pose.a_T_b @ platform_D, None if covariance is None else into @ covariance @ into.T)


def _carried(settled: _Settled, body: str, at_ns: int, own: slice, by_slip: FloatArray) -> FloatArray:
    """(6, 6) by how much the covariance of unknowns ``own`` grows when all slips of the body so far, each carried over
    by ``by_slip`` (6, 6), come on top."""
    if settled.joint is None:
        return np.zeros((6, 6))
    n = len(settled.joint) - 6 * len(settled.slips.changes)
    J = np.zeros((6, len(settled.joint)))
    J[:, own] = np.eye(6)
    for index in settled.slips.of_body(body):
        if settled.slips.changes[index].after_ns <= at_ns:
            J[:, n + 6 * index : n + 6 * index + 6] = by_slip
    return np.asarray(J @ settled.joint @ J.T - settled.joint[own, own])


def _sum(covariance: FloatArray | None, more: FloatArray) -> FloatArray | None:
    return None if covariance is None else covariance + more


def _merged(calibration: Calibration, cameras: tuple[str, ...]) -> Calibration:
    """With the recording's own cameras alone, each as it was in the first stretch."""
    solution = calibration.solution
    return replace(
        calibration,
        cameras={name: calibration.cameras[name] for name in cameras},
        covariances={kind: _of_cameras(joint, cameras) for kind, joint in calibration.covariances.items()},
        estimates={stage: _estimate_of(found, cameras) for stage, found in calibration.estimates.items()},
        solution=None
        if solution is None
        else replace(
            solution,
            estimate=_estimate_of(solution.estimate, cameras),
            views={name: solution.views[name] for name in cameras},
        ),
    )


def _of_cameras(joint: JointCovariance, cameras: tuple[str, ...]) -> JointCovariance:
    kept = [joint.columns_of_body_T_board, *map(joint.columns_of_camera_T_ref, cameras)]
    kept += [joint.columns_of_theta(name) for name in cameras]
    rows = np.concatenate([np.arange(len(joint.matrix))[columns] for columns in kept])
    sizes = {name: joint.theta_sizes[name] for name in cameras}
    return JointCovariance(joint.kind, sizes, joint.matrix[np.ix_(rows, rows)], joint.board_shape)


def _estimate_of(estimate: Estimate, cameras: tuple[str, ...]) -> Estimate:
    return Estimate(
        estimate.body_T_board,
        {name: estimate.camera_T_ref[name] for name in cameras},
        {name: estimate.theta[name] for name in cameras},
        estimate.board_shape,
    )
