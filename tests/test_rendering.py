"""Rendered images show the board where the camera model projects it, and look as a camera's do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from factors import CAMERA_MODELS, PINHOLE_RADTAN
from factors.rigid import inverse
from gtcal.board import PAPER_A2, AprilGrid, ArucoGrid, Board, CharucoBoard
from gtcal.camera import Camera
from gtcal.detection.detect import detect
from gtcal.recordings.capture import Capture
from gtcal.recordings.images import read_grey
from gtcal.recordings.recording import load_recording
from gtcal.simulation import (
    ImageOptions,
    Simulation,
    SimulationOptions,
    fixed_cameras_rig,
    quest3_like_rig,
    read_ground_truth,
    simulate,
    write_simulation,
)
from gtcal.simulation.backdrop import brightness_towards, room
from gtcal.simulation.filming import Studio
from gtcal.simulation.pattern import black_share_of_any, black_share_of_small, pattern_of
from gtcal.simulation.rendering import lens_of, plate_of, render, sub_exposures
from gtcal.simulation.transforms import apply

BOARDS = (PAPER_A2, AprilGrid(6, 6, 0.06, 0.3), CharucoBoard("DICT_5X5_100", 8, 6, 0.06, 0.045))
PLAIN = ImageOptions(
    subdivisions=4,
    blur_px=0.0,
    exposure_s=0.0,
    dark_noise_grey=0.0,
    light_noise_grey=0.0,
    vignetting_share=0.0,
    gradient_share=0.0,
    shade_share=0.0,
)
ROOM_GREY = 100.0
GREY_ROOM = np.full((16, 16), ROOM_GREY / PLAIN.white_grey, dtype=np.float32)


def plain_image(camera: Camera, board: Board, camera_T_board: np.ndarray, options: ImageOptions = PLAIN) -> np.ndarray:
    lens = lens_of(camera, options, np.random.default_rng(0))
    poses = camera_T_board if camera_T_board.ndim == 3 else camera_T_board[None]
    return render(lens, plate_of(board), GREY_ROOM, poses, np.eye(4), options, np.random.default_rng(0))


def views_of(simulation: Simulation, every: int) -> list[tuple[Camera, np.ndarray, np.ndarray]]:
    """Camera, camera_T_board and visible corner ids of some views of each camera."""
    views = []
    for index, (name, detections) in enumerate(simulation.recording.detections.items()):
        frames = simulation.truth.cameras[name].frames_of(detections.stamps_ns)
        poses = simulation.scene.camera_T_board(index, simulation.frame_times_s[frames])
        for view in range(0, detections.n_views, every):
            ids = detections.corner_ids[slice(*detections.view_start[view : view + 2])]
            views.append((simulation.options.rig.cameras[index], poses[view], ids))
    return views


# The print


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: type(board).__name__)
def test_the_black_share_of_a_rectangle_is_exact(board: Board) -> None:
    pattern, black = pattern_of(board), board.black_rectangles_m
    random = np.random.default_rng(0)
    x_min, y_min, x_max, y_max = board.bounds_m
    compared = 0
    for size_m in (1e-4, 2e-3, 0.02, 0.3):
        for _ in range(300):
            x0, y0 = random.uniform((x_min - 0.02, y_min - 0.02), (x_max, y_max))
            x1, y1 = np.array([x0, y0]) + size_m * random.uniform(0.1, 1.0, 2)
            width = np.clip(np.minimum(black[:, 2], x1) - np.maximum(black[:, 0], x0), 0, None)
            height = np.clip(np.minimum(black[:, 3], y1) - np.maximum(black[:, 1], y0), 0, None)
            expected = (width * height).sum() / ((x1 - x0) * (y1 - y0))
            assert black_share_of_any(pattern, x0, y0, x1, y1) == pytest.approx(expected, abs=1e-6)
            small = black_share_of_small(
                pattern.x_edges_m, pattern.y_edges_m, pattern.black, pattern.x_bins, pattern.y_bins, x0, y0, x1, y1
            )
            if small >= 0.0:
                compared += 1
                assert small == pytest.approx(expected, abs=1e-9)
    assert compared > 600


# Where things are in the image


def cast_rays(camera: Camera, board: Board, camera_T_board: np.ndarray, pixels_px: np.ndarray) -> np.ndarray:
    """Grey levels (N,) of ideal points of the image, ray by ray, from nothing but the camera model and the board."""
    bearings, valid = camera.unproject(pixels_px)
    board_T_camera = inverse(camera_T_board)
    rays = bearings @ board_T_camera[:3, :3].T
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = -board_T_camera[2, 3] / rays[:, 2]
        x, y = (board_T_camera[:2, 3, None] + distance * rays[:, :2].T).astype(float)
    x_min, y_min, x_max, y_max = plate_of(board).bounds_m
    on_plate = valid & (distance > 0) & (x > x_min) & (x < x_max) & (y > y_min) & (y < y_max)
    black = np.zeros(len(pixels_px), dtype=bool)
    for x0, y0, x1, y1 in board.black_rectangles_m:
        black |= (x > x0) & (x < x1) & (y > y0) & (y < y1)
    grey = np.where(black, PLAIN.black_grey, PLAIN.white_grey)
    return np.where(on_plate, grey, np.where(valid, ROOM_GREY, 0.0))


@pytest.mark.long
@pytest.mark.parametrize("model", list(CAMERA_MODELS))
def test_a_pixel_is_the_mean_over_its_square(model: str) -> None:
    """Against casting 14 x 14 rays through every pixel."""
    rig = fixed_cameras_rig(models=(model,)).scaled(0.1)
    simulation = simulate(
        SimulationOptions(
            rig=rig,
            board=ArucoGrid("DICT_4X4_50", 3, 2, 0.11, 0.055, corner_squares=True),
            capture=Capture.FIXED_CAMERAS,
            duration_s=20.0,
            n_frames=20,
            limits=replace(SimulationOptions().limits, min_feature_px=2.0),
        ),
        seed=1,
    )
    n = 14
    part_px = (np.arange(n) + 0.5) / n - 0.5
    camera, camera_T_board, _ = views_of(simulation, every=4)[0]
    columns, rows = np.meshgrid(np.arange(camera.image_width_px), np.arange(camera.image_height_px))
    total = np.zeros(columns.shape)
    for dy in part_px:
        for dx in part_px:
            pixels_px = np.stack([columns.ravel() + dx, rows.ravel() + dy], axis=1)
            total += cast_rays(camera, simulation.options.board, camera_T_board, pixels_px).reshape(total.shape)
    expected = total / n**2
    image = plain_image(camera, simulation.options.board, camera_T_board).astype(float)
    assert ((expected > 30) & (expected < 100)).sum() > 100
    # An eighth of a pixel of error would change the pixels of an edge by 24 grey levels.
    assert np.abs(image - expected).mean() < 0.6  # a quarter of a grey level is rounding
    assert np.abs(image - expected).max() < 12.0
    assert abs((image - expected).mean()) < 0.1


def test_edges_are_where_projection_says_to_a_thousandth_of_a_pixel() -> None:
    """A tag seen straight on: the dark part of a row of pixels, summed, is as long as the projected tag, and its
    middle is where the projected middle is. Half a pixel, or a shifted grid of sub-pixels, would show at once."""
    tag = ArucoGrid("DICT_4X4_50", 1, 1, 0.1, 0.05)
    theta = np.array([400.0, 410.0, 80.3, 61.7, 0.0, 0.0, 0.0, 0.0, 0.0])
    camera = Camera("straight", PINHOLE_RADTAN, theta, 160, 128)
    camera_T_board = np.diag([1.0, -1.0, -1.0, 1.0])
    camera_T_board[:3, 3] = [-0.0463, 0.0517, 0.5]
    image = plain_image(camera, tag, camera_T_board).astype(float)
    corners_px, _ = camera.project(apply(camera_T_board, tag.corners_m))
    left, top = corners_px.min(axis=0)
    right, bottom = corners_px.max(axis=0)
    darkness = (PLAIN.white_grey - image) / (PLAIN.white_grey - PLAIN.black_grey)
    border_row = darkness[round(top) + 5, round(left) - 6 : round(right) + 7]  # in the tag's black border
    border_column = darkness[round(top) - 6 : round(bottom) + 7, round(left) + 5]
    columns = np.arange(round(left) - 6, round(right) + 7)
    rows = np.arange(round(top) - 6, round(bottom) + 7)
    for dark, places, low, high in ((border_row, columns, left, right), (border_column, rows, top, bottom)):
        assert dark.sum() == pytest.approx(high - low, abs=0.006)  # 8-bit rounding of two edge pixels
        assert dark @ places / dark.sum() == pytest.approx((low + high) / 2, abs=0.003)


@pytest.mark.long
@pytest.mark.parametrize("capture", [Capture.TRACKED_PLATFORM, Capture.FIXED_CAMERAS])
def test_saddles_are_where_projection_says(capture: Capture) -> None:
    """Corners found by the gradient method of OpenCV, which shares nothing with the renderer."""
    rig = quest3_like_rig() if capture is Capture.TRACKED_PLATFORM else fixed_cameras_rig()
    simulation = simulate(SimulationOptions(rig=rig, capture=capture, duration_s=20.0, n_frames=20), seed=3)
    options = replace(PLAIN, blur_px=0.7)
    errors_px = []
    for camera, camera_T_board, ids in views_of(simulation, every=9):
        image = plain_image(camera, PAPER_A2, camera_T_board, options)
        expected_px, _ = camera.project(apply(camera_T_board, PAPER_A2.corners_m[ids]))
        start_px = expected_px.astype(np.float32)[:, None].copy()
        found_px = cv2.cornerSubPix(image, start_px, (3, 3), (-1, -1), (3, 50, 1e-4))[:, 0]
        errors_px.append(found_px - expected_px)
    errors = np.concatenate(errors_px)
    assert len(errors) > 300
    np.testing.assert_allclose(np.median(errors, axis=0), 0.0, atol=0.003)
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.035  # the method's own error on curved, slanted edges


def test_a_few_parts_per_pixel_are_enough() -> None:
    simulation = simulate(SimulationOptions(duration_s=10.0, n_frames=5), seed=2)
    camera, camera_T_board, _ = views_of(simulation, every=2)[0]
    fine = plain_image(camera, PAPER_A2, camera_T_board, replace(PLAIN, subdivisions=12)).astype(float)
    usual = plain_image(camera, PAPER_A2, camera_T_board, replace(PLAIN, subdivisions=ImageOptions().subdivisions))
    assert fine.std() > 20
    assert np.abs(usual - fine).max() <= 20  # single pixels, where the board is seen edge-on
    assert np.mean(np.abs(usual - fine) > 4) < 0.001


def test_the_back_of_the_board_shows_no_print() -> None:
    camera = quest3_like_rig().scaled(0.25).cameras[0]
    front = np.diag([1.0, -1.0, -1.0, 1.0])
    back = np.diag([-1.0, -1.0, 1.0, 1.0])
    for pose, n_greys in ((front, 10), (back, 0)):
        pose[:3, 3] = [0.0, 0.0, 0.5] - pose[:3, :3] @ PAPER_A2.corners_m.mean(axis=0)
        image = plain_image(camera, PAPER_A2, pose)
        middle = image[100:156, 130:190]
        assert (middle.min() == round(PLAIN.black_grey)) == (n_greys > 0)
        assert len(np.unique(middle)) >= n_greys
        assert n_greys or np.ptp(middle) == 0


# Motion, light, noise


def test_motion_blur_is_the_mean_over_the_exposure_around_the_time_stamp() -> None:
    simulation = simulate(SimulationOptions(rig=quest3_like_rig().scaled(0.5), duration_s=10.0, n_frames=30), seed=0)
    options = replace(PLAIN, exposure_s=0.02)
    plate = plate_of(PAPER_A2)
    name = "front_left"
    truth, detections = simulation.truth.cameras[name], simulation.recording.detections[name]
    times_s = simulation.frame_times_s[truth.frames_of(detections.stamps_ns)]
    ends = [simulation.scene.camera_T_board(0, t + np.array([-0.01, 0.01])) for t in times_s]
    counts = [sub_exposures(truth.camera, plate, pair) for pair in ends]
    fastest = int(np.argmax(counts))
    assert counts[fastest] >= 8
    assert sub_exposures(truth.camera, plate, ends[fastest][[0, 0]]) == 1

    filmed = simulate(replace(simulation.options, images=options), seed=0)
    studio = Studio(replace(filmed, options=replace(filmed.options, images=options)))
    frame = int(truth.frames_of(detections.stamps_ns[fastest : fastest + 1])[0])
    blurred = studio.take(studio.lens(0), 0, frame).astype(float)
    moments_s = times_s[fastest] + 0.02 * ((np.arange(40) + 0.5) / 40 - 0.5)
    still = replace(options, exposure_s=0.0)
    lens = lens_of(truth.camera, still, np.random.default_rng(0))
    world = inverse(filmed.scene.world_T_camera(0, times_s[fastest : fastest + 1]))[0]
    sharp = [
        render(
            lens,
            plate,
            studio.room,
            filmed.scene.camera_T_board(0, np.array([t])),
            world,
            still,
            np.random.default_rng(0),
        )
        for t in moments_s
    ]
    assert np.abs(blurred - np.mean(sharp, axis=0)).mean() < 0.5
    assert np.abs(blurred - sharp[0]).mean() > 2.0


def test_blur_keeps_the_light_and_softens_the_edges() -> None:
    simulation = simulate(SimulationOptions(duration_s=10.0, n_frames=5), seed=2)
    camera, camera_T_board, _ = views_of(simulation, every=2)[0]
    sharp = plain_image(camera, PAPER_A2, camera_T_board).astype(float)
    soft = plain_image(camera, PAPER_A2, camera_T_board, replace(PLAIN, blur_px=0.6)).astype(float)
    expected = gaussian_filter(sharp, 0.6)
    assert np.abs(soft - expected).max() <= 2.0
    assert np.abs(np.diff(soft, axis=1)).max() < 0.75 * np.abs(np.diff(sharp, axis=1)).max()


def test_noise_has_the_sigma_asked_for_in_the_dark_and_in_the_light() -> None:
    camera = quest3_like_rig().scaled(0.25).cameras[0]
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0.0, 0.0, 0.5] - pose[:3, :3] @ PAPER_A2.corners_m.mean(axis=0)
    options = replace(PLAIN, dark_noise_grey=2.0, light_noise_grey=4.0, white_grey=180.0)
    lens, plate = lens_of(camera, options, np.random.default_rng(0)), plate_of(PAPER_A2)
    images = np.stack(
        [render(lens, plate, GREY_ROOM, pose[None], np.eye(4), options, np.random.default_rng(i)) for i in range(100)]
    ).astype(float)
    spread, mean = images.std(axis=0), images.mean(axis=0)
    for grey in (options.black_grey, ROOM_GREY / PLAIN.white_grey * options.white_grey, options.white_grey):
        alike = np.abs(mean - grey) < 1.0
        assert alike.sum() > 50
        expected = np.sqrt(2.0**2 + 4.0**2 * grey / options.white_grey + 1 / 12)
        assert np.median(spread[alike]) == pytest.approx(expected, rel=0.03)


def test_light_falls_off_to_a_dark_rim_and_the_room_turns_with_the_camera() -> None:
    camera = quest3_like_rig().scaled(0.25).cameras[0]
    options = replace(PLAIN, vignetting_share=0.4, gradient_share=0.2)
    lens = lens_of(camera, options, np.random.default_rng(0))
    _, valid = camera.unproject(np.array([[0.0, 0.0]]))
    assert not valid[0]
    assert lens.light[0, 0] == 0.0
    assert lens.light[128, 160] == pytest.approx(1.0, abs=0.02)
    assert lens.light.max() > 1.02
    inside = lens.light[lens.light > 0]
    assert inside.min() < 0.75

    picture = room(np.random.default_rng(3))
    assert 0.05 <= picture.min() < 0.3 < 0.45 < picture.max() <= 0.8
    directions = np.random.default_rng(0).standard_normal((200, 3))
    seen = np.array([brightness_towards(picture, *d) for d in directions])
    nearby = np.array([brightness_towards(picture, *d) for d in directions + 1e-3])
    assert seen.std() > 0.05
    assert np.abs(nearby - seen).max() < 0.05  # smooth, also across the seams of the map


# On disk


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Simulation, Path]:
    options = SimulationOptions(rig=quest3_like_rig().scaled(0.5), duration_s=10.0, n_frames=6)
    simulation = simulate(options, seed=5)
    folder = tmp_path_factory.mktemp("filmed") / "recording"
    seen: list[tuple[str, int, int]] = []
    write_simulation(simulation, folder, images=True, progress=lambda *step: seen.append(step))
    assert seen == [("rendering images", done, 24) for done in range(1, 25)]
    return simulation, folder


def test_images_are_written_by_camera_and_time_stamp(filmed: tuple[Simulation, Path]) -> None:
    simulation, folder = filmed
    recording = load_recording(folder)
    assert recording.detections == {}
    for name, truth in simulation.truth.cameras.items():
        np.testing.assert_array_equal(recording.images[name].stamps_ns, truth.stamps_ns)
        assert recording.images[name].paths[0] == folder / "images" / name / f"{truth.stamps_ns[0]}.png"
        image = recording.images[name].read(0)
        assert image.shape == (512, 640)
        assert 15 < image.std() < 120
    assert len(read_ground_truth(folder).cameras["side_left"].wrong_corners) == 0


def test_a_seed_renders_the_same_images_byte_for_byte(filmed: tuple[Simulation, Path], tmp_path: Path) -> None:
    simulation, folder = filmed
    write_simulation(simulate(simulation.options, seed=5), tmp_path / "again", images=True)
    for path in folder.rglob("*"):
        if path.is_file():
            assert (tmp_path / "again" / path.relative_to(folder)).read_bytes() == path.read_bytes()
    other = Studio(simulate(simulation.options, seed=6))
    name = str(simulation.truth.cameras["front_left"].stamps_ns[0])
    assert (read_grey(folder / "images" / "front_left" / f"{name}.png") != other.take(other.lens(0), 0, 0)).mean() > 0.5


def test_the_real_detector_reads_the_images(filmed: tuple[Simulation, Path]) -> None:
    """With all the blur and noise: most of the corners that the simulated detector claims, and where they are."""
    simulation, folder = filmed
    recording = load_recording(folder)
    errors_px, claimed = [], 0
    for name, camera in recording.cameras.items():
        found = detect(recording.images[name], recording.board, camera)
        truth = simulation.truth.cameras[name]
        frames = truth.frames_of(found.stamps_ns)
        poses = (truth.camera_T_ref @ truth.ref_T_body[frames] @ simulation.truth.body_T_board)[found.view_of_corner]
        corners_m = recording.board.corners_m[found.corner_ids]
        pixels, _ = camera.project(np.einsum("nij,nj->ni", poses[:, :3, :3], corners_m) + poses[:, :3, 3])
        errors_px.append(np.linalg.norm(found.corners_px - pixels, axis=1))
        claimed += simulation.recording.detections[name].n_corners
    errors = np.concatenate(errors_px)
    assert len(errors) > 0.8 * claimed
    assert np.median(errors) < 0.1
