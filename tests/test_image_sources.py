"""One rendered recording from image files, a video, a bag and a VRS file: the same corners, the same calibration."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import yaml
from media_support import image_message, small_simulation, write_bag, write_video
from vrs_support import image_stream, write_vrs

from gtcal.errors import GtcalError
from gtcal.estimation.options import CalibrationOptions
from gtcal.files import fingerprint
from gtcal.recordings.images import Images
from gtcal.recordings.recording import Recording, load_recording, write_recording
from gtcal.results.calibration import pose_difference
from gtcal.simulation.writing import write_simulation
from gtcal.workflow import calibrate, detected

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the recording with image files, detected already."""
    folder = tmp_path_factory.mktemp("rendered") / "files"
    write_simulation(small_simulation(), folder, images=True)
    detected(load_recording(folder))
    return folder


def pictures(recording: Recording) -> tuple[str, Images, list[np.ndarray]]:
    (name, images), *_ = recording.images.items()
    return name, images, [images.read(i) for i in range(len(images))]


def video(codec: str, pixel_format: str, options: dict[str, str]) -> Callable[[Path, Images, list], dict]:
    def write(folder: Path, images: Images, shown: list[np.ndarray]) -> dict:
        pytest.importorskip("av")
        start_ns = int(images.stamps_ns[0])
        pts = (images.stamps_ns - start_ns).tolist()
        base = Fraction(1, SECOND) if codec == "ffv1" else Fraction(1, 1_000_000)
        stamps = [round(p * 1e-9 / base) for p in pts]
        path = folder / "cam.nut"
        write_video(path, shown, stamps, time_base=base, codec=codec, pixel_format=pixel_format, options=options)
        return {"video": path.name, "stamp_offset_ns": start_ns}

    return write


def bag(storage: str) -> Callable[[Path, Images, list], dict]:
    def write(folder: Path, images: Images, shown: list[np.ndarray]) -> dict:
        pytest.importorskip("rosbags")
        rows = [(stamp + 7, stamp, image_message(p)) for stamp, p in zip(images.stamps_ns.tolist(), shown, strict=True)]
        path = folder / ("cam.bag" if storage == "ros1" else "cam")
        write_bag(path, {"/cam": rows}, storage=storage)
        return {"bag": path.name, "topic": "/cam"}

    return write


def vrs(folder: Path, images: Images, shown: list[np.ndarray]) -> dict:
    pytest.importorskip("pyvrs")
    stamps_ns = images.stamps_ns.tolist()
    write_vrs(folder / "cam.vrs", [image_stream(shown, [stamp * 1e-9 for stamp in stamps_ns], stamps_ns)])
    return {"vrs": "cam.vrs", "stream": "1201-1"}


def copied(rendered: Path, folder: Path, write: Callable[[Path, Images, list], dict]) -> Path:
    """The recording with its images in another source."""
    name, images, shown = pictures(load_recording(rendered))
    shutil.copytree(rendered, folder, ignore=shutil.ignore_patterns("images", ".gtcal"))
    manifest = yaml.safe_load((folder / "recording.yaml").read_text())
    del manifest["cameras"][name]["images"]
    manifest["cameras"][name] |= write(folder, images, shown)
    (folder / "recording.yaml").write_text(yaml.safe_dump(manifest))
    return folder


LOSSLESS = {
    "video": video("ffv1", "gray", {}),
    "ROS 1 bag": bag("ros1"),
    "ROS 2 bag": bag("mcap"),
    "VRS": vrs,
}


@pytest.mark.long
@pytest.mark.parametrize("source", LOSSLESS)
def test_the_corners_are_those_of_the_image_files(source: str, rendered: Path, tmp_path: Path) -> None:
    folder = copied(rendered, tmp_path / "copy", LOSSLESS[source])
    reference, found = detected(load_recording(rendered)), detected(load_recording(folder))
    (name,) = found.detections
    for column in ("stamps_ns", "view_start", "corner_ids", "corners_px"):
        np.testing.assert_array_equal(
            getattr(found.detections[name], column), getattr(reference.detections[name], column)
        )
    (path,) = found.images[name].inputs
    assert fingerprint(path) in found.inputs
    cache = list((folder / ".gtcal").iterdir())
    assert len(cache) == 1
    detected(load_recording(folder))
    assert list((folder / ".gtcal").iterdir()) == cache, "what was found is not kept for the next time"


@pytest.mark.parametrize("source", LOSSLESS)
def test_a_recording_is_written_with_its_source(source: str, rendered: Path, tmp_path: Path) -> None:
    recording = load_recording(copied(rendered, tmp_path / "copy", LOSSLESS[source]))
    again = load_recording(write_recording(recording, tmp_path / "again"))
    (name,) = recording.images
    np.testing.assert_array_equal(again.images[name].stamps_ns, recording.images[name].stamps_ns)
    np.testing.assert_array_equal(again.images[name].read(5), recording.images[name].read(5))


def test_a_lossy_video_calibrates_alike(rendered: Path, tmp_path: Path) -> None:
    folder = copied(rendered, tmp_path / "copy", video("libx264", "yuv420p", {"crf": "18"}))
    options = CalibrationOptions(mocap="exact", clock="trust")
    reference, found = (calibrate(load_recording(path), options) for path in (rendered, folder))
    (name,) = found.cameras
    assert found.rmse_px < reference.rmse_px + 0.1
    mm, deg = pose_difference(found.cameras[name].camera_T_ref.a_T_b, reference.cameras[name].camera_T_ref.a_T_b)
    assert mm < 2.0
    assert deg < 0.1


def test_a_wrong_stream_and_a_missing_offset_are_told(rendered: Path, tmp_path: Path) -> None:
    folder = copied(rendered, tmp_path / "copy", video("ffv1", "gray", {}))
    text = (folder / "recording.yaml").read_text()
    lines = [line for line in text.splitlines() if "stamp_offset_ns" not in line]
    (folder / "recording.yaml").write_text("\n".join(lines))
    with pytest.raises(GtcalError, match=r"cameras\.\w+\.stamp_offset_ns: is missing; a video's stamps count"):
        load_recording(folder)
    (folder / "recording.yaml").write_text(text.replace("cam.nut", "gone.mkv"))
    with pytest.raises(GtcalError, match=r"cameras\.\w+\.video: there is no .*gone\.mkv"):
        load_recording(folder)
