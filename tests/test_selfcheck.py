"""The self-checks: silent on true calibrations, loud where something moved, and the error in its right place."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from cli_support import run

from gtcal import CalibrationOptions, GtcalError, load_recording, selfcheck, synchronise, write_selfcheck
from gtcal.estimation.observations import Observations
from gtcal.estimation.residuals import select_views
from gtcal.estimation.solver import calibrate_observations
from gtcal.recordings.capture import Capture
from gtcal.selfchecks.folds import DEFAULT
from gtcal.selfchecks.halves import split_half
from gtcal.selfchecks.selfcheck import SelfCheck, check_observations
from gtcal.selfchecks.time_blocks import only_frames, time_blocks
from gtcal.simulation import CornerNoise, MocapNoise, write_simulation

NOISY = MocapNoise(translation_mm=0.2, rotation_deg=0.02)


def observed(seed: int, **changes: object) -> Observations:
    return synchronise(simulated(HEADSET, seed=seed, frames=80, mocap=NOISY, **changes).recording)


def checked(observations: Observations, n_folds: int = 3) -> SelfCheck:
    return check_observations(observations, CalibrationOptions(), n_folds=n_folds)


@pytest.fixture(scope="module", name="found")
def _found() -> list[SelfCheck]:
    return [checked(observed(seed)) for seed in range(2)]


@pytest.mark.long
def test_halves_of_a_good_recording_agree(found: list[SelfCheck]) -> None:
    per_dof = np.array([check.halves.overall.per_dof for check in found])
    assert 0.5 < per_dof.mean() < 1.6
    assert all(check.halves.agrees and "they agree" in check.halves.statement for check in found)
    assert {difference.what for difference in found[0].halves.by_unknown} > {"board", "side_left"}
    assert found[0].halves.overall.dof == 6 + 4 * (6 + 12)


@pytest.mark.long
def test_a_camera_that_moved_half_way_is_told() -> None:
    observations = observed(0)
    later = time_blocks(observations, 2) == 1
    views = observations.views["side_left"]
    shifted = views.corners_px + np.where(later[views.frame_index[views.view_of_corner]], 2.0, 0.0)[:, None]
    moved = replace(observations, views=observations.views | {"side_left": replace(views, corners_px=shifted)})
    check = checked(moved)
    assert not check.halves.agrees
    assert "side_left most: something moved or drifted" in check.halves.statement


@pytest.mark.long
def test_every_frame_is_held_out_once_and_the_default_is_the_best(found: list[SelfCheck]) -> None:
    for check in found:
        by_stage = {hold_out.stage: hold_out for hold_out in check.hold_outs}
        assert set(by_stage) == {DEFAULT, 3, 4}
        best = min(by_stage[3].rmse_px, by_stage[4].rmse_px)
        assert by_stage[DEFAULT].rmse_px < 1.02 * best
        assert by_stage[DEFAULT].rmse_px > check.calibration.rmse_px * 0.95
    spread = {s: np.mean([list(c.hold_outs[s].spread_mm.values()) for c in found]) for s in (1, 2)}
    assert spread[2] < 0.8 * spread[1]  # stage 4's positions vary less than stage 3's


@pytest.mark.long
def test_the_error_is_found_where_it_is(found: list[SelfCheck]) -> None:
    for camera in found[0].cameras:
        assert camera.pnp_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
        assert camera.mocap_px > 1.5 * camera.pnp_px
        assert "of the mocap" in camera.statement
    blurred = checked(synchronise(simulated(HEADSET, corners=CornerNoise(pixel_px=1.0), frames=80).recording))
    assert all("lens model and detector" in camera.statement for camera in blurred.cameras)


def test_blocks_of_time_are_whole_and_in_order() -> None:
    observations = observed(0)
    blocks = time_blocks(observations, 7)
    assert (np.diff(blocks) >= 0).all()
    assert np.ptp(np.bincount(blocks)) <= 1
    with pytest.raises(GtcalError, match="can't be cut into 1000 blocks"):
        time_blocks(observations, 1000)
    with pytest.raises(GtcalError, match="in a part of the recording only"):
        only_frames(observations, np.zeros(observations.n_frames, dtype=bool))
    with pytest.raises(GtcalError, match="n_folds: 1 is less than 2"):
        check_observations(observations, CalibrationOptions(), n_folds=1)


@pytest.mark.long
def test_halves_that_determine_nothing_are_a_note() -> None:
    observations = observed(0)
    late = np.arange(observations.n_frames) >= 0.52 * observations.n_frames
    views = observations.views["side_left"]
    only_late = select_views(views, np.flatnonzero(late[views.frame_index]))
    check = checked(replace(observations, views=observations.views | {"side_left": only_late}))
    assert check.halves is None
    assert "no split-half check" in check.notes[0]


@pytest.mark.long
def test_a_block_without_which_there_is_no_calibration_is_named_and_the_others_count() -> None:
    observations = observed(0)
    views = observations.views["side_left"]
    in_the_first = select_views(views, np.flatnonzero(time_blocks(observations, 3)[views.frame_index] == 0))
    check = checked(replace(observations, views=observations.views | {"side_left": in_the_first}))
    (of_halves, failed) = check.notes
    assert "no split-half check" in of_halves
    assert failed.startswith("block 1 of 3 (0.00 to ")
    assert "the rest of the recording gives no calibration: camera 'side_left'" in failed
    default = check.hold_outs[0]
    assert list(default.by_block_px) == [1, 2]
    assert default.rmse_px < 1.5 * check.calibration.rmse_px
    assert np.isnan(default.by_camera_px["side_left"])


@pytest.mark.long
def test_a_block_that_the_others_do_not_predict_is_named() -> None:
    observations = observed(1)
    last = time_blocks(observations, 5) == 4
    moved = {
        name: replace(views, corners_px=views.corners_px + 3.0 * last[views.frame_index][views.view_of_corner][:, None])
        for name, views in observations.views.items()
    }
    check = checked(replace(observations, views=moved), n_folds=5)
    assert [note[:12] for note in check.notes] == ["block 5 of 5"]
    assert "something differs in that time" in check.notes[0]


@pytest.mark.long
def test_halves_are_judged_by_the_covariance_of_the_whole_recording(found: list[SelfCheck]) -> None:
    whole = found[0].calibration
    halves = time_blocks(observed(0), 2)
    first, second = (
        calibrate_observations(only_frames(observed(0), halves == half), CalibrationOptions()) for half in range(2)
    )
    by_own, by_whole = split_half(first, second).overall, split_half(first, second, whole).overall
    assert by_whole.per_dof == pytest.approx(by_own.per_dof, rel=0.3)
    confident = replace(first, covariances={k: c.times(1e-2) for k, c in first.covariances.items()})
    sure = replace(second, covariances={k: c.times(1e-2) for k, c in second.covariances.items()})
    assert split_half(confident, sure).overall.per_dof == pytest.approx(100.0 * by_own.per_dof)
    assert split_half(confident, sure, whole).overall.per_dof == pytest.approx(by_whole.per_dof)


@pytest.mark.long
def test_the_command_prints_and_writes_it(tmp_path: Path) -> None:
    write_simulation(simulated(HEADSET, frames=80, mocap=NOISY), tmp_path / "recording", images=False)
    ran = run("selfcheck", tmp_path / "recording", "-o", tmp_path / "s.json", "--folds", "3")
    assert (ran.code, ran.err) == (0, "")
    for words in ("first half of the recording against the second", "3 blocks of time", "they agree", "of the mocap"):
        assert words in ran.out
    document = json.loads((tmp_path / "s.json").read_text())
    assert [row["estimate"] for row in document["hold_out"]] == ["as taken", "stage 3", "stage 4"]
    assert document["split_half"]["agrees"] is True
    assert document["provenance"]["inputs"]


@pytest.mark.long
@pytest.mark.parametrize("capture", [Capture.TRACKED_PLATFORM, Capture.STANDING_BOARD])
def test_on_the_real_recording_the_default_is_within_two_percent_of_the_best(
    vicon_recording: Callable[..., Path], capture: Capture, tmp_path: Path
) -> None:
    check = selfcheck(load_recording(vicon_recording(capture)), CalibrationOptions(intrinsics="calibrate"))
    default, *by_stage = check.hold_outs
    assert [hold_out.stage for hold_out in by_stage] == [3, 4]
    assert default.rmse_px <= 1.02 * min(hold_out.rmse_px for hold_out in by_stage)
    assert all(0.0 < hold_out.spread_mm["cam0"] < 100.0 for hold_out in check.hold_outs)
    write_selfcheck(tmp_path / "s.json", check)
    assert "cam0" in (tmp_path / "s.json").read_text()
