"""The Lollypop in rendered images: read by the real detector, through the whole verification."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from factors.rigid import inverse
from gtcal import CalibrationOptions, calibrate, load_recording
from gtcal.camera import RollingShutter
from gtcal.cli import main
from gtcal.recordings.images import GreyImage
from gtcal.results.calibration_file import write_calibration
from gtcal.simulation import MocapNoise, SimulationOptions, quest3_like_rig, simulate, write_simulation
from gtcal.simulation.corners import CornerNoise
from gtcal.simulation.filming import Studio
from gtcal.simulation.lollypop import (
    LollypopOptions,
    LollypopSimulation,
    others_of,
    simulate_lollypop,
    write_lollypop_simulation,
)
from gtcal.simulation.rendering import Lens
from gtcal.simulation.rig import Rig
from gtcal.simulation.transforms import apply
from gtcal.verification.lollypop import device_from_manifest
from gtcal.verification.lollypop_detection import see_lollypop
from gtcal.verification.lollypop_recording import load_lollypop_recording
from gtcal.verification.verification import Verdict, VerificationOptions
from gtcal.verification.verification_file import read_verification
from gtcal.verification.workflow import verify

DEVICE = LollypopOptions().device


@cache
def simulation() -> LollypopSimulation:
    return simulate_lollypop(LollypopOptions(duration_s=20.0), seed=6)


@cache
def studio_and_lens() -> tuple[Studio, Lens]:
    studio = Studio(simulation().world)
    return studio, studio.lens(0)


@cache
def shot(frame: int) -> GreyImage:
    """What the first camera takes."""
    studio, lens = studio_and_lens()
    return studio.take(lens, 0, frame)


def true_frames(camera_index: int, n: int) -> np.ndarray:
    """Frames in which a detector would read the tag, spread evenly."""
    name = simulation().options.rig.cameras[camera_index].name
    truth, detections = simulation().world.truth.cameras[name], simulation().recording.detections[name]
    frames = truth.frames_of(detections.stamps_ns)
    return frames[np.linspace(0, len(frames) - 1, n).astype(int)]


def test_the_homography_centre_of_a_rendered_tag_is_the_projected_one() -> None:
    """0.05 px on average over the field to 75 degrees is asked for; what is found is a third of that."""
    apart, field = [], []
    camera = simulation().options.rig.cameras[0]
    scene, times_s = simulation().world.scene, simulation().world.frame_times_s
    frames = true_frames(0, 12)
    for frame in frames.tolist():
        seen = see_lollypop(shot(frame), DEVICE, camera)
        if not len(seen.corner_ids):
            continue
        T = scene.camera_T_board(0, times_s[[frame]])[0] @ inverse(DEVICE.faces[0].body_T_board)
        in_camera = DEVICE.corners_m @ T[:3, :3].T + T[:3, 3]
        corners_px, _ = camera.project(in_camera)
        assert np.linalg.norm(seen.corners_px - corners_px[seen.corner_ids], axis=1).max() < 0.5
        found = np.cross(*[np.cross(*camera.unproject(seen.corners_px)[0][[i, i + 2]]) for i in (0, 1)])
        found *= np.sign(found @ T[:3, 3])
        centre_px, _ = camera.project(np.stack([found, T[:3, 3]]))
        apart.append(np.linalg.norm(centre_px[0] - centre_px[1]))
        field.append(np.rad2deg(np.arccos(T[2, 3] / np.linalg.norm(T[:3, 3]))))
    assert len(apart) >= 10
    assert max(field) > 55
    assert np.mean(apart) < 0.03
    assert max(apart) < 0.15


def test_nothing_is_seen_where_there_is_nothing_to_see() -> None:
    image = shot(int(true_frames(0, 12)[3]))
    assert len(see_lollypop(image, DEVICE, simulation().options.rig.cameras[0]).corner_ids) == 4
    other = device_from_manifest({"dictionary": "DICT_5X5_50", "tag_id": 7, "tag_side_m": 0.06})
    for wrong in (other, device_from_manifest({"dictionary": "DICT_6X6_250", "tag_id": 0, "tag_side_m": 0.06})):
        assert len(see_lollypop(image, wrong).corner_ids) == 0
    assert len(see_lollypop(np.full((480, 640), 90, dtype=np.uint8), DEVICE).corner_ids) == 0
    assert len(see_lollypop(np.ascontiguousarray(image[:, ::-1]), DEVICE).corner_ids) == 0


def test_rendered_images_verify_a_true_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Small images, 10 frames: detection is cached, and e_2D at full size would stay below 0.3 px."""
    options = LollypopOptions(rig=quest3_like_rig().scaled(0.5), duration_s=20.0, n_frames=10)
    small = simulate_lollypop(options, seed=6)
    write_lollypop_simulation(small, tmp_path / "lollypop", images=True)
    recording = load_lollypop_recording(tmp_path / "lollypop")
    assert recording.detections == {}
    found = verify(recording, small.true_calibration(), VerificationOptions(min_sightings=5, min_coverage=0.0))
    assert found.pooled_px.count > 10
    assert found.pooled_px.rmse < 0.15  # half the pixels: half of 0.3
    assert len(list((tmp_path / "lollypop" / ".gtcal").glob("*.npz"))) == 4
    assert {entry.path.name for entry in found.provenance.inputs} >= {"front_left", "recording.yaml"}
    write_calibration(tmp_path / "calibration.json", small.true_calibration())
    code = main(
        ["verify", str(tmp_path / "calibration.json"), str(tmp_path / "lollypop"), "-o", str(tmp_path / "v.json")]
    )
    assert code == 4  # ten frames decide nothing
    assert "sightings are too few" in " ".join(capsys.readouterr().out.split())
    np.testing.assert_allclose(read_verification(tmp_path / "v.json").pooled_px.rmse, found.pooled_px.rmse)


# Several faces, rolling shutters

FACES = [  # as two pages of a book that stands open, and one on its back
    {"tag_id": 0, "tag_side_m": 0.05, "centre_in_body_m": [-0.035, 0.0, 0.01], "quat_wxyz": [0.9659, 0, 0.2588, 0]},
    {"tag_id": 1, "tag_side_m": 0.05, "centre_in_body_m": [0.035, 0.0, 0.01], "quat_wxyz": [0.9659, 0, -0.2588, 0]},
    {"tag_id": 2, "tag_side_m": 0.05, "centre_in_body_m": [0.0, 0.0, -0.02], "quat_wxyz": [0, 0, 1, 0]},
]
SHUTTER = RollingShutter(0.016, "first")


def with_rolling_shutters(rig: Rig) -> Rig:
    return replace(rig, cameras=tuple(replace(camera, rolling_shutter=SHUTTER) for camera in rig.cameras))


@cache
def of_three_faces(n_frames: int) -> LollypopSimulation:
    device = device_from_manifest({"dictionary": "DICT_5X5_50", "faces": FACES})
    return simulate_lollypop(
        LollypopOptions(device=device, rig=quest3_like_rig().scaled(0.5), duration_s=20.0, n_frames=n_frames), seed=6
    )


def studio_of(simulation: LollypopSimulation) -> Studio:
    return Studio(simulation.world, others_of(simulation.options.device))


def test_all_faces_that_are_turned_to_a_camera_are_in_its_image_and_the_others_are_not() -> None:
    simulation = of_three_faces(40)
    device, camera = simulation.options.device, simulation.options.rig.cameras[0]
    detections, studio = simulation.recording.detections[camera.name], studio_of(simulation)
    lens = studio.lens(0)
    n_corners = np.diff(detections.view_start)
    seen_faces: set[int] = set()
    for view in np.argsort(-n_corners, kind="stable")[:4].tolist():
        (frame,) = simulation.world.truth.cameras[camera.name].frames_of(detections.stamps_ns[[view]])
        seen = see_lollypop(studio.take(lens, 0, int(frame)), device, camera)
        T = simulation.world.scene.camera_T_board(0, simulation.world.frame_times_s[[frame]])[0]
        T = T @ inverse(device.faces[0].body_T_board)
        exact_px, _ = camera.project(device.corners_m @ T[:3, :3].T + T[:3, 3])
        assert np.linalg.norm(seen.corners_px - exact_px[seen.corner_ids], axis=1).max() < 0.5
        seen_faces |= set(device.corner_faces[seen.corner_ids].tolist())
        assert not {0, 2} <= set(device.corner_faces[seen.corner_ids].tolist())  # one is on the other's back
    assert seen_faces >= {0, 1}


def test_a_rolling_shutter_bends_the_image_as_it_bends_the_simulated_corners() -> None:
    """Detected corners are where those of the simulation are, row by row, and not where one moment has them."""
    options = LollypopOptions(
        rig=with_rolling_shutters(quest3_like_rig().scaled(0.5)),
        duration_s=20.0,
        n_frames=40,
        corners=CornerNoise(pixel_px=0.0),
    )
    simulation = simulate_lollypop(options, seed=6)
    camera, studio = options.rig.cameras[0], Studio(simulation.world)
    lens, detections = studio.lens(0), simulation.recording.detections[options.rig.cameras[0].name]
    frames = simulation.world.truth.cameras[camera.name].frames_of(detections.stamps_ns)
    at_once = simulation.world.scene.camera_T_board(0, simulation.world.frame_times_s[frames])
    off, bent = [], []
    for view in range(0, detections.n_views, 3):
        seen = see_lollypop(studio.take(lens, 0, int(frames[view])), options.device, camera)
        rows = slice(*detections.view_start[view : view + 2])
        if len(seen.corner_ids) == 4 and len(detections.corner_ids[rows]) == 4:
            off.append(np.linalg.norm(seen.corners_px - detections.corners_px[rows], axis=1))
            still, _ = camera.project(apply(at_once[[view]], options.device.faces[0].board.corners_m)[0])
            bent.append(np.linalg.norm(still - detections.corners_px[rows], axis=1))
    assert len(off) >= 5
    assert np.median(off) < 0.06
    assert np.median(bent) > 10.0 * np.median(off)


@pytest.mark.long
def test_from_images_of_several_faces_to_the_verdict(tmp_path: Path) -> None:
    simulation = of_three_faces(60)
    write_lollypop_simulation(simulation, tmp_path / "images", images=True)
    options = VerificationOptions(min_sightings=20, min_coverage=0.0)
    found = verify(load_lollypop_recording(tmp_path / "images"), simulation.true_calibration(), options)
    assert found.pooled_px.count > 100
    assert found.pooled_px.rmse < 0.15
    assert found.verdict is Verdict.PASS
    assert not found.faults


@pytest.mark.long
def test_from_images_of_rolling_shutters_to_the_verdict(tmp_path: Path) -> None:
    """Board and Lollypop; with the shutter unsaid, the same images give a worse calibration."""
    rig = with_rolling_shutters(quest3_like_rig().scaled(0.5))
    board = simulate(SimulationOptions(rig=rig, n_frames=30, mocap=MocapNoise(0.05, 0.005)), seed=2)
    write_simulation(board, tmp_path / "board", images=True)
    recording = load_recording(tmp_path / "board")
    assert recording.cameras["front_left"].rolling_shutter == SHUTTER
    options = CalibrationOptions(effects=False, clock="trust")
    calibration = calibrate(recording, options)
    device = LollypopOptions(rig=rig, calibrated_in=board.scene, duration_s=20.0, n_frames=60)
    write_lollypop_simulation(simulate_lollypop(device, seed=3), tmp_path / "lollypop", images=True)
    limits = VerificationOptions(min_sightings=15, min_coverage=0.0)
    found = verify(load_lollypop_recording(tmp_path / "lollypop"), calibration, limits)
    assert found.verdict is Verdict.PASS
    assert found.pooled_px.rmse < 0.2
    unsaid = {name: replace(camera, rolling_shutter=None) for name, camera in recording.cameras.items()}
    worse = calibrate(replace(recording, cameras=unsaid), options)
    assert worse.rmse_px > 2.0 * calibration.rmse_px
