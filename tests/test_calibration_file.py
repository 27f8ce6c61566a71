"""calibration.json: nothing lost, nothing half-written, every fault named; and what its sigmas mean."""

from __future__ import annotations

import json
from dataclasses import asdict, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from scipy.spatial.transform import Rotation

import gtcal
from factors.board_shape import shaped
from factors.rigid import inverse
from gtcal.errors import GtcalError
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.files import InputFile
from gtcal.results.calibration import Calibration, PoseEstimate, ResidualStatistics, pose_difference
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import CornerNoise


@cache
def calibration(**options: object) -> Calibration:
    simulation = simulated(HEADSET, swap_share=0.1, corners=CornerNoise(wrong_corner_share=0.02))
    inputs = (InputFile(Path("a folder/with spaces.csv"), "0" * 64),)
    found = calibrate_observations(synchronise(simulation.recording), CalibrationOptions(**options), inputs=inputs)
    return replace(found, warnings=(*found.warnings, "an umlaut: ü, a quote: \"'"))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_calibration(tmp_path / "calibration.json", calibration())
    return tmp_path / "calibration.json"


def plain(result: Calibration) -> Any:
    """All of a calibration but the solution, in a form in which == compares every bit; NaN equals NaN."""

    def compared(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.dtype.str, value.shape, value.tobytes()
        if isinstance(value, float):
            return repr(float(value))
        if isinstance(value, dict):
            return {key: compared(inner) for key, inner in value.items()}
        if isinstance(value, (list, tuple)):
            return [compared(inner) for inner in value]
        return compared(vars(value)) if is_dataclass(value) else value

    fields = {
        name: value for name, value in vars(result).items() if name not in ("cameras", "solution", "body_T_board")
    }
    of_camera = {
        name: [
            camera.camera.name,
            camera.camera.model.name,
            compared(camera.camera.theta),
            (camera.camera.image_width_px, camera.camera.image_height_px),
            compared(vars(camera.camera_T_ref)),
            compared(camera.theta_covariance),
            compared(asdict(camera.residuals)),
        ]
        for name, camera in result.cameras.items()
    }
    return of_camera, compared(vars(result.body_T_board)), compared(fields)


WAYS = {"plain": {}, "intrinsics too": {"intrinsics": "refine"}, "no covariance": {"stages": (1, 2)}}


@pytest.mark.parametrize("options", WAYS.values(), ids=WAYS)
def test_what_is_read_is_what_was_written_bit_for_bit(options: dict[str, object], tmp_path: Path) -> None:
    write_calibration(tmp_path / "c.json", calibration(**options))
    read = read_calibration(tmp_path / "c.json")
    assert plain(read) == plain(calibration(**options))
    assert read.solution is None
    write_calibration(tmp_path / "again.json", read)
    write_calibration(tmp_path / "third.json", read_calibration(tmp_path / "again.json"))
    assert (tmp_path / "third.json").read_bytes() == (tmp_path / "again.json").read_bytes()


def test_paths_may_be_text(tmp_path: Path) -> None:
    """As in the package's own example."""
    gtcal.write_calibration(str(tmp_path / "c.json"), calibration())
    assert plain(gtcal.read_calibration(str(tmp_path / "c.json"))) == plain(calibration())


def test_the_file_is_strict_json_with_every_promised_thing(path: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    document = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    for name, camera in calibration().cameras.items():
        block = document["cameras"][name]
        assert block["parameters"] == dict(zip(camera.camera.model.parameter_names, camera.camera.theta, strict=True))
        assert {"rmse_px", "median_px", "p95_px", "n_corners", "n_views"} <= set(block["residuals"])
        pose = block["camera_T_ref"]
        assert np.shape(pose["covariance"]) == (6, 6)
        assert np.shape(pose["position_of_camera_in_ref_sigma_mm"]) == np.shape(pose["rotation_sigma_deg"]) == (3,)
    assert [stage["stage"] for stage in document["stages"]] == [0, 1, 2, 3, 4]
    assert {"gross view", "gross corner"} <= {entry["reason"].split(" (")[0] for entry in document["dropped"]}
    assert {"command_line", "versions", "options", "inputs", "created_utc"} <= set(document["provenance"])
    assert document["provenance"]["options"]["eps"] == 1e-4
    assert document["provenance"]["inputs"] == [{"path": "a folder/with spaces.csv", "sha256": "0" * 64}]
    assert {"gtcal", "gtsam", "numpy", "python"} <= set(document["provenance"]["versions"])
    assert "Exp(xi)" in document["conventions"]


def test_quaternion_and_translation_beside_the_matrix_say_the_same(path: Path) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    poses = [block["camera_T_ref"] for block in document["cameras"].values()] + [document["body_T_board"]]
    for pose in poses:
        w, x, y, z = pose["quat_wxyz"]
        matrix = np.array(pose["matrix"])
        np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), matrix[:3, :3], atol=1e-12)
        assert pose["t_m"] == matrix[:3, 3].tolist()


# Nothing half-written


def test_a_number_that_json_has_not_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_calibration(tmp_path / "c.json", replace(calibration(), sigma_px=float("nan")))
    assert list(tmp_path.iterdir()) == []


def test_a_failing_disk_leaves_the_old_file_and_nothing_else(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = path.read_bytes()

    def fail(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(GtcalError, match=r"calibration\.json: can't be written: No space left on device"):
        write_calibration(path, replace(calibration(), sigma_px=1.0))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


# Faults


def refused(path: Path) -> str:
    with pytest.raises(GtcalError) as caught:
        read_calibration(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "can't be read: No such file" in refused(tmp_path / "absent.json")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_truncated_file_is_no_json(path: Path, share: float) -> None:
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: int(share * len(text))], encoding="utf-8")
    assert "is no calibration of gtcal, it is not valid JSON" in refused(path)


def test_a_folder_is_no_calibration(tmp_path: Path) -> None:
    assert "is a folder; expected a calibration of gtcal, a JSON file" in refused(tmp_path)


@pytest.mark.parametrize("content", [b"[1, 2]", b"{}", b'"text"', b"3", b'{"gtcal_calibration": "1"}'])
def test_another_file_is_no_calibration(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    assert "is no calibration of gtcal" in refused(path)


def test_bytes_that_are_no_text_are_no_json(path: Path) -> None:
    path.write_bytes(b"\x89PNG\r\n\x1a\n\xff")
    assert "is not UTF-8 text" in refused(path)


def test_a_newer_schema_asks_for_a_newer_gtcal(path: Path) -> None:
    edited(path, lambda document: document.update(gtcal_calibration=99))
    assert "has calibration schema 99, this gtcal reads up to 1; update gtcal" in refused(path)


def edited(path: Path, edit: Any) -> None:
    document = json.loads(path.read_text(encoding="utf-8"))
    edit(document)
    path.write_text(json.dumps(document), encoding="utf-8")


READ = {
    "": ("capture", "cameras", "body_T_board", "board", "sigma_px", "covariance_kind", "stages", "dropped", "warnings"),
    "cameras.side_left": ("model", "image_size_px", "parameters", "parameter_covariance", "camera_T_ref", "residuals"),
    "cameras.side_left.parameters": ("fx", "k5", "p1"),
    "cameras.side_left.camera_T_ref": ("matrix", "covariance"),
    "cameras.side_left.residuals": ("rmse_px", "p95_px", "n_views", "n_without_pixel"),
    "body_T_board": ("matrix", "covariance"),
    "stages.2": ("stage", "name", "error_unit", "median_px"),
    "dropped.0": ("camera", "reason", "n_corners"),
    "provenance": ("created_utc", "command_line", "versions", "options", "inputs", "duration_s"),
    "provenance.inputs.0": ("path", "sha256"),
}


@pytest.mark.parametrize(("where", "name"), [(where, name) for where, names in READ.items() for name in names])
def test_a_missing_field_is_named(path: Path, where: str, name: str) -> None:
    def remove(document: Any) -> None:
        for key in filter(None, where.split(".")):
            document = document[int(key) if key.isdigit() else key]
        del document[name]

    edited(path, remove)
    assert f"the field {name!r} is missing" in refused(path)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda d: d.update(capture="tripod"), "tripod"),
        (lambda d: d.update(cameras=[]), "wrong form"),
        (lambda d: d.update(sigma_px="small"), "small"),
        (lambda d: d["body_T_board"].update(matrix=[[1.0, 0.0], [0.0, 1.0]]), "shape (2, 2), expected (4, 4)"),
        (lambda d: d["body_T_board"].update(matrix=None), "matrix is null"),
        (lambda d: d["body_T_board"].update(covariance=[1.0]), "shape (1,), expected (6, 6)"),
        (lambda d: d["cameras"]["side_left"].update(model="fisheye99"), "'fisheye99'; choose from"),
        (lambda d: d["cameras"]["side_left"].update(image_size_px=[640]), "wrong form"),
        (lambda d: d["cameras"]["side_left"]["parameters"].update(fx="wide"), "wide"),
    ],
)
def test_a_field_of_the_wrong_form_is_refused(path: Path, edit: Any, said: str) -> None:
    edited(path, edit)
    assert said in refused(path)


@pytest.mark.parametrize("constant", ["NaN", "Infinity", "-Infinity"])
def test_numbers_that_json_has_not_are_refused(path: Path, constant: str) -> None:
    text = path.read_text(encoding="utf-8")
    start = text.index('"sigma_px": ') + len('"sigma_px": ')
    path.write_text(text[:start] + constant + text[text.index(",", start) :], encoding="utf-8")
    assert f"{constant} is no number of JSON" in refused(path)


def test_fields_that_a_later_version_adds_are_passed_over(path: Path) -> None:
    edited(path, lambda d: [d.update(more=1), d["stages"][0].update(more=1), d["provenance"].update(more=1)])
    assert plain(read_calibration(path)) == plain(calibration())


# What the numbers mean


def random_estimate(seed: int) -> PoseEstimate:
    rng = np.random.default_rng(seed)
    a_T_b = np.eye(4)
    a_T_b[:3, :3], a_T_b[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(0.0, 1.0, 3)
    factor = rng.normal(0.0, 1.0, (6, 6)) * np.array([2e-3] * 3 + [3e-3] * 3)[:, None]
    return PoseEstimate(a_T_b, factor @ factor.T)


def drawn(estimate: PoseEstimate, n: int = 20_000) -> np.ndarray:
    """(N, 4, 4) transforms of the stated distribution: a_T_b * Exp(xi)."""
    xi = np.random.default_rng(9).multivariate_normal(np.zeros(6), estimate.covariance, n)
    return np.stack([estimate.a_T_b @ gtsam.Pose3.Expmap(row).matrix() for row in xi])


@pytest.mark.parametrize("seed", range(3))
def test_position_covariances_are_those_of_drawn_transforms(seed: int) -> None:
    estimate = random_estimate(seed)
    poses = drawn(estimate)
    positions = inverse(poses)[:, :3, 3]
    expected = estimate.position_of_a_in_b_covariance_m2
    np.testing.assert_allclose(np.cov(positions.T), expected, atol=0.04 * np.abs(expected).max())
    np.testing.assert_allclose(1e3 * positions.std(axis=0), estimate.position_of_a_in_b_sigma_mm, rtol=0.03)
    np.testing.assert_allclose(1e3 * poses[:, :3, 3].std(axis=0), estimate.position_of_b_in_a_sigma_mm, rtol=0.03)
    np.testing.assert_allclose(positions.mean(axis=0), estimate.position_of_a_in_b_m, atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_rotation_sigmas_are_about_the_axes_of_b(seed: int) -> None:
    estimate = random_estimate(seed)
    turns = Rotation.from_matrix((inverse(estimate.a_T_b) @ drawn(estimate))[:, :3, :3])
    np.testing.assert_allclose(turns.as_rotvec(degrees=True).std(axis=0), estimate.rotation_sigma_deg, rtol=0.03)


def test_without_a_covariance_there_are_no_sigmas() -> None:
    estimate = PoseEstimate(np.eye(4), None)
    assert estimate.rotation_sigma_deg is None
    assert estimate.position_of_a_in_b_sigma_mm is None
    assert estimate.position_of_b_in_a_sigma_mm is None


def test_pose_difference_is_in_mm_and_deg() -> None:
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 2.5], degrees=True).as_matrix()
    turned[:3, 3] = [0.003, 0.0, 0.004]
    assert pose_difference(turned, np.eye(4)) == pytest.approx((5.0, 2.5))


def test_residual_statistics_are_of_the_corners_with_a_pixel() -> None:
    statistics = ResidualStatistics.of(np.array([3.0, np.inf, 4.0, 0.0]), n_views=2)
    assert statistics.rmse_px == pytest.approx(np.sqrt(25.0 / 3.0))
    assert (statistics.median_px, statistics.worst_px) == (3.0, 4.0)
    assert (statistics.n_corners, statistics.n_without_pixel, statistics.n_views) == (4, 1, 2)


def test_the_pooled_rmse_weighs_cameras_by_their_corners() -> None:
    result = calibration()
    lengths = np.concatenate([np.hypot(*_residuals(result, name).T) for name in result.cameras])
    assert result.rmse_px == pytest.approx(np.sqrt(np.mean(lengths**2)), rel=1e-9)


def _residuals(result: Calibration, name: str) -> np.ndarray:
    views, camera = result.solution.views[name], result.cameras[name]
    poses = camera.camera_T_ref.a_T_b @ views.ref_T_body @ result.body_T_board.a_T_b
    poses = poses[views.view_of_corner]
    corners_m = shaped(views.corners_m, views.outline_m, result.estimate.board_shape)
    in_camera = np.einsum("nij,nj->ni", poses[:, :3, :3], corners_m) + poses[:, :3, 3]
    return camera.camera.project(in_camera)[0] - views.corners_px
