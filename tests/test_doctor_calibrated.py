"""What the doctor tells of a recording that is read rightly: what moved, what was mistaken, what is not as stated; and
of one of the Lollypop, by a calibration."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from calibration_support import simulated
from doctor_support import poses, theta
from scipy.spatial.transform import Rotation

from gtcal import Recording, calibrate
from gtcal.doctor.diagnose import diagnose_recording
from gtcal.doctor.lollypop import diagnose_lollypop
from gtcal.effects.turned import turned_views
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop

PLAIN = CalibrationOptions(effects=False)


def mistaken(recording: Recording, body: str, axis: list[float], deg: float, share: float = 0.2) -> Recording:
    """Where this share of the body's poses is turned about its own axis, in four stretches."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(np.deg2rad(deg) * np.array(axis)).as_matrix()

    def change(world_T_body: np.ndarray) -> np.ndarray:
        at = np.linspace(0.0, 4.0, len(world_T_body), endpoint=False) % 1.0 < share
        return np.where(at[:, None, None], world_T_body @ turn, world_T_body)

    return poses(recording, [body], change)


def slipped(recording: Recording, body: str, mm: float) -> Recording:
    """Whose markers move along the body's x, halfway."""

    def change(world_T_body: np.ndarray) -> np.ndarray:
        moved = world_T_body.copy()
        half = len(moved) // 2
        moved[half:, :3, 3] += 1e-3 * mm * moved[half:, :3, 0]
        return moved

    return poses(recording, [body], change)


@pytest.mark.parametrize(
    ("body", "axis", "deg"), [("board_body", [0.0, 0.0, 1.0], 180.0), ("platform", [0.0, 1.0, 0.0], 90.0)]
)
def test_a_body_that_was_mistaken_is_named_with_its_turn(body: str, axis: list[float], deg: float) -> None:
    simulation = simulated()
    observations = synchronise(mistaken(simulation.recording, body, axis, deg))
    calibration = calibrate(mistaken(simulation.recording, body, axis, deg), PLAIN)
    assert calibration.solution is not None
    found = turned_views(observations, calibration.estimate, calibration.solution.views)
    assert found is not None
    assert (found.body, found.turn_deg) == (body, deg)
    np.testing.assert_allclose(np.abs(found.axis), axis, atol=0.05)
    left_out = sum(views.n_views for views in observations.views.values()) - sum(
        views.n_views for views in calibration.solution.views.values()
    )
    assert 0.9 * left_out <= found.n_views <= left_out


def test_poses_that_are_wrong_in_another_way_are_no_mistaken_body() -> None:
    recording = simulated().recording
    rng = np.random.default_rng(0)

    def scatter(world_T_body: np.ndarray) -> np.ndarray:
        wrong = world_T_body.copy()
        at = rng.random(len(wrong)) < 0.2
        wrong[at, :3, :3] = Rotation.random(int(at.sum()), rng=rng).as_matrix()
        return wrong

    spoilt = poses(recording, ["board_body"], scatter)
    calibration = calibrate(spoilt, PLAIN)
    assert calibration.solution is not None
    observations = synchronise(spoilt)
    assert turned_views(observations, calibration.estimate, calibration.solution.views) is None


def test_poses_that_are_wrong_at_one_moment_are_no_mistaken_body() -> None:
    simulation = simulated()
    recording = simulation.recording
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, np.pi]).as_matrix()
    seen = np.concatenate([views.stamps_ns for views in synchronise(recording).views.values()])
    stamps_ns, counts = np.unique(seen, return_counts=True)
    moment_ns = int(stamps_ns[counts.argmax()])
    assert counts.max() >= 3  # cameras, which all see it turned

    assert recording.board_body is not None
    near = np.abs(recording.board_body.stamps_ns - moment_ns) < 50_000_000

    def change(world_T_body: np.ndarray) -> np.ndarray:
        return np.where(near[:, None, None], world_T_body @ turn, world_T_body)

    spoilt = poses(recording, ["board_body"], change)
    calibration = calibrate(spoilt, PLAIN)
    assert calibration.solution is not None
    observations = synchronise(spoilt)
    left_out = sum(views.n_views for views in observations.views.values()) - sum(
        views.n_views for views in calibration.solution.views.values()
    )
    assert left_out >= 3
    assert turned_views(observations, calibration.estimate, calibration.solution.views) is None


def test_calibrate_warns_of_a_mistaken_body_and_the_doctor_explains_it() -> None:
    recording = mistaken(simulated().recording, "board_body", [1.0, 0.0, 0.0], 180.0)
    assert any("turned by 180 deg about its axis" in line for line in calibrate(recording).warnings)
    found = diagnose_recording(recording)
    assert [finding.fault for finding in found.findings] == ["mistaken body"]
    assert found.unexplained is None
    assert found.misfit_mm is not None
    assert found.misfit_mm < 1.0


def test_markers_that_moved_are_a_finding() -> None:
    found = diagnose_recording(slipped(simulated().recording, "board_body", 5.0))
    (finding,) = found.findings
    assert finding.fault == "board_body markers moved"
    assert 4.8 < float(re.search(r"by ([\d.]+) mm", finding.says)[1]) < 5.2
    assert finding.before is not None
    assert finding.after is not None
    assert finding.after < 0.5 * finding.before


@pytest.mark.long
def test_without_intrinsics_too_what_moved_is_a_finding() -> None:
    recording = slipped(simulated(frames=80).recording, "board_body", 5.0)
    bare = {name: replace(camera, parameters=None) for name, camera in recording.cameras.items()}
    found = diagnose_recording(replace(recording, cameras=bare))
    assert [finding.fault for finding in found.findings] == ["board_body markers moved"]
    assert not any("no calibration" in note for note in found.notes)


@pytest.mark.long
def test_a_third_of_wrong_poses_is_explained_where_no_reading_does() -> None:
    recording = simulated().recording

    def away(world_T_body: np.ndarray) -> np.ndarray:
        moved = world_T_body.copy()
        moved[np.linspace(0.0, 6.0, len(moved), endpoint=False) % 1.0 < 0.35, :3, 3] += 0.23
        return moved

    found = diagnose_recording(poses(recording, ["board_body"], away))
    assert [finding.fault for finding in found.findings] == ["gross views"]
    assert found.unexplained is None
    assert found.misfit_mm is not None
    assert found.misfit_mm < 1.0


@pytest.mark.long
def test_a_lens_far_from_what_is_stated_is_a_finding() -> None:
    recording = simulated().recording
    found = diagnose_recording(
        theta(recording, lambda values: values * np.append([1.02, 1.02], np.ones(len(values) - 2)))
    )
    assert "intrinsics" in {finding.fault for finding in found.findings}


@pytest.mark.long
def test_a_lens_far_from_what_is_stated_is_a_finding_beside_one_that_is_not_stated() -> None:
    recording = simulated(frames=80).recording
    off = theta(recording, lambda values: values * np.append([1.02, 1.02], np.ones(len(values) - 2)))
    name = next(iter(off.cameras))
    mixed = replace(off, cameras=off.cameras | {name: replace(off.cameras[name], parameters=None)})
    found = diagnose_recording(mixed)
    (finding,) = [finding for finding in found.findings if finding.fault == "intrinsics"]
    assert f"'{name}'" not in finding.says
    assert not any("no calibration" in note for note in found.notes)


@pytest.fixture(scope="module", name="device")
def _device() -> LollypopOptions:
    simulation = simulated()
    return LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene, n_frames=100)


def test_a_lollypop_is_judged_by_a_calibration(device: LollypopOptions) -> None:
    simulation = simulate_lollypop(device, seed=2)
    right = simulation.true_calibration()
    found = diagnose_lollypop(simulation.recording, right)
    assert found.healthy
    assert found.misfit_mm is not None
    assert found.misfit_mm < 2.0
    swapped = replace(
        simulation.recording,
        platform=replace(simulation.recording.device_body, body="platform"),
        device_body=replace(simulation.recording.platform, body="device_body"),
    )
    (finding,) = diagnose_lollypop(swapped, right).findings
    assert finding.fault == "swapped bodies"
    assert "device_body" in finding.fixes[0]


def test_a_lollypop_without_time_in_common_is_one_line(device: LollypopOptions) -> None:
    simulation = simulate_lollypop(device, seed=2)
    late = replace(
        simulation.recording.device_body, stamps_ns=simulation.recording.device_body.stamps_ns + 3_600_000_000_000
    )
    found = diagnose_lollypop(replace(simulation.recording, device_body=late), simulation.true_calibration())
    assert found.findings == ()
    assert found.unexplained is not None
    assert "share no time" in found.unexplained
