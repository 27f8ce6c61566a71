"""What moved during the recording: a body's markers, or a camera, from some moment on.

A slip of the board body's markers by d makes the mocap's A_f of all later frames A_f Exp(d) instead of A_f; a slip of
the platform's moves all Y_c of later frames together; a bump moves one. So the columns of a change are constant columns
of the frames after it, and the sums of all frames after each possible time, added up once from the end, hold all that
any change at any time needs. Changes are added one at a time, the most significant first, and tested again given the
others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from gtcal.camera import BoolArray, FloatArray
from gtcal.effects.effect import length
from gtcal.effects.evidence import Sums
from gtcal.effects.frames import Frames
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import IntArray
from gtcal.results.effect_finding import Moment, Quantity

MOST_CHANGES = 6
"""Looked for in a recording; where there are more, it is no recording of rigid things."""

FEWEST_FRAMES = 8
"""Of what changed, before and after."""

_INTERVAL = 9.0  # of twice the log-likelihood: three sigma
_ROUNDS = 3
_OPEN = 1e-9


@dataclass(frozen=True)
class Part:
    """What can move: a tracked body ('board_body', 'platform') or one of the cameras; ``columns`` (D - 1, 6): what its
    move does to the tangents of each frame after it. lens: (D - 1, l), what else a bump may do: a camera's principal
    point moves, which is let in where other effects are looked for. frames: (n,) whether a frame would show it."""

    name: str
    is_camera: bool
    columns: FloatArray
    lens: FloatArray
    frames: BoolArray
    position_m: FloatArray | None = None


@dataclass(frozen=True)
class ChangePoint:
    """A part that moved. index: of the first frame after it. after_ns: when, half-way from the last frame before.
    tests: how many places and times were tried."""

    part: Part
    index: int
    after_ns: int
    moment: Moment
    tests: int

    @property
    def name(self) -> str:
        return f"camera {self.part.name} moved" if self.part.is_camera else f"{self.part.name} markers moved"

    @property
    def what(self) -> str:
        if self.part.is_camera:
            return f"camera {self.part.name!r} moved"
        return f"the markers of {self.part.name!r} moved on their body"

    @property
    def advice(self) -> str:
        return "--segments auto calibrates before and after it on their own; or record again with it fixed"

    def columns(self, frames: Frames) -> FloatArray:
        after = np.arange(len(frames.stamps_ns)) >= self.index
        return np.asarray(after[:, None, None] * self.part.columns, dtype=np.float64)

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        """How far the part's origin moved, and turned."""
        J = np.hstack([np.zeros((3, 3)), np.eye(3)])
        if self.part.position_m is not None:
            x, y, z = self.part.position_m
            J = np.hstack([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], -np.eye(3)])
        return (
            length("by", J @ estimate, J @ covariance @ J.T, 1e3, "mm"),
            length("", estimate[:3], covariance[:3, :3], float(np.rad2deg(1.0)), "deg"),
        )


def parts(frames: Frames) -> tuple[Part, ...]:
    """All that can move. A platform with a single camera: which of the two moved can't be told, and it is called the
    platform."""
    capture, found = frames.motion.capture, []
    size, any_frame = frames.n_columns, np.ones(len(frames.stamps_ns), dtype=bool)
    if "board_body" in capture.bodies:
        columns = np.zeros((size, 6))
        columns[:6] = -np.eye(6)
        found.append(Part("board_body", False, columns, np.zeros((size, 0)), any_frame))
    if "platform" in capture.bodies:
        columns = np.zeros((size, 6))
        columns[12 : 12 + 6 * len(frames.cameras)] = np.tile(np.eye(6), (len(frames.cameras), 1))
        found.append(Part("platform", False, columns, np.zeros((size, 0)), any_frame))
    if len(frames.cameras) > 1 or capture is Capture.FIXED_CAMERAS:
        found += [_camera(frames, name) for name in frames.cameras]
    return tuple(found)


def _camera(frames: Frames, name: str) -> Part:
    columns = np.zeros((frames.n_columns, 6))
    columns[frames.columns_of_camera(name)] = np.eye(6)
    camera_T_ref = frames.estimate.camera_T_ref[name]
    position_m = -camera_T_ref[:3, :3].T @ camera_T_ref[:3, 3]
    of_lens = frames.columns_of_theta(name)
    lens = np.zeros((frames.n_columns, 2 if of_lens.stop > of_lens.start else 0))
    centre = of_lens.start + 2
    if lens.size and centre not in frames.free:
        lens[[centre, centre + 1], [0, 1]] = 1.0
    return Part(name, True, columns, lens, frames.seen[name], position_m)


@dataclass(frozen=True)
class LensAfter:
    """What a change does to a lens, let in where other effects are looked for: no finding of its own."""

    change: ChangePoint
    name: str = ""
    what: str = ""
    advice: str = ""
    moment: Moment | None = None

    def columns(self, frames: Frames) -> FloatArray:
        after = np.arange(len(frames.stamps_ns)) >= self.change.index
        return np.asarray(after[:, None, None] * self.change.part.lens, dtype=np.float64)

    def quantities(self, estimate: FloatArray, covariance: FloatArray) -> tuple[Quantity, ...]:
        return ()


@dataclass(frozen=True)
class _Search:
    """after: (n, D, D) sums over each frame and all later ones."""

    frames: Frames
    parts: tuple[Part, ...]
    after: FloatArray

    @staticmethod
    def of(frames: Frames) -> _Search:
        return _Search(frames, parts(frames), np.cumsum(frames.marginal[::-1], axis=0)[::-1])

    @property
    def tests(self) -> int:
        """Parts and times that are tried."""
        return sum(int(self.allowed(part).sum()) for part in self.parts)

    def base(self, changes: Sequence[ChangePoint]) -> tuple[FloatArray, FloatArray]:
        """(U, U) and (U,): the normal equations of the calibration's unknowns and of the changes."""
        n = len(self.frames.free)
        images = [self._unknowns, *(_whole(change) for change in changes)]
        starts = [0, *(change.index for change in changes)]
        sides = list(zip(images, starts, strict=True))
        H = np.block([[a.T @ self.after[max(i, j)] @ b for b, j in sides] for a, i in sides])
        g = np.concatenate([a.T @ self.after[i][:, -1] for a, i in sides])
        H[:n, :n] += self.frames.information[:n, :n]
        g[:n] += self.frames.information[:n, -1]
        return H, g

    @property
    def _unknowns(self) -> FloatArray:
        return np.eye(self.after.shape[1])[:, self.frames.free]

    def solved(self, changes: Sequence[ChangePoint]) -> FloatArray:
        """(U,) the unknowns, then the changes, each with its lens."""
        H, g = self.base(changes)
        return np.asarray(-np.linalg.solve(_regular(H), g), dtype=np.float64)

    def scan(self, part: Part, changes: Sequence[ChangePoint]) -> FloatArray:
        """(n,) by how much the weighted squares fall if the part moves at each frame; 0 where too few show it."""
        times = np.flatnonzero(self.allowed(part) & self._apart(part, changes))
        gain = np.zeros(len(self.after))
        if len(times) == 0:
            return gain
        H, g = self.base(changes)
        TE = self.after @ _padded(part.columns)
        crossed = [TE[times][:, self.frames.free]]
        crossed += [_whole(change).T @ TE[np.maximum(times, change.index)] for change in changes]
        N = np.concatenate(crossed, axis=1)
        own = np.swapaxes(_padded(part.columns).T @ TE[times], 1, 2)
        inverse = np.linalg.inv(_regular(H))
        information = own - np.swapaxes(N, 1, 2) @ inverse @ N
        score = TE[times][:, -1] - (inverse @ g) @ N
        step = np.linalg.solve(information + _OPEN * own * np.eye(6), score[:, :, None])
        gain[times] = np.einsum("ni,nik->n", score, step)
        return gain

    def allowed(self, part: Part) -> BoolArray:
        """(n,) whether the part may move just before each frame: it and enough others, before and after, show it."""
        shown = np.cumsum(part.frames)
        before: IntArray = shown - part.frames.astype(np.int64)
        return np.asarray(part.frames & (before >= FEWEST_FRAMES) & (shown[-1] - before >= FEWEST_FRAMES))

    def _apart(self, part: Part, changes: Sequence[ChangePoint]) -> BoolArray:
        """(n,) whether enough frames that show the part lie between each and all changes of the part."""
        shown = np.cumsum(part.frames)
        own = [change.index for change in changes if change.part.name == part.name]
        far = [np.abs(shown - shown[index]) >= FEWEST_FRAMES for index in own]
        return np.all([shown >= 0, *far], axis=0)

    def most_significant(self, changes: Sequence[ChangePoint]) -> tuple[ChangePoint, float] | None:
        """One more change, and by how much the squares fall with it."""
        scans = [(part, self.scan(part, changes)) for part in self.parts]
        part, gain = max(scans, key=lambda scan: float(scan[1].max()))
        return (self._change(part, gain), float(gain.max())) if gain.any() else None

    def retimed(self, change: ChangePoint, others: Sequence[ChangePoint]) -> tuple[ChangePoint, float]:
        """The change at its likeliest time given the others."""
        gain = self.scan(change.part, others)
        return self._change(change.part, gain), float(gain.max())

    def _change(self, part: Part, gain: FloatArray) -> ChangePoint:
        """Between the last frame that shows the part as it was, and the first that shows it moved."""
        shown = np.flatnonzero(part.frames)
        index = int(gain.argmax())
        likely = np.flatnonzero(gain >= max(gain[index] - _INTERVAL, 0.5 * gain[index]))
        before = [int(shown[np.searchsorted(shown, i) - 1]) for i in (index, likely[0])]
        seconds = self.frames.seconds(self.frames.stamps_ns)
        middle = 0.5 * float(seconds[before[0]] + seconds[index])
        moment = Moment(middle, float(seconds[before[1]]), float(seconds[likely[-1]]))
        after_ns = self.frames.start_ns + round(1e9 * middle)
        return ChangePoint(part, index, after_ns, moment, self.tests)


def _padded(columns: FloatArray) -> FloatArray:
    """(D, k): a residual's row is none of an effect's."""
    return np.vstack([columns, np.zeros((1, columns.shape[1]))])


def _whole(change: ChangePoint) -> FloatArray:
    """(D, 6 + l) with its lens."""
    return _padded(np.hstack([change.part.columns, change.part.lens]))


def _regular(H: FloatArray) -> FloatArray:
    diagonal = np.diag(H)
    return np.asarray(H + np.diag(np.where(diagonal > 0.0, _OPEN * diagonal, 1.0)))


def find_changes(frames: Frames, *, level: float) -> tuple[Frames, tuple[ChangePoint, ...]]:
    """The changes whose probability of chance is under ``level``, all parts and times allowed for; and the frames with
    the noise that is left once these are in. Noise that a slip inflates hides others: it is estimated anew until the
    same changes stay."""
    found: tuple[ChangePoint, ...] = ()
    for _ in range(_ROUNDS):
        search = _Search.of(frames)
        before = _where(found)
        found = _grown(search, found, level)
        if not found or _where(found) == before:
            break
        again = frames.shifted_noise(_shift(search, found))
        if again is None:
            break
        frames = again
    return frames, found


def _where(changes: Sequence[ChangePoint]) -> list[tuple[str, int]]:
    return [(change.part.name, change.index) for change in changes]


def _grown(search: _Search, found: tuple[ChangePoint, ...], level: float) -> tuple[ChangePoint, ...]:
    """With one more at a time, while it is significant; all tested again given the others."""
    least_gain = special.chdtri(6, level / max(search.tests, 1))
    found = _those_that_hold(search, _tested_again(search, found, least_gain), level)
    while len(found) < MOST_CHANGES:
        more = search.most_significant(found)
        if more is None or more[1] < least_gain:
            break
        grown = _those_that_hold(search, _tested_again(search, (*found, more[0]), least_gain), level)
        if len(grown) <= len(found):
            break
        found = grown
    return tuple(sorted(found, key=lambda change: change.index))


def _those_that_hold(search: _Search, changes: tuple[ChangePoint, ...], level: float) -> tuple[ChangePoint, ...]:
    """The changes that, given the others, are no chance by the frames' own scatter either, and predict unseen frames
    better: what a wrong lens does to a board that wanders through the image looks like small changes, but does not."""
    while changes:
        count = len(changes)
        sums = Sums.of(search.frames, (*changes, *map(LensAfter, changes)))
        found = [sums.evidence(index, others_of(index, count)) for index in range(count)]
        failing = [
            index
            for index, evidence in enumerate(found)
            if evidence.p_value * search.tests > level or evidence.hold_out_drop_px <= 0.0
        ]
        if not failing:
            break
        worst = min(failing, key=lambda index: found[index].worth)
        changes = tuple(change for index, change in enumerate(changes) if index != worst)
    return changes


def others_of(index: int, count: int) -> list[int]:
    """The places of all other changes and of their lenses, where ``count`` changes come first and their lenses next."""
    others = [other for other in range(count) if other != index]
    return [*others, *(count + other for other in others)]


def _tested_again(search: _Search, found: tuple[ChangePoint, ...], least_gain: float) -> tuple[ChangePoint, ...]:
    for change in found:
        others = tuple(other for other in found if other is not change)
        again, gain = search.retimed(change, others)
        found = (*others, again) if gain >= least_gain else others
    return found


def _shift(search: _Search, changes: Sequence[ChangePoint]) -> FloatArray:
    """(n, D - 1) of the frames' tangents, from where they were linearised to the solution with the changes."""
    frames, solved = search.frames, search.solved(changes)
    shift = np.zeros((len(frames.stamps_ns), frames.n_columns))
    n = len(frames.free)
    shift[:, frames.free] = solved[:n]
    for change in changes:
        columns = np.concatenate([change.columns(frames), LensAfter(change).columns(frames)], axis=2)
        shift += columns @ solved[n : n + columns.shape[2]]
        n += columns.shape[2]
    return shift
