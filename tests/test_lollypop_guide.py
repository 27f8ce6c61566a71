"""The Lollypop looked for where calibration and mocap expect it: the verdict is that of a search of all images."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gtcal.detection.corner_search import PredictedBoard
from gtcal.results.calibration import Calibration
from gtcal.simulation import quest3_like_rig
from gtcal.simulation.fault import small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification import lollypop_guide
from gtcal.verification.lollypop_detection import see_lollypop
from gtcal.verification.lollypop_guide import spread
from gtcal.verification.lollypop_recording import LollypopRecording, load_lollypop_recording
from gtcal.verification.verification import Verification, VerificationOptions
from gtcal.verification.workflow import verify

EXPECTED = VerificationOptions(images="expected", min_sightings=2, min_coverage=0.0)


@dataclass(frozen=True)
class Filmed:
    recording: LollypopRecording
    calibration: Calibration


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    """Of two cameras, ten images a second, so that all of them are among those that are looked at."""
    rig = quest3_like_rig().scaled(0.5)
    rig = replace(rig, cameras=rig.cameras[:2], rig_T_camera=rig.rig_T_camera[:2])
    simulation = simulate_lollypop(LollypopOptions(rig=rig, n_frames=60, duration_s=12.0), seed=5)
    manifest = write_lollypop_simulation(simulation, tmp_path_factory.mktemp("filmed") / "recording", images=True)
    return Filmed(load_lollypop_recording(manifest), simulation.true_calibration())


def test_images_are_chosen_ten_a_second() -> None:
    stamps_ns = np.arange(900) * 33_333_333
    assert np.array_equal(spread(stamps_ns), np.arange(0, 900, 3))
    assert np.array_equal(spread(stamps_ns[::6]), np.arange(150))
    assert spread(stamps_ns[:1]).tolist() == [0]


@pytest.mark.long
def test_corners_near_the_prediction_are_those_of_the_whole_image(filmed: Filmed) -> None:
    recording, n = filmed.recording, 0
    for name, calibrated in filmed.calibration.cameras.items():
        images, camera = recording.images[name], calibrated.camera
        poses = recording.motion.at(images.stamps_ns)
        for index in range(0, len(images), 6):
            image = images.read(index)
            camera_T_body = calibrated.camera_T_ref.a_T_b @ poses.ref_T_body[index]
            whole = see_lollypop(image, recording.device, camera)
            near = see_lollypop(image, recording.device, camera, PredictedBoard(camera, camera_T_body))
            if len(whole.corner_ids):
                n += 1
                assert np.array_equal(near.corner_ids, whole.corner_ids)
                assert np.abs(near.corners_px - whole.corners_px).max() < 0.02
    assert n > 3


def _verified(filmed: Filmed, calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> tuple[Verification, int]:
    """And how many images were looked at whole."""
    whole = []
    look_at = lollypop_guide.look_at

    def counted(images, indices, looking, *, predicted=None):  # type: ignore[no-untyped-def]
        whole.extend(indices if predicted is None else [])
        return look_at(images, indices, looking, predicted=predicted)

    monkeypatch.setattr(lollypop_guide, "look_at", counted)
    return verify(filmed.recording, calibration, EXPECTED), len(whole)


@pytest.mark.long
def test_the_verification_is_that_of_all_images(filmed: Filmed, monkeypatch: pytest.MonkeyPatch) -> None:
    found, n_whole = _verified(filmed, filmed.calibration, monkeypatch)
    searched = verify(filmed.recording, filmed.calibration, replace(EXPECTED, images="all"))
    assert n_whole <= 24
    assert found.pooled_px.count > 0.9 * searched.pooled_px.count > 10
    assert found.pooled_px.rmse == pytest.approx(searched.pooled_px.rmse, rel=0.1)
    assert found.verdict == searched.verdict
    assert set(found.recording.images) == set(filmed.recording.images)  # type: ignore[union-attr]


@pytest.mark.long
def test_a_calibration_that_is_far_off_is_found_to_be_so(filmed: Filmed, monkeypatch: pytest.MonkeyPatch) -> None:
    name, turned = next(iter(filmed.calibration.cameras)), small_motion((0.0, 0.0, 0.0), (0.0, 15.0, 0.0))
    camera = filmed.calibration.cameras[name]
    pose = replace(camera.camera_T_ref, a_T_b=turned @ camera.camera_T_ref.a_T_b)
    assert filmed.recording.path is not None
    shutil.rmtree(filmed.recording.path.parent / ".gtcal", ignore_errors=True)  # what the search of all of them found
    cameras = filmed.calibration.cameras | {name: replace(camera, camera_T_ref=pose)}
    found, n_whole = _verified(filmed, replace(filmed.calibration, cameras=cameras), monkeypatch)
    assert n_whole > 24
    assert found.cameras[name].n_sightings > 5
    assert found.cameras[name].px.rmse > 20.0
    assert found.verdict == "fail"
