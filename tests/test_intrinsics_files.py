"""A recording whose lenses are in camera files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from factors import KANNALA_BRANDT4, PINHOLE_RADTAN
from gtcal.camera import Camera
from gtcal.camera_files.formats import write_rig
from gtcal.camera_files.rig import Rig, RigCamera
from gtcal.errors import GtcalError
from gtcal.files import fingerprint
from gtcal.recordings.recording import Recording, load_recording
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
from gtcal.verification.lollypop_recording import load_lollypop_recording


def edited(folder: Path, edit: Callable[[dict], object]) -> Path:
    manifest = yaml.safe_load((folder / "recording.yaml").read_text())
    edit(manifest["cameras"])
    (folder / "recording.yaml").write_text(yaml.safe_dump(manifest))
    return folder


def in_a_file(folder: Path, cameras: dict[str, Camera], format_name: str, name: str, **stated: object) -> Path:
    """The recording with the lenses of these cameras, by their names in the file, in a camera file of this name."""
    rig = Rig(
        tuple(RigCamera(replace(camera, name=own)) for own, camera in cameras.items()), "ref", "the rig", "not known"
    )
    write_rig(rig, folder / name, format_name, ["a test"])

    def edit(entries: dict) -> None:
        for entry in entries.values():
            for field in ("model", "image_size_px", "parameters"):
                del entry[field]
            entry["intrinsics"] = {"file": name, **stated}

    return edited(folder, edit)


@pytest.mark.parametrize("stated", [{}, {"format": "numpy"}])
def test_every_camera_takes_the_lens_of_its_name(
    stated: dict, small_recording: Recording, recording_folder: Path
) -> None:
    folder = in_a_file(recording_folder, small_recording.cameras, "numpy", "lenses.npz", **stated)
    recording = load_recording(folder)
    for name, camera in small_recording.cameras.items():
        assert replace(recording.cameras[name], parameters=None) == replace(camera, parameters=None)
        np.testing.assert_array_equal(recording.cameras[name].parameters, camera.parameters)
    lenses = [file for file in recording.inputs if file.path.name == "lenses.npz"]
    assert lenses == [fingerprint(folder / "lenses.npz")]  # once, though two cameras take it


def test_a_camera_of_another_name_is_named_and_a_single_one_needs_no_name(
    small_recording: Recording, recording_folder: Path
) -> None:
    cameras = {"cam0": small_recording.cameras["left"], "cam1": small_recording.cameras["right"]}
    folder = in_a_file(recording_folder, cameras, "numpy", "lenses.npz")
    with pytest.raises(GtcalError, match=r"left\.intrinsics: lenses\.npz holds several .* 'camera': cam0, cam1"):
        load_recording(folder)
    edited(folder, lambda entries: entries["left"]["intrinsics"].update(camera="cam2"))
    with pytest.raises(GtcalError, match=r"there is no camera 'cam2' in lenses\.npz; cameras: cam0, cam1"):
        load_recording(folder)
    edited(
        folder,
        lambda entries: [entries[n]["intrinsics"].update(camera=c) for n, c in [("left", "cam0"), ("right", "cam1")]],
    )
    np.testing.assert_array_equal(load_recording(folder).cameras["right"].theta, cameras["cam1"].theta)
    one = Rig((RigCamera(replace(cameras["cam0"], name="any")),), "ref", "the rig", "not known")
    write_rig(one, folder / "one.json", "umetrack", [])
    edited(folder, lambda entries: entries["left"].update(intrinsics={"file": "one.json"}))
    assert load_recording(folder).cameras["left"].name == "left"


def test_a_lens_is_taken_in_the_stated_model_where_that_is_the_same_lens(
    small_recording: Recording, recording_folder: Path
) -> None:
    folder = in_a_file(recording_folder, small_recording.cameras, "numpy", "lenses.npz")
    edited(folder, lambda entries: entries["left"].update(model="fisheye624", image_size_px=[640, 480]))
    left = load_recording(folder).cameras["left"]
    np.testing.assert_array_equal(left.theta, [*small_recording.cameras["left"].theta, 0, 0, 0, 0])
    assert left.model.name == "fisheye624"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"model": "pinhole_radtan"},
            r"lenses\.npz: the lens of camera 'left' is a fisheye62, but model says pinhole",
        ),
        ({"image_size_px": [640, 512]}, r"'left' is for images of 640 x 480 px, but image_size_px says 640 x 512"),
        ({"intrinsics": {"file": "no.npz"}}, r"cameras\.left\.intrinsics\.file: there is no .*no\.npz"),
        ({"intrinsics": {"file": "lenses.npz", "format": "kalibr"}}, r"cameras\.left\.intrinsics: .*lenses\.npz: "),
        (
            {"intrinsics": {"file": "platform.csv"}},
            r"platform\.csv: is no camera file that gtcal knows; formats: ",
        ),
    ],
)
def test_what_contradicts_or_is_missing_is_named(
    change: dict, message: str, small_recording: Recording, recording_folder: Path
) -> None:
    folder = in_a_file(recording_folder, small_recording.cameras, "numpy", "lenses.npz")
    edited(folder, lambda entries: entries["left"].update(change))
    with pytest.raises(GtcalError, match=message) as caught:
        load_recording(folder)
    assert str(caught.value).startswith(f"{folder / 'recording.yaml'}: cameras.left")
    assert "\n" not in str(caught.value)


def test_a_lens_for_another_image_is_noticed(small_recording: Recording, recording_folder: Path) -> None:
    left = small_recording.cameras["left"]
    theta = left.theta.copy()
    theta[2:4] = [1279.0, 959.0]
    folder = in_a_file(recording_folder, {"left": replace(left, parameters=theta)}, "numpy", "lenses.npz")
    edited(folder, lambda entries: entries.pop("right"))
    with pytest.raises(GtcalError, match=r"left\.intrinsics: the principal point \(1279, 959\) px lies in an"):
        load_recording(folder)


@pytest.mark.parametrize(("format_name", "file"), [("kalibr", "chain.yaml"), ("opencv", "rig.yaml"), ("ros", "infos")])
def test_files_of_other_tools(format_name: str, file: str, small_recording: Recording, recording_folder: Path) -> None:
    pinhole = replace(
        small_recording.cameras["right"], parameters=np.array([600, 601, 322, 250, 0.1, 0.01, 0, 0.001, 0])
    )
    fisheye = Camera("left", KANNALA_BRANDT4, np.array([250.1, 250.2, 319.4, 239.7, 0.01, 0.002, 0, 0]), 640, 480)
    folder = in_a_file(recording_folder, {"left": fisheye, "right": pinhole}, format_name, file)
    recording = load_recording(folder)
    assert [camera.model for camera in recording.cameras.values()] == [KANNALA_BRANDT4, PINHOLE_RADTAN]
    np.testing.assert_array_equal(recording.cameras["left"].theta, fisheye.theta)
    np.testing.assert_array_equal(recording.cameras["right"].theta, pinhole.theta)
    assert fingerprint(folder / file) in recording.inputs


def test_a_recording_of_the_lollypop_takes_them_too(tmp_path: Path) -> None:
    simulation = simulate_lollypop(LollypopOptions(duration_s=3.0), seed=4)
    write_lollypop_simulation(simulation, tmp_path / "lollypop", images=False)
    cameras = simulation.recording.cameras
    folder = in_a_file(tmp_path / "lollypop", cameras, "numpy", "lenses.npz")
    recording = load_lollypop_recording(folder)
    for name, camera in cameras.items():
        np.testing.assert_array_equal(recording.cameras[name].theta, camera.theta)
    assert fingerprint(folder / "lenses.npz") in recording.inputs
