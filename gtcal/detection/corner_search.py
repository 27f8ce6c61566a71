"""Corners of a board in one image, outwards from places that are known.

Predict the next corners from the known ones around them, fit each in the image, keep those that are what the print
shows there and lie where their neighbours say. Where the intrinsics are known the neighbours are compared without the
lens distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gtcal.board import Board
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.detection.local_warp import LocalWarps, fit_local_warps
from gtcal.detection.refinement import MAX_RADIUS_PX, N_PARAMETERS, RefinedCorners, refine_corners
from gtcal.detection.sight import BoardImage, BoardSight, PixelSight, Sight, board_image, sight_of
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage

# A corner is refused nearer to the image's edge than this: its window would show one side only.
_MARGIN_PX = 3.0
# How far a fit may end from its prediction: this part of a tag's side, but always these pixels.
_MOVED_PART, _MOVED_PX = 0.15, 1.5
# What a fit must look like: residual over half the step between black and white, half that step in grey levels (of
# 255 in all), turn of the edges; and their blur, as a part of the window's radius, but always these pixels. On real
# views the clean corners stay under 0.23, 0.17 rad and 0.9 px.
_MISFIT, _FAINTEST_STEP, _STRONGEST_STEP, _TURNED_RAD = 0.3, 4.0, 150.0, 0.35
_BLUR_PART, _BLUR_PX = 0.3, 1.3
_TRIES = 3
# How far a predicted board may be off for it to be found at its whole edge.
_OFF_PREDICTION_PX = 10.0
# The board's pitch in the image under which nothing is looked for.
_NARROWEST_PX = 5.0
# How far the next corners may be from the known ones, in pitches of the board: both edges of the next tag.
_REACH = 1.05
# A corner this far from where its neighbours put it is stray: pixels, multiples of the view's median and, as long as
# the lens is a guess, this part of the board's pitch. The next thing that looks like a corner is a module away, 0.08
# of the pitch or more.
_STRAY_PX, _STRAY_FACTOR, _STRAY_PART = 0.75, 5.0, 0.02
FEWEST_CORNERS, _ENOUGH_CORNERS = 4, 12
# Median distance of the corners from where their neighbours put them, in pixels and as a part of the board's pitch,
# at which the print has other proportions than the board: 0.018 is a gap wrong by a tenth. The right board stays at
# a third of that, but a lens that has to be guessed bends it more.
_WARPED_PX, _WARPED_PART, _WARPED_PART_UNKNOWN_LENS = 0.5, 0.018, 0.045


@dataclass(frozen=True)
class SeenBoard:
    """What one image shows. corner_ids: (n,) increasing. corners_px: (n, 2). Both are empty where the board isn't
    recognised, although ``n_tags`` of its tags may have been read. unsearched: for it should be outside the image."""

    corner_ids: IntArray
    corners_px: FloatArray
    n_tags: int
    unsearched: bool = False


@dataclass(frozen=True)
class PredictedBoard:
    """Where the board should be in an image. camera: with parameters. camera_T_board: (4, 4)."""

    camera: Camera
    camera_T_board: FloatArray

    def image_of(self, points_m: FloatArray, step_m: float) -> BoardImage:
        """Of points (N, 2) of the board."""
        return board_image(BoardSight(self.camera, self.camera_T_board), points_m, _as_it_is(len(points_m)), step_m)


def _as_it_is(n: int) -> FloatArray:
    """(N, 2, 2) the derivative of points of the board to themselves."""
    return np.broadcast_to(np.eye(2), (n, 2, 2))


@dataclass(frozen=True)
class _Print:
    """What the search needs to know of the board, computed once per board.

    near: (C, C) pairs of corners so close that one predicts the other. saddle: (C,). sign: (C,) +-1, the sign of
    the fitted step."""

    near: BoolArray
    saddle: BoolArray
    sign: FloatArray


@lru_cache(maxsize=8)
def _print_of(board: Board) -> _Print:
    xy = board.corners_m[:, :2]
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    black = board.corner_quadrants
    saddle = (black[:, 0] == black[:, 2]) & (black[:, 1] == black[:, 3]) & (black[:, 0] != black[:, 1])
    white = 1.0 - 2.0 * black
    return _Print(
        apart < _REACH * board.pitch_m,
        saddle,
        np.sign(white[:, 0] - white[:, 1] + white[:, 2] - white[:, 3]),
    )


class CornerSearch:
    """The state of the search in one image, outwards from places that are known.

    corners_px: (C, 2), NaN where not found. fits: (C, P) the parameters of those that are. tries: (C,) how often each
    was looked for."""

    def __init__(self, image: GreyImage, board: Board, camera: Camera | None) -> None:
        self.image, self.board, self.camera = image, board, camera
        self.sight: Sight = PixelSight()
        self.n_when_sighted = 0
        self.print = _print_of(board)
        self.corners_m = board.corners_m[:, :2]
        self.corners_px = np.full((board.n_corners, 2), np.nan)
        self.fits = np.empty((board.n_corners, N_PARAMETERS))
        self.tries = np.zeros(board.n_corners, dtype=np.int64)
        self.anchors_m = self.anchors_px = np.empty((0, 2))

    @property
    def _lens_known(self) -> bool:
        return self.camera is not None and self.camera.parameters is not None

    @property
    def found(self) -> BoolArray:
        return np.isfinite(self.corners_px[:, 0])

    def known(self) -> tuple[FloatArray, FloatArray]:
        """Places on the board and their pixels: the corners, and as long as these are few, the first tags too."""
        corners_m, corners_px = self.corners_m[self.found], self.corners_px[self.found]
        if len(corners_m) >= _ENOUGH_CORNERS:
            return corners_m, corners_px
        return np.concatenate([corners_m, self.anchors_m]), np.concatenate([corners_px, self.anchors_px])

    def reachable(self) -> IntArray:
        """The corners to look for next: missing, next to a known one, not given up."""
        beside = self.print.near[:, self.found].any(axis=1)
        return np.flatnonzero(beside & ~self.found & (self.tries < _TRIES))

    @property
    def is_warped(self) -> bool:
        """Whether the corners lie otherwise than on this board."""
        off_px, pitch_px = self._off_from_neighbours_px(np.flatnonzero(self.found))
        part = _WARPED_PART if self._lens_known else _WARPED_PART_UNKNOWN_LENS
        return not bool(np.median(off_px) < max(_WARPED_PX, part * np.median(pitch_px)))

    def extend(self, known_m: FloatArray, known_px: FloatArray, candidates: IntArray) -> bool:
        """Look for the candidates as the known points predict them. Whether it is worth going on."""
        if not len(candidates) or len(known_m) < FEWEST_CORNERS:
            return False
        self.tries[candidates] += 1
        self._take_sight(known_m, known_px)
        guess = self._predict(known_m, known_px, self.corners_m[candidates])
        shown = self._shown(guess)
        self._look(candidates[shown], guess.at(shown))
        return True

    def begin_at(self, predicted: PredictedBoard) -> int:
        """Look for the corners where they are predicted to be, and once more by their neighbours for those that aren't
        there. Returns how many should be seen."""
        guess = predicted.image_of(self.corners_m, self._step_m)
        expected = self._shown(guess)
        self.tries[:] = np.where(self._shown(guess, outside_px=_OFF_PREDICTION_PX), _TRIES - 1, _TRIES)
        if expected.any():
            self._take_sight(self.corners_m[expected], guess.pixels_px[expected])
        self._look(np.flatnonzero(expected), guess.at(expected))
        return int(expected.sum())

    def go_on(self) -> None:
        """Look outwards from what is found until nothing is left to look for."""
        while self.extend(*self.known(), self.reachable()):
            pass

    def polish(self) -> None:
        """Fit once more what was found, with the print's scale and the lens's bend as the neighbours now tell them: so
        it doesn't matter from what the corners were predicted."""
        ids = np.flatnonzero(self.found)
        there = self._predict(self.corners_m[ids], self.corners_px[ids], self.corners_m[ids])
        guess = BoardImage(self.corners_px[ids], there.px_per_m, there.px_per_m2)
        refined = self._refined(ids, guess, going_on_from=self.fits[ids])
        better = self._good(refined, ids, guess)
        self.corners_px[ids[better]] = refined.corners_px[better]

    def _shown(self, guess: BoardImage, outside_px: float = 0.0) -> BoolArray:
        wide = self.board.pitch_m * least_stretch(guess.px_per_m) > _NARROWEST_PX
        return self._well_inside(guess.pixels_px, _MARGIN_PX - outside_px) & wide

    def _look(self, candidates: IntArray, guess: BoardImage) -> None:
        """Fit the candidates near their guessed places, and keep what is the board's."""
        refined = self._refined(candidates, guess)
        good = self._good(refined, candidates, guess)
        self.corners_px[candidates[good]] = refined.corners_px[good]
        self.fits[candidates[good]] = refined.parameters[good]
        self._drop_stray()

    def _refined(self, corners: IntArray, guess: BoardImage, going_on_from: FloatArray | None = None) -> RefinedCorners:
        return refine_corners(
            self.image,
            guess,
            saddle=self.print.saddle[corners],
            clear_band_m=self.board.clear_band_m,
            clear_reach_m=self.board.clear_reach_m,
            going_on_from=going_on_from,
        )

    def _take_sight(self, known_m: FloatArray, known_px: FloatArray) -> None:
        """Choose the plane of comparison, and again when much more of the board is known."""
        if len(known_m) >= 1.5 * self.n_when_sighted:
            self.sight = sight_of(self.camera, self.image.shape[:2], known_m, known_px)
            self.n_when_sighted = len(known_m)

    def _predict(self, known_m: FloatArray, known_px: FloatArray, at_m: FloatArray) -> BoardImage:
        """The image of places (M, 2) on the board."""
        plane = self.sight.to_plane(known_px)
        usable = np.isfinite(plane).all(axis=1)
        warps = fit_local_warps(known_m[usable], plane[usable], at_m, spread_m=self.board.pitch_m)
        return self._to_pixels(warps)

    def _well_inside(self, pixels_px: FloatArray, margin_px: float = _MARGIN_PX) -> BoolArray:
        height, width = self.image.shape
        x, y = pixels_px[:, 0], pixels_px[:, 1]
        inside = (x >= margin_px) & (x <= width - 1 - margin_px)
        return inside & (y >= margin_px) & (y <= height - 1 - margin_px)

    def _good(self, refined: RefinedCorners, corners: IntArray, guess: BoardImage) -> BoolArray:
        moved_px = np.linalg.norm(refined.corners_px - guess.pixels_px, axis=1)
        side_px = self.board.pitch_m * least_stretch(guess.px_per_m)
        step = refined.step * self.print.sign[corners]
        reach_px = side_px * self.board.clear_reach_m / self.board.pitch_m
        blurred_px = np.maximum(_BLUR_PART * np.minimum(reach_px, MAX_RADIUS_PX), _BLUR_PX)
        return (
            self._well_inside(refined.corners_px)
            & (moved_px < np.maximum(_MOVED_PART * side_px, _MOVED_PX))
            & (step > _FAINTEST_STEP)
            & (step < _STRONGEST_STEP)
            & (refined.blur_px < blurred_px)
            & (refined.misfit < _MISFIT)
            & (refined.turned_rad < _TURNED_RAD)
        )

    def _drop_stray(self) -> None:
        """Drop corners that don't lie where their neighbours say, the worst of a neighbourhood first."""
        while self.found.any():
            ids = np.flatnonzero(self.found)
            near = self.print.near[np.ix_(ids, ids)]
            off_px, pitch_px = self._off_from_neighbours_px(ids)
            limit_px = np.maximum(_STRAY_PX, _STRAY_FACTOR * np.median(off_px))
            if not self._lens_known:
                limit_px = np.maximum(limit_px, _STRAY_PART * pitch_px)
            excess = off_px / limit_px
            stray = (excess > 1) & (excess >= np.where(near, excess[None], 0.0).max(axis=1))
            if not stray.any():
                return
            self.corners_px[ids[stray]] = np.nan

    def _off_from_neighbours_px(self, ids: IntArray) -> tuple[FloatArray, FloatArray]:
        """(n,) how far each found corner is from where the others put it, 0 where they can't tell; and (n,) the
        board's pitch in pixels there."""
        corners_m = self.corners_m[ids]
        plane = self.sight.to_plane(self.corners_px[ids])
        warps = fit_local_warps(corners_m, plane, corners_m, spread_m=self.board.pitch_m, leave_out=np.arange(len(ids)))
        predicted = self._to_pixels(warps)
        off_px = np.linalg.norm(predicted.pixels_px - self.corners_px[ids], axis=1)
        return np.nan_to_num(off_px), np.nan_to_num(self.board.pitch_m * least_stretch(predicted.px_per_m))

    def _to_pixels(self, warps: LocalWarps) -> BoardImage:
        return board_image(self.sight, *warps.at_centres(), step_m=self._step_m)

    @property
    def _step_m(self) -> float:
        """Over which the board's image is differentiated."""
        return 0.05 * self.board.pitch_m


def least_stretch(derivative: FloatArray) -> FloatArray:
    """(M,) the smaller singular value of matrices (M, 2, 2)."""
    squares = (derivative**2).sum(axis=(1, 2))
    area = np.abs(derivative[:, 0, 0] * derivative[:, 1, 1] - derivative[:, 0, 1] * derivative[:, 1, 0])
    return (np.sqrt(squares + 2 * area) - np.sqrt(np.maximum(squares - 2 * area, 0))) / 2
