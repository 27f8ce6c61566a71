"""Chessboards and grids of dots: their laws, their pictures, their corners in images, and which way up they were."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from cli_support import run
from scipy.spatial.transform import Rotation

from factors import PINHOLE_RADTAN
from factors.rigid import inverse
from gtcal.board import Board, board_from_manifest
from gtcal.camera import Camera, FloatArray
from gtcal.detection.plain_guess import PlainGuess, guess_plain_board
from gtcal.detection.view_detection import see_board
from gtcal.drawing import board_texture, draw_board
from gtcal.errors import GtcalError
from gtcal.estimation.observations import board_turns, synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.told_apart import told_apart
from gtcal.overview.draft import draft
from gtcal.overview.survey import survey
from gtcal.plain_boards import Chessboard, DotGrid
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import GreyImage, numbered_folder
from gtcal.recordings.recording import Recording
from gtcal.results.calibration_file import read_calibration
from gtcal.simulation import SimulationOptions, simulate
from gtcal.simulation.ground_truth import read_ground_truth

BOARDS: dict[Board, int] = {
    Chessboard(9, 6, 0.04): 1,
    Chessboard(8, 6, 0.04): 2,
    Chessboard(9, 7, 0.04): 2,
    Chessboard(8, 8, 0.04): 2,
    Chessboard(7, 7, 0.04): 4,
    DotGrid(10, 10, 0.0254): 4,
    DotGrid(7, 5, 0.04): 2,
    DotGrid(4, 11, 0.06, asymmetric=True): 1,
    DotGrid(4, 10, 0.06, asymmetric=True): 2,
}


@pytest.mark.parametrize(("board", "n_turns"), BOARDS.items(), ids=lambda value: str(value)[:40])
def test_the_turns_are_those_after_which_the_print_is_the_same(board: Board, n_turns: int) -> None:
    assert board_from_manifest(board.to_manifest()) == board
    assert len(board.turns) == n_turns
    image = board_texture(board, texels_per_module=8, margin_m=0.0).image
    same = [k for k in range(4) if np.rot90(image, k).shape == image.shape and _alike(np.rot90(image, k), image)]
    assert len(same) == n_turns
    for turned, pose in zip(board.turns, board_turns(board), strict=True):
        np.testing.assert_allclose(board.corners_m @ pose[:3, :3].T + pose[:3, 3], board.corners_m[turned], atol=1e-12)


def _alike(one: GreyImage, other: GreyImage) -> bool:
    return float(np.mean(np.abs(one.astype(float) - other))) < 20.0


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"type": "chessboard", "square_columns": 9, "square_rows": 6, "square_side_m": 40}, "40 mm is 0.04 m"),
        ({"type": "chessboard", "square_columns": 3, "square_rows": 6, "square_side_m": 0.04}, "expected 4 or more"),
        ({"type": "dot_grid", "dot_columns": 4, "dot_rows": 11}, "lacks dot_pitch_m"),
        (
            {"type": "dot_grid", "dot_columns": 4, "dot_rows": 11, "dot_pitch_m": 0.04, "dot_diameter_m": 0.05},
            "expected less than the 0.04 m between two dots",
        ),
    ],
)
def test_boards_that_can_not_be(block: dict, message: str) -> None:
    with pytest.raises(GtcalError, match=message):
        board_from_manifest(block)


def test_dots_are_drawn_round(tmp_path: Path) -> None:
    board = DotGrid(4, 5, 0.03, asymmetric=True, dot_diameter_m=0.012)
    sheet = draw_board(board, tmp_path / "dots.png", dpi=254)
    image = cv2.imread(str(tmp_path / "dots.png"), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    x_m, y_m, r_m = (board.discs_m[7] + [*sheet.board_origin_m, 0.0]).tolist()
    x, y, r = round(1e4 * x_m), round(image.shape[0] - 1e4 * y_m), round(1e4 * r_m)
    piece = 255.0 - image[y - r - 5 : y + r + 5, x - r - 5 : x + r + 5]
    assert piece.sum() / 255.0 == pytest.approx(np.pi * (1e4 * r_m) ** 2, rel=0.01)
    for suffix in ("pdf", "svg"):
        draw_board(board, tmp_path / f"dots.{suffix}")
    assert (tmp_path / "dots.svg").read_text().count("<circle") == board.n_corners


CAMERA = Camera("cam0", PINHOLE_RADTAN, np.array([600.0, 600, 319.5, 239.5, -0.1, 0.02, 0, 0, 0]), 640, 480)


@lru_cache
def _picture(board: Board, turn_deg: float) -> GreyImage:
    """By the board's raster and the lens, with what a lens blurs and a sensor adds."""
    texture = board_texture(board, texels_per_module=16, margin_m=0.75 * board.pitch_m)
    over, middle = 2, 0.5
    x, y = np.meshgrid(np.arange(640 * over), np.arange(480 * over))
    pixels = (np.stack([x, y], axis=2).reshape(-1, 2) - middle) / over
    bearings, _ = CAMERA.unproject(pixels)
    board_T_camera = inverse(_pose(board, turn_deg))
    rays = bearings @ board_T_camera[:3, :3].T
    at = board_T_camera[:3, 3] - rays * (board_T_camera[2, 3] / rays[:, 2])[:, None]
    texels = texture.texels_of(at).astype(np.float32).reshape(480 * over, 640 * over, 2)
    fine = cv2.remap(texture.image, texels, None, cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=(150,))
    image = cv2.GaussianBlur(fine.astype(np.float32), (0, 0), 0.6 * over)
    image = image.reshape(480, over, 640, over).mean(axis=(1, 3)) * 0.7 + 30.0
    return np.rint(image + np.random.default_rng(0).normal(0, 1.0, image.shape)).clip(0, 255).astype(np.uint8)


def _pose(board: Board, turn_deg: float) -> FloatArray:
    T = np.eye(4)
    seen = Rotation.from_euler("zxy", [turn_deg, 25.0, -20.0], degrees=True)
    T[:3, :3] = seen.as_matrix() @ np.diag([1.0, -1.0, -1.0])  # its face towards the camera
    T[:3, 3] = np.array([0.01, -0.02, 0.9]) - T[:3, :3] @ board.corners_m.mean(axis=0)
    return T


@pytest.mark.long
@pytest.mark.parametrize(
    ("board", "limit_px"),
    [
        (Chessboard(9, 6, 0.03), 0.03),
        (Chessboard(8, 8, 0.03), 0.03),
        (DotGrid(8, 6, 0.03), 0.05),
        (DotGrid(4, 9, 0.06, asymmetric=True), 0.05),
    ],
    ids=["chessboard", "square chessboard", "dots", "asymmetric dots"],
)
@pytest.mark.parametrize("turn_deg", [10.0, 190.0])
@pytest.mark.parametrize("camera", [CAMERA, None], ids=["lens known", "unknown"])
def test_corners_are_found_where_they_are(
    board: Board, limit_px: float, turn_deg: float, camera: Camera | None
) -> None:
    T = _pose(board, turn_deg)
    seen = see_board(_picture(board, turn_deg), board, camera)
    assert len(seen.corner_ids) == board.n_corners
    exact_px, _ = CAMERA.project(board.corners_m @ T[:3, :3].T + T[:3, 3])
    off_px = [np.sqrt(np.mean((seen.corners_px - exact_px[turn[seen.corner_ids]]) ** 2)) for turn in board.turns]
    assert min(off_px) < limit_px


def test_another_board_is_not_taken_for_it() -> None:
    image = _picture(Chessboard(9, 6, 0.03), 10.0)
    assert not len(see_board(image, Chessboard(8, 6, 0.03)).corner_ids)
    assert not len(see_board(image, DotGrid(8, 6, 0.03)).corner_ids)
    assert not len(see_board(np.full((480, 640), 128, dtype=np.uint8), Chessboard(9, 6, 0.03)).corner_ids)


@pytest.mark.parametrize(
    ("board", "expected"),
    [
        (Chessboard(9, 6, 0.03), PlainGuess("chessboard", 9, 6, asymmetric=False)),
        (DotGrid(8, 6, 0.03), PlainGuess("dot_grid", 8, 6, asymmetric=False)),
    ],
    ids=["chessboard", "dots"],
)
def test_init_counts_squares_and_dots(board: Board, expected: PlainGuess, tmp_path: Path) -> None:
    (tmp_path / "cam0").mkdir()
    for number in range(2):
        cv2.imwrite(str(tmp_path / "cam0" / f"frame_{number}.png"), _picture(board, 10.0))
    assert guess_plain_board(numbered_folder(tmp_path / "cam0")) == expected
    (tmp_path / "wrist.txt").write_text("\n".join(["1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"] * 2) + "\n")
    fields = yaml.safe_load(draft(survey(tmp_path), tmp_path / "recording.yaml").text)
    assert fields["numbered"] is True
    assert fields["board"]["type"] == expected.kind
    assert fields["platform"] == {"trajectory": "wrist.txt", "format": "pose_list", "length_unit": "QUESTION"}
    assert "image_list" not in fields["cameras"]["cam0"]


def _turned_at_random(recording: Recording, seed: int) -> Recording:
    """The recording as a detector would have found it, which can't tell which way up the print was."""
    rng, turns = np.random.default_rng(seed), recording.board.turns

    def scrambled(found: CameraDetections) -> CameraDetections:
        of_view = rng.integers(len(turns), size=found.n_views)
        return replace(found, corner_ids=turns[of_view[found.view_of_corner], found.corner_ids])

    return replace(recording, detections={name: scrambled(found) for name, found in recording.detections.items()})


@pytest.mark.parametrize("board", [DotGrid(10, 10, 0.05), Chessboard(8, 6, 0.06)], ids=["four ways", "two ways"])
def test_the_chain_tells_which_way_up_every_view_was(board: Board) -> None:
    simulation = simulate(SimulationOptions(board=board, n_frames=30), seed=3)
    scrambled = _turned_at_random(simulation.recording, 1)
    found = told_apart(synchronise(scrambled), CalibrationOptions())
    common = set()
    for name, views in found.views.items():
        true_ids = synchronise(simulation.recording).views[name].corner_ids
        common |= {k for k, turn in enumerate(board.turns) if np.mean(turn[true_ids] == views.corner_ids) > 0.95} or {
            -1
        }
    assert len(common) == 1
    assert -1 not in common  # one and the same turn of the board's frame, for all views of all cameras
    again = told_apart(synchronise(_turned_at_random(simulation.recording, 2)), CalibrationOptions())
    for name, views in found.views.items():  # whatever the detector made of it
        assert np.mean(again.views[name].corner_ids == views.corner_ids) > 0.95


@pytest.mark.long
@pytest.mark.parametrize(("preset", "lengths"), [("chessboard", ["square_side_m"]), ("dots", ["dot_pitch_m"])])
def test_from_images_to_a_calibration_by_what_init_drafts(preset: str, lengths: list[str], tmp_path: Path) -> None:
    """What the images and files don't say is answered by the truth; then calibrated, examined and shown."""
    folder = tmp_path / "recording"
    made = ["--board", preset, "--rig", "fixed", "--images", "--frames", "120", "--image-scale", "0.5", "--seed", "3"]
    assert run("simulate", "-o", folder, *made, "-q").code == 0
    true = yaml.safe_load((folder / "recording.yaml").read_text())
    (folder / "recording.yaml").unlink()
    assert run("init", folder).code == 0
    drafted = yaml.safe_load((folder / "recording.yaml").read_text())
    counts = {name: value for name, value in true["board"].items() if name.endswith(("columns", "rows"))}
    assert {drafted["board"][name] for name in counts} == set(counts.values())
    drafted["board"] |= {name: true["board"][name] for name in (*lengths, *counts)}
    for name, camera in drafted["cameras"].items():
        camera["model"] = true["cameras"][name]["model"]
    (folder / "recording.yaml").write_text(yaml.safe_dump(drafted))
    report = tmp_path / "report.html"
    ran = run("calibrate", folder, "-o", tmp_path / "calibration.json", "--report", report, "-q")
    assert (ran.code, ran.err) == (0, "")
    calibration, truth = read_calibration(tmp_path / "calibration.json"), read_ground_truth(folder)
    for name, camera in calibration.cameras.items():
        apart = inverse(camera.camera_T_ref.a_T_b) - inverse(truth.camera_T_ref[name])
        assert np.linalg.norm(apart[:3, 3]) < 5e-4
    assert report.stat().st_size > 100_000
    assert run("doctor", folder, "-q").code == 0
