"""Poses in place of corners: the joint estimate on SE(3), its sigmas, its file, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from cli_support import run
from factors_support import numeric_derivative
from support import replace_once

from factors.rigid import inverse
from gtcal.baselines.closed_forms import CLOSED_FORMS
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.estimation.linear import squared_distance
from gtcal.estimation.pose_joint import (
    JointPoses,
    PoseChain,
    PoseViews,
    differences,
    stage_1_of_poses,
    stage_2_of_poses,
    stage_3_of_poses,
)
from gtcal.pose_recordings.calibration import closed_forms
from gtcal.pose_recordings.calibration_file import read_pose_calibration
from gtcal.pose_recordings.recording import load_pose_recording
from gtcal.readers import write_euroc_csv, write_tum
from gtcal.readers.pose_list import write_pose_list
from gtcal.recordings.trajectory import Trajectory

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
    refused = run(
        "calibrate", folder, "-o", tmp_path / "x.json", "--clock", "estimate", "--report", tmp_path / "x.html"
    )
    assert refused.code == 1
    assert "poses in place of corners, which have no use for report, clock" in refused.err
    assert "'gtcal calibrate' and 'gtcal compare' take" in run("doctor", folder).err


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
