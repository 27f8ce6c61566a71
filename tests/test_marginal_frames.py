"""The factor that integrates the mocap's noise out, against the graph with a variable per frame that it stands for."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import gtsam
import numpy as np
import pytest

from factors import GAUSSIAN, PINHOLE_RADTAN, RobustKernel, marginal_frames
from factors.frames import CameraFrames
from factors.marginal_frames import MarginalFramesFactor
from factors.noise_chain import NoiseChain
from factors.reprojection import CornerViews
from factors.rigid import exponential, right_jacobian
from gtcal import CalibrationOptions, calibrate_observations, synchronise
from gtcal.estimation.adjustment import Adjusted, adjust
from gtcal.estimation.errors_in_variables import (
    MocapNoiseFit,
    adjust_with_mocap_noise,
    graph_of_frames,
    marginal_factor,
    ref_T_body_key,
    shared_keys,
)
from gtcal.estimation.graph import BODY_T_BOARD, camera_T_ref_key, to_values
from gtcal.estimation.marginals import covariance_of, joint_information
from gtcal.estimation.mocap_noise import MocapNoiseModel
from gtcal.estimation.options import MocapSigmas
from gtcal.recordings.capture import RefMotion
from gtcal.simulation import MocapNoise, SimulationOptions, quest3_like_rig, simulate

SIGMAS = MocapSigmas(translation_mm=0.5, rotation_deg=0.05)
_QUEST = quest3_like_rig()
RIG = replace(_QUEST, cameras=_QUEST.cameras[::2], rig_T_camera=_QUEST.rig_T_camera[::2])


class Case(NamedTuple):
    """Stage 3's result, the noise to assume, and what to solve for."""

    adjusted: Adjusted
    fit: MocapNoiseFit
    motion: RefMotion
    options: CalibrationOptions


def ordering(keys: list[int]) -> gtsam.Ordering:
    found = gtsam.Ordering()
    for key in keys:
        found.push_back(key)
    return found


@cache
def case(correlation_s: float = 0.0, intrinsics: str = "auto", kernel: str = "") -> Case:
    noise = MocapNoise(translation_mm=SIGMAS.translation_mm, rotation_deg=SIGMAS.rotation_deg)
    observations = synchronise(simulate(SimulationOptions(rig=RIG, n_frames=24, mocap=noise), seed=4).recording)
    robust = RobustKernel(kernel, 1.5) if kernel else GAUSSIAN
    options = CalibrationOptions(intrinsics=intrinsics, robust=robust, mocap="exact", screen=False)
    start = calibrate_observations(observations, replace(options, effects=False)).solution.estimate
    adjusted = adjust(observations.views, start, options)
    model = MocapNoiseModel(dict.fromkeys(observations.motion.trajectories, SIGMAS), correlation_s)
    return Case(adjusted, MocapNoiseFit(model, 0.1, None, ()), observations.motion, options)


CASES = [(0.0, "auto", ""), (0.8, "auto", ""), (0.8, "exact", ""), (0.0, "exact", "Huber")]


@pytest.mark.parametrize("which", CASES)
def test_it_has_the_optimum_and_the_information_of_the_graph_with_a_variable_per_frame(which):
    one = case(*which)
    solved = adjust_with_mocap_noise(*one)
    graph, values = graph_of_frames(*one)
    values.update(solved.values)
    views = one.adjusted.screened.views
    frames = np.unique(np.concatenate([of_camera.frame_index for of_camera in views.values()]))
    for frame, pose in zip(frames, marginal_factor(*one).ref_T_body(solved.values), strict=True):
        values.update(ref_T_body_key(int(frame)), gtsam.Pose3(pose))
    assert solved.graph.error(solved.values) == pytest.approx(graph.error(values), rel=1e-9)
    keys = list(shared_keys(views, one.options))
    of_frames, ours = (joint_information(*of, keys) for of in ((graph, values), (solved.graph, solved.values)))
    scale = np.sqrt(np.diag(of_frames))
    off = np.abs((ours - of_frames) / np.outer(scale, scale))
    assert np.median(off) < (1e-11 if which[2] == "" else 1e-6)  # weights change with the last digits of z
    assert off.max() < 1e-4  # the triangle of a single frame's factor loses directions to rounding
    assert sigmas_to_optimum(graph, values, keys) < 1e-2


def sigmas_to_optimum(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: list[int]) -> float:
    """How far Newton's step would go, over all unknowns that frames share together."""
    linear = graph.linearize(values)
    frames = ordering(sorted(set(linear.keyVector()) - set(keys)))
    reduced = linear.eliminatePartialMultifrontal(frames)[1] if frames.size() else linear
    information, descent = reduced.hessian(ordering(keys))
    return float(np.sqrt(descent @ covariance_of(information) @ descent))


@pytest.mark.parametrize("which", CASES[:2])
def test_its_gradient_is_that_of_its_error(which):
    """Away from the optimum too, where z is predicted and refined."""
    one = case(*which)
    factor = marginal_factor(*one)
    start = to_values(one.adjusted.estimate, with_theta=True, with_shape=True)
    sizes = shared_keys(one.adjusted.screened.views, one.options)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    information, descent = graph.linearize(start).hessian(ordering(list(sizes)))
    steps = np.diag(1e-2 / np.sqrt(np.diag(information)))

    def error(step: np.ndarray) -> float:
        parts = dict(zip(sizes, np.split(step, np.cumsum(list(sizes.values()))[:-1]), strict=True))
        delta = gtsam.VectorValues()
        for key, part in parts.items():
            delta.insert(key, part)
        return float(graph.error(start.retract(delta)))

    numeric = np.array([0.5 * (error(step) - error(-step)) for step in steps])
    expected = -descent * np.diag(steps)
    assert np.abs(numeric - expected).max() < 1e-3 * np.abs(expected).max()


def test_a_chain_is_eliminated_in_parts_as_in_one():
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((9, 20, 12))
    moments, L = np.swapaxes(rows, 1, 2) @ rows, np.tril(rng.standard_normal((9, 6, 6)))
    rho = np.array([0.9, 0.5, 0.0, 0.7, 0.7, 0.2, 0.9, 0.9, 0.0])
    whole, parted = NoiseChain.starting(9, 6), NoiseChain.starting(9, 6)
    log_determinant = whole.eliminate(moments, L, rho)
    of_parts = sum(parted.eliminate(moments[part], L[part], rho[part]) for part in (slice(0, 5), slice(5, 9)))
    assert of_parts == pytest.approx(log_determinant)
    np.testing.assert_allclose(parted.known_square, whole.known_square)
    rest = rng.standard_normal(6)
    z = whole.noise_at(rho, rest)
    np.testing.assert_allclose(parted.noise_at(rho, rest), z)
    np.testing.assert_allclose(z, by_dense_solution(moments, L, rho, rest))


def by_dense_solution(moments: np.ndarray, L: np.ndarray, rho: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """The z (n, 6) that minimise the frames' squares and their prior's, from one system of equations."""
    n = len(moments)
    of_noise = np.eye(n)
    for f in range(n - 1):
        of_noise[f + 1, : f + 1] = rho[f] * of_noise[f, : f + 1]
        of_noise[: f + 1, f + 1] = of_noise[f + 1, : f + 1]
    system, right = np.kron(np.linalg.inv(of_noise), np.eye(6)), np.zeros(6 * n)
    for f in range(n):
        part = slice(6 * f, 6 * f + 6)
        system[part, part] += L[f].T @ moments[f, :6, :6] @ L[f]
        right[part] = -L[f].T @ moments[f, :6, 6:] @ rest
    return np.linalg.solve(system, right).reshape(n, 6)


def test_the_exponential_and_its_jacobian_are_gtsams():
    xi = np.random.default_rng(5).standard_normal((20, 6)) * np.array([1.5] * 3 + [4.0] * 3)
    for twist, pose, jacobian in zip(xi, exponential(xi), right_jacobian(xi), strict=True):
        np.testing.assert_allclose(pose, gtsam.Pose3.Expmap(twist).matrix(), atol=1e-12)
        np.testing.assert_allclose(jacobian, gtsam.Pose3.ExpmapDerivative(twist), atol=1e-9)


def test_what_does_not_fit_is_refused():
    cameras = graph_cameras()
    good = {
        "measured_ref_T_body": np.tile(np.eye(4), (3, 1, 1)),
        "noise": np.tile(np.eye(6), (3, 1, 1)),
        "correlation": np.zeros(3),
        "body_T_board": BODY_T_BOARD,
    }
    MarginalFramesFactor(cameras, **good)
    for name, wrong in (("noise", np.eye(6)), ("correlation", np.zeros(2)), ("measured_ref_T_body", np.eye(4))):
        with pytest.raises(ValueError, match=r"for [34] frames"):
            MarginalFramesFactor(cameras, **good | {name: wrong})
    fewer = {name: value[:2] if isinstance(value, np.ndarray) else value for name, value in good.items()}
    with pytest.raises(ValueError, match="frame numbers 0 to 2 for 2 frames"):
        MarginalFramesFactor(cameras, **fewer)


def graph_cameras() -> list[CameraFrames]:
    views = CornerViews(np.array([0, 1, 2]), np.zeros((2, 3)), np.zeros((2, 2)))
    theta = np.array([500.0, 500.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return [CameraFrames(views, np.array([0, 2]), PINHOLE_RADTAN, camera_T_ref_key(0), theta)]


def test_a_camera_may_see_nothing_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of some hundreds of frames, that are summed together."""
    one = case(*CASES[2])
    whole = adjust_with_mocap_noise(*one).values
    monkeypatch.setattr(marginal_frames, "_AT_ONCE", 1)
    by_frame = adjust_with_mocap_noise(*one).values
    for key in list(whole.keys()):
        np.testing.assert_allclose(by_frame.atPose3(key).matrix(), whole.atPose3(key).matrix(), atol=1e-8)
