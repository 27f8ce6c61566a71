from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pyarrow
import pytest
from pyarrow import parquet
from support import random_detections, replace_once

from factors import PINHOLE_RADTAN
from gtcal.board import PAPER_A2, AprilGrid, CharucoBoard
from gtcal.camera import Camera
from gtcal.errors import GtcalError
from gtcal.recordings.detection_files import read_detections, write_detections
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.numbering import stamps_of

BOARD = AprilGrid(tag_columns=6, tag_rows=6, tag_side_m=0.088, tag_spacing=0.3)
OFFSET_BOARD = AprilGrid(tag_columns=3, tag_rows=2, tag_side_m=0.088, tag_spacing=0.3, first_tag_id=7)
CAMERA = Camera("cam0", PINHOLE_RADTAN, None, 640, 480)
STAMPS_NS = 1606153863362296104 + 33_333_333 * np.arange(20)
HEADER = "timestamp_ns,corner_id,x_px,y_px"
BY_TAG = "timestamp_ns,tag_id,corner_index,x_px,y_px"


def csv(path: Path, *lines: str) -> Path:
    (path / "cam0.csv").write_text("\n".join(lines) + "\n")
    return path / "cam0.csv"


def assert_same(a: CameraDetections, b: CameraDetections) -> None:
    for name in ("stamps_ns", "view_start", "corner_ids", "corners_px"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_what_is_written_is_read_back_to_the_last_bit(tmp_path: Path) -> None:
    detections = random_detections(CAMERA, BOARD.n_corners, STAMPS_NS, seed=0)
    write_detections(tmp_path / "cam0.csv", detections)
    assert_same(read_detections(tmp_path / "cam0.csv", BOARD, CAMERA), detections)


def test_a_camera_that_saw_nothing_is_written_and_read_too(tmp_path: Path) -> None:
    write_detections(tmp_path / "cam0.csv", CameraDetections.from_views([]))
    assert read_detections(tmp_path / "cam0.csv", BOARD, CAMERA).n_views == 0


def test_rows_in_any_order_and_over_several_files_are_the_same_views(tmp_path: Path) -> None:
    detections = random_detections(CAMERA, BOARD.n_corners, STAMPS_NS, seed=1)
    write_detections(tmp_path / "cam0.csv", detections)
    rows = (tmp_path / "cam0.csv").read_text().splitlines()[1:]
    by_time_backward = sorted(rows, key=lambda row: -int(row.split(",")[0]))
    assert_same(read_detections(csv(tmp_path, HEADER, *by_time_backward), BOARD, CAMERA), detections)
    folder = tmp_path / "folder"
    folder.mkdir()
    for part in range(3):
        (folder / f"{part}.csv").write_text("\n".join([HEADER, *rows[part::3]]) + "\n")
    joined = read_detections(folder, BOARD, CAMERA)
    assert sorted(zip(joined.corner_ids.tolist(), joined.corners_px.tolist(), strict=True)) == sorted(
        zip(detections.corner_ids.tolist(), detections.corners_px.tolist(), strict=True)
    )
    np.testing.assert_array_equal(joined.view_start, detections.view_start)


def test_tags_are_named_by_their_printed_ids(tmp_path: Path) -> None:
    path = csv(tmp_path, BY_TAG, "5,7,0,1.5,2.5", "5,12,3,3,4")
    detections = read_detections(path, OFFSET_BOARD, CAMERA)
    assert detections.corner_ids.tolist() == [0, 23]
    assert detections.corners_px.tolist() == [[1.5, 2.5], [3, 4]]


def test_the_real_aprilgrid_folder(shared: Callable[[str], Path]) -> None:
    detections = read_detections(shared("data/vicon_aprilgrid/grid0/cam0/data"), BOARD, CAMERA)
    assert (detections.n_views, detections.n_corners) == (30, 4008)
    assert detections.stamps_ns[0] == 1606153907495166540
    assert np.diff(detections.view_start).min() == 63
    assert detections.corners_px[0].tolist() == [593.417603, 207.100677]
    assert detections.corner_ids[:4].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "board",
    [
        AprilGrid(tag_columns=6, tag_rows=6, tag_side_m=0.080, tag_spacing=0.3),
        AprilGrid(tag_columns=6, tag_rows=6, tag_side_m=0.088, tag_spacing=0.25),
        AprilGrid(tag_columns=9, tag_rows=4, tag_side_m=0.088, tag_spacing=0.3),
    ],
)
def test_an_aprilgrid_file_of_another_board_is_refused(board: AprilGrid, shared: Callable[[str], Path]) -> None:
    message = r"\.csv:\d+: tag \d+ corner \d lies at .* board of 6 x 6 tags of 88 mm, spacing 0\.3, .*AprilGrid"
    with pytest.raises(GtcalError, match=message):
        read_detections(shared("data/vicon_aprilgrid/grid0/cam0/data"), board, CAMERA)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            [HEADER, "5,0,1,2", "5,144,1,2"],
            r"cam0\.csv:3: corner_id 144 is not on the board; expected 0 to 143 \(April",
        ),
        ([HEADER, "5,-1,1,2"], r"cam0\.csv:2: corner_id -1 is not on the board"),
        ([BY_TAG, "5,36,0,1,2"], r"cam0\.csv:2: tag_id 36 is not on the board; expected 0 to 35"),
        ([BY_TAG, "5,3,4,1,2"], r"cam0\.csv:2: corner_index is 4; a tag has the corners 0 to 3"),
        ([HEADER, "5,0,1,nan"], r"cam0\.csv:2: y_px is nan; expected a finite number"),
        ([HEADER, "5,0,inf,2"], r"cam0\.csv:2: x_px is inf; expected a finite number"),
        ([HEADER, "5,0,1,two"], r"cam0\.csv:2: y_px is 'two'; expected a number"),
        ([HEADER, "5,0.5,1,2"], r"cam0\.csv:2: corner_id is '0\.5'; expected a whole number"),
        ([HEADER, "5,0,1,2", "5,1,1"], r"cam0\.csv:3: fields in the row: 3, expected 4 \(is the file cut off"),
        (
            [HEADER, "5,0,1,2", "6,0,1,2", "5,0,1,3"],
            r"cam0\.csv:4: tag 0 corner 0 appears twice in the view at 5 ns",
        ),
        (
            [HEADER, "5,0,640,2"],
            r"cam0\.csv:2: the pixel \(640, 2\) lies outside the 640 x 480 image of camera 'cam0'",
        ),
        ([HEADER, "5,0,1,-0.6"], r"cam0\.csv:2: the pixel \(1, -0\.6\) lies outside .* another size"),
        (
            ["time,id,x,y", "5,0,1,2"],
            r"cam0\.csv:1: the header is 'time,id,x,y', .*expected timestamp_ns,corner_id",
        ),
        (["5,0,1,2"], r"cam0\.csv:1: the header is '', not that of a file of detections"),
        ([""], r"cam0\.csv: the file is empty"),
    ],
)
def test_wrong_rows_are_named_by_file_and_line(lines: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        read_detections(csv(tmp_path, *lines), BOARD, CAMERA)
    assert "\n" not in str(caught.value)


def test_the_border_of_the_image_is_half_a_pixel_outside_the_outermost_centres(tmp_path: Path) -> None:
    path = csv(tmp_path, HEADER, "5,0,-0.5,-0.5", "5,1,639.5,479.5")
    assert read_detections(path, BOARD, CAMERA).n_corners == 2


def test_the_second_of_two_equal_corners_is_named_in_its_own_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{HEADER}\n5,0,1,2\n")
    (tmp_path / "b.csv").write_text(f"{HEADER}\n5,1,1,2\n5,0,1,2\n")
    with pytest.raises(GtcalError, match=r"b\.csv:3: tag 0 corner 0 appears twice"):
        read_detections(tmp_path, BOARD, CAMERA)


def test_boards_without_tag_corners_are_not_named_by_tag(tmp_path: Path) -> None:
    charuco = CharucoBoard("DICT_5X5_100", 8, 6, 0.04, 0.03)
    with pytest.raises(GtcalError, match=r"cam0\.csv: .*no grid of tags \(ChArUco"):
        read_detections(csv(tmp_path, BY_TAG, "5,0,0,1,2"), charuco, CAMERA)
    assert read_detections(csv(tmp_path, HEADER, "5,34,1,2"), charuco, CAMERA).n_corners == 1


def test_missing_files_and_empty_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=r"absent\.csv: there is no such file"):
        read_detections(tmp_path / "absent.csv", PAPER_A2, CAMERA)
    with pytest.raises(GtcalError, match=r"there is no \.csv or \.parquet file in this folder"):
        read_detections(tmp_path, PAPER_A2, CAMERA)


def test_a_truncated_aprilgrid_file_is_named(tmp_path: Path, shared: Callable[[str], Path]) -> None:
    source = next(iter(sorted(shared("data/vicon_aprilgrid/grid0/cam0/data").glob("*.csv"))))
    copy = tmp_path / source.name
    copy.write_text(source.read_text()[:-30])
    with pytest.raises(GtcalError, match=rf"{source.name}:\d+: fields in the row: \d+, expected 12"):
        read_detections(tmp_path, BOARD, CAMERA)
    copy.write_text(source.read_text())
    replace_once(copy, "565.545105", "NaN")
    with pytest.raises(GtcalError, match=rf"{source.name}:3: kp_x is nan"):
        read_detections(tmp_path, BOARD, CAMERA)


def test_parquet_is_read_back_to_the_last_bit_too(tmp_path: Path) -> None:
    detections = random_detections(CAMERA, BOARD.n_corners, STAMPS_NS, seed=0)
    write_detections(tmp_path / "cam0.parquet", detections)
    assert_same(read_detections(tmp_path / "cam0.parquet", BOARD, CAMERA), detections)
    assert (tmp_path / "cam0.parquet").stat().st_size < 20 * detections.n_corners
    numbered = replace(detections, stamps_ns=stamps_of(np.arange(20)))
    write_detections(tmp_path / "numbered.parquet", numbered, numbered=True)
    assert_same(read_detections(tmp_path / "numbered.parquet", BOARD, CAMERA, numbered=True), numbered)
    with pytest.raises(GtcalError, match=r"numbered\.parquet:1: the header .*set numbered: true"):
        read_detections(tmp_path / "numbered.parquet", BOARD, CAMERA)


def test_columns_of_parquet_come_in_any_order_with_others_and_as_frames_hold_them(tmp_path: Path) -> None:
    columns = {"y_px": np.float32([2.5]), "score": [0.9], "x_px": [1], "corner_index": np.int8([3]), "tag_id": [8]}
    frame = pandas.DataFrame(columns | {"timestamp_ns": pandas.to_datetime([STAMPS_NS[0]], unit="ns")})
    frame.to_parquet(tmp_path / "cam0.parquet")
    found = read_detections(tmp_path / "cam0.parquet", OFFSET_BOARD, CAMERA)
    assert (found.stamps_ns.tolist(), found.corner_ids.tolist()) == ([STAMPS_NS[0]], [7])
    np.testing.assert_array_equal(found.corners_px, [[1.0, 2.5]])


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("corner_id", [0, 999], r"cam0\.parquet: row 2: corner_id 999 is not on the board"),
        ("corner_id", [0.0, 1.0], r"cam0\.parquet: corner_id is a column of double; expected a whole number"),
        ("x_px", [1.0, np.nan], r"cam0\.parquet: row 2: x_px is nan; expected a number"),
        ("x_px", [1.0, None], r"cam0\.parquet: row 2: x_px is empty"),
        ("y_px", [1.0, 900.0], r"cam0\.parquet: row 2: the pixel \(1, 900\) lies outside"),
        ("y_px", ["1", "2"], r"cam0\.parquet: y_px is a column of .*string; expected a number"),
        ("corner_id", [3, 3], r"cam0\.parquet: row 2: tag 0 corner 3 appears twice in the view at 5 ns"),
    ],
)
def test_wrong_rows_of_parquet_are_named(column: str, values: list[object], message: str, tmp_path: Path) -> None:
    columns = {"timestamp_ns": [5, 5], "corner_id": [0, 1], "x_px": [1.0, 1.0], "y_px": [1.0, 1.0], column: values}
    parquet.write_table(pyarrow.table(columns), tmp_path / "cam0.parquet")
    with pytest.raises(GtcalError, match=message):
        read_detections(tmp_path / "cam0.parquet", BOARD, CAMERA)


def test_a_damaged_parquet_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "cam0.parquet"
    write_detections(path, random_detections(CAMERA, BOARD.n_corners, STAMPS_NS, seed=0))
    whole = path.read_bytes()
    for damaged in (b"", b"timestamp_ns", whole[:-40], whole[:60] + bytes(400) + whole[460:]):
        path.write_bytes(damaged)
        with pytest.raises(GtcalError, match=r"cam0\.parquet: is no Parquet file, or damaged: \S"):
            read_detections(path, BOARD, CAMERA)


@pytest.fixture
def _by_arrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gtcal.recordings.text_table._WORTH_ARROW", 0)


@pytest.mark.usefixtures("_by_arrow")
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_large_csvs_are_read_as_small_ones(end: str, tmp_path: Path) -> None:
    detections = random_detections(CAMERA, BOARD.n_corners, STAMPS_NS, seed=0)
    write_detections(tmp_path / "cam0.csv", detections)
    text = (tmp_path / "cam0.csv").read_text()
    for written in (text, "\ufeff# corners\n\n" + text.replace(",", " ,"), text.rstrip() + "\n# the end\n"):
        (tmp_path / "cam0.csv").write_bytes(written.replace("\n", end).encode())
        assert_same(read_detections(tmp_path / "cam0.csv", BOARD, CAMERA), detections)


@pytest.mark.usefixtures("_by_arrow")
@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("6,0,1,", r"cam0\.csv:3: y_px is empty; expected a number"),
        ("6,0,1,nan", r"cam0\.csv:3: y_px is nan"),
        ('"6",0,1,1', r"cam0\.csv:3: time stamp '\"6\"' is not a finite number"),
        ("6,0,1", r"cam0\.csv:3: fields in the row: 3, expected 4"),
        ("6,999,1,1", r"cam0\.csv:3: corner_id 999 is not on the board"),
    ],
)
def test_wrong_rows_of_large_csvs_are_named_as_of_small_ones(row: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message):
        read_detections(csv(tmp_path, HEADER, "5,0,1,2", row), BOARD, CAMERA)
