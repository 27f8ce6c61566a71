"""What cameras may be called: checked where a manifest, a rig or a result is read, so that no name becomes a path."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from calibration_support import HEADSET, simulated
from camera_files_support import rig_of
from cli_support import files_in, run

from gtcal.camera_files.formats import read_rig
from gtcal.errors import GtcalError
from gtcal.names import MOST_BYTES, check_name, fault_of_name
from gtcal.recordings.recording import load_recording, write_recording
from gtcal.results.calibration_file import read_calibration, write_calibration
from gtcal.simulation import write_simulation
from gtcal.simulation.lollypop import LollypopOptions, exact_calibration, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop_recording import load_lollypop_recording

WRONG = {
    "": "is empty",
    " ": "is empty",
    "../../escaped": "separator",
    "/abs/escaped": "separator",
    "a\\b": "separator",
    "..": "ends with a dot",
    ".": "ends with a dot",
    "a.": "ends with a dot",
    "a ": "ends with a dot or a space",
    "esc\x1b[31m": "control character",
    "two\nlines": "control character",
    "nul\0": "control character",
    "del\x7f": "control character",
    "next\x85line": "control character",
    "line\u2028end": "control character",
    "half\ud800": "control character",
    "x" * (MOST_BYTES + 1): "bytes long",
    "相" * 67: "bytes long",
    "CON": "reserved",
    "nul.csv": "reserved",
    "lpt1": "reserved",
}
FINE = [
    "cam0",
    "café",
    "камера 1",
    "相机",
    "x😀",
    "a: b",
    ".hidden",
    "[red]",
    "console",
    "x" * MOST_BYTES,
    "a'b\"c",
    "-o",
]


@pytest.mark.parametrize("name", WRONG, ids=lambda name: repr(name)[:30])
def test_what_can_be_no_name(name: str) -> None:
    assert WRONG[name] in fault_of_name(name)
    with pytest.raises(GtcalError) as raised:
        check_name("camera", name)
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 300


@pytest.mark.parametrize("name", FINE)
def test_letters_of_every_script_are_welcome(name: str) -> None:
    assert fault_of_name(name) == ""
    rig_of("radtan", name=name)


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, one of the Lollypop, and a calibration."""
    folder = tmp_path_factory.mktemp("names")
    simulation = simulated(HEADSET)
    write_simulation(simulation, folder / "rec", images=False)
    device = LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene, n_frames=30)
    write_lollypop_simulation(simulate_lollypop(device, seed=2), folder / "lollypop", images=False)
    rig = simulation.options.rig
    poses = {camera.name: np.eye(4) for camera in rig.cameras}
    write_calibration(folder / "cal.json", exact_calibration(simulation.recording.capture, rig.cameras, poses))
    return folder


def renamed(manifest: Path, name: str) -> Path:
    """The manifest with its first camera called like this."""
    fields = yaml.safe_load(manifest.read_text())
    first = next(iter(fields["cameras"]))
    fields["cameras"] = {name: fields["cameras"].pop(first), **fields["cameras"]}
    other = manifest.with_name(f"{abs(hash(name))}.json")
    other.write_text(json.dumps(fields))
    return other


@pytest.mark.parametrize("name", [name for name in WRONG if name.strip()], ids=lambda name: repr(name)[:30])
def test_every_reader_asks(name: str, ground: Path, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=WRONG[name]) as in_recording:
        load_recording(renamed(ground / "rec" / "recording.yaml", name))
    with pytest.raises(GtcalError, match=WRONG[name]) as in_lollypop:
        load_lollypop_recording(renamed(ground / "lollypop" / "recording.yaml", name))
    document = json.loads((ground / "cal.json").read_text())
    first = next(iter(document["cameras"]))
    document["cameras"][name] = document["cameras"].pop(first)
    (tmp_path / "cal.json").write_text(json.dumps(document))
    with pytest.raises(GtcalError, match=WRONG[name]) as in_calibration:
        read_calibration(tmp_path / "cal.json")
    with pytest.raises(GtcalError, match=WRONG[name]):
        rig_of("radtan", name=name)
    for raised in (in_recording, in_lollypop, in_calibration):
        assert ".json: " in str(raised.value)  # which file
        assert str(raised.value).isprintable()


def test_no_name_leads_out_of_the_folder(ground: Path, tmp_path: Path) -> None:
    manifest = renamed(ground / "rec" / "recording.yaml", "../../escaped")
    ran = run("detect", manifest, "-o", tmp_path / "in" / "out")
    assert ran.code == 1
    assert ran.err.count("\n") == 1
    assert "cameras.'../../escaped': the name has a separator" in ran.err
    assert not files_in(tmp_path)


def test_a_namespace_of_ros_is_written_with_underscores(tmp_path: Path) -> None:
    """As the camera_info of a stereo camera names its cameras."""
    from gtcal.camera_files.formats import write_rig

    write_rig(rig_of("radtan", name="left"), tmp_path / "ros", "ros", [])
    file = tmp_path / "ros" / "left.yaml"
    file.write_text(file.read_text().replace('camera_name: "left"', 'camera_name: "narrow_stereo/left"'))
    assert [camera.name for camera in read_rig(file, None).rig.cameras] == ["narrow_stereo_left"]


def test_a_recording_with_names_of_any_script_is_written_and_read(tmp_path: Path) -> None:
    recording = simulated(HEADSET).recording
    new = dict(zip(recording.cameras, ("café", "камера 1", "相机", "[red]"), strict=False))
    other = replace(
        recording,
        cameras={new[name]: replace(camera, name=new[name]) for name, camera in recording.cameras.items()},
        detections={new[name]: found for name, found in recording.detections.items()},
    )
    write_recording(other, tmp_path / "rec")
    assert set(load_recording(tmp_path / "rec").cameras) == set(new.values())
