"""The Lollypop in rendered images: read by the real detector, through the whole verification."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from factors.rigid import inverse
from gtcal.cli import main
from gtcal.errors import GtcalError
from gtcal.recordings.images import GreyImage
from gtcal.results.calibration_file import write_calibration
from gtcal.simulation import quest3_like_rig
from gtcal.simulation.filming import Studio
from gtcal.simulation.lollypop import (
    LollypopOptions,
    LollypopSimulation,
    simulate_lollypop,
    write_lollypop_simulation,
)
from gtcal.simulation.rendering import Lens
from gtcal.verification.lollypop import device_from_manifest
from gtcal.verification.lollypop_detection import see_lollypop
from gtcal.verification.lollypop_recording import load_lollypop_recording
from gtcal.verification.verification import VerificationOptions
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


def test_images_of_several_faces_are_refused(tmp_path: Path) -> None:
    faces = [{"tag_id": i, "tag_side_m": 0.05, "centre_in_body_m": [0.06 * i, 0, 0]} for i in range(2)]
    device = device_from_manifest({"dictionary": "DICT_5X5_50", "faces": faces})
    several = simulate_lollypop(replace(LollypopOptions(), device=device, duration_s=2.0), seed=1)
    with pytest.raises(GtcalError, match="of devices with one face only"):
        write_lollypop_simulation(several, tmp_path / "images", images=True)
