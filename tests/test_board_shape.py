"""A board that is larger than stated, bowed or twisted: solved for near what is known of it, and sized."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import systematic
from calibration_support import simulated

from factors.board_shape import N_SHAPE, SHAPE_NAMES, outline_of, shaped
from factors.rigid import inverse
from gtcal.board import PAPER_A2, board_manifest_schema, load_board
from gtcal.board_tolerance import BoardTolerance, tolerance_of, with_tolerance_schema
from gtcal.cli.tables import print_calibration
from gtcal.errors import GtcalError
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import calibrate_observations
from gtcal.results.calibration import Calibration
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import MocapNoise

NOISE = MocapNoise(translation_mm=0.2, rotation_deg=0.02)
BOW_MM, SCALE_PERCENT = 1.0, 0.2


@cache
def found(what: str, board: str = "auto") -> tuple[Calibration, float]:
    """The calibration of a recording with a board that is bowed or larger, and how far its cameras are off, in mm."""
    simulation = simulated(seed=5, frames=60, mocap=NOISE)
    recording = {
        "flat": lambda: simulation.recording,
        "bowed": lambda: systematic.bow(simulation, BOW_MM),
        "larger": lambda: systematic.scale(simulation, SCALE_PERCENT),
        "bent": lambda: systematic.bow(simulation, 8.0),
    }[what]()
    calibration = calibrate_observations(synchronise(recording), CalibrationOptions(board=board))  # type: ignore[arg-type]
    errors_mm = [
        1e3
        * np.linalg.norm(
            inverse(camera.camera_T_ref.a_T_b)[:3, 3] - inverse(simulation.truth.camera_T_ref[name])[:3, 3]
        )
        for name, camera in calibration.cameras.items()
    ]
    return calibration, float(np.mean(errors_mm))


@pytest.mark.long
@pytest.mark.parametrize(
    ("what", "part", "value"), [("bowed", 2, BOW_MM), ("larger", 0, SCALE_PERCENT), ("flat", 3, 0)]
)
def test_a_board_that_is_not_as_stated_is_sized_and_does_not_matter(what: str, part: int, value: float) -> None:
    calibration, error_mm = found(what)
    assert calibration.board_shape is not None
    parts = list(calibration.board_shape.parts)
    for index, one in enumerate(parts):
        assert one.value == pytest.approx(value if index == part else 0.0, abs=4.0 * one.sigma)
        assert one.sigma < 0.2 * one.stated_sigma
    assert error_mm < 1.3 * found("flat")[1]
    assert not calibration.warnings


@pytest.mark.long
@pytest.mark.parametrize("what", ["bowed", "larger"])
def test_taken_as_flat_it_matters(what: str) -> None:
    calibration, error_mm = found(what, "exact")
    assert calibration.board_shape is None
    assert error_mm > 3.0 * found(what)[1]


def test_a_shape_that_nobody_expected_is_warned_of() -> None:
    calibration, _ = found("bent")
    (warning,) = (line for line in calibration.warnings if "not as it was expected" in line)
    assert "bow along x by 8 mm" in warning


def test_only_where_intrinsics_stay_near_what_is_known() -> None:
    """The paper's modes keep the plane."""
    solved = {mode: CalibrationOptions(intrinsics=mode).solves_board_shape for mode in ("exact", "fixed", "refine")}
    assert solved == {"exact": False, "fixed": False, "refine": False}
    assert CalibrationOptions().solves_board_shape


def test_it_is_shown_and_survives_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibration, _ = found("bowed")
    write_calibration(tmp_path / "calibration.json", calibration)
    again = read_calibration(tmp_path / "calibration.json")
    assert again.board_shape is not None
    np.testing.assert_array_equal(again.board_shape.shape, calibration.estimate.board_shape)
    np.testing.assert_array_equal(again.estimate.board_shape, calibration.estimate.board_shape)
    assert again.covariance is not None
    np.testing.assert_array_equal(again.covariance.board_shape, calibration.covariance.board_shape)
    print_calibration(again)
    assert "bow along x" in capsys.readouterr().out


def test_the_board_bends_as_its_numbers_say() -> None:
    corners_m = PAPER_A2.corners_m
    outline_m = outline_of(corners_m)
    moved = shaped(corners_m, outline_m, np.array([0.01, 0.002, 0.003, 0.0, 0.0])) - corners_m
    np.testing.assert_allclose(moved[:, :2], corners_m[:, :2] * [0.011, 0.009], atol=1e-15)
    at_edge = np.isclose(np.abs(corners_m[:, 0] - outline_m[0]), outline_m[2])
    np.testing.assert_allclose(moved[at_edge, 2], 0.0, atol=1e-12)
    assert moved[:, 2].max() == pytest.approx(0.003, rel=0.05)


def test_its_tolerance_is_read_from_the_board_block() -> None:
    rest, tolerance = tolerance_of({"preset": "paper_a2", "scale_sigma": 2e-4, "flatness_mm": 0.1})
    assert (rest, tolerance) == ({"preset": "paper_a2"}, BoardTolerance(2e-4, 0.1))
    sigmas = tolerance.shape_sigmas(outline_of(PAPER_A2.corners_m))
    np.testing.assert_allclose(sigmas, [2e-4, 2e-4, 1e-4, 1e-4, 1e-4])
    assert len(SHAPE_NAMES) == N_SHAPE == len(sigmas)


def test_a_manifest_that_states_it_gives_the_same_board(tmp_path: Path) -> None:
    """To every command that reads a board from a manifest, and in its schema."""
    (tmp_path / "recording.yaml").write_text("board: {preset: paper_a2, scale_sigma: 2.0e-4}\n")
    assert load_board(str(tmp_path / "recording.yaml")) == PAPER_A2
    schema = with_tolerance_schema(board_manifest_schema())
    assert all({"scale_sigma", "flatness_mm"} < set(one["properties"]) for one in schema["oneOf"])


@pytest.mark.parametrize("value", [0.0, -1, "0.1", True, float("nan"), float("inf")])
def test_a_tolerance_that_is_none_is_refused(value: object) -> None:
    with pytest.raises(GtcalError, match=r"flatness_mm: .* is not a positive number"):
        tolerance_of({"flatness_mm": value})
