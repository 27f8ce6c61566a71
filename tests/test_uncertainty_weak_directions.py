"""What is weak or open, and whether it is named: against covariances with a known weakness, and degenerate motions."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated, with_exact_mocap

from factors import RobustKernel
from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError, calibrate_observations, synchronise
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.graph import (
    BODY_T_BOARD,
    IntrinsicsPrior,
    camera_T_ref_key,
    reprojection_graph,
    theta_key,
    to_values,
)
from gtcal.estimation.marginals import joint_information
from gtcal.estimation.observations import Observations
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration, PoseEstimate
from gtcal.results.covariance import NAIVE, JointCovariance
from gtcal.simulation import Simulation
from gtcal.uncertainty.direction_words import axis_in_words, described
from gtcal.uncertainty.motions import motions
from gtcal.uncertainty.placement import UNIT_DEG, UNIT_MM, UNIT_PX, Placement
from gtcal.uncertainty.projected import image_grid
from gtcal.uncertainty.weak_directions import (
    OPEN,
    Grade,
    directions_of_covariance,
    directions_of_graph,
    directions_of_information,
    least_sure,
    weak_directions,
    weakness_warnings,
)

FIXED = "pinholes and fisheyes fixed"
ALONE = "one carried camera"


@cache
def calibration(kind: str = FIXED, intrinsics: str = "refine", **changes: object) -> Calibration:
    options = CalibrationOptions(intrinsics, mocap="exact", allow_degenerate=True)  # type: ignore[arg-type]
    return calibrate_observations(synchronise(simulated(kind, **changes).recording), options)


@cache
def placement(kind: str = FIXED) -> Placement:
    return Placement.of(calibration(kind))


# Measures


@pytest.mark.parametrize("column", range(6))
def test_the_boards_measures_are_turns_and_shifts_of_its_centre_along_the_bodys_axes(column: int) -> None:
    found = placement()
    step = np.zeros(len(found.measures))
    step[column] = 1e-7
    X = gtsam.Pose3(found.body_T_board)
    moved = X * gtsam.Pose3.Expmap(step[:6])
    turn = (moved * X.inverse()).rotation()
    shift_m = moved.transformFrom(found.board_centre_m) - X.transformFrom(found.board_centre_m)
    measured = found.measures @ step
    np.testing.assert_allclose(measured[:3] * UNIT_DEG, np.rad2deg(gtsam.Rot3.Logmap(turn)), atol=1e-11)
    np.testing.assert_allclose(measured[3:6] * UNIT_MM, 1e3 * shift_m, atol=1e-10)
    assert not measured[6:].any()


@pytest.mark.parametrize("column", range(6))
def test_a_cameras_measures_are_turns_about_its_axes_and_shifts_in_ref(column: int) -> None:
    found, name = placement(), "cam1"
    block = found.blocks[2][:6]
    step = np.zeros(len(found.measures))
    step[block[column]] = 1e-7
    Y = gtsam.Pose3(found.camera_T_ref[name])
    moved = Y * gtsam.Pose3.Expmap(step[block])
    turn = (moved * Y.inverse()).rotation()
    shift_m = moved.inverse().translation() - Y.inverse().translation()
    measured = (found.measures @ step)[block]
    np.testing.assert_allclose(measured[:3] * UNIT_DEG, np.rad2deg(gtsam.Rot3.Logmap(turn)), atol=1e-11)
    np.testing.assert_allclose(measured[3:] * UNIT_MM, 1e3 * shift_m, atol=1e-10)


def test_a_lenss_measure_is_what_it_does_to_the_image() -> None:
    found, name = placement(), "cam1"
    camera = found.cameras[name]
    step = 1e-6 * np.random.default_rng(0).standard_normal(camera.model.n_parameters)
    x, y = np.meshgrid(*image_grid(camera, 150))
    pixels_px = np.stack([x.ravel(), y.ravel()], axis=1)
    bearings, valid = camera.unproject(pixels_px)
    moved, _ = replace(camera, parameters=camera.theta + step).project(bearings[valid])
    rms_px = np.sqrt(np.mean(((moved - pixels_px[valid]) ** 2).sum(axis=1)))
    change = np.zeros(len(found.measures))
    change[found.blocks[2][6:]] = step
    assert np.linalg.norm(found.measures @ change) * UNIT_PX == pytest.approx(rms_px, rel=0.08)


# Directions


def test_the_one_that_stands_out_is_the_eigenvector() -> None:
    found = calibration(HEADSET, "fixed", motion="single_axis")
    L = Placement.of(found).measures
    values, vectors = np.linalg.eigh(L @ found.covariance.matrix @ L.T)
    first = least_sure(found)[0]
    eigenvector = vectors[:, -1] * np.sqrt(values[-1])
    motion = np.concatenate([first.board.turn_deg / UNIT_DEG, first.board.shift_mm / UNIT_MM])
    cosine = abs(motion @ eigenvector[:6]) / np.linalg.norm(motion) / np.linalg.norm(eigenvector[:6])
    assert cosine > 0.9999
    assert np.linalg.norm(motion) == pytest.approx(np.linalg.norm(eigenvector[:6]), rel=1e-3)


def test_together_the_directions_are_the_covariance() -> None:
    found = calibration()
    joint = found.covariance
    directions = directions_of_covariance(joint, placement(), most=len(joint.matrix))
    for name, camera in found.cameras.items():
        shifts = np.array([one.cameras[name].shift_mm for one in directions])
        np.testing.assert_allclose(
            np.diag(shifts.T @ shifts), camera.camera_T_ref.position_of_a_in_b_sigma_mm**2, rtol=1e-5
        )
    weaknesses = [one.weakness for one in directions]
    assert weaknesses == sorted(weaknesses, reverse=True)


def test_every_camera_that_is_weak_gets_a_direction() -> None:
    """Also where it takes several directions to make it weak."""
    joint = calibration().covariance
    for factor in (1e3, 1e4, 1e5):
        wide = replace(joint, matrix=factor * joint.matrix)
        left = placement().measures @ wide.matrix @ placement().measures.T
        for one in directions_of_covariance(wide, placement()):
            left -= np.outer(motion := in_measures(one), motion)
        worst = max(np.linalg.eigvalsh(left[np.ix_(block[:6], block[:6])])[-1] for block in placement().blocks)
        assert worst < 1.001


def in_measures(one) -> np.ndarray:
    """The motion of a direction whose lenses take no part that is asked for."""
    parts = [one.board.turn_deg / UNIT_DEG, one.board.shift_mm / UNIT_MM]
    for camera in one.cameras.values():
        parts += [camera.turn_deg / UNIT_DEG, camera.shift_mm / UNIT_MM]
    poses = np.concatenate(parts)
    return np.pad(poses, (0, len(placement().measures) - len(poses)))


# Words


def planted(kind: str = FIXED, *, board=((0, 0, 0), (0, 0, 0)), lens=None, **cameras) -> tuple:
    """The directions of a covariance that is fine but for one direction. Board and cameras: turn in deg, shift in mm
    (a camera's turn about its own axes, its shift along those of ref). lens: a camera and its change of theta."""
    found = placement(kind)
    motion = np.zeros(len(found.measures))
    motion[:6] = np.concatenate([np.divide(board[0], UNIT_DEG), np.divide(board[1], UNIT_MM)])
    for index, name in enumerate(found.cameras):
        if name in cameras:
            turn, shift = cameras[name]
            motion[found.blocks[1 + index][:6]] = np.concatenate([np.divide(turn, UNIT_DEG), np.divide(shift, UNIT_MM)])
        if lens is not None and lens[0] == name:
            motion[found.blocks[1 + index][6:]] = found.lens_effect(name) @ np.array(lens[1]) / UNIT_PX
    inverse_L = np.linalg.inv(found.measures)
    matrix = inverse_L @ (np.outer(motion, motion) + 1e-4 * np.eye(len(motion))) @ inverse_L.T
    return directions_of_covariance(JointCovariance("naive", dict(found.theta_sizes), matrix), found)


def along_the_axis(name: str, mm: float) -> np.ndarray:
    """A shift in ref along the camera's optical axis."""
    return mm * placement().camera_T_ref[name][2, :3]


def across_the_axis(name: str, mm: float) -> np.ndarray:
    return mm * placement().camera_T_ref[name][0, :3]


STILL = (0.0, 0.0, 0.0)
FOCAL = [4.0, 4.0, *[0.0] * 6]
CENTRE = [0.0, 0.0, 3.0, 0.0, *[0.0] * 4]
DISTORTION = [*[0.0] * 4, 0.01, 0.005, 0.0, 0.0]


def with_all_cameras(turn, shift) -> dict:
    return dict.fromkeys(placement().cameras, (turn, shift))


@pytest.mark.parametrize(
    ("plan", "what", "size", "fix"),
    [
        (
            lambda: {"board": (STILL, (0, 0, 14)), **with_all_cameras(STILL, (0, 14, 0))},
            "body_T_board: translation along the body's z axis, which all turns share, and the cameras with it",
            "14 mm",
            "second axis",
        ),
        (
            lambda: {"board": ((3, 0, 0), STILL), **with_all_cameras((0, 0, 3), STILL)},
            "body_T_board: attitude about the body's x axis, and the cameras with it",
            "3 deg",
            "two axes or more",
        ),
        (
            lambda: {"board": (STILL, (0, 5, 0))},
            "body_T_board: translation along the body's y axis",
            "5 mm",
            "turned",
        ),
        (lambda: {"board": ((0, 0.6, 0.8), STILL)}, "about (0.00, 0.60, 0.80) of the body", "1 deg", "turned"),
        (
            lambda: {"cam1": (STILL, along_the_axis("cam1", 9))},
            "camera 'cam1': its depth, along its optical axis",
            "9 mm",
            "record nearer",
        ),
        (
            lambda: {"cam1": (STILL, across_the_axis("cam1", 9))},
            "camera 'cam1': its position across its optical axis",
            "9 mm",
            "several distances",
        ),
        (
            lambda: {"cam1": ((0, 0.8, 0), across_the_axis("cam1", 9))},
            "camera 'cam1': its position against its attitude (0.8 deg)",
            "9 mm",
            "several distances",
        ),
        (
            lambda: {"cam0": ((0, 0, 0.7), STILL)},
            "camera 'cam0': its attitude about its optical axis",
            "0.7 deg",
            "image",
        ),
        (
            lambda: {"cam1": (STILL, along_the_axis("cam1", 6)), "lens": ("cam1", FOCAL)},
            "camera 'cam1': its focal length against its depth",
            "6 mm",
            "several distances and tilted",
        ),
        (
            lambda: {"cam1": ((0, 0.5, 0), STILL), "lens": ("cam1", CENTRE)},
            "camera 'cam1': its principal point against its attitude",
            "3 px and 0.5 deg",
            "tilted",
        ),
        (lambda: {"lens": ("cam1", DISTORTION)}, "camera 'cam1': its distortion, over the image", "px", "corners"),
        (
            lambda: dict.fromkeys(("cam0", "cam1"), (STILL, (8, 0, 0))),
            "cameras 'cam0' and 'cam1' together: their positions",
            "8 mm",
            "nearer",
        ),
    ],
)
def test_a_known_weakness_is_named_with_its_size_and_the_motion_that_would_fix_it(plan, what, size, fix) -> None:
    (found,) = planted(**plan())
    assert what in found.what
    assert size in found.size
    assert found.size.endswith("1-sigma")
    assert fix in found.fix
    assert found.sentence == f"{found.what}: {found.size}; {found.fix}"


def test_two_cameras_that_are_weak_by_themselves_are_not_mixed() -> None:
    """Equal eigenvalues have any eigenvectors; people want those that name a camera."""
    found, shifts = placement(), {name: along_the_axis(name, 5.0) for name in ("cam0", "cam1")}
    covariance = 1e-4 * np.eye(len(found.measures))
    for index, name in enumerate(shifts):
        block = found.blocks[1 + index][3:6]
        covariance[np.ix_(block, block)] += np.outer(shifts[name], shifts[name]) / UNIT_MM**2
    inverse_L = np.linalg.inv(found.measures)
    joint = JointCovariance("naive", dict(found.theta_sizes), inverse_L @ covariance @ inverse_L.T)
    told = {one.what for one in directions_of_covariance(joint, found)}
    assert told == {f"camera {name!r}: its depth, along its optical axis" for name in shifts}


def test_no_two_directions_are_told_in_the_same_words() -> None:
    joint = calibration().covariance
    directions = directions_of_covariance(joint, placement(), most=len(joint.matrix))
    assert len({one.sentence for one in directions}) == len(directions) > 20
    alike = [one for one in directions if "[" in one.what]
    assert alike
    for one in alike:  # the board, a position, an attitude or a lens, with its unit
        assert re.search(r"\(-?\d[^)]*\) (mm|deg)|distortion \S+ px", one.what), one.what


def test_large_numbers_are_no_powers_of_ten() -> None:
    (found,) = planted(cam0=(STILL, (1400.0, 0.0, 0.0)))
    assert found.size == "1,400 mm 1-sigma"


def test_axes_are_named_by_letter_where_they_are_near_one() -> None:
    assert axis_in_words(np.array([0.0, -2.0, 0.1]), "the body") == "the body's y axis"
    assert axis_in_words(np.array([0.0, 0.0, 1.0]), "the mocap's world") == "the z axis of the mocap's world"
    assert axis_in_words(np.array([-0.8, 0.0, 0.6]), "the body") == "(0.80, 0.00, -0.60) of the body"


# Grades


@pytest.mark.parametrize(
    ("mm", "grade"), [(1.9, None), (2.1, Grade.WEAK), (9.9, Grade.WEAK), (10.2, Grade.REFUSED), (300, Grade.REFUSED)]
)
def test_over_2_mm_is_weak_and_over_10_mm_refused(mm: float, grade: Grade | None) -> None:
    found = planted(cam0=(STILL, (mm, 0.0, 0.0)))
    assert [one.grade for one in found] == ([grade] if grade else [])
    if grade is Grade.REFUSED:
        with pytest.raises(
            GtcalError, match=r"the data do not determine the result: camera 'cam0'.*over 10 mm or 1 deg"
        ):
            weakness_warnings(found, allow_degenerate=False)
    else:
        assert len(weakness_warnings(found, allow_degenerate=False)) == len(found)
    assert len(weakness_warnings(found, allow_degenerate=True)) == len(found)


def test_a_lens_alone_is_warned_of_and_not_refused() -> None:
    (found,) = planted(lens=("cam1", np.multiply(20.0, DISTORTION)))
    assert found.weakness > 5.0
    assert found.grade is Grade.WEAK
    (warning,) = weakness_warnings((found,), allow_degenerate=False)
    assert warning == f"weakly determined: {found.sentence}"


def test_a_good_recording_has_no_weak_direction_but_some_are_least_sure() -> None:
    assert weak_directions(calibration()) == ()
    assert [one.grade for one in least_sure(calibration(), most=3)] == [Grade.FINE] * 3


def test_without_a_covariance_nothing_is_said() -> None:
    assert least_sure(replace(calibration(), covariances={})) == ()


# Open directions


def graph_of(observations: Observations, simulation: Simulation, *, free_theta: bool = False):
    """Stage 3's graph at the truth."""
    views, truth = observations.views, simulation.truth
    cameras = {name: of_camera.camera.theta for name, of_camera in views.items()}
    estimate = Estimate(truth.body_T_board, {name: truth.camera_T_ref[name] for name in views}, cameras)
    priors = dict.fromkeys(views, IntrinsicsPrior()) if free_theta else None
    graph = reprojection_graph(views, estimate, sigma_px=0.1, robust=RobustKernel(), intrinsics_priors=priors)
    keys = [BODY_T_BOARD, *map(camera_T_ref_key, range(len(views)))]
    keys += list(map(theta_key, range(len(views)))) if free_theta else []
    sizes = {name: len(theta) * free_theta for name, theta in cameras.items()}
    centre_m = observations.board.corners_m.mean(axis=0)
    cameras = {name: of_camera.camera for name, of_camera in views.items()}
    placed = Placement(observations.capture, centre_m, truth.body_T_board, cameras, estimate.camera_T_ref, sizes)
    return graph, to_values(estimate, with_theta=free_theta), keys, placed


@pytest.mark.parametrize("kind", [HEADSET, FIXED, "headset, AprilGrid stands"])
@pytest.mark.parametrize(("motion", "n_open"), [("single_axis", 1), ("translation", 3)])
def test_what_a_degenerate_motion_leaves_open_is_the_boards_translation(kind: str, motion: str, n_open: int) -> None:
    simulation = simulated(kind, motion=motion)
    graph, values, keys, placed = graph_of(with_exact_mocap(simulation), simulation)
    found = [one for one in directions_of_graph(graph, values, keys, placed) if one.grade is Grade.OPEN]
    assert len(found) == n_open
    for one in found:
        assert one.what.startswith("body_T_board: translation along ")
        assert one.what.endswith("and the cameras with it")
        assert ("which all turns share" in one.what) == (n_open == 1)
        assert one.size == "open"
        assert np.linalg.norm(one.board.shift_mm) == pytest.approx(UNIT_MM, rel=0.02)
    with pytest.raises(GtcalError, match=r"do not determine the result: body_T_board: translation .*: open; turn "):
        weakness_warnings(tuple(found), allow_degenerate=False)
    if kind == "headset, AprilGrid stands":
        assert "mocap's world" in found[0].what
        assert "turn the rig" in found[0].fix


def test_the_open_axis_is_the_one_that_all_turns_share() -> None:
    simulation = simulated(FIXED, motion="single_axis")
    observations = with_exact_mocap(simulation)
    graph, values, keys, placed = graph_of(observations, simulation)
    (found,) = directions_of_graph(graph, values, keys, placed)
    poses = observations.views["cam0"].ref_T_body
    turn = gtsam.Rot3.Logmap(gtsam.Rot3(poses[0, :3, :3].T @ poses[-1, :3, :3]))
    axis = turn / np.linalg.norm(turn)
    assert abs(found.board.shift_mm @ axis) == pytest.approx(np.linalg.norm(found.board.shift_mm), rel=1e-5)


def test_a_board_that_stood_still_leaves_all_of_it_open() -> None:
    simulation = simulated(ALONE, frames=20)
    observations = with_exact_mocap(simulation)
    views = observations.views["cam0"]
    first = slice(0, views.view_start[1])
    still = replace(
        views,
        stamps_ns=views.stamps_ns[:1],
        ref_T_body=views.ref_T_body[:1],
        view_start=views.view_start[:2],
        corner_ids=views.corner_ids[first],
        corners_m=views.corners_m[first],
        corners_px=views.corners_px[first],
    )
    graph, values, keys, placed = graph_of(replace(observations, views={"cam0": still}), simulation)
    found = directions_of_graph(graph, values, keys, placed)
    assert sum(one.grade is Grade.OPEN for one in found) == 6


def test_an_open_lens_is_named() -> None:
    """A few views in one corner of the image, with the intrinsics free: focal length and distortion run away."""
    graph, values, keys, placed = graph_of(synchronise(simulated(ALONE).recording), simulated(ALONE), free_theta=True)
    information = joint_information(graph, values, keys)
    lens = placed.blocks[1][6:]
    information[lens], information[:, lens] = 0.0, 0.0
    found = directions_of_information(information, placed)
    assert sum(one.grade is Grade.OPEN for one in found) == len(lens)
    assert all("camera 'cam0': its " in one.what for one in found if one.grade is Grade.OPEN)


def test_information_and_covariance_tell_the_same() -> None:
    found = calibration(HEADSET, "fixed", motion="single_axis")
    where = Placement.of(found)
    joint = found.covariances[NAIVE]
    by_covariance = directions_of_covariance(joint, where, most=5)
    by_information = directions_of_information(np.linalg.inv(joint.matrix), where, most=5)
    assert by_information[0].sentence == by_covariance[0].sentence
    weaknesses = [[one.weakness for one in found] for found in (by_information, by_covariance)]
    np.testing.assert_allclose(*weaknesses, rtol=0.02)
    assert by_covariance[0].weakness < OPEN


def test_the_joint_information_is_the_inverse_of_gtsams_marginals_with_every_pose_free() -> None:
    simulation = simulated(ALONE, frames=20)
    graph, values, keys, _ = graph_of(synchronise(simulation.recording), simulation)
    extra = gtsam.symbol("a", 0)
    values.insert(extra, gtsam.Pose3())
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    graph.add(gtsam.BetweenFactorPose3(keys[1], extra, values.atPose3(keys[1]).inverse(), noise))
    graph.add(gtsam.PriorFactorPose3(extra, gtsam.Pose3(), noise))
    information = joint_information(graph, values, keys)
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(keys)
    marginal = np.block([[joint.at(row, column) for column in keys] for row in keys])
    scale = np.sqrt(np.outer(np.diag(marginal), np.diag(marginal)))
    np.testing.assert_allclose(np.linalg.inv(information) / scale, marginal / scale, atol=1e-6)


def test_the_places_of_a_capture_are_named_as_its_own() -> None:
    words = {Capture.FIXED_CAMERAS: "the board", Capture.STANDING_BOARD: "the rig"}
    for capture, mover in words.items():
        found = replace(placement(), capture=capture)
        matrix = np.linalg.inv(found.measures)
        motion = np.zeros(len(matrix))
        motion[3] = 3.0
        joint = JointCovariance("naive", dict(found.theta_sizes), matrix @ np.outer(motion, motion) @ matrix.T)
        (one,) = directions_of_covariance(joint, found)
        assert f"with {mover} turned about several axes" in one.fix


def test_positions_are_those_of_the_result() -> None:
    """The sigma of a camera's position is that of ``PoseEstimate``."""
    found = calibration()
    L = placement().measures
    covariance = L @ found.covariance.matrix @ L.T
    for index, (name, camera) in enumerate(found.cameras.items()):
        pose: PoseEstimate = camera.camera_T_ref
        block = placement().blocks[1 + index][3:6]
        sigma_mm = UNIT_MM * np.sqrt(np.diag(covariance)[block])
        np.testing.assert_allclose(sigma_mm, pose.position_of_a_in_b_sigma_mm, rtol=1e-9)
        np.testing.assert_allclose(inverse(placement().camera_T_ref[name])[:3, 3], pose.position_of_a_in_b_m)


def test_cameras_that_shift_together_are_told_apart_by_their_axes() -> None:
    found = placement(HEADSET)
    what = []
    for axis in range(3):
        motion = np.zeros(len(found.measures))
        for i, block in enumerate(found.blocks[1:]):
            motion[np.arange(len(motion))[block][3 + axis]] = 1.0 if i % 2 else -0.9
        what.append(described(*motions(motion, found), found).what)
    assert all("together: their positions, " in one for one in what)
    assert ["ref's x axis" in what[0], "ref's y axis" in what[1], "ref's z axis" in what[2]] == [True] * 3
