"""Two calibrations of one rig, each with its covariance: what moved between them, what is the same, and what they are
too uncertain to tell apart.

Poses are compared in the tangent at the first one's: Y_c of B is Y_c of A * Exp(xi), so that one xi common to all
cameras is a ref that is defined anew (its markers moved, or the mocap's software was told of another body), and what
is left of each xi is a camera that moved by itself. Each xi is held against the sum of both covariances; the two
calibrations are taken to rest on recordings of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import gtsam
import numpy as np
from scipy import special

from factors.board_shape import N_SHAPE, outline_of, shaped
from factors.rigid import adjoint, inverse
from gtcal.board import board_from_manifest
from gtcal.camera import FloatArray
from gtcal.differences.exchanged import Exchanged, exchanged_cameras, known_pairs
from gtcal.errors import GtcalError
from gtcal.estimation.earlier import BOARD, SHAPE, intrinsics_of
from gtcal.estimation.linear import squared_distance
from gtcal.files import InputFile
from gtcal.results.calibration import Calibration, pose_difference
from gtcal.results.covariance import JointCovariance
from gtcal.results.presented import Presented
from gtcal.uncertainty.projected import (
    CELLS_ACROSS,
    image_grid,
    joint_covariance_of,
    pixel_jacobians,
    pixel_uncertainty,
    points_ahead,
)

UNLIKELY = 0.01
"""Something moved where chance lets any of the differences be as large in one comparison of a hundred."""

AT_MOST_SIGMAS = 2.0
"""A difference is at most what was found and so many sigmas of it more."""

ALL, TO_EACH_OTHER = "all cameras together", "cameras to each other"

_MANIFESTS = (".yaml", ".yml", ".json")

_ROUNDS, _NO_STEP = 10, 1e-12


class Verdict(StrEnum):
    """What is to be said of a difference. WITHIN: it is no chance, and less than the tolerance. UNTOLD: it may be
    chance, and may be more than the tolerance."""

    SAME = "the same"
    WITHIN = "moved, within the tolerance"
    UNTOLD = "not told apart"
    MOVED = "moved"


@dataclass(frozen=True)
class DifferenceOptions:
    """max_mm, max_px: tolerances, on the place of a camera or the board and on the pixels of points in ref (RMS over
    the image). distance_m: of those points from the camera.

    Raises GtcalError for a number that is not positive."""

    max_mm: float = 1.0
    max_px: float = 0.5
    distance_m: float = 1.0

    def __post_init__(self) -> None:
        for name in ("max_mm", "max_px", "distance_m"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise GtcalError(f"{name}: {getattr(self, name)} is not a positive number")


@dataclass(frozen=True)
class Change:
    """From A to B, of one thing.

    distance2: squared, in units of the sum of both covariances; dof: its degrees of freedom.
    moved_mm, sigma_mm: of its place, and 1-sigma of that along the least sure direction; turned_deg, sigma_deg: of its
    rotation. rms_px: of the pixels of points over the image; expected_px: what the covariances let expect of that.
    Each NaN where there is none. n_compared: of how many changes this is one."""

    what: str
    distance2: float
    dof: int
    moved_mm: float = float("nan")
    sigma_mm: float = float("nan")
    turned_deg: float = float("nan")
    sigma_deg: float = float("nan")
    rms_px: float = float("nan")
    expected_px: float = float("nan")
    n_compared: int = 1

    @property
    def probability(self) -> float:
        """Of a difference as large or larger where nothing moved."""
        return float(special.chdtrc(self.dof, self.distance2))

    @property
    def moved(self) -> bool:
        return self.probability < UNLIKELY / self.n_compared

    @property
    def at_most_mm(self) -> float:
        return self.moved_mm + AT_MOST_SIGMAS * self.sigma_mm

    @property
    def at_most_px(self) -> float:
        return self.rms_px + AT_MOST_SIGMAS * self.expected_px

    def verdict(self, options: DifferenceOptions) -> Verdict:
        within = not (self.at_most_mm > options.max_mm or self.at_most_px > options.max_px)
        if self.moved:
            return Verdict.WITHIN if within else Verdict.MOVED
        return Verdict.SAME if within else Verdict.UNTOLD


@dataclass(frozen=True)
class PixelChange:
    """Of the pixels of points at one distance from a camera, on a grid over its image; row 0 is the image's top.

    x_px: (W,), y_px: (H,) middles of the cells, as A has them. change_px: (H, W, 2) from A's pixel to B's; expected_px:
    (H, W) root mean square length that both covariances let expect. NaN where no point has a pixel in both."""

    camera: str
    x_px: FloatArray
    y_px: FloatArray
    change_px: FloatArray
    expected_px: FloatArray

    @property
    def length_px(self) -> FloatArray:
        """(H, W)."""
        return np.asarray(np.linalg.norm(self.change_px, axis=2))

    @property
    def rms_px(self) -> float:
        return _rms(self.length_px)

    @property
    def rms_expected_px(self) -> float:
        return _rms(self.expected_px)


@dataclass(frozen=True, repr=False)
class Difference(Presented):
    """aligned: B_ref_T_A_ref (4, 4), where ref was defined anew; the cameras' changes are then what is left of them.
    changes: of all cameras together (where there are several), of each camera, of its intrinsics, of the board and its
    shape.
    pixels: by camera. notes: what was not compared, and why. exchanged: two cameras that stand where the other one
    did."""

    options: DifferenceOptions
    changes: tuple[Change, ...]
    pixels: tuple[PixelChange, ...]
    aligned: FloatArray | None
    notes: tuple[str, ...] = field(default=())
    exchanged: Exchanged | None = None

    @property
    def verdict(self) -> Verdict:
        """The worst of all."""
        order = list(Verdict)
        return max((change.verdict(self.options) for change in self.changes), key=order.index)

    @property
    def moved_statements(self) -> tuple[str, ...]:
        """What moved, in a sentence each; the cameras to each other only where no single one of them surely did. First
        of all, two whose images are swapped."""
        moved = [change for change in self.changes if change.moved]
        if any(change.what in {seen.camera for seen in self.pixels} for change in moved):
            moved = [change for change in moved if change.what != TO_EACH_OTHER]
        swapped = () if self.exchanged is None else (self.exchanged.statement,)
        return (*swapped, *(_sentence(change, self.options) for change in moved))

    @property
    def statements(self) -> tuple[str, ...]:
        """What moved, in a sentence each; or that nothing did."""
        if self.moved_statements:
            return self.moved_statements
        untold = [c.what for c in self.changes if c.verdict(self.options) is Verdict.UNTOLD]
        if untold:
            return (
                f"nothing has surely moved, but {', '.join(untold)} may differ by more than the tolerance: "
                "record longer, or with more of the motion that 'gtcal uncertainty' names",
            )
        return ("nothing moved",)


def _sentence(change: Change, options: DifferenceOptions) -> str:
    sizes = [
        f"{value:.3g} {unit}"
        for value, unit in ((change.moved_mm, "mm"), (change.turned_deg, "deg"), (change.rms_px, "px over the image"))
        if np.isfinite(value)
    ]
    less = " (within the tolerance)" if change.verdict(options) is Verdict.WITHIN else ""
    by = f" by {', '.join(sizes)}" if sizes else ""
    cause = {
        ALL: ": ref was defined anew, or its markers moved; the cameras' changes below are what is left without that",
        BOARD: ": its body was defined anew, or its markers moved",
    }.get(change.what, "")
    return f"{change.what}: moved{by}{less}{cause}"


def difference(a: Calibration, b: Calibration, options: DifferenceOptions | None = None) -> Difference:
    """What moved from calibration A to B.

    Raises GtcalError where they are of different captures, have no camera in common, or one has no covariance."""
    options = options or DifferenceOptions()
    if a.capture is not b.capture:
        raise GtcalError(
            f"the captures differ, {a.capture.value} and {b.capture.value}: what is ref in one is not in the other"
        )
    names = tuple(name for name in a.cameras if name in b.cameras)
    if not names:
        raise GtcalError(f"no camera in common: {', '.join(a.cameras)}, and {', '.join(b.cameras)}")
    poses = _Poses.of(a, b, names)
    common = _common_motion(poses)
    aligned = None if common is None else common.aligned
    pixels = tuple(_pixel_change(a, b, aligned, name, options.distance_m) for name in names)
    changes = [
        *_of_the_rig(poses, common),
        *_of_cameras(poses, common, pixels),
        *_of_lenses(a, b, names, options.distance_m),
        *_of_the_board(a, b),
        *_of_the_shape(a, b),
    ]
    counted = tuple(replace(change, n_compared=len(changes)) for change in changes)
    exchanged = exchanged_cameras(b.estimate.camera_T_ref, known_pairs(a.estimate.camera_T_ref))
    return Difference(options, counted, pixels, aligned, _notes(a, b), exchanged)


def _notes(a: Calibration, b: Calibration) -> tuple[str, ...]:
    notes = [
        f"{', '.join(missing)}: only in {which}, not compared"
        for missing, which in (
            ([name for name in a.cameras if name not in b.cameras], "A"),
            ([name for name in b.cameras if name not in a.cameras], "B"),
        )
        if missing
    ]
    if a.board != b.board:
        notes.append("the boards are different ones: where they are on their bodies is not compared")
    for name, camera in a.cameras.items():
        if name in b.cameras and camera.camera.model != b.cameras[name].camera.model:
            notes.append(f"intrinsics of {name}: of different models, compared by their pixels alone")
    if measured(a.provenance.inputs) & measured(b.provenance.inputs):
        notes.append(
            "both rest on some of the same files: errors that they share cancel, so the difference shows too little"
        )
    return tuple(notes)


def measured(inputs: Iterable[InputFile]) -> set[str]:
    """Hashes of those files that hold what was measured; a manifest may well be the same."""
    return {entry.sha256 for entry in inputs if entry.path.suffix not in _MANIFESTS}


@dataclass(frozen=True)
class _Poses:
    """Y_c of both, of the cameras that both have: (C, 4, 4), and the joint covariances (6 C, 6 C)."""

    names: tuple[str, ...]
    first: FloatArray
    second: FloatArray
    of_first: FloatArray
    of_second: FloatArray

    @staticmethod
    def of(a: Calibration, b: Calibration, names: tuple[str, ...]) -> _Poses:
        poses = [np.stack([found.cameras[name].camera_T_ref.a_T_b for name in names]) for found in (a, b)]
        return _Poses(names, *poses, *(_of_poses(joint_covariance_of(found), names) for found in (a, b)))

    def xi(self, aligned: FloatArray | None) -> FloatArray:
        """(C, 6) with Y_c of A * Exp(xi) = Y_c of B * aligned, which is B_ref_T_A_ref."""
        return np.stack([_log(inverse(y_a) @ y_b) for y_a, y_b in zip(self.first, self._second(aligned), strict=True)])

    def covariance(self, aligned: FloatArray | None) -> FloatArray:
        """(6 C, 6 C) of ``xi``."""
        into = np.kron(np.eye(len(self.names)), np.eye(6) if aligned is None else adjoint(inverse(aligned)[None])[0])
        return np.asarray(self.of_first + into @ self.of_second @ into.T)

    def _second(self, aligned: FloatArray | None) -> FloatArray:
        return self.second if aligned is None else np.asarray(self.second @ aligned)


def _of_poses(joint: JointCovariance, names: tuple[str, ...]) -> FloatArray:
    columns = np.concatenate([np.arange(len(joint.matrix))[joint.columns_of_camera_T_ref(name)] for name in names])
    return joint.matrix[np.ix_(columns, columns)]


@dataclass(frozen=True)
class _Common:
    """The motion of ref that most cameras share. aligned: B_ref_T_A_ref. covariance: (6, 6) of its tangent. weights:
    (6, 6 C) that it takes the cameras' xi by, zero for those that moved by themselves."""

    aligned: FloatArray
    covariance: FloatArray
    weights: FloatArray

    @staticmethod
    def of(poses: _Poses, keep: Sequence[int]) -> _Common:
        """Of the cameras ``keep`` of C."""
        columns = np.concatenate([np.arange(6 * i, 6 * i + 6) for i in keep])
        G = np.tile(np.eye(6), (len(keep), 1))
        aligned = inverse(poses.second[keep[0]]) @ poses.first[keep[0]]
        for _ in range(_ROUNDS):
            weighted = np.linalg.solve(poses.covariance(aligned)[np.ix_(columns, columns)], G)
            covariance = np.linalg.inv(G.T @ weighted)
            weights = np.zeros((6, 6 * len(poses.names)))
            weights[:, columns] = covariance @ weighted.T
            step = weights @ poses.xi(aligned).ravel()
            aligned = aligned @ gtsam.Pose3.Expmap(-step).matrix()
            if np.abs(step).max() < _NO_STEP:
                break
        return _Common(aligned, np.asarray(covariance, dtype=np.float64), weights)

    def left(self, poses: _Poses) -> tuple[FloatArray, FloatArray]:
        """What is left of the cameras' xi (C, 6) without it, and the covariance of that (6 C, 6 C)."""
        without = np.eye(6 * len(poses.names)) - np.tile(self.weights, (len(poses.names), 1))
        return poses.xi(self.aligned), without @ poses.covariance(self.aligned) @ without.T


def _common_motion(poses: _Poses) -> _Common | None:
    """Where most of the cameras surely moved, and more than half of them together."""
    n = len(poses.names)
    xi, sigma = poses.xi(None), poses.covariance(None)
    surely = [special.chdtrc(6, squared_distance(xi[i], _block(sigma, i))) < UNLIKELY / n for i in range(n)]
    keep = list(range(n))
    if 2 * sum(surely) <= n:
        return None
    while 2 * len(keep) > n and len(keep) > 1:
        if special.chdtrc(6 * (len(keep) - 1), _distance2_to_each_other(poses, keep)) > UNLIKELY:
            return _Common.of(poses, keep)
        keep = min(([i for i in keep if i != out] for out in keep), key=lambda k: _distance2_to_each_other(poses, k))
    return None


def _distance2_to_each_other(poses: _Poses, keep: Sequence[int]) -> float:
    common = _Common.of(poses, keep)
    columns = np.concatenate([np.arange(6 * i, 6 * i + 6) for i in keep])
    xi = poses.xi(common.aligned).ravel()[columns]
    return squared_distance(xi, poses.covariance(common.aligned)[np.ix_(columns, columns)])


def _block(matrix: FloatArray, i: int) -> FloatArray:
    return matrix[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]


def _of_the_rig(poses: _Poses, common: _Common | None) -> Iterator[Change]:
    n = len(poses.names)
    if common is not None:
        moved_mm, turned_deg = pose_difference(np.eye(4), inverse(common.aligned))
        distance2 = squared_distance(_log(inverse(common.aligned)), common.covariance)
        yield Change(ALL, distance2, 6, moved_mm, *_sigmas(common.covariance, turned_deg))
    if n > 1:
        farthest = max(_camera_changes(poses, _Common.of(poses, range(n))), key=lambda change: change.moved_mm)
        distance2 = _distance2_to_each_other(poses, range(n))
        yield replace(farthest, what=TO_EACH_OTHER, distance2=distance2, dof=6 * (n - 1))


def _of_cameras(poses: _Poses, common: _Common | None, pixels: Sequence[PixelChange]) -> Iterator[Change]:
    for change, seen in zip(_camera_changes(poses, common), pixels, strict=True):
        yield replace(change, rms_px=seen.rms_px, expected_px=seen.rms_expected_px)


def _camera_changes(poses: _Poses, common: _Common | None) -> Iterator[Change]:
    """Of each camera, without the motion that ref has in common."""
    xi, sigma = (poses.xi(None), poses.covariance(None)) if common is None else common.left(poses)
    second = poses.second if common is None else poses.second @ common.aligned
    for i, name in enumerate(poses.names):
        own = _block(sigma, i)
        moved_mm, turned_deg = pose_difference(inverse(poses.first[i]), inverse(second[i]))
        into = adjoint(poses.first[i][None])[0]  # Exp(xi) of ref, as a motion of the camera in its own frame
        yield Change(name, squared_distance(xi[i], own), 6, moved_mm, *_sigmas(into @ own @ into.T, turned_deg))


def _sigmas(covariance: FloatArray, turned_deg: float) -> tuple[float, float, float]:
    """Of a pose's tangent: the largest 1-sigma of its place in mm, its rotation, and the largest 1-sigma of that."""
    rotation, place = (np.sqrt(np.linalg.eigvalsh(covariance[part, part])[-1]) for part in (np.s_[:3], np.s_[3:]))
    return 1e3 * float(place), turned_deg, float(np.rad2deg(rotation))


def _of_lenses(a: Calibration, b: Calibration, names: tuple[str, ...], distance_m: float) -> Iterator[Change]:
    """Where both are of one model, and one of them was solved for."""
    for name in names:
        first, second = a.cameras[name], b.cameras[name]
        covariances = [found.theta_covariance for found in (first, second) if found.theta_covariance is not None]
        if first.camera.model != second.camera.model or not covariances:
            continue
        xi, sigma = second.camera.theta - first.camera.theta, np.asarray(np.sum(covariances, axis=0))
        points_m, has_point = points_ahead(first.camera, distance_m, CELLS_ACROSS)
        before, valid, J = pixel_jacobians(first.camera, np.eye(4), points_m)
        after, still, _ = pixel_jacobians(second.camera, np.eye(4), points_m)
        both = has_point & valid & still
        J = J[both][:, :, 6:]
        moved_px = _rms(np.linalg.norm(after[both] - before[both], axis=1))
        expected_px = float(np.sqrt(np.einsum("nik,kl,nil->n", J, sigma, J).mean()))
        change = Change(intrinsics_of(name), squared_distance(xi, sigma), len(xi))
        yield replace(change, rms_px=moved_px, expected_px=expected_px)


def _of_the_board(a: Calibration, b: Calibration) -> Iterator[Change]:
    if a.board != b.board:
        return
    sigma = joint_covariance_of(a).body_T_board + joint_covariance_of(b).body_T_board
    first, second = a.body_T_board.a_T_b, b.body_T_board.a_T_b
    moved_mm, turned_deg = pose_difference(first, second)
    distance2 = squared_distance(_log(inverse(first) @ second), sigma)
    yield Change(BOARD, distance2, 6, moved_mm, *_sigmas(sigma, turned_deg))


def _of_the_shape(a: Calibration, b: Calibration) -> Iterator[Change]:
    """Where both solved for it. moved_mm, sigma_mm: RMS over the board's corners."""
    if a.board != b.board or a.board_shape is None or b.board_shape is None:
        return
    corners_m = board_from_manifest(a.board).corners_m
    outline_m, unit = outline_of(corners_m), np.eye(N_SHAPE)
    J = np.stack([(shaped(corners_m, outline_m, column) - corners_m).ravel() for column in unit], axis=1)
    xi, sigma = b.board_shape.shape - a.board_shape.shape, a.board_shape.covariance + b.board_shape.covariance
    moved_mm, sigma_mm = (
        1e3 * float(np.sqrt(square / len(corners_m))) for square in ((J @ xi) @ (J @ xi), np.trace(J @ sigma @ J.T))
    )
    yield Change(SHAPE, squared_distance(xi, sigma), N_SHAPE, moved_mm, sigma_mm)


def _pixel_change(
    a: Calibration, b: Calibration, aligned: FloatArray | None, name: str, distance_m: float
) -> PixelChange:
    first = a.cameras[name]
    x_px, y_px = image_grid(first.camera, CELLS_ACROSS)
    points_m, has_point = points_ahead(first.camera, distance_m, CELLS_ACROSS)
    into = inverse(first.camera_T_ref.a_T_b)
    in_ref_a = points_m @ into[:3, :3].T + into[:3, 3]
    to_b = np.eye(4) if aligned is None else aligned
    in_ref_b = in_ref_a @ to_b[:3, :3].T + to_b[:3, 3]
    before, after = pixel_uncertainty(a, name, in_ref_a), pixel_uncertainty(b, name, in_ref_b)
    both = has_point & before.valid & after.valid
    expected_px = np.where(both, np.hypot(before.rms_px, after.rms_px), np.nan)
    shape = len(y_px), len(x_px)
    change_px = np.where(both[:, None], after.pixels_px - before.pixels_px, np.nan).reshape(*shape, 2)
    return PixelChange(name, x_px, y_px, change_px, expected_px.reshape(shape))


def _log(pose: FloatArray) -> FloatArray:
    return np.asarray(gtsam.Pose3.Logmap(gtsam.Pose3(pose)))


def _rms(lengths: FloatArray) -> float:
    finite = lengths[np.isfinite(lengths)]
    return float(np.sqrt((finite**2).mean())) if finite.size else float("nan")
