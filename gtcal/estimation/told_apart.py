"""Observations of a print that looks the same after some turns, with each view's corners named as they truly are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gtcal.board import Board
from gtcal.camera import FloatArray
from gtcal.estimation.alignment import guides_of, stage_1
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Observations, Views
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.residuals import chain_residuals_px, median_by_view, norms
from gtcal.recordings.detections import IntArray


def told_apart(observations: Observations, options: CalibrationOptions) -> Observations:
    """The observations with their corners renamed view by view so that all are of one chain: of the chains that differ
    by a turn of the print that with the smallest rotation X. As they are where the print has one way up."""
    if len(observations.board.turns) == 1:
        return observations
    guides = guides_of(observations.views, options.pnp_views)
    if any(not len(guide.corner_moments) for guide in guides.values()):
        return observations  # what PnP can't solve is told later
    estimate = stage_1(guides, np.random.default_rng(options.seed)).estimate
    return told_apart_by(observations, _least_turned(estimate, observations))


def told_apart_by(observations: Observations, estimate: Estimate) -> Observations:
    """... so that each view fits a known chain best."""
    board = observations.board
    if len(board.turns) == 1:
        return observations
    views = {name: _renamed(of_camera, board, estimate) for name, of_camera in observations.views.items()}
    return replace(observations, views=views)


def _least_turned(estimate: Estimate, observations: Observations) -> Estimate:
    """The same chain by the turn of the board's frame whose X turns least."""
    S = next(iter(observations.views.values())).board_turns
    X = estimate.body_T_board @ np.linalg.inv(S)
    return replace(estimate, body_T_board=X[int(np.argmax(np.einsum("gii->g", X[:, :3, :3])))])


def _renamed(views: Views, board: Board, estimate: Estimate) -> Views:
    tried = [_turned(views, board, turn) for turn in board.turns]
    off_px = np.stack([_medians_px(turned, estimate) for turned in tried])
    best = off_px.argmin(axis=0)[views.view_of_corner]
    ids = np.choose(best, [turned.corner_ids for turned in tried])
    return replace(views, corner_ids=ids, corners_m=board.corners_m[ids], board_turns=np.eye(4)[None])


def _turned(views: Views, board: Board, turn: IntArray) -> Views:
    ids = turn[views.corner_ids]
    return replace(views, corner_ids=ids, corners_m=board.corners_m[ids])


def _medians_px(views: Views, estimate: Estimate) -> FloatArray:
    return np.nan_to_num(median_by_view(views, norms(chain_residuals_px(views, estimate))), nan=np.inf)
