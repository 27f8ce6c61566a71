"""Numbers of files are bounded where they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from calibration_support import HEADSET, simulated
from camera_files_support import rig_of
from cli_support import run

from gtcal.bounds import LARGEST_STAMP_NS, added, within
from gtcal.camera_files.formats import read_rig, write_rig
from gtcal.documents import load_document
from gtcal.errors import GtcalError
from gtcal.recordings.recording import load_recording
from gtcal.recordings.trajectory import Trajectory
from gtcal.simulation import write_simulation


@pytest.mark.parametrize("text", ["1e308", "1.0e+19", "-1e19", "9" * 23, "9" * 4000, "-" + "9" * 400])
@pytest.mark.parametrize("suffix", ["yaml", "json", "toml"])
def test_no_document_holds_a_number_without_meaning(text: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"file.{suffix}"
    whole = {
        "yaml": f"a: {{b: [1, {text}]}}",
        "json": f'{{"a": {{"b": [1, {text}]}}}}',
        "toml": f"[a]\nb = [1, {text}]",
    }
    path.write_text(whole[suffix])
    with pytest.raises(GtcalError, match=rf"file\.{suffix}: (a\.b\.1: is |is not valid TOML)") as raised:
        load_document(path)
    assert len(str(raised.value)) < 300


def test_what_is_within() -> None:
    assert all(within(value) for value in (0, -1e9, 1606153863362296104, 2**63 - 1, "1e308", None, True))
    assert not any(within(value) for value in (1e19, 2**64, -(10**400), float("inf"), float("nan")))


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bounds") / "rec"
    write_simulation(simulated(HEADSET), folder, images=False)
    return folder


Change = Callable[[dict], None]
CHANGES: dict[str, Change] = {
    "platform.stamp_offset_ns": lambda fields: fields["platform"].update(stamp_offset_ns=LARGEST_STAMP_NS + 1),
    "platform.rate_hz": lambda fields: fields["platform"].update(rate_hz=1e18),
    "image_size_px": lambda fields: next(iter(fields["cameras"].values())).update(image_size_px=[10**12, 10**12]),
    "parameters.cy": lambda fields: next(iter(fields["cameras"].values()))["parameters"].update(cy=1e18),
    "max_gap_ms": lambda fields: fields.update(max_gap_ms=1e18),
}


@pytest.mark.parametrize("field", CHANGES)
def test_a_manifest_names_the_field(field: str, ground: Path, tmp_path: Path) -> None:
    fields = yaml.safe_load((ground / "recording.yaml").read_text())
    CHANGES[field](fields)
    other = ground / f"{field}.yaml"
    other.write_text(yaml.safe_dump(fields))
    with pytest.raises(GtcalError, match=field):
        load_recording(other)


@pytest.mark.parametrize("name", ["lollypop_manifest_stamp_offset.yaml", "manifest_infinite_principal_point.yaml"])
def test_damaged_manifests_that_were_met(name: str, shared: Callable[[str], Path]) -> None:
    path = shared(f"cases/damaged/{name}")
    command = ["verify", "absent.json", path] if "lollypop" in name else ["calibrate", path]
    ran = run("info", path) if "lollypop" in name else run(*command)
    assert ran.code == 1
    assert ran.err.count("\n") == 1
    assert ("stamp_offset_ns" if "lollypop" in name else "cy") in ran.err
    assert "bug" not in ran.err


def test_stamps_stay_times() -> None:
    stamps_ns = np.array([0, LARGEST_STAMP_NS - 1], dtype=np.int64)
    assert added("it", stamps_ns, 1).tolist() == [1, LARGEST_STAMP_NS]
    with pytest.raises(GtcalError, match="146 years from zero"):
        added("it", stamps_ns, 2)
    with pytest.raises(GtcalError, match="years from zero"):
        added("it", stamps_ns, -(10**30))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 1e200
    with pytest.raises(GtcalError, match="m from zero; check the unit"):
        Trajectory("body", stamps_ns, poses)


@pytest.mark.parametrize("format_name", ["opencv", "kalibr", "umetrack", "ros"])
@pytest.mark.parametrize("value", ["1e12", "1e308"])
def test_a_lens_beyond_any(format_name: str, value: str, tmp_path: Path) -> None:
    rig = rig_of("fisheye")
    path = tmp_path / ("rig.json" if format_name == "umetrack" else "rig.yaml")
    write_rig(rig, tmp_path / "ros" if format_name == "ros" else path, format_name, [])
    path = tmp_path / "ros" / "fisheye.yaml" if format_name == "ros" else path
    cy = repr(float(rig.cameras[0].camera.theta[3]))
    assert cy in path.read_text()
    path.write_text(path.read_text().replace(cy, value))
    with pytest.raises(GtcalError, match=r"beyond any|finite number"):
        read_rig(path, format_name)


def test_an_array_beyond_any_lens(tmp_path: Path) -> None:
    write_rig(rig_of("fisheye"), tmp_path / "rig.npz", "numpy", [])
    arrays = dict(np.load(tmp_path / "rig.npz"))
    arrays["theta_fisheye"][3] = 1e12
    np.savez(tmp_path / "rig.npz", **arrays)
    with pytest.raises(GtcalError, match="beyond any"):
        read_rig(tmp_path / "rig.npz", "numpy")
