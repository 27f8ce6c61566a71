"""Results at a prompt and in a notebook: their tables, pages, dictionaries, data frames and figures."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import gtcal
from gtcal.baselines.compare import Compared
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop


@dataclass(frozen=True)
class Results:
    calibration: gtcal.Calibration
    verification: gtcal.Verification
    drift: gtcal.Drift
    difference: gtcal.Difference


@pytest.fixture(scope="module", name="results")
def _results() -> Results:
    simulation = simulated(HEADSET)
    options = gtcal.CalibrationOptions(intrinsics="exact", mocap="exact", effects=False)
    calibration = gtcal.calibrate(simulation.recording, options)
    device = simulate_lollypop(LollypopOptions(n_frames=60, calibrated_in=simulation.scene), seed=1).recording
    verification = gtcal.verify(device, calibration)
    drift = gtcal.verify_series([("monday", device)], calibration)
    return Results(calibration, verification, drift, gtcal.difference(calibration, calibration))


EACH = pytest.mark.parametrize("which", ["calibration", "verification", "drift", "difference"])


@EACH
def test_it_prints_as_the_terminals_table(results: Results, which: str) -> None:
    shown = repr(getattr(results, which))
    assert str(getattr(results, which)) == shown
    assert len(shown) < 8_000
    assert "array(" not in shown
    words = {"calibration": "reprojection residuals, px", "verification": "RMSE px", "difference": "± mm"}
    assert words.get(which, "monday") in shown
    names = results.calibration.cameras if which != "drift" else results.drift.cameras
    assert all(name in shown for name in names)


@pytest.mark.long
@EACH
def test_its_html_holds_no_markup_of_the_results_own(results: Results, which: str) -> None:
    page = getattr(results, which)._repr_html_()
    frame = page.startswith("<iframe srcdoc=")
    assert frame is (which in ("calibration", "verification"))  # the report's page, which styles nothing around it
    assert page.count("<") <= 3
    if frame:
        assert "&lt;html" in page or "&lt;!doctype html" in page.lower()


@EACH
def test_its_dictionary_is_json(results: Results, which: str) -> None:
    result = getattr(results, which)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False)) == result.to_dict()


def test_the_dictionary_of_a_calibration_is_its_file(results: Results, tmp_path: Path) -> None:
    gtcal.write_calibration(tmp_path / "c.json", results.calibration)
    assert json.loads((tmp_path / "c.json").read_text()) == json.loads(json.dumps(results.calibration.to_dict()))
    read = gtcal.read_calibration(tmp_path / "c.json")
    assert repr(read) == repr(results.calibration)


def test_data_frames_hold_the_numbers(results: Results) -> None:
    pandas = pytest.importorskip("pandas")
    frame = results.calibration.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.index) == list(results.calibration.cameras)
    for name, camera in results.calibration.cameras.items():
        row = frame.loc[name]
        position_mm = row[["x_mm", "y_mm", "z_mm"]].astype(float)
        np.testing.assert_allclose(position_mm, 1e3 * camera.camera_T_ref.position_of_a_in_b_m)
        assert row["rmse_px"] == camera.residuals.rmse_px
        assert row["fx"] == camera.camera.theta[0]
    verified = results.verification.to_pandas()
    for name, camera in results.verification.cameras.items():
        assert (verified.loc[name, "rmse_px"], verified.loc[name, "verdict"]) == (camera.px.rmse, camera.verdict)
    assert list(results.drift.to_pandas().index) == ["monday"] * len(results.drift.cameras)
    assert len(results.difference.to_pandas()) == len(results.difference.changes)


@pytest.mark.long
def test_figures_are_matplotlibs_and_can_be_saved(results: Results) -> None:
    calibration, verification = results.calibration, results.verification
    for figure in (
        calibration.plot_cameras(),
        calibration.plot_residuals("side_left"),
        calibration.plot_residuals_over_time("side_left"),
        calibration.plot_uncertainty("side_left", distance_m=0.7),
        calibration.plot_volume_uncertainty(),
        verification.plot_heat_maps(),
        verification.plot_errors_over_time("side_left"),
    ):
        assert isinstance(figure, Figure)
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=30)
        assert len(file.getvalue()) > 2_000


def test_what_there_is_no_figure_of_is_said_in_a_line(results: Results, tmp_path: Path) -> None:
    gtcal.write_calibration(tmp_path / "c.json", results.calibration)
    read = gtcal.read_calibration(tmp_path / "c.json")
    with pytest.raises(gtcal.GtcalError, match="read from a file, which holds no residuals"):
        read.plot_residuals("side_left")
    with pytest.raises(gtcal.GtcalError, match="there is no camera 'left'; cameras: front_left"):
        results.calibration.plot_uncertainty("left")


def test_every_public_name_is_in_the_packages_help() -> None:
    assert gtcal.__doc__ is not None
    assert not [name for name in gtcal.__all__ if name not in gtcal.__doc__]
    assert set(gtcal.__all__) <= set(dir(gtcal))


def other_results(calibration: gtcal.Calibration) -> dict[str, tuple[object, str, int]]:
    """Of a diagnosis, a comparison and a calibration from poses: the result, what it shows, how many rows it has."""
    finding = gtcal.Finding("units", "m are mm", ("platform.length_unit: mm",), ("check it",), "misfit", 9.0, 0.1, "mm")
    failed = Compared("Park-Martin", None, float("nan"), None, float("nan"), float("nan"), 0.1, "too few poses")
    joint = Compared("joint", calibration, 0.1, None, 0.0, 0.0, 1.0, sigma_mm=0.04, sigma_deg=0.004)
    random = np.random.default_rng(0)
    X, Y, A = (Rotation.random(n, rng=random) for n in (None, None, 12))
    poses = np.tile(np.eye(4), (2, 12, 1, 1))
    poses[0, :, :3, :3], poses[1, :, :3, :3] = A.as_matrix(), (Y * A * X).as_matrix()
    return {
        "diagnosis": (gtcal.Diagnosis((finding,), None, ("a note",), 0.1, 0.01), "platform.length_unit: mm", 1),
        "healthy": (gtcal.Diagnosis((), None, (), 0.1, 0.01), "nothing wrong found", 0),
        "comparison": (gtcal.Comparison((joint, failed)), "Park-Martin: too few poses", 2),
        "poses": (gtcal.calibrate_poses(*poses), "1-sigma", 1),
    }


def test_all_other_results_show_themselves_too(results: Results) -> None:
    pytest.importorskip("pandas")
    for name, (result, words, n_rows) in other_results(results.calibration).items():
        assert words in repr(result), name
        assert "array(" not in repr(result)
        assert words in result._repr_html_()
        assert json.loads(json.dumps(result.to_dict(), allow_nan=False)) == result.to_dict()
        assert len(result.to_pandas()) == n_rows


def test_a_comparison_is_gone_through_and_asked_by_name(results: Results, tmp_path: Path) -> None:
    comparison = other_results(results.calibration)["comparison"][0]
    assert isinstance(comparison, gtcal.Comparison)
    assert [row.method for row in comparison] == ["joint", "Park-Martin"]
    assert comparison.joint is results.calibration
    assert comparison["Park-Martin"].failure == "too few poses"
    with pytest.raises(gtcal.GtcalError, match="no method 'Shah'; methods: joint, Park-Martin"):
        comparison["Shah"]
    gtcal.write_comparison(tmp_path / "c.json", comparison)
    assert json.loads((tmp_path / "c.json").read_text()) == comparison.to_dict()
