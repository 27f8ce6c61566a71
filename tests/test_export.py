"""Exports, read by the libraries they are for: the same points at the same pixels."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from calibration_support import simulated

from gtcal import calibrate_observations, synchronise
from gtcal.camera_files.export import export_calibration
from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.estimation.options import CalibrationOptions
from gtcal.results.calibration_file import write_calibration


@cache
def calibrated(kind="pinholes and fisheyes fixed"):
    recording = simulated(kind, frames=30).recording
    return calibrate_observations(synchronise(recording), CalibrationOptions(mocap="exact"))


def points_in(camera):
    """Points in the camera frame within its image."""
    width, height = camera.image_width_px, camera.image_height_px
    pixels = np.random.default_rng(1).uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height], (40, 2))
    bearings, valid = camera.unproject(pixels)
    assert valid.all()
    return 2.0 * bearings


def opencv_pixels(points, K, D, fisheye):
    if fisheye:
        return cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, D.reshape(4))[0][:, 0]
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, D)[0][:, 0]


def test_opencv_reads_its_file_and_projects_to_the_same_pixels(tmp_path):
    result = calibrated()
    export_calibration(result, tmp_path / "rig.yaml", "opencv")
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    for i, calibration in enumerate(result.cameras.values()):
        node, camera = storage.getNode(f"cam{i}"), calibration.camera
        assert node.getNode("name").string() == camera.name
        K, D = node.getNode("camera_matrix").mat(), node.getNode("distortion_coefficients").mat()
        points = points_in(camera)
        found = opencv_pixels(points, K, D, bool(node.getNode("fisheye").real()))
        np.testing.assert_allclose(found, camera.project(points)[0], atol=1e-6)
        np.testing.assert_array_equal(node.getNode("camera_T_ref").mat(), calibration.camera_T_ref.a_T_b)


def test_numpy_loses_nothing(tmp_path):
    result = calibrated("headset, board tracked")
    export_calibration(result, tmp_path / "rig.npz", "numpy")
    with np.load(tmp_path / "rig.npz") as file:
        for i, name in enumerate(file["names"]):
            np.testing.assert_array_equal(file[f"theta_{name}"], result.cameras[str(name)].camera.theta)
            np.testing.assert_array_equal(file["camera_T_ref"][i], result.cameras[str(name)].camera_T_ref.a_T_b)


def test_a_lens_that_the_format_lacks_is_refused_with_its_loss(tmp_path):
    result = calibrated("headset, board tracked")
    with pytest.raises(GtcalError, match=r"can't express fisheye62 .* px rms"):
        export_calibration(result, tmp_path / "rig.yaml", "opencv")
    assert not list(tmp_path.iterdir())


def test_the_nearest_lens_is_as_near_as_it_says(tmp_path):
    result = calibrated("headset, board tracked")
    export_calibration(result, tmp_path / "rig.yaml", "opencv", nearest=True)
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    for i, calibration in enumerate(result.cameras.values()):
        node, points = storage.getNode(f"cam{i}"), points_in(calibration.camera)
        K, D = node.getNode("camera_matrix").mat(), node.getNode("distortion_coefficients").mat()
        off = np.linalg.norm(opencv_pixels(points, K, D, True) - calibration.camera.project(points)[0], axis=1)
        assert 0.0 < off.max() <= 1.05 * node.getNode("lens_off_at_most_px").real()


def test_kalibrs_chain_leads_back_to_every_camera(tmp_path):
    yaml = pytest.importorskip("yaml")
    result = calibrated("headset, board tracked")
    write_calibration(result, tmp_path / "calibration.json")
    arguments = [str(tmp_path / "calibration.json"), "--to", "kalibr", "-o", str(tmp_path / "chain.yaml"), "--nearest"]
    assert main(["export", *arguments]) == 0
    chain = yaml.safe_load((tmp_path / "chain.yaml").read_text())
    camera_T_ref = None
    for i, calibration in enumerate(result.cameras.values()):
        entry = chain[f"cam{i}"]
        step = np.array(entry["camera_T_ref"] if i == 0 else entry["T_cn_cnm1"])
        camera_T_ref = step if camera_T_ref is None else step @ camera_T_ref
        np.testing.assert_allclose(camera_T_ref, calibration.camera_T_ref.a_T_b, atol=1e-9)
        assert entry["distortion_model"] == "equidistant"
