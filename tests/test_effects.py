"""What else the data want: changes named and timed, lasting effects sized, clean recordings left alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from calibration_support import simulated
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.cli.tables import print_calibration
from gtcal.effects.effect import length
from gtcal.effects.evidence import Sums
from gtcal.effects.find import FALSE_ALARMS, effect_warnings, find_effects, frames_of
from gtcal.effects.isolated import isolated
from gtcal.errors import GtcalError
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording
from gtcal.report import render
from gtcal.report.calibration_part import calibration_part
from gtcal.results.calibration import Calibration, pose_difference
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.results.effect_finding import EffectFinding, Quantity
from gtcal.simulation import MocapNoise
from gtcal.workflow import calibrate

NOISE = MocapNoise(translation_mm=0.2, rotation_deg=0.02)
AXIS = np.array([1.0, 0.5, -0.3]) / np.linalg.norm([1.0, 0.5, -0.3])
FRAMES, HALF_S = 90, 30.0
FLAT_BOARD = CalibrationOptions(board="exact")
EXACT = CalibrationOptions(intrinsics="exact")
"""For what has nothing to do with lenses."""

Spoil = Callable[[Recording], Recording]


def recording(seed: int = 3, **changes: object) -> Recording:
    return simulated(seed=seed, frames=FRAMES, mocap=NOISE, **changes).recording


def moved_by(mm: float, deg: float) -> np.ndarray:
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_rotvec(np.deg2rad(deg) * AXIS).as_matrix()
    moved[:3, 3] = 1e-3 * mm * AXIS
    return moved


def slip(body: str, mm: float, deg: float, at_s: float = HALF_S, until_s: float = np.inf) -> Spoil:
    """The body's markers move."""

    def spoilt(clean: Recording) -> Recording:
        trajectory = getattr(clean, body)
        since_s = 1e-9 * (trajectory.stamps_ns - min(d.stamps_ns[0] for d in clean.detections.values()))
        after = (since_s > at_s) & (since_s < until_s)
        poses = trajectory.world_T_body.copy()
        poses[after] = poses[after] @ moved_by(mm, deg)
        return replace(clean, **{body: replace(trajectory, world_T_body=poses)})

    return spoilt


def bump(camera: str, px: float, at_s: float = HALF_S) -> Spoil:
    """All that the camera sees moves along a row."""

    def spoilt(clean: Recording) -> Recording:
        found = clean.detections[camera]
        since_s = 1e-9 * (found.stamps_ns - min(d.stamps_ns[0] for d in clean.detections.values()))
        corners_px = found.corners_px.copy()
        corners_px[:, 0] += px * np.repeat(since_s > at_s, np.diff(found.view_start))
        return replace(clean, detections=clean.detections | {camera: replace(found, corners_px=corners_px)})

    return spoilt


@cache
def clean() -> Calibration:
    return calibrate(recording())


def changes(found: Calibration) -> list[EffectFinding]:
    return [finding for finding in found.effects if finding.moment and finding.significant]


def test_a_clean_recording_wants_nothing() -> None:
    assert clean().effects
    assert not [finding.name for finding in clean().effects if finding.significant]
    assert not effect_warnings(clean().effects)


@pytest.mark.long
@pytest.mark.parametrize(
    ("body", "mm", "deg", "at_s"),
    [("board_body", 5.0, 0.5, 30.0), ("board_body", 5.0, 0.5, 48.0), ("platform", 2.0, 0.3, 30.0)],
)
def test_markers_that_slip_are_named_with_time_and_size(body: str, mm: float, deg: float, at_s: float) -> None:
    calibration = calibrate(slip(body, mm, deg, at_s)(recording()), CalibrationOptions() if at_s == 48.0 else EXACT)
    (found,) = changes(calibration)
    assert found.name == f"{body} markers moved"
    assert found.moment.after_s <= at_s <= found.moment.before_s
    assert found.moment.before_s - found.moment.after_s < 3.0
    by_mm, by_deg = found.estimate
    assert (by_mm.unit, by_deg.unit) == ("mm", "deg")
    assert abs(by_mm.value - mm) < 4.0 * by_mm.sigma < 0.4
    assert abs(by_deg.value - deg) < 4.0 * by_deg.sigma < 0.04
    assert found.hold_out_drop_px > 0.1
    for name, true_camera_T_ref in simulated(seed=3, frames=FRAMES, mocap=NOISE).truth.camera_T_ref.items():
        found_camera_T_ref = calibration.cameras[name].camera_T_ref.a_T_b
        off_mm, _ = pose_difference(inverse(found_camera_T_ref), inverse(true_camera_T_ref))
        assert found.moves_mm[name] == pytest.approx(off_mm, abs=0.15), "it moves cameras by what they are off"


@pytest.mark.long
@pytest.mark.parametrize("px", [1.0, 5.0])
def test_a_camera_that_is_bumped_is_named(px: float) -> None:
    found = calibrate(bump("side_left", px)(recording()))
    (change,) = changes(found)
    assert change.name == "camera side_left moved"
    assert change.moment.after_s <= HALF_S <= change.moment.before_s
    assert change.estimate[1].value == pytest.approx(np.rad2deg(px / 505.8), rel=0.4)
    assert [w for w in found.warnings if "'side_left' moved at" in w and "--segments auto" in w]


@pytest.mark.long
def test_two_changes_are_told_apart() -> None:
    spoilt = slip("platform", 3.0, 0.2, 40.0)(slip("board_body", 4.0, 0.4, 20.0)(recording()))
    found = sorted(changes(calibrate(spoilt, EXACT)), key=lambda change: change.moment.at_s)
    assert [change.name for change in found] == ["board_body markers moved", "platform markers moved"]
    assert [change.moment.at_s for change in found] == pytest.approx([20.0, 40.0], abs=1.0)


def test_gross_frames_that_stand_alone_are_no_change() -> None:
    spoilt = recording(swap_share=0.15)
    assert not changes(calibrate(spoilt, EXACT))


def test_isolated_views_are_those_that_their_neighbours_contradict() -> None:
    lengths = np.concatenate([np.full(30, 0.2), np.full(30, 9.0)])
    assert not isolated(lengths).any()
    lengths[[4, 40, 41]] = 60.0, 300.0, np.inf
    assert np.flatnonzero(isolated(lengths)).tolist() == [4, 40, 41]


@cache
def stretches(body: str) -> Calibration:
    """After a slip half way; with lenses solved for in one of both."""
    options = CalibrationOptions(segments="auto", intrinsics="auto" if body == "board_body" else "exact")
    return calibrate(slip(body, 5.0, 0.5)(recording()), options)


@pytest.mark.long
@pytest.mark.parametrize("body", ["board_body", "platform"])
def test_each_stretch_is_as_true_as_without_the_slip(body: str) -> None:
    simulation = simulated(seed=3, frames=FRAMES, mocap=NOISE)
    found = stretches(body)
    assert [segment.moved for segment in found.segments] == ["", body]
    moved = moved_by(5.0, 0.5)
    for segment, slipped in zip(found.segments, (np.eye(4), moved), strict=True):
        platform, board = (slipped if body == name else np.eye(4) for name in ("platform", "board_body"))
        assert_within(segment.body_T_board, inverse(board) @ simulation.truth.body_T_board)
        for name, pose in segment.camera_T_ref.items():
            assert_within(pose, simulation.truth.camera_T_ref[name] @ platform)
    for name, camera in found.cameras.items():
        assert pose_difference(camera.camera_T_ref.a_T_b, found.segments[0].camera_T_ref[name].a_T_b) == (0.0, 0.0)
    assert changes(found)
    assert found.rmse_px < 1.1 * clean().rmse_px


def assert_within(pose: object, true_a_T_b: np.ndarray) -> None:
    """Within 99.99 % of what the covariance allows."""
    import gtsam

    xi = gtsam.Pose3.Logmap(gtsam.Pose3(inverse(pose.a_T_b) @ true_a_T_b))
    assert xi @ np.linalg.solve(pose.covariance, xi) < 28.0


@pytest.mark.long
def test_a_bumped_camera_has_a_pose_before_and_one_after() -> None:
    true_camera_T_ref = simulated(seed=3, frames=FRAMES, mocap=NOISE).truth.camera_T_ref
    options = CalibrationOptions(intrinsics="exact", segments="auto")  # else a shift of pixels is a lens's
    found = calibrate(bump("side_left", 5.0)(recording()), options)
    assert list(found.cameras) == list(found.covariance.theta_sizes) == list(true_camera_T_ref)
    before, after = found.segments
    assert (before.moved, after.moved) == ("", "side_left")
    _, turned_deg = pose_difference(before.camera_T_ref["side_left"].a_T_b, after.camera_T_ref["side_left"].a_T_b)
    assert turned_deg == pytest.approx(0.57, rel=0.4)
    for name, camera in found.cameras.items():
        mm, deg = pose_difference(inverse(camera.camera_T_ref.a_T_b), inverse(true_camera_T_ref[name]))
        assert mm < 0.2, name
        assert deg < 0.03, name  # 1-sigma of each axis: 0.017 deg
    assert before.camera_T_ref["front_left"].a_T_b == pytest.approx(after.camera_T_ref["front_left"].a_T_b)


def test_without_a_change_there_is_one_stretch() -> None:
    found = calibrate(recording(), CalibrationOptions(segments="auto"))
    assert found.segments == ()
    assert [finding.name for finding in found.effects] == [finding.name for finding in clean().effects]


def lenses(scale: float) -> Spoil:
    def spoilt(given: Recording) -> Recording:
        cameras = {}
        for name, camera in given.cameras.items():
            theta = camera.theta.copy()
            theta[:2] *= scale
            cameras[name] = replace(camera, parameters=theta)
        return replace(given, cameras=cameras)

    return spoilt


@pytest.mark.long
def test_focal_lengths_that_are_off_are_sized_in_every_camera_and_warned_of_once() -> None:
    found = calibrate(lenses(1.003)(recording()), CalibrationOptions(intrinsics="exact"))
    wanted = {finding.name: finding for finding in found.effects if finding.significant}
    assert set(wanted) == {f"focal length of {name}" for name in found.cameras}
    for finding in wanted.values():
        (share,) = finding.estimate
        assert share.value == pytest.approx(-0.3, abs=max(5.0 * share.sigma, 0.01))
    assert len([warning for warning in found.warnings if "--refine-intrinsics" in warning]) == 1


def test_a_lens_given_without_distortion_is_named() -> None:
    given = recording()
    front_left = given.cameras["front_left"]
    theta = front_left.theta.copy()
    theta[4:] = 0.0
    given = replace(given, cameras=given.cameras | {"front_left": replace(front_left, parameters=theta)})
    found = calibrate(given, CalibrationOptions(intrinsics="exact"))
    wanted = [finding for finding in found.effects if finding.significant]
    assert "given without distortion" in next(f.what for f in wanted if f.name == "distortion of front_left")


@pytest.mark.long
def test_a_board_of_another_size_is_sized() -> None:
    given = recording()
    board = replace(given.board, tag_side_m=1.003 * given.board.tag_side_m, tag_gap_m=1.003 * given.board.tag_gap_m)
    found = calibrate(replace(given, board=board), FLAT_BOARD)
    wanted = [finding for finding in found.effects if finding.significant]
    (share,) = next(finding for finding in wanted if finding.name == "scale").estimate
    assert share.value == pytest.approx(-0.3, abs=0.03)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "move_m", "size"),
    [
        ("board stretch", lambda p, half: np.outer(p[:, 0], [0.002, 0, 0]) - np.outer(p[:, 1], [0, 0.002, 0]), 0.4),
        ("board bow along x", lambda p, half: np.outer(1.0 - (p[:, 0] / half[0]) ** 2, [0, 0, 0.001]), 1.0),
        ("board bow along y", lambda p, half: np.outer(1.0 - (p[:, 1] / half[1]) ** 2, [0, 0, 0.001]), 1.0),
    ],
)
def test_a_board_of_another_shape_is_sized(name: str, move_m: Callable[..., np.ndarray], size: float) -> None:
    """The board stands for what is stated; it is the truth that is stretched or bowed the other way."""
    given = synchronise(recording())
    corners_m = given.board.corners_m
    centre, half = 0.5 * (corners_m.max(axis=0) + corners_m.min(axis=0)), 0.5 * np.ptp(corners_m, axis=0)
    views = {
        camera: replace(of_camera, corners_m=of_camera.corners_m - move_m(of_camera.corners_m - centre, half))
        for camera, of_camera in given.views.items()
    }
    spoilt = replace(given, views=views)
    found = find_effects(calibrate_observations(spoilt, FLAT_BOARD), spoilt, FLAT_BOARD).effects
    wanted = {finding.name: finding for finding in found if finding.significant}
    (share,) = wanted[name].estimate
    assert share.value == pytest.approx(size, rel=0.1)
    assert not {"board stretch", "board bow along x", "board bow along y"} - {name} & set(wanted)


def test_a_clock_is_asked_only_where_something_moves() -> None:
    names = [finding.name for finding in clean().effects]
    assert {"clock offset", "clock drift", "platform lag"} <= set(names)
    late = calibrate(recording(clock_offset_s=0.004), replace(EXACT, clock="trust"))
    (offset,) = next(finding for finding in late.effects if finding.name == "clock offset").estimate
    assert offset.value == pytest.approx(-4.0, abs=max(5.0 * offset.sigma, 0.2))


def test_a_clock_is_never_asked_where_poses_are_known_at_the_images_alone() -> None:
    """An arm that stops for each image: what it does between is not known."""
    given = recording()
    stops_ns = np.unique(np.concatenate([found.stamps_ns for found in given.detections.values()]))
    bodies = {
        name: replace(body, stamps_ns=stops_ns, world_T_body=body.interpolate(stops_ns, 0.2).world_T_body)
        for name, body in given.motion.trajectories.items()
    }
    names = [finding.name for finding in calibrate(replace(given, **bodies), FLAT_BOARD).effects]
    assert "scale" in names
    assert not {"clock offset", "clock drift", "platform lag"} & set(names)


@pytest.mark.long
def test_no_effects_where_the_mocap_is_exact_or_none_are_asked_for() -> None:
    given = recording()
    assert calibrate(given, CalibrationOptions(mocap="exact")).effects == ()
    assert calibrate(given, CalibrationOptions(effects=False)).effects == ()
    with pytest.raises(GtcalError, match="segments are found among the effects"):
        CalibrationOptions(segments="auto", effects=False)


@pytest.mark.long
@pytest.mark.parametrize("capture", [Capture.FIXED_CAMERAS, Capture.STANDING_BOARD])
def test_all_captures(capture: Capture) -> None:
    kind = {
        Capture.FIXED_CAMERAS: "pinholes and fisheyes fixed",
        Capture.STANDING_BOARD: "headset, AprilGrid stands",
    }[capture]
    given = simulated(kind, seed=2, frames=FRAMES, mocap=NOISE).recording
    assert not [finding.name for finding in calibrate(given, EXACT).effects if finding.significant]
    body = "board_body" if capture is Capture.FIXED_CAMERAS else "platform"
    (found,) = changes(calibrate(slip(body, 3.0, 0.3)(given), EXACT))
    assert found.name == f"{body} markers moved"
    assert found.estimate[0].value == pytest.approx(3.0, abs=0.3)


def test_effects_of_ones_own_need_a_few_lines() -> None:
    """Columns that are another effect's are sized as it is; what is fitted to one stretch alone is no evidence."""
    given = recording()
    frames = frames_of(clean(), synchronise(given), CalibrationOptions())

    class Height:
        """The board body's markers sit higher in the first tenth of the recording."""

        name, what, advice, moment = "height", "markers sit higher at first", "none", None

        def columns(self, frames: object) -> np.ndarray:
            columns = np.zeros((len(frames.stamps_ns), frames.n_columns, 1))
            columns[: len(columns) // 10, 5, 0] = 1.0
            return columns

        def quantities(self, estimate: np.ndarray, covariance: np.ndarray) -> tuple[Quantity, ...]:
            return (length("", estimate, covariance, 1e3, "mm"),)

    evidence = Sums.of(frames, [Height()]).evidence(0)
    assert evidence.p_value > FALSE_ALARMS
    assert abs(evidence.estimate[0]) < 4.0 * np.sqrt(evidence.covariance[0, 0]) < 1e-3


def test_quantities_show_two_digits_of_their_sigma() -> None:
    assert Quantity("by", 5.0384, 0.0291, "mm").text == "5.038 mm ± 0.029"
    assert Quantity("", -12.0, 3.1, "us/s").text == "-12.0 us/s ± 3.1"


@pytest.mark.long
def test_effects_and_stretches_survive_the_file(tmp_path: Path) -> None:
    found = stretches("platform")
    write_calibration(tmp_path / "calibration.json", found)
    read = read_calibration(tmp_path / "calibration.json")
    assert read.effects == found.effects
    for again, segment in zip(read.segments, found.segments, strict=True):
        assert (again.start_s, again.end_s, again.moved) == (segment.start_s, segment.end_s, segment.moved)
        for name, pose in segment.camera_T_ref.items():
            assert np.array_equal(again.camera_T_ref[name].a_T_b, pose.a_T_b)
            assert np.array_equal(again.camera_T_ref[name].covariance, pose.covariance)
    print_calibration(read)
    part = calibration_part(read, None)
    assert [row.moved for row in part.segments] == ["", "platform"]
    assert part.effects[0].significant
    assert "What else the data want" in render(found)


def test_files_from_before_effects_are_read(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(path, clean())
    document = json.loads(path.read_text())
    del document["effects"], document["segments"]
    path.write_text(json.dumps(document))
    assert read_calibration(path).effects == ()
