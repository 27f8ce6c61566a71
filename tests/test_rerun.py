"""A file for rerun's viewer, read back: what is in it, when, and that the numbers are those of the results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_support import HEADSET, simulated

from factors.rigid import inverse
from gtcal import CalibrationOptions, GtcalError, calibrate, verify
from gtcal.cli import main
from gtcal.recordings.capture import Capture
from gtcal.report.rerun_file import ENLARGED, write_rerun
from gtcal.results.calibration_file import write_calibration
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop

chunks = pytest.importorskip("rerun.chunk")


class Black:
    """Black images of a camera at these times."""

    def __init__(self, stamps_ns: np.ndarray, shape: tuple[int, int]) -> None:
        self.stamps_ns, self.shape = stamps_ns, shape

    def read(self, index: int) -> np.ndarray:
        return np.zeros(self.shape, np.uint8)


def read_back(path: Path) -> dict[str, dict[str, list]]:
    """By entity and column, all values in order."""
    found: dict[str, dict[str, list]] = {}
    for chunk in chunks.RrdReader(path).stream().to_chunks():
        columns = found.setdefault(chunk.entity_path.lstrip("/"), {})
        batch = chunk.to_record_batch()
        for name, values in zip(batch.schema.names, batch.columns, strict=True):
            columns.setdefault(name, []).extend((values.cast("int64") if name == "time" else values).to_pylist())
    return found


@pytest.fixture(scope="module", name="seen")
def _seen(tmp_path_factory: pytest.TempPathFactory):
    simulation = simulated(HEADSET)
    calibration = calibrate(simulation.recording, CalibrationOptions(intrinsics="exact", mocap="exact", effects=False))
    device = simulate_lollypop(LollypopOptions(n_frames=30, calibrated_in=simulation.scene), seed=1)
    verification = verify(device.recording, calibration)
    name, camera = next(iter(simulation.recording.cameras.items()))
    stamps_ns = simulation.recording.detections[name].stamps_ns[:3]
    black = Black(stamps_ns, (camera.image_height_px, camera.image_width_px))
    recording = replace(simulation.recording, images={name: black})
    path = tmp_path_factory.mktemp("rerun") / "all.rrd"
    write_rerun(path, calibration, recording=recording, verification=verification)
    return simulation, (calibration, verification, name), read_back(path)


def column(entity: dict[str, list], ends: str) -> list:
    """The values of a component, rows without it left out."""
    (name,) = [name for name in entity if name.endswith(ends)]
    return [value for value in entity[name] if value is not None]


def test_the_cameras_are_where_they_were_calibrated(seen) -> None:
    _, (calibration, _, _), found = seen
    for name, camera in calibration.cameras.items():
        (position,) = column(found[f"ref/cameras/{name}"], ":translation")
        np.testing.assert_allclose(position[0], inverse(camera.camera_T_ref.a_T_b)[:3, 3], atol=1e-6)


def test_every_view_is_there_at_its_time_with_its_corners_and_residuals(seen) -> None:
    simulation, (calibration, _, _), found = seen
    for name, camera in calibration.cameras.items():
        views, entity = calibration.solution.views[name], f"ref/cameras/{name}/image"
        positions = column(found[f"{entity}/corners"], ":positions")
        assert len(positions) >= views.n_views
        assert set(views.stamps_ns.tolist()) <= set(found[f"{entity}/corners"]["time"])
        arrows = [arrow for row in column(found[f"{entity}/residuals"], ":vectors") for arrow in row]
        lengths_px = np.linalg.norm(arrows, axis=1) / ENLARGED
        assert np.median(lengths_px) == pytest.approx(camera.residuals.median_px, rel=0.02)
        assert len(column(found[f"rmse_px/{name}"], ":scalars")) >= views.n_views
    assert len(column(found["ref/body"], ":translation")) >= len(np.unique(views.stamps_ns))
    assert len(column(found["ref/body/board/corners"], ":positions")[0]) == len(simulation.recording.board.corners_m)


def test_images_and_the_lollypops_errors_are_there(seen) -> None:
    _, (_, verification, name), found = seen
    assert len(column(found[f"ref/cameras/{name}/image"], ":blob")) == 3
    for camera, sightings in verification.sightings.items():
        errors = [row[0] for row in column(found[f"lollypop/e_2d_px/{camera}"], ":scalars")]
        np.testing.assert_allclose(errors, sightings.e_2d_px, rtol=1e-6)


def test_from_the_command_line(seen, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, (calibration, _, _), _ = seen
    write_calibration(tmp_path / "calibration.json", calibration)
    main(["export", str(tmp_path / "calibration.json"), "--to", "rerun", "-o", str(tmp_path / "out.rrd")])
    assert "wrote" in capsys.readouterr().out
    assert set(read_back(tmp_path / "out.rrd")) >= {f"ref/cameras/{name}" for name in calibration.cameras}


def test_another_rigs_recording_leaves_nothing_behind(seen, tmp_path: Path) -> None:
    simulation, (calibration, _, _), _ = seen
    of_another = replace(calibration, capture=Capture.FIXED_CAMERAS)
    with pytest.raises(GtcalError, match="its capture is tracked_platform, the calibration's fixed_cameras"):
        write_rerun(tmp_path / "out.rrd", of_another, recording=simulation.recording)
    assert not list(tmp_path.iterdir())
