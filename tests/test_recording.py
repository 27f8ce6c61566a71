from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from support import replace_once, wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.files import fingerprint
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import image_folder
from gtcal.recordings.recording import Recording, load_recording, write_recording


def assert_same(a: Recording, b: Recording) -> None:
    assert (a.capture, a.board, a.max_gap_s, list(a.cameras)) == (b.capture, b.board, b.max_gap_s, list(b.cameras))
    for name, camera in a.cameras.items():
        other = b.cameras[name]
        assert replace(camera, parameters=None) == replace(other, parameters=None)
        np.testing.assert_array_equal(camera.parameters, other.parameters)
    assert a.detections.keys() == b.detections.keys()
    for name, detections in a.detections.items():
        for column in ("stamps_ns", "view_start", "corner_ids", "corners_px"):
            np.testing.assert_array_equal(getattr(detections, column), getattr(b.detections[name], column))
    assert a.motion.trajectories.keys() == b.motion.trajectories.keys()
    for name, trajectory in a.motion.trajectories.items():
        np.testing.assert_array_equal(trajectory.stamps_ns, b.motion.trajectories[name].stamps_ns)
        np.testing.assert_allclose(trajectory.world_T_body, b.motion.trajectories[name].world_T_body, atol=2e-15)


def edited_manifest(folder: Path, edit: Callable[[dict], None]) -> None:
    manifest = yaml.safe_load((folder / "recording.yaml").read_text())
    edit(manifest)
    (folder / "recording.yaml").write_text(yaml.safe_dump(manifest))


@pytest.mark.parametrize("capture", list(Capture))
@pytest.mark.parametrize("max_gap_s", [None, 0.0125])
def test_what_is_written_is_loaded_again(
    capture: Capture, max_gap_s: float | None, small_recording: Recording, tmp_path: Path
) -> None:
    bodies = {
        name: getattr(small_recording, name) if name in capture.bodies else None for name in ("platform", "board_body")
    }
    recording = replace(small_recording, capture=capture, max_gap_s=max_gap_s, **bodies)
    path = write_recording(recording, tmp_path / "out")
    assert path == tmp_path / "out" / "recording.yaml"
    assert_same(load_recording(path.parent), recording)
    assert_same(load_recording(path), recording)


def test_cameras_without_intrinsics_stay_without(small_recording: Recording, tmp_path: Path) -> None:
    cameras = {name: replace(camera, parameters=None) for name, camera in small_recording.cameras.items()}
    write_recording(replace(small_recording, cameras=cameras), tmp_path)
    assert all(camera.parameters is None for camera in load_recording(tmp_path).cameras.values())


def test_images_are_pointed_to_by_name_or_by_list(small_recording: Recording, tmp_path: Path) -> None:
    for folder, names in (("by_stamp", ("1000000", "34000000")), ("by_frame", ("frame_1", "frame_2"))):
        for name in names:
            (tmp_path / folder).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / folder / f"{name}.png"), np.zeros((480, 640), np.uint8))
    stamped = image_folder(tmp_path / "by_stamp").expecting(640, 480)
    listed = replace(stamped, paths=tuple((tmp_path / "by_frame" / f"frame_{i}.png") for i in (1, 2)))
    for images, has_list in ((stamped, False), (listed, True)):
        recording = replace(small_recording, images={"left": images})
        folder = tmp_path / f"out_{has_list}"
        write_recording(recording, folder)
        loaded = load_recording(folder).images["left"]
        assert [path.resolve() for path in loaded.paths] == list(images.paths)
        np.testing.assert_array_equal(loaded.stamps_ns, images.stamps_ns)
        assert (folder / "left_images.csv").exists() == has_list


def test_the_inputs_are_fingerprinted(recording_folder: Path) -> None:
    inputs = load_recording(recording_folder).inputs
    names = ["recording.yaml", "left_detections.csv", "right_detections.csv", "platform.csv", "board_body.csv"]
    assert [file.path.name for file in inputs] == names
    assert list(inputs) == [fingerprint(recording_folder / name) for name in names]


@pytest.mark.parametrize("capture", [Capture.TRACKED_PLATFORM, Capture.STANDING_BOARD])
@pytest.mark.parametrize("given_corners", [True, False])
def test_the_real_vicon_recording(capture: Capture, given_corners: bool, vicon_recording: Callable) -> None:
    recording = load_recording(vicon_recording(capture, given_corners=given_corners))
    assert recording.capture is capture
    assert recording.board.n_corners == 144
    assert recording.cameras["cam0"].parameters is None
    assert len(recording.images["cam0"]) == 30
    assert list(recording.motion.trajectories) == list(capture.bodies)
    if given_corners:
        assert recording.detections["cam0"].n_corners == 4008
    else:
        assert recording.detections == {}


def test_images_of_another_size_than_stated_are_refused(vicon_recording: Callable) -> None:
    folder = vicon_recording()
    replace_once(folder / "recording.yaml", "[640, 480]", "[1280, 960]")
    with pytest.raises(GtcalError, match=r"1606153907495166540\.jpg: the image is 640 x 480 pixels, but .* 1280 x 960"):
        load_recording(folder)


@pytest.mark.parametrize(
    ("cx", "cy", "message"),
    [
        (
            639.5,
            479.5,
            r"middle of an image of about 1279 x 959, not the 640 x 480 .* look like another image size",
        ),
        (159.0, 120.0, r"middle of an image of about 318 x 240, not the 640 x 480"),
        (700.0, 240.0, r"\(700, 240\) px lies in an image of about 1400 x 480"),
        (319.0, -3.0, r"\(319, -3\) px lies in an image"),
    ],
)
def test_intrinsics_of_another_image_size_are_noticed(
    cx: float, cy: float, message: str, recording_folder: Path
) -> None:
    def move(manifest: dict) -> None:
        manifest["cameras"]["left"]["parameters"] |= {"cx": cx, "cy": cy}

    edited_manifest(recording_folder, move)
    with pytest.raises(GtcalError, match=rf"recording\.yaml: cameras\.left\.parameters: .*{message}"):
        load_recording(recording_folder)


@pytest.mark.parametrize(("cx", "cy"), [(319.5, 239.5), (250.0, 300.0), (420.0, 240.0), (130.0, 240.0)])
def test_a_lens_off_the_middle_of_its_sensor_is_taken(cx: float, cy: float, recording_folder: Path) -> None:
    def move(manifest: dict) -> None:
        manifest["cameras"]["left"]["parameters"] |= {"cx": cx, "cy": cy}

    edited_manifest(recording_folder, move)
    assert load_recording(recording_folder).cameras["left"].theta[2:4].tolist() == [cx, cy]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": -1.0}, r"parameters\.fx: is -1; a focal length is positive"),
        ({"fy": 2500.0}, r"parameters\.fx: is 250\.1, but fy is 2500; .*check both"),
        (
            {"fxx": 0.0},
            r"parameters\.fxx: is not a parameter of fisheye62; did you mean 'fx'\?; parameters: fx, fy",
        ),
        ({"k5": None}, r"parameters\.k5: is missing; fisheye62 has fx, fy, cx, cy, k0"),
    ],
)
def test_wrong_parameters_are_named(change: dict, message: str, recording_folder: Path) -> None:
    def edit(manifest: dict) -> None:
        parameters = manifest["cameras"]["left"]["parameters"] | change
        manifest["cameras"]["left"]["parameters"] = {k: v for k, v in parameters.items() if v is not None}

    edited_manifest(recording_folder, edit)
    with pytest.raises(GtcalError, match=rf"recording\.yaml: cameras\.left\.{message}"):
        load_recording(recording_folder)


@pytest.mark.parametrize(
    ("field", "file"),
    [
        (r"cameras\.left\.detections", "left_detections.csv"),
        (r"platform\.trajectory", "platform.csv"),
        (r"board_body\.trajectory", "board_body.csv"),
    ],
)
def test_missing_files_are_named_with_their_field(field: str, file: str, recording_folder: Path) -> None:
    (recording_folder / file).unlink()
    with pytest.raises(GtcalError, match=rf"recording\.yaml: {field}: there is no .*/{file}"):
        load_recording(recording_folder)


def test_a_board_that_cannot_be_is_named_with_the_manifest(recording_folder: Path) -> None:
    replace_once(recording_folder / "recording.yaml", "tag_side_m: 0.05", "tag_side_m: 50")
    with pytest.raises(GtcalError, match=r"recording\.yaml: board: board field 'tag_side_m' is 50"):
        load_recording(recording_folder)


def test_board_ids_that_are_not_on_the_board_are_refused(recording_folder: Path) -> None:
    replace_once(recording_folder / "recording.yaml", "tag_rows: 2", "tag_rows: 1")
    with pytest.raises(
        GtcalError, match=r"left_detections\.csv:\d+: corner_id \d+ is not on the board; expected 0 to 11"
    ):
        load_recording(recording_folder)


def test_metres_declared_as_millimetres_are_noticed_when_nothing_moves(
    small_recording: Recording, tmp_path: Path
) -> None:
    write_recording(small_recording, tmp_path)
    for name in ("platform", "board_body"):
        replace_once(tmp_path / f"{name}.csv", "p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]", "x, y, z")
        replace_once(tmp_path / "recording.yaml", f"{name}.csv,", f"{name}.csv, length_unit: mm,")
    with pytest.raises(GtcalError, match=r"recording\.yaml: platform\.length_unit: as mm, no body moves by more than"):
        load_recording(tmp_path)


def test_a_recording_knows_whose_detections_it_has(small_recording: Recording) -> None:
    nothing = CameraDetections.from_views([])
    with pytest.raises(
        GtcalError, match="camera 'cam9' has detections but is not in the recording; cameras: left, right"
    ):
        replace(small_recording, detections=small_recording.detections | {"cam9": nothing})
    with pytest.raises(GtcalError, match="camera 'right' has neither images nor detections"):
        replace(small_recording, detections={"left": small_recording.detections["left"]})
    with pytest.raises(GtcalError, match="platform: is missing; capture tracked_platform needs"):
        replace(small_recording, platform=None)
    with pytest.raises(GtcalError, match="platform: capture fixed_cameras has no use for it"):
        replace(small_recording, capture=Capture.FIXED_CAMERAS)


def test_no_manifest_is_left_where_writing_fails(small_recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "platform.csv").mkdir()
    with pytest.raises(GtcalError, match=r"platform\.csv: can't be written"):
        write_recording(small_recording, tmp_path)
    assert not (tmp_path / "recording.yaml").exists()
    assert not list(tmp_path.glob(".*"))


def test_a_truncated_trajectory_fails_the_load_in_one_line(recording_folder: Path) -> None:
    path = recording_folder / "board_body.csv"
    path.write_text(path.read_text()[:-60])
    with pytest.raises(GtcalError, match=r"board_body\.csv:61: fields in the row: \d, expected 8") as caught:
        load_recording(recording_folder)
    assert "\n" not in str(caught.value)


def test_bodies_may_have_any_rate(small_recording: Recording, tmp_path: Path) -> None:
    slow = wandering_trajectory("platform", n=7, interval_ns=100_000_000)
    write_recording(replace(small_recording, platform=slow), tmp_path)
    assert load_recording(tmp_path).motion.at(slow.stamps_ns[:1]).ok.all()
