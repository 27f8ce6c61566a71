"""Which board the images show where it isn't the one that was said: as its tags tell, with the stated lengths."""

from __future__ import annotations

import numpy as np

from gtcal.board import AprilGrid, ArucoGrid, Board, CharucoBoard, TaggedBoard
from gtcal.detection.board_guess import BoardGuess, guess_board
from gtcal.doctor.manifest_lines import line_of
from gtcal.errors import GtcalError
from gtcal.recordings.recording import Recording


def board_in_images(recording: Recording) -> tuple[Board, str] | None:
    """The board that the images show, and what tells, in words; None where they tell none, or the one that was stated.

    Raises GtcalError where an image can't be read."""
    guesses = (guess_board(images) for images in recording.images.values())
    for guess in (guess for guess in guesses if guess is not None):
        board = _of_stated_size(guess, recording.board)
        if board not in (None, recording.board):
            ids = f"ids {guess.ids.min()} to {guess.ids.max()}"
            return board, f"the images show tags of {guess.dictionary}, {ids}, as on another board: {board.describe()}"
    return None


def board_lines(stated: Board, found: Board) -> tuple[str, ...]:
    """What to write in a manifest that has the stated board: the fields that differ, or all of another type."""
    before, after = stated.to_manifest(), found.to_manifest()
    if before["type"] != after["type"]:
        return (line_of("board", after),)
    return tuple(line_of(f"board.{name}", value) for name, value in after.items() if before.get(name) != value)


def _of_stated_size(guess: BoardGuess, stated: Board) -> Board | None:
    """None where the tags don't tell how they are arranged, or the stated lengths are none of such a board."""
    if guess.columns is None or guess.rows is None:
        return None
    tag_side_m, gap_m = _lengths_m(stated)
    try:
        if guess.kind == "charuco":
            return CharucoBoard(guess.dictionary, guess.columns, guess.rows, tag_side_m + gap_m, tag_side_m)
        if guess.kind == "aprilgrid":
            family = guess.dictionary.removeprefix("DICT_APRILTAG_")
            spacing = round(gap_m / tag_side_m, 9)
            return AprilGrid(guess.columns, guess.rows, tag_side_m, spacing, family, guess.first_tag_id)
        squares = isinstance(stated, ArucoGrid) and stated.corner_squares
        return ArucoGrid(
            guess.dictionary, guess.columns, guess.rows, tag_side_m, gap_m, guess.first_tag_id, corner_squares=squares
        )
    except GtcalError:
        return None


def _lengths_m(board: Board) -> tuple[float, float]:
    """The side of a tag, and from its edge to that of the next one, in a grid or one square further."""
    if not isinstance(board, TaggedBoard):
        return board.clear_band_m, board.pitch_m - board.clear_band_m
    first, second = board.tag_corners_m[0, :2]
    side_m = round(float(np.linalg.norm(second - first)), 9)
    return side_m, round(board.pitch_m - side_m, 9)
