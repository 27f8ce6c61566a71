from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factors import FISHEYE62
from gtcal.board import ArucoGrid
from gtcal.camera import Camera
from gtcal.estimation.pnp import _turn_to
from gtcal.simulation import quest3_like_rig
from gtcal.verification.face_centres import face_centres
from gtcal.verification.lollypop import Face

TAG = Face(ArucoGrid("DICT_5X5_50", 1, 1, 0.06, 0.015))
GRID = Face(ArucoGrid("DICT_5X5_50", 2, 3, 0.03, 0.01))


def poses(n: int, seed: int, off_axis_deg: float) -> np.ndarray:
    """(N, 4, 4) camera_T_face up to so far off the axis, tilted up to 60 degrees."""
    random = np.random.default_rng(seed)
    off, around = np.deg2rad(off_axis_deg) * np.sqrt(random.random(n)), random.uniform(-np.pi, np.pi, n)
    sight = np.stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)], axis=1)
    T = np.tile(np.eye(4), (n, 1, 1))
    for i in range(n):
        to_camera = _turn_to(-sight[i]).T  # its z looks back at the camera
        azimuth, tilt = random.uniform(-np.pi, np.pi), np.deg2rad(60) * random.random()
        turn = Rotation.from_rotvec(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
        T[i, :3, :3] = to_camera @ turn.as_matrix() @ Rotation.from_euler("z", random.uniform(-3, 3)).as_matrix()
    T[:, :3, 3] = sight * random.uniform(0.3, 1.0, (n, 1))
    return T


def bearings_of(face: Face, camera_T_face: np.ndarray) -> np.ndarray:
    """(N C, 3) unit bearings of the corners."""
    points = np.einsum("nij,cj->nci", camera_T_face[:, :3, :3], face.corners_in_face_m) + camera_T_face[:, None, :3, 3]
    flat = points.reshape(-1, 3)
    return np.asarray(flat / np.linalg.norm(flat, axis=1, keepdims=True))


@pytest.mark.parametrize("face", [TAG, GRID])
@pytest.mark.parametrize("off_axis_deg", [30.0, 100.0])
def test_exact_corners_give_the_centre_and_the_normal(face: Face, off_axis_deg: float) -> None:
    T = poses(200, 1, off_axis_deg)
    n = face.board.n_corners
    found = face_centres(bearings_of(face, T), np.tile(face.corners_in_face_m, (200, 1)), np.arange(201) * n)
    assert found.ok.all()
    np.testing.assert_allclose(found.centre_in_camera_m, T[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(found.normal_in_camera, T[:, :3, 2], atol=1e-7)
    true = np.arccos(-(T[:, :3, 2] * T[:, :3, 3]).sum(axis=1) / np.linalg.norm(T[:, :3, 3], axis=1))
    np.testing.assert_allclose(found.viewing_angle_rad, true, atol=1e-6)


def test_with_noise_it_is_opencvs_homography_in_a_virtual_camera_turned_to_the_tag() -> None:
    T = poses(50, 2, 85.0)
    noise = 2e-4 * np.random.default_rng(3).standard_normal((200, 3))
    bearings = bearings_of(TAG, T) + noise
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    found = face_centres(bearings, np.tile(TAG.corners_in_face_m, (50, 1)), np.arange(51) * 4)
    square = (TAG.corners_in_face_m[:, :2] / 0.03).astype(np.float32)
    for i in range(50):
        b = bearings[4 * i : 4 * i + 4]
        virtual_R_camera = _turn_to(b.mean(axis=0))
        turned = b @ virtual_R_camera.T
        H = cv2.getPerspectiveTransform(square, (turned[:, :2] / turned[:, 2:]).astype(np.float32))
        centre = virtual_R_camera.T @ np.array([H[0, 2], H[1, 2], H[2, 2]])
        mine = found.centre_in_camera_m[i] / np.linalg.norm(found.centre_in_camera_m[i])
        np.testing.assert_allclose(mine, centre / np.linalg.norm(centre), atol=2e-6)


def test_four_corners_and_least_squares_agree() -> None:
    """Faces with four corners of a larger grid go both ways: alone by the closed form, with a repeated corner by the
    other."""
    T = poses(30, 4, 80.0)
    b = bearings_of(TAG, T).reshape(30, 4, 3)
    corners = np.tile(TAG.corners_in_face_m, (30, 1, 1))
    four = face_centres(b.reshape(-1, 3), corners.reshape(-1, 3), np.arange(31) * 4)
    five = face_centres(
        np.concatenate([b, b[:, :1]], axis=1).reshape(-1, 3),
        np.concatenate([corners, corners[:, :1]], axis=1).reshape(-1, 3),
        np.arange(31) * 5,
    )
    np.testing.assert_allclose(five.centre_in_camera_m, four.centre_in_camera_m, atol=1e-9)


def test_a_mirrored_or_folded_tag_is_no_face() -> None:
    T = poses(2, 5, 30.0)
    b = bearings_of(TAG, T).reshape(2, 4, 3)
    mirrored, folded = b[0, [1, 0, 3, 2]], b[1, [1, 0, 2, 3]]
    found = face_centres(
        np.concatenate([mirrored, folded]), np.tile(TAG.corners_in_face_m, (2, 1)), np.array([0, 4, 8])
    )
    assert not found.ok[0]
    assert np.isnan(found.centre_in_camera_m[0]).all()
    good = face_centres(b.reshape(-1, 3), np.tile(TAG.corners_in_face_m, (2, 1)), np.array([0, 4, 8]))
    assert good.ok.all()


def test_through_a_fisheye_beyond_80_degrees() -> None:
    camera: Camera = quest3_like_rig().cameras[0]
    assert camera.model is FISHEYE62
    T = poses(300, 6, 84.0)
    pixels, valid = camera.project(bearings_of(TAG, T))
    valid = valid.reshape(-1, 4).all(axis=1)
    assert valid.sum() > 200
    bearings, _ = camera.unproject(pixels.reshape(-1, 4, 2)[valid].reshape(-1, 2))
    n = int(valid.sum())
    found = face_centres(bearings, np.tile(TAG.corners_in_face_m, (n, 1)), np.arange(n + 1) * 4)
    seen_px, _ = camera.project(found.centre_in_camera_m)
    true_px, _ = camera.project(T[valid, :3, 3])
    np.testing.assert_allclose(seen_px, true_px, atol=1e-5)
