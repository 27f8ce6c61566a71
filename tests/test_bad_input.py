"""Bad input as an operator meets it: 'gtcal calibrate' ends with code 1, one line on stderr that names the file and
the field, frame or camera, and nothing written."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from calibration_support import HEADSET, simulated
from cli_support import Ran, files_in, run

from gtcal.simulation import write_simulation

Edit = Callable[[Path], None]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sound recording of detections; its trajectories have no header, so that the manifest states their form."""
    folder = tmp_path_factory.mktemp("good") / "recording"
    simulation = simulated(HEADSET, frames=30)
    write_simulation(simulation, folder, images=False)
    (folder / "ground_truth.json").unlink()
    for body in ("platform", "board_body"):
        rows = (folder / f"{body}.csv").read_text().splitlines()[1:]
        (folder / f"{body}.csv").write_text("\n".join(rows[::4]) + "\n")
    stated = {"format": "euroc_csv", "quaternion": "wxyz", "length_unit": "m", "time_unit": "ns"}
    in_manifest(lambda m: [m[body].update(stated) for body in ("platform", "board_body")])(folder)
    return folder


@pytest.fixture
def folder(good: Path, tmp_path: Path) -> Path:
    """A copy of it, to damage."""
    shutil.copytree(good, tmp_path / "recording")
    return tmp_path / "recording"


def calibrate(folder: Path, *options: str) -> Ran:
    return run("calibrate", folder, "-o", folder.parent / "calibration.json", *options)


def refused(folder: Path, *options: str) -> str:
    """The line that an operator sees."""
    before = files_in(folder.parent)
    ran = calibrate(folder, *options)
    assert ran.code == 1, ran.err
    assert ran.out == ""
    assert ran.err.startswith("gtcal: ")
    assert ran.err.count("\n") == 1, ran.err
    assert files_in(folder.parent) == before
    return ran.err


# Ways to damage a recording


def in_manifest(change: Callable[[dict], object]) -> Edit:
    def edit(folder: Path) -> None:
        path = folder / "recording.yaml"
        manifest = yaml.safe_load(path.read_text())
        change(manifest)
        path.write_text(yaml.safe_dump(manifest, sort_keys=False))

    return edit


def removed(name: str) -> Edit:
    return lambda folder: (folder / name).unlink()


def in_row(name: str, line: int, change: Callable[[list[str]], object]) -> Edit:
    """Change the fields of one line of a CSV, counted from 1."""

    def edit(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        fields = lines[line - 1].split(",")
        lines[line - 1] = ",".join(change(fields) or fields)
        (folder / name).write_text("\n".join(lines) + "\n")

    return edit


def field(index: int, value: str) -> Callable[[list[str]], None]:
    return lambda fields: fields.__setitem__(index, value)


def lines(name: str, change: Callable[[list[str]], list[str]]) -> Edit:
    def edit(folder: Path) -> None:
        changed = change((folder / name).read_text().splitlines())
        (folder / name).write_text("".join(f"{line}\n" for line in changed))

    return edit


def cut(name: str, share: float) -> Edit:
    """As a copy that was interrupted."""

    def edit(folder: Path) -> None:
        text = (folder / name).read_text()
        middle = text.index("\n", int(share * len(text))) + 1
        (folder / name).write_text(text[: middle + 30])

    return edit


def shifted_by_a_day(name: str) -> Edit:
    day_ns = 86_400 * 10**9
    return lines(name, lambda rows: [re.sub(r"^\d+", lambda stamp: str(int(stamp[0]) + day_ns), row) for row in rows])


def _twice(rows: list[str]) -> list[str]:
    return [*rows[:31], rows[30], *rows[31:]]


def _backward(rows: list[str]) -> list[str]:
    return [*rows[:30], rows[31], rows[30], *rows[32:]]


CASES: dict[str, tuple[Edit, list[str]]] = {
    # files
    "no manifest": (removed("recording.yaml"), ["recording: there is no manifest", "recording.yaml"]),
    "no trajectory": (removed("platform.csv"), ["recording.yaml: platform.trajectory: there is no", "platform.csv"]),
    "no detections": (
        removed("side_left_detections.csv"),
        ["recording.yaml: cameras.side_left.detections: there is no", "side_left_detections.csv"],
    ),
    "trajectory cut off": (cut("board_body.csv", 0.5), ["board_body.csv:", "is the file cut off?"]),
    "detections cut off": (cut("front_left_detections.csv", 0.5), ["front_left_detections.csv:"]),
    "empty trajectory": (lines("platform.csv", lambda rows: []), ["platform.csv"]),
    "a picture for a trajectory": (
        lambda folder: (folder / "platform.csv").write_bytes(b"\x89PNG\r\n\x1a\n\x00\xff"),
        ["platform.csv"],
    ),
    # values
    "NaN in a trajectory": (in_row("platform.csv", 12, field(2, "nan")), ["platform.csv:12", "nan"]),
    "infinity in a trajectory": (in_row("board_body.csv", 7, field(1, "inf")), ["board_body.csv:7", "inf"]),
    "NaN in detections": (in_row("side_right_detections.csv", 9, field(3, "nan")), ["side_right_detections.csv:9"]),
    "infinity in detections": (
        in_row("side_right_detections.csv", 9, field(2, "-inf")),
        ["side_right_detections.csv:9"],
    ),
    "text for a number": (in_row("platform.csv", 5, field(3, "1.2.3")), ["platform.csv:5", "1.2.3"]),
    "zero quaternion": (
        in_row("platform.csv", 20, lambda fields: fields[:4] + ["0"] * 4),
        ["platform.csv:20", "quaternion"],
    ),
    "quaternion that is no unit": (
        in_row("platform.csv", 20, lambda fields: fields[:4] + [str(2 * float(q)) for q in fields[4:]]),
        ["platform.csv:20", "quaternion"],
    ),
    # what the data contradict
    "quaternion order swapped": (
        in_manifest(lambda m: m["platform"].update(quaternion="xyzw")),
        ["no calibration fits", "set platform.quaternion: wxyz in the manifest"],
    ),
    "quaternion order of both swapped": (
        in_manifest(lambda m: [m[body].update(quaternion="xyzw") for body in ("platform", "board_body")]),
        ["set platform.quaternion: wxyz and set board_body.quaternion: wxyz"],
    ),
    "inverse poses": (
        in_manifest(lambda m: m["board_body"].update(pose="body_T_world")),
        ["no calibration fits", "set board_body.pose"],
    ),
    "metres declared as millimetres": (
        in_manifest(lambda m: [m[body].update(length_unit="mm") for body in ("platform", "board_body")]),
        ["recording.yaml: platform.length_unit: as mm, no body moves by more than", "then set m"],
    ),
    "one body's metres declared as millimetres": (
        in_manifest(lambda m: m["board_body"].update(length_unit="mm")),
        ["no calibration fits", "set board_body.length_unit: m in the manifest"],
    ),
    "nanoseconds declared as microseconds": (
        in_manifest(lambda m: m["platform"].update(time_unit="us")),
        ["platform.csv:1: time stamp", "check the time unit"],
    ),
    # time
    "a stamp twice": (lines("platform.csv", _twice), ["platform.csv:32", "stamp"]),
    "a stamp that runs backward": (lines("platform.csv", _backward), ["platform.csv:32", "stamp"]),
    "a corner twice in a view": (
        lines("front_left_detections.csv", lambda rows: [*rows[:3], rows[2], *rows[3:]]),
        ["front_left_detections.csv:4"],
    ),
    "no time in common": (
        shifted_by_a_day("board_body.csv"),
        ["camera 'front_left' and the board_body trajectory share no time"],
    ),
    # board, cameras, intrinsics
    "ids that are not on the board": (
        in_row("front_right_detections.csv", 40, field(1, "96")),
        ["front_right_detections.csv:40", "96"],
    ),
    "another board": (
        in_manifest(lambda m: m["board"].update(tag_columns=2, tag_rows=2)),
        ["front_left_detections.csv:", "corner"],
    ),
    "corners outside the image": (
        in_row("side_left_detections.csv", 5, field(2, "1500.0")),
        ["side_left_detections.csv:5", "1280"],
    ),
    "an image size that is not the intrinsics'": (
        in_manifest(lambda m: m["cameras"]["side_left"].update(image_size_px=[640, 512])),
        ["recording.yaml: cameras.side_left"],
    ),
    "a parameter missing": (
        in_manifest(lambda m: m["cameras"]["front_left"]["parameters"].pop("k3")),
        ["recording.yaml: cameras.front_left.parameters.k3: is missing"],
    ),
    "a parameter of another model": (
        in_manifest(lambda m: m["cameras"]["front_left"]["parameters"].update(k6=0.1)),
        ["recording.yaml: cameras.front_left.parameters.k6: is not a parameter of fisheye62"],
    ),
    "a camera without views": (
        lines("side_right_detections.csv", lambda rows: rows[:1]),
        ["camera 'side_right' has no views"],
    ),
    # the manifest
    "an unknown field": (
        in_manifest(lambda m: m.update(camera_model="x")),
        ["recording.yaml: camera_model: is not a field"],
    ),
    "a missing field": (in_manifest(lambda m: m.pop("board")), ["recording.yaml: board: is missing"]),
    "an unknown model": (
        in_manifest(lambda m: m["cameras"]["front_left"].update(model="fisheye26")),
        ["recording.yaml: cameras.front_left.model", "did you mean 'fisheye62'?"],
    ),
    "a body too few": (in_manifest(lambda m: m.pop("board_body")), ["recording.yaml: board_body: is missing"]),
    "a body too many": (
        in_manifest(lambda m: m.update(capture="standing_board")),
        ["recording.yaml: board_body: capture standing_board has no use for it"],
    ),
    "units unsaid": (
        in_manifest(lambda m: m["platform"].pop("length_unit")),
        ["platform.csv", "length_unit"],
    ),
    "quaternion order unsaid": (
        in_manifest(lambda m: m["platform"].pop("quaternion")),
        ["platform.csv", "quaternion"],
    ),
    "no YAML": (
        lambda folder: (folder / "recording.yaml").write_text("cameras: [\n"),
        ["recording.yaml:", "is not valid YAML"],
    ),
}


@pytest.mark.parametrize("case", list(CASES))
def test_bad_input_ends_in_one_line_that_says_where_and_what(case: str, folder: Path) -> None:
    edit, said = CASES[case]
    edit(folder)
    line = refused(folder)
    for part in said:
        assert part in line


def test_the_sound_recording_calibrates(folder: Path) -> None:
    """Else all the others would prove nothing."""
    ran = calibrate(folder, "-q")
    assert (ran.code, ran.out, ran.err) == (0, "", "")
    assert (folder.parent / "calibration.json").exists()


def test_a_camera_with_too_few_views_is_named(folder: Path) -> None:
    rows = (folder / "side_left_detections.csv").read_text().splitlines()
    stamps = sorted({row.split(",")[0] for row in rows[1:]})[:2]
    few = [row for row in rows[1:] if row.split(",")[0] in stamps]
    (folder / "side_left_detections.csv").write_text("\n".join([rows[0], *few]) + "\n")
    assert "camera 'side_left' has 2 usable view(s); at least 3 are needed" in refused(folder)


def test_intrinsics_can_not_be_found_from_too_few_views(folder: Path) -> None:
    rows = (folder / "side_left_detections.csv").read_text().splitlines()
    stamps = sorted({row.split(",")[0] for row in rows[1:]})[:5]
    few = [row for row in rows[1:] if row.split(",")[0] in stamps]
    (folder / "side_left_detections.csv").write_text("\n".join([rows[0], *few]) + "\n")
    assert "camera 'side_left': 5 views with 12 or more corners; at least 6" in refused(
        folder, "--calibrate-intrinsics"
    )


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        ("single_axis", "single axis, (0.18, 0.98, -0.01) of the body frame"),
        ("translation", "pure translation"),
    ],
)
def test_a_motion_that_determines_too_little_is_named(motion: str, said: str, tmp_path: Path) -> None:
    write_simulation(simulated(HEADSET, motion=motion), tmp_path / "recording", images=False)
    line = refused(tmp_path / "recording")
    assert said in line
    assert "cannot be found" in line


def test_gaps_that_leave_no_view_are_counted_by_reason(folder: Path) -> None:
    """A trajectory with a sample a second."""
    lines("platform.csv", lambda rows: rows[::30])(folder)
    line = refused(folder)
    assert "camera 'front_left' has no views left to calibrate from" in line
    assert "gap > 200 ms in platform" in line


# Images


@pytest.fixture
def with_images(folder: Path) -> Path:
    """The recording with a camera that has images, grey ones, in place of detections."""
    stamps = sorted({row.split(",")[0] for row in (folder / "side_left_detections.csv").read_text().splitlines()[1:]})
    (folder / "side_left").mkdir()
    for stamp in stamps[:4]:
        cv2.imwrite(str(folder / "side_left" / f"{stamp}.png"), np.full((1024, 1280), 128, dtype=np.uint8))
    in_manifest(lambda m: m["cameras"]["side_left"].pop("detections"))(folder)
    in_manifest(lambda m: m["cameras"]["side_left"].update(images="side_left"))(folder)
    return folder


def nth_image(folder: Path, index: int) -> Path:
    return sorted((folder / "side_left").iterdir())[index]


def test_an_image_of_another_size_is_named(with_images: Path) -> None:
    path = nth_image(with_images, 2)
    cv2.imwrite(str(path), np.full((480, 640), 128, dtype=np.uint8))
    line = refused(with_images)
    assert path.name in line
    assert "640 x 480" in line
    assert "1280 x 1024" in line


def test_an_image_that_is_cut_off_is_named(with_images: Path) -> None:
    path = nth_image(with_images, 1)
    path.write_bytes(path.read_bytes()[:200])
    assert path.name in refused(with_images)


def test_an_image_that_is_none_is_named(with_images: Path) -> None:
    path = nth_image(with_images, 3)
    path.write_bytes(b"not an image")
    assert path.name in refused(with_images)


def test_a_name_without_a_time_stamp_is_named(with_images: Path) -> None:
    nth_image(with_images, 0).rename(with_images / "side_left" / "first.png")
    line = refused(with_images)
    assert "first.png" in line


def test_images_that_do_not_show_the_board_are_told(with_images: Path) -> None:
    ran = calibrate(with_images)
    assert ran.code == 1
    assert "camera 'side_left' has no views: the board was not found in any of its images" in ran.err
    assert not (with_images.parent / "calibration.json").exists()


def test_an_older_result_stays_where_a_new_run_fails(folder: Path) -> None:
    assert calibrate(folder, "-q").code == 0
    before = (folder.parent / "calibration.json").read_bytes()
    in_row("platform.csv", 12, field(2, "nan"))(folder)
    refused(folder)
    assert (folder.parent / "calibration.json").read_bytes() == before
