"""Poses in place of corners: the joint estimate on SE(3), its sigmas, its file, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from cli_support import run
from factors_support import numeric_derivative
from scipy.spatial.transform import Rotation
from support import replace_once

from factors.rigid import inverse
from gtcal import CalibrationOptions
from gtcal.baselines.closed_forms import CLOSED_FORMS
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.linear import squared_distance
from gtcal.estimation.observations import synchronise
from gtcal.estimation.pose_joint import (
    JointPoses,
    PoseChain,
    PoseViews,
    differences,
    stage_1_of_poses,
    stage_2_of_poses,
    stage_3_of_poses,
)
from gtcal.pose_recordings.calibration import calibrate_pose_recording, closed_forms
from gtcal.pose_recordings.calibration_file import read_pose_calibration
from gtcal.pose_recordings.doctor import diagnose_poses
from gtcal.pose_recordings.frames import pose_frames
from gtcal.pose_recordings.recording import PoseRecording, load_pose_recording
from gtcal.readers import write_euroc_csv, write_tum
from gtcal.readers.pose_list import write_pose_list
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation import MocapNoise, SimulationOptions, simulate

CAMERA_SIGMAS = np.repeat([1e-3, 5e-4], 3)
MOCAP_SIGMAS = np.repeat([5e-4, 4e-4], 3)


def _poses(rng: np.random.Generator, n: int, sigmas: FloatArray) -> FloatArray:
    return np.stack([gtsam.Pose3.Expmap(rng.normal(size=6) * sigmas).matrix() for _ in range(n)])


def scene(
    seed: int, names: tuple[str, ...] = ("left", "right"), n_frames: int = 30
) -> tuple[dict[str, PoseViews], PoseChain]:
    """Cameras that see most frames of a board whose body the mocap tracks, all with noise; and the truth."""
    rng = np.random.default_rng(seed)
    wide, (X,) = np.repeat([0.8, 0.4], 3), _poses(rng, 1, np.repeat([1.0, 0.2], 3))
    cameras = {name: _poses(rng, 1, np.repeat([1.0, 0.5], 3))[0] for name in names}
    A = _poses(rng, n_frames, wide)
    measured = A @ _poses(rng, n_frames, MOCAP_SIGMAS)
    views = {}
    for name, Y in cameras.items():
        seen = np.sort(rng.choice(n_frames, int(0.9 * n_frames), replace=False))
        B = Y @ A[seen] @ X @ _poses(rng, len(seen), CAMERA_SIGMAS)
        views[name] = PoseViews(1_000_000_000 * (seen + 1), seen, measured[seen], B)
    return views, PoseChain(cameras, X)


def solved(views: dict[str, PoseViews]) -> JointPoses:
    start = stage_1_of_poses(views, np.random.default_rng(0))
    aligned, _ = stage_2_of_poses(views, start, eps=1e-4, max_iterations=50)
    return stage_3_of_poses(views, aligned, eps=1e-6, max_iterations=50)


@pytest.fixture(scope="module")
def found() -> tuple[dict[str, PoseViews], PoseChain, JointPoses]:
    views, truth = scene(1)
    return views, truth, solved(views)


@pytest.mark.parametrize("stated", [False, True])
def test_the_jacobians_are_numeric_ones(stated: bool) -> None:
    views, truth = scene(0, n_frames=6)
    of_camera = views["left"]
    if stated:
        covariance = np.diag(np.arange(1.0, 7.0) ** 2) * 1e-6
        of_camera = replace(of_camera, covariance=np.tile(covariance, (of_camera.n_views, 1, 1)))
    Y, X = truth.camera_T_ref["left"], truth.body_T_board

    def residual(xi: FloatArray) -> FloatArray:
        moved = [pose @ gtsam.Pose3.Expmap(part).matrix() for pose, part in ((Y, xi[:6]), (X, xi[6:]))]
        return of_camera.residuals(*moved)[0].ravel()

    J = of_camera.residuals(Y, X)[1].reshape(-1, 12)
    np.testing.assert_allclose(J, numeric_derivative(residual, np.zeros(12), 1e-6), atol=1e-5 * np.abs(J).max())


@pytest.mark.long
def test_the_truth_lies_where_the_covariance_says() -> None:
    nees = []
    for seed in range(4):
        views, truth = scene(seed)
        joint = solved(views)
        xi = differences(joint.chain, truth)
        nees.append(squared_distance(xi, joint.covariance) / len(xi))
        assert joint.mocap_covariance is not None
    assert 0.5 < np.mean(nees) < 1.7  # 72 degrees of freedom together: within four sigma of one


def test_stated_covariances_weigh_the_views() -> None:
    views, truth = scene(3, names=("alone",), n_frames=40)
    of_camera = views["alone"]
    rng = np.random.default_rng(0)
    factors = np.where(np.arange(of_camera.n_views) % 2, 1.0, 30.0)
    spoilt = np.stack(
        [
            pose @ gtsam.Pose3.Expmap(factor * rng.normal(size=6) * CAMERA_SIGMAS).matrix()
            for pose, factor in zip(of_camera.camera_T_board, factors, strict=True)
        ]
    )
    stated = np.diag(CAMERA_SIGMAS**2) * factors[:, None, None] ** 2
    blind, told = (replace(of_camera, camera_T_board=spoilt, covariance=c) for c in (None, stated))
    errors = [np.linalg.norm(differences(solved({"alone": v}).chain, truth)[3:6]) for v in (blind, told)]
    assert errors[1] < errors[0]


def test_flipped_boards_hardly_count() -> None:
    views, truth = scene(5, names=("alone",), n_frames=40)
    seen, flip = views["alone"].camera_T_board.copy(), gtsam.Pose3.Expmap(np.array([0, 0.6, 0, 0, 0, 0.05])).matrix()
    seen[::8] = seen[::8] @ flip
    joint = solved({"alone": replace(views["alone"], camera_T_board=seen)})
    assert joint.weights["alone"][::8].max() < 0.2
    xi = differences(joint.chain, truth)
    assert (np.abs(xi) < 5.0 * np.sqrt(np.diag(joint.covariance))).all()


def test_every_closed_form_comes_near_and_is_measured(found: tuple) -> None:
    views, _, joint = found
    forms = closed_forms(views, joint)
    assert [form.method for form in forms] == list(CLOSED_FORMS)
    for form in forms:
        assert not form.failure
        assert 0.0 < form.difference_mm < 3.0
        assert form.sigmas > 0.1


def written(folder: Path, views: dict[str, PoseViews], *, numbered: bool = False) -> Path:
    """A recording of fixed cameras with these views."""
    folder.mkdir()
    stamps = np.unique(np.concatenate([v.stamps_ns for v in views.values()]))
    poses = {int(s): A for v in views.values() for s, A in zip(v.stamps_ns, v.ref_T_body, strict=True)}
    A = np.stack([poses[int(stamp)] for stamp in stamps])
    lines = ["gtcal_recording: 1", "capture: fixed_cameras", *(["numbered: true"] if numbered else []), "cameras:"]
    for name, v in views.items():
        file = f"{name}.csv" if numbered else f"{name}.tum"
        if numbered:
            write_pose_list(folder / file, v.stamps_ns // 10**9, v.camera_T_board)
        else:
            write_tum(folder / file, Trajectory(name, v.stamps_ns, v.camera_T_board))
        lines.append(f"  {name}: {{views: {file}}}")
    if numbered:
        write_pose_list(folder / "board.csv", stamps // 10**9, A)
    else:
        write_euroc_csv(folder / "board.csv", Trajectory("board_body", stamps, A))
    lines.append(f"board_body: {{trajectory: board.csv, format: {'pose_list' if numbered else 'euroc_csv'}}}")
    (folder / "recording.yaml").write_text("\n".join(lines) + "\n")
    return folder


def test_by_time_or_by_number_they_are_the_same(found: tuple, tmp_path: Path) -> None:
    views = found[0]
    by_time, by_number = (
        load_pose_recording(written(tmp_path / str(numbered), views, numbered=numbered)) for numbered in (False, True)
    )
    for name, v in views.items():
        for loaded in (by_time, by_number):
            np.testing.assert_allclose(loaded.views[name].camera_T_board, v.camera_T_board, atol=1e-12)
            np.testing.assert_allclose(loaded.views[name].ref_T_body, v.ref_T_body, atol=1e-12)


def test_the_command_writes_what_is_read_back(found: tuple, tmp_path: Path) -> None:
    views, _, joint = found
    folder = written(tmp_path / "recording", views)
    ran = run("calibrate", folder, "-o", tmp_path / "poses.json", "-v")
    assert ran.code == 0
    for expected in ("mocap, at the board", "Daniilidis", "Zhuang", "1-sigma, mm"):
        assert expected in ran.out
    back = read_pose_calibration(tmp_path / "poses.json")
    np.testing.assert_allclose(differences(back.chain, joint.chain), 0.0, atol=1e-5)
    assert back.cameras["left"].statistics.n_views == views["left"].n_views
    assert "Shah" in run("compare", folder).out
    refused = run("calibrate", folder, "-o", tmp_path / "x.json", "--segments", "auto", "--kernel", "Huber")
    assert refused.code == 1
    assert "poses in place of corners, which have no use for robust, segments" in refused.err
    assert "'gtcal calibrate', 'compare', 'doctor' and 'report' take" in run("info", folder).err


def test_the_report_shows_poses_in_mm_and_deg(found: tuple, tmp_path: Path) -> None:
    folder = written(tmp_path / "recording", found[0])
    assert run("calibrate", folder, "-o", tmp_path / "p.json", "--report", tmp_path / "p.html", "-q").code == 0
    page = (tmp_path / "p.html").read_text()
    for expected in ("Residual over time", "Residual against distance", "Residual by axis", "Daniilidis"):
        assert expected in page
    assert run("report", tmp_path / "p.json", "-o", tmp_path / "bare.html").code == 0
    assert "Residual over time" not in (tmp_path / "bare.html").read_text()
    again = run("report", tmp_path / "p.json", "--recording", folder, "-o", tmp_path / "again.html")
    assert again.code == 0
    assert (tmp_path / "again.html").read_text() == page
    with_lollypop = run("report", tmp_path / "p.json", "--verification", tmp_path / "v.json")
    assert "is a calibration from poses, without lenses" in with_lollypop.err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("left: {views: left.tum}", "left: {images: left}", "cameras.left: has no 'views', but other cameras have"),
        ("views: left.tum", "views: {file: left.tum, format: pose_list}", "pose_list has no time stamps"),
        ("views: left.tum", "views: nowhere.tum", r"cameras.left.views.trajectory: there is no .*nowhere.tum"),
        (
            "views: left.tum",
            "views: {file: left.tum, format: tum, covariance: c.csv}",
            "1 covariances for the 27 poses",
        ),
        ("capture: fixed_cameras", "capture: standing_board", "platform: is missing"),
    ],
)
def test_each_fault_is_told_in_one_line(old: str, new: str, message: str, found: tuple, tmp_path: Path) -> None:
    folder = written(tmp_path / "recording", found[0])
    (folder / "c.csv").write_text(",".join(map(str, np.eye(6).ravel().tolist())) + "\n")
    replace_once(folder / "recording.yaml", old, new)
    with pytest.raises(GtcalError, match=message) as told:
        load_pose_recording(folder)
    assert "\n" not in str(told.value)


def test_inverse_poses_may_be_stated(found: tuple, tmp_path: Path) -> None:
    views = found[0]
    turned = {name: replace(v, camera_T_board=inverse(v.camera_T_board)) for name, v in views.items()}
    folder = written(tmp_path / "recording", turned)
    for name in views:
        new = f"views: {{file: {name}.tum, format: tum, pose: board_T_camera}}"
        replace_once(folder / "recording.yaml", f"views: {name}.tum", new)
    loaded = load_pose_recording(folder)
    np.testing.assert_allclose(loaded.views["left"].camera_T_board, views["left"].camera_T_board, atol=1e-12)


def test_the_frames_derivatives_are_numeric_ones(found: tuple, tmp_path: Path) -> None:
    views, _, joint = found
    motion = load_pose_recording(written(tmp_path / "recording", views)).motion
    frames = pose_frames(views, motion, joint.chain)
    assert frames is not None
    row, name = 3, "right"
    v = frames.of_views[name]
    index = int(np.searchsorted(frames.of_frames.frame_index, v.frame_index[row]))
    Y, A, X = joint.chain.camera_T_ref[name], v.ref_T_body[row], joint.chain.body_T_board

    def residual(xi: FloatArray) -> FloatArray:
        moved = (gtsam.Pose3.Expmap(xi[start : start + 6]).matrix() for start in (0, 6, 18))
        A_moved, X_moved, Y_moved = (pose @ step for pose, step in zip((A, X, Y), moved, strict=True))
        one = PoseViews(v.stamps_ns[:1], v.frame_index[:1], A_moved[None], v.camera_T_board[row][None])
        return one.residuals(Y_moved, X_moved)[0][0]

    J = numeric_derivative(residual, np.zeros(24), 1e-6)
    shift = np.zeros((len(frames.stamps_ns), 24))
    shift[index] = np.random.default_rng(0).normal(size=24) * 1e-4
    moved = frames.moved(name, shift)
    before, after = (u.residuals(Y, X)[0][row] for u in (v, moved))
    np.testing.assert_allclose(after - before, J @ shift[index], atol=2e-7)


def test_the_doctor_names_what_is_wrong_with_the_cameras_poses(found: tuple, tmp_path: Path) -> None:
    wrong = {name: replace(v, camera_T_board=inverse(v.camera_T_board)) for name, v in found[0].items()}
    diagnosis = diagnose_poses(written(tmp_path / "recording", wrong))
    assert [finding.fault for finding in diagnosis.findings] == ["inverse poses"]
    assert diagnosis.lines[0] == "cameras.left.views: {file: left.tum, format: tum, pose: board_T_camera}"


@pytest.mark.long
def test_the_doctor_leaves_a_sound_recording_alone(found: tuple, tmp_path: Path) -> None:
    folder = written(tmp_path / "recording", found[0])
    assert diagnose_poses(folder).healthy
    assert run("doctor", folder).code == 0


def moving(seed: int, *, early_s: float = 0.0, slip: FloatArray | None = None) -> PoseRecording:
    """A simulated headset's poses, stamped too early, from the middle on of a board that slipped on its body."""
    simulation = simulate(SimulationOptions(mocap=MocapNoise(translation_mm=0.1, rotation_deg=0.01)), seed=seed)
    observations, rng = synchronise(simulation.recording), np.random.default_rng(seed)
    views = {}
    for index, (name, v) in enumerate(observations.views.items()):
        taken = np.isin(simulation.truth.cameras[name].stamps_ns, v.stamps_ns)
        true = simulation.scene.camera_T_board(index, simulation.frame_times_s[taken])
        seen = true @ _poses(rng, len(true), CAMERA_SIGMAS)
        late = v.stamps_ns > (v.stamps_ns[0] + v.stamps_ns[-1]) // 2
        seen[late] = seen[late] if slip is None else seen[late] @ slip
        stamps = v.stamps_ns - round(1e9 * early_s)
        at = observations.motion.at(stamps)
        views[name] = PoseViews(stamps[at.ok], v.frame_index[at.ok], at.ref_T_body[at.ok], seen[at.ok])
    return PoseRecording(Path("none"), observations.capture, views, observations.motion, (), (), ())


@pytest.mark.long
def test_the_clocks_offset_is_found_and_corrected() -> None:
    recording = moving(3, early_s=0.02)
    trusted = calibrate_pose_recording(recording)
    assert any("--clock estimate" in line for line in trusted.warnings)
    corrected = calibrate_pose_recording(recording, CalibrationOptions(clock="estimate"))
    assert corrected.clock is not None
    name = next(iter(corrected.cameras))
    assert abs(corrected.clock.offset_s[name] - 0.02) < 4.0 * corrected.clock.sigma_s[name] < 2e-3
    fits = [c.cameras[name].statistics.shift_rms_mm for c in (corrected, trusted)]
    assert fits[0] < 0.5 * fits[1]


@pytest.mark.long
def test_a_board_that_slipped_is_named_and_sized() -> None:
    slip = gtsam.Pose3.Expmap(np.array([0, 0, 0.004, 0.002, 0, 0])).matrix()
    found = calibrate_pose_recording(moving(3, slip=slip))
    (change, *others) = [effect for effect in found.effects if effect.significant]
    assert not others
    assert change.name == "board_body markers moved"
    by_mm, by_deg = change.estimate
    assert abs(by_deg.value - np.rad2deg(0.004)) < 4.0 * by_deg.sigma
    assert change.moment is not None
    assert any("as two recordings" in line for line in found.warnings)
    assert by_mm.unit == "mm"


@pytest.mark.parametrize(
    ("views", "stated", "body", "message"),
    [
        ("quats", "{}", "matrices", "doesn't state its quaternion, .* xyzw or wxyz"),
        ("vectors", "{}", "matrices", "doesn't state its rotation"),
        ("vectors", "{rotation: helical}", "matrices", "doesn't state its angle_unit"),
        ("degrees", "{rotation: helical, angle_unit: rad}", "matrices", "more than a turn; .*views.angle_unit: deg"),
        (
            "vectors",
            "{rotation: helical, angle_unit: deg}",
            "matrices",
            "no angle .* larger .*views.angle_unit: rad",
        ),
        ("stretched", "{}", "matrices", r"left.txt:2: the matrix's 3 x 3 part is no rotation"),
        ("matrices", "{}", "fewer", r"board_body: 9 poses for 10 images \(numbers 1 to 10\)"),
    ],
)
def test_each_fault_of_poses_by_number_is_told_in_one_line(
    views: str, stated: str, body: str, message: str, tmp_path: Path
) -> None:
    poses = _poses(np.random.default_rng(0), 10, np.repeat([0.8, 0.4], 3))
    R, t = Rotation.from_matrix(poses[:, :3, :3]), poses[:, :3, 3]
    stretched = poses.copy()
    stretched[1, :3, :3] *= 1.1
    kinds = {
        "matrices": poses.reshape(10, 16),
        "fewer": poses.reshape(10, 16)[:9],
        "stretched": stretched.reshape(10, 16),
        "quats": np.hstack([t, R.as_quat()]),
        "vectors": np.hstack([t, R.as_rotvec()]),
        "degrees": np.hstack([t, R.as_rotvec(degrees=True)]),
    }
    np.savetxt(tmp_path / "left.txt", kinds[views])
    np.savetxt(tmp_path / "board.txt", kinds[body])
    said = "{file: left.txt, format: pose_list, length_unit: m" + (f", {stated[1:-1]}}}" if stated != "{}" else "}")
    (tmp_path / "recording.yaml").write_text(
        "gtcal_recording: 1\ncapture: fixed_cameras\nnumbered: true\n"
        f"cameras:\n  left: {{views: {said}}}\n"
        "board_body: {trajectory: board.txt, format: pose_list, length_unit: m}\n"
    )
    with pytest.raises(GtcalError, match=message) as told:
        load_pose_recording(tmp_path)
    assert "\n" not in str(told.value)
