"""What is known beforehand: its factors, its file, and what it does to estimate and covariance."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from calibration_support import HEADSET, errors, pose_errors, simulated
from cli_support import run
from factors_support import derivative_to, poses
from guide_support import block
from scipy.spatial.transform import Rotation

from factors import PoseMeasurementFactor
from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError, calibrate_observations, read_calibration, synchronise
from gtcal.camera_files.formats import write_rig
from gtcal.camera_files.rig import Rig, RigCamera
from gtcal.estimation.priors import PosePrior, Priors
from gtcal.estimation.priors_file import read_priors
from gtcal.results.covariance import CLUSTERED, ERRORS_IN_VARIABLES, NAIVE
from gtcal.simulation import MocapNoise, write_simulation

KEYS = [gtsam.symbol("y", 0), gtsam.symbol("y", 1)]


def stated(a_T_b: np.ndarray, sigma_mm: float | None, sigma_deg: float | None) -> PosePrior:
    x, y, z, w = Rotation.from_matrix(a_T_b[:3, :3]).as_quat()
    sigma_m = None if sigma_mm is None else 1e-3 * sigma_mm
    sigma_rad = None if sigma_deg is None else np.deg2rad(sigma_deg)
    return PosePrior(tuple(a_T_b[:3, 3]), (w, x, y, z), (sigma_m,) * 3, (sigma_rad,) * 3)


@pytest.mark.parametrize("chain", [[(0, False)], [(0, True)], [(0, False), (1, True)], [(0, True), (1, False)]])
def test_a_measured_chain_of_poses_and_its_jacobians(chain: list[tuple[int, bool]]) -> None:
    random = np.random.default_rng(0)
    true = poses(random, 2, 2.0, 0.5)
    values = gtsam.Values()
    for key, pose in zip(KEYS, true, strict=True):
        values.insert(key, gtsam.Pose3(pose))
    whole = np.linalg.multi_dot([np.eye(4), *(inverse(true[i]) if inverted else true[i] for i, inverted in chain)])
    xi = np.array([0.03, -0.02, 0.05, 0.01, 0.02, -0.03])
    weights = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 0.0])
    measured = whole @ gtsam.Pose3.Expmap(-xi).matrix()
    factor = PoseMeasurementFactor([(KEYS[i], inverted) for i, inverted in chain], measured, weights)
    np.testing.assert_allclose(factor.unwhitenedError(values), weights * xi, atol=1e-12)
    jacobian, _ = factor.linearize(values).jacobian()
    numeric = [derivative_to(factor.unwhitenedError, values, KEYS[i]) for i, _ in chain]
    np.testing.assert_allclose(jacobian, np.hstack(numeric), atol=1e-6)


def test_a_weight_below_zero_is_refused() -> None:
    with pytest.raises(ValueError, match="of zero or more"):
        PoseMeasurementFactor([(KEYS[0], False)], np.eye(4), np.full(6, -1.0))


# Estimates

NOISE = MocapNoise(translation_mm=0.3, rotation_deg=0.03)


@pytest.mark.long
def test_true_priors_make_the_estimate_better_and_surer() -> None:
    without_mm, with_mm = [], []
    for seed in range(3):
        simulation = simulated(HEADSET, seed=seed, frames=30, mocap=NOISE)
        truth, observations = simulation.truth, synchronise(simulation.recording)
        tight = stated(inverse(truth.camera_T_ref["front_left"]), 0.02, 0.002)
        priors = Priors(ref_T_camera={"front_left": tight})
        plain = calibrate_observations(observations, CalibrationOptions())
        found = calibrate_observations(observations, CalibrationOptions(priors=priors))
        assert not any("contradict" in warning for warning in found.warnings)
        without_mm.append(errors(plain, simulation)["front_left"][0])
        with_mm.append(errors(found, simulation)["front_left"][0])
        for kind in set(plain.covariances) - {NAIVE}:  # naive sigmas are smaller than the prior's
            before, after = (np.diag(c.covariances[kind].camera_T_ref("front_left")) for c in (plain, found))
            assert (after < before).all(), kind
        assert found.cameras["front_left"].camera_T_ref.position_of_a_in_b_sigma_mm.max() < 0.021
    assert np.mean(with_mm) < 0.5 * np.mean(without_mm)


def test_a_known_baseline_between_cameras_holds() -> None:
    simulation = simulated(HEADSET, frames=30, mocap=NOISE)
    truth = simulation.truth.camera_T_ref
    true = truth["side_left"] @ inverse(truth["side_right"])
    priors = Priors(camera_a_T_camera_b={("side_left", "side_right"): stated(true, 0.001, 0.0001)})
    found = calibrate_observations(synchronise(simulation.recording), CalibrationOptions(priors=priors)).cameras
    pose = found["side_left"].camera_T_ref.a_T_b @ inverse(found["side_right"].camera_T_ref.a_T_b)
    mm, deg = pose_errors(pose, true)
    assert (mm < 0.005, deg < 0.0005) == (True, True)


@pytest.mark.long
def test_a_prior_that_is_wrong_is_said_to_be() -> None:
    simulation = simulated(HEADSET, frames=60)
    wrong = simulation.truth.body_T_board.copy()
    wrong[:3, 3] += [0.0, 0.05, 0.0]
    options = CalibrationOptions(priors=Priors(body_T_board=stated(wrong, 1.0, None)))
    found = calibrate_observations(synchronise(simulation.recording), options)
    assert any("the prior on the board's pose and the data contradict each other" in w for w in found.warnings)


def test_a_prior_on_the_board_rescues_a_motion_about_one_axis() -> None:
    """What such a motion leaves open is a shift of the board along its axis, and all cameras' with it."""
    simulation = simulated(HEADSET, motion="single_axis")
    observations = synchronise(simulation.recording)
    with pytest.raises(GtcalError, match="single axis"):
        calibrate_observations(observations)
    prior = stated(simulation.truth.body_T_board, 0.5, 0.1)
    found = calibrate_observations(observations, CalibrationOptions(priors=Priors(body_T_board=prior)))
    assert errors(found, simulation)["X"][0] < 0.5
    assert max(mm for mm, _ in errors(found, simulation).values()) < 5.0
    assert found.covariance_kind in (CLUSTERED, ERRORS_IN_VARIABLES)


def test_intrinsics_may_be_known_in_part() -> None:
    simulation = simulated(HEADSET, intrinsics="perturbed", frames=60)
    true = simulation.truth.intrinsics["front_left"]
    known = {"front_left": {"cx": (float(true[2]), 0.01), "cy": (float(true[3]), 0.01)}}
    options = CalibrationOptions(intrinsics="refine", priors=Priors(intrinsics=known))
    found = calibrate_observations(synchronise(simulation.recording), options).cameras["front_left"]
    np.testing.assert_allclose(found.camera.theta[2:4], true[2:4], atol=0.03)


@pytest.mark.parametrize(
    ("priors", "free", "message"),
    [
        (Priors(ref_T_camera={"left": stated(np.eye(4), 1.0, 1.0)}), False, "camera 'left', which is not there"),
        (Priors(intrinsics={"front_left": {"cx": (1.0, 1.0)}}), False, "but they are fixed: refine them"),
        (Priors(intrinsics={"front_left": {"k9": (1.0, 1.0)}}), True, "'k9' of camera 'front_left'; fisheye62 has fx"),
    ],
)
def test_priors_that_do_not_fit_are_refused(priors: Priors, free: bool, message: str) -> None:
    options = CalibrationOptions(priors=priors, intrinsics="refine" if free else "exact")
    with pytest.raises(GtcalError, match=message):
        calibrate_observations(synchronise(simulated(HEADSET).recording), options)


# The file

FILE = """
gtcal_priors: 1
body_T_board: {position_mm: [12, 0, 40], rotvec_deg: [0, 0, 90], sigma_mm: [1, 2, null]}
cameras:
  front_left:
    ref_T_camera: {position_mm: [1, 2, 3], quat_wxyz: [1, 0, 0, 0], sigma_mm: 0.5, sigma_deg: 180}
    intrinsics: {cx: {value: 640.5, sigma: 2}}
between_cameras:
  - {camera: side_left, seen_from: front_left, position_mm: [0, 0, 0], quat_wxyz: [0, 1, 0, 0], sigma_deg: 0.1}
"""


def test_the_file_says_what_it_says(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(FILE)
    found = read_priors(tmp_path / "p.yaml")
    assert found.body_T_board.position_m == pytest.approx((0.012, 0.0, 0.04))
    np.testing.assert_allclose(found.body_T_board.a_T_b[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.body_T_board.weights, [0.0, 0.0, 0.0, 1000.0, 500.0, 0.0])
    np.testing.assert_allclose(found.ref_T_camera["front_left"].sigma_rad, np.pi)
    assert found.camera_a_T_camera_b["front_left", "side_left"].sigma_m == (None, None, None)
    assert found.intrinsics == {"front_left": {"cx": (640.5, 2.0)}}


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("rotvec_deg: [0, 0, 90], ", "", "body_T_board: the rotation is missing"),
        (
            "quat_wxyz: [1, 0, 0, 0]",
            "quat_wxyz: [1, 1, 0, 0]",
            "ref_T_camera: quat_wxyz: .* not of length 1",
        ),
        ("sigma_mm: 0.5", "sigma_mm: -1", "sigma_m: .* no positive number"),
        (", sigma_deg: 0.1", "", "neither sigma_mm nor sigma_deg"),
        ("position_mm: [1, 2, 3]", "position_mm: [1, 2]", "position_mm: list should have at least 3 items"),
        ("gtcal_priors: 1", "gtcal_priors: 2", "gtcal_priors: input should be 1"),
        ("cameras:\n", "camera:\n", "camera: extra inputs are not permitted"),
    ],
)
def test_a_wrong_file_is_told_in_one_line(tmp_path: Path, before: str, after: str, message: str) -> None:
    assert before in FILE
    (tmp_path / "p.yaml").write_text(FILE.replace(before, after, 1))
    with pytest.raises(GtcalError, match=message) as caught:
        read_priors(tmp_path / "p.yaml")
    assert str(caught.value).startswith(str(tmp_path / "p.yaml"))
    assert "\n" not in str(caught.value)


def test_the_command_takes_it_and_keeps_it(tmp_path: Path) -> None:
    write_simulation(simulated(HEADSET), tmp_path / "recording", images=False)
    position_mm = (1e3 * simulated(HEADSET).truth.body_T_board[:3, 3]).tolist()
    text = f"{{gtcal_priors: 1, body_T_board: {{position_mm: {position_mm}, quat_wxyz: [1, 0, 0, 0], sigma_mm: 1}}}}"
    (tmp_path / "p.yaml").write_text(text)
    ran = run("calibrate", tmp_path / "recording", "-o", tmp_path / "c.json", "-q", "--priors", tmp_path / "p.yaml")
    assert (ran.code, ran.err) == (0, "")
    kept = read_calibration(tmp_path / "c.json").provenance.options["priors"]
    assert kept["body_T_board"]["sigma_m"] == [0.001] * 3
    assert replace(CalibrationOptions()).priors.document()["body_T_board"] is None


# A rig in a camera file


def rig_file(folder: Path, format_name: str) -> Path:
    """A file of priors beside the true rig in a camera file of this format."""
    truth, cameras = simulated(HEADSET).truth, simulated(HEADSET).recording.cameras
    rig = Rig(tuple(RigCamera(cameras[name], pose) for name, pose in truth.camera_T_ref.items()), "ref", "the headset")
    write_rig(rig, folder / "rig.json", format_name, ["a test"])
    stated = {"file": "rig.json", "sigma_mm": 0.2, "sigma_deg": 0.05}
    (folder / "p.yaml").write_text(json.dumps({"gtcal_priors": 1, "rig": stated}))
    return folder / "p.yaml"


@pytest.mark.parametrize("format_name", ["hot3d", "umetrack"])
def test_a_camera_file_says_where_cameras_are_to_each_other(format_name: str, tmp_path: Path) -> None:
    camera_T_ref = simulated(HEADSET).truth.camera_T_ref
    priors = read_priors(rig_file(tmp_path, format_name)).camera_a_T_camera_b
    first, *others = camera_T_ref
    assert list(priors) == [(first, other) for other in others]
    for (a, b), prior in priors.items():
        np.testing.assert_allclose(prior.a_T_b, camera_T_ref[a] @ inverse(camera_T_ref[b]), atol=1e-12)
        assert (prior.sigma_m, prior.sigma_rad) == ((0.0002,) * 3, pytest.approx(np.deg2rad([0.05] * 3).tolist()))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("rig.json", "no.json", "rig: .*no.json: there is no such file"),
        ('"rig.json"', '"rig.json", "format": "kalibr"', r"rig: .*rig.json: is \[.* expected named fields"),
        ('"sigma_mm": 0.2, ', "", "rig.sigma_mm: field required"),
        ('"sigma_mm": 0.2', '"sigma_mm": 0', "rig: sigma_m: .* no positive number"),
        (
            '"rig":',
            '"between_cameras": [{"camera": "front_left", "seen_from": "side_left", "position_mm": [0, 0, 0], '
            '"quat_wxyz": [1, 0, 0, 0], "sigma_deg": 0.1}], "rig":',
            "rig: it and between_cameras both relate 'front_left' to 'side_left'; keep one",
        ),
    ],
)
def test_a_wrong_rig_is_told_in_one_line(tmp_path: Path, before: str, after: str, message: str) -> None:
    path = rig_file(tmp_path, "hot3d")
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, 1))
    with pytest.raises(GtcalError, match=message) as caught:
        read_priors(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_the_guides_file_is_read_and_a_rigs_file_is_used(tmp_path: Path) -> None:
    rig_file(tmp_path, "hot3d")
    text = block("priors", "yaml").replace("factory_rig.json", "rig.json").replace("cam0", "front_left")
    (tmp_path / "p.yaml").write_text(text)
    found = read_priors(tmp_path / "p.yaml")
    assert found.body_T_board.sigma_m == (0.002,) * 3
    assert len(found.camera_a_T_camera_b) == 3
    surely = {
        pair: replace(prior, sigma_m=(1e-5,) * 3, sigma_rad=(1e-5,) * 3)
        for pair, prior in found.camera_a_T_camera_b.items()
    }
    observations = synchronise(simulated(HEADSET, frames=12, mocap=MocapNoise(0.5, 0.05)).recording)
    without, with_rig = (
        calibrate_observations(observations, CalibrationOptions(priors=priors, mocap="exact"))
        for priors in (Priors(), Priors(camera_a_T_camera_b=surely))
    )
    truth = simulated(HEADSET).truth.camera_T_ref
    apart_mm = [
        pose_errors(
            result.cameras["side_left"].camera_T_ref.a_T_b @ inverse(result.cameras["side_right"].camera_T_ref.a_T_b),
            truth["side_left"] @ inverse(truth["side_right"]),
        )[0]
        for result in (without, with_rig)
    ]
    assert apart_mm[1] < 0.5 * apart_mm[0]
