"""Image sequences: time stamps from names or lists, and every file that can't be used named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from gtcal.errors import GtcalError
from gtcal.recordings.images import image_folder, image_list, read_grey

STAMPS_NS = (1_606_153_907_495_166_540, 1_606_153_907_528_499_873, 1_606_153_907_561_833_206)
PICTURE = (np.indices((12, 16)).sum(axis=0) * 9).astype(np.uint8)


def write(folder: Path, names: list[str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), PICTURE + i)
    return folder


def test_a_folder_is_read_in_order_of_time(tmp_path: Path) -> None:
    folder = write(tmp_path / "images", ["1000000000.png", "900000000.png", "1100000000.png"])
    (folder / "notes.txt").write_text("not an image")
    (folder / ".1200000000.png").write_text("hidden")
    images = image_folder(folder)
    assert len(images) == 3
    np.testing.assert_array_equal(images.stamps_ns, [900_000_000, 1_000_000_000, 1_100_000_000])
    assert images.stamps_ns.dtype == np.int64
    np.testing.assert_array_equal(images.read(0), PICTURE + 1)
    assert images.notes == ()


def test_nanoseconds_of_today_are_exact(tmp_path: Path) -> None:
    images = image_folder(write(tmp_path, [f"{stamp}.png" for stamp in STAMPS_NS]))
    assert tuple(images.stamps_ns.tolist()) == STAMPS_NS


def test_colour_becomes_grey(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), np.dstack([PICTURE, PICTURE, PICTURE]))
    grey = read_grey(tmp_path / "1.png")
    assert grey.dtype == np.uint8
    np.testing.assert_array_equal(grey, PICTURE)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], "holds no images"),
        (["frame_7.png"], "'frame_7' is no time stamp; expected integer nanoseconds"),
        (["1606153907.4951.png"], "'1606153907.4951' is no time stamp"),
        (["99999999999999999999.png"], "'99999999999999999999' is no time stamp"),
        (["-5.png"], "'-5' is no time stamp"),
        (["1000000000.png", "1000000000.jpg"], "have the same time stamp 1000000000 ns"),
        (["1000000000.png", "01000000000.png"], "have the same time stamp 1000000000 ns"),
        (["0.png", "1.png", "2.png"], "are 1 ns apart, so these are frame numbers or another unit"),
    ],
)
def test_a_folder_that_can_not_be_used_is_told(names: list[str], message: str, tmp_path: Path) -> None:
    folder = write(tmp_path / "images", names)
    with pytest.raises(GtcalError, match=message) as caught:
        image_folder(folder)
    assert str(folder) in str(caught.value)


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match="nowhere: there is no such folder of images"):
        image_folder(tmp_path / "nowhere")


def listing(folder: Path, text: str) -> Path:
    path = folder / "data.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "header", ["#timestamp [ns],filename\n", "timestamp [ns],filename\n", "timestamp_ns,name\n", ""]
)
def test_a_list_names_files_by_time(header: str, tmp_path: Path) -> None:
    write(tmp_path / "data", ["b.png", "a.png"])
    images = image_list(listing(tmp_path, header + f"{STAMPS_NS[0]},a.png\n{STAMPS_NS[1]}, b.png\n\n"))
    np.testing.assert_array_equal(images.stamps_ns, STAMPS_NS[:2])
    assert [path.name for path in images.paths] == ["a.png", "b.png"]
    assert images.notes == ()


def test_a_list_may_point_to_any_folder_or_its_own(tmp_path: Path) -> None:
    text = f"{STAMPS_NS[0]},a.png\n"
    write(tmp_path / "elsewhere", ["a.png"])
    path = listing(tmp_path, text)
    assert image_list(path, tmp_path / "elsewhere").paths == (tmp_path / "elsewhere" / "a.png",)
    assert image_list(listing(tmp_path / "elsewhere", text)).paths == (tmp_path / "elsewhere" / "a.png",)


def test_another_extension_is_taken_and_said(tmp_path: Path) -> None:
    write(tmp_path / "data", ["a.jpg", "b.png"])
    images = image_list(listing(tmp_path, f"{STAMPS_NS[0]},a.png\n{STAMPS_NS[1]},b.png\n"))
    assert [path.name for path in images.paths] == ["a.jpg", "b.png"]
    assert "1 of 2 listed images are not there under the listed name" in images.notes[0]
    assert "a.jpg for a.png" in images.notes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lists no images"),
        ("#timestamp [ns],filename\n", "lists no images"),
        ("#timestamp [s],filename\n5,a.png\n", "data.csv:1: the time stamps are in 's'; expected ns"),
        ("timestamp_us,filename\n5,a.png\n", "data.csv:1: the time stamps are in 'us'; expected ns"),
        ("5.5,a.png\n", "data.csv:1: '5.5,a.png'; expected 'timestamp,filename'"),
        ("5\n", "data.csv:1: '5'; expected 'timestamp,filename'"),
        ("5,\n", "data.csv:1: '5,'; expected 'timestamp,filename'"),
        ("5000000,a.png\nx,a.png\n", "data.csv:2: 'x,a.png'; expected"),
        ("5000000,a.png\n5000000,b.png\n", "data.csv:2: time stamp 5000000 ns is not after the one before, 5000000"),
        ("5000000,a.png\n4000000,b.png\n", "data.csv:2: time stamp 4000000 ns is not after the one before, 5000000"),
        ("1,a.png\n2,b.png\n", "are 1 ns apart"),
        ("5000000,c.png\n", "lists 'c.png', which is not in"),
        ("5000000,d.tiff\n", r"of the others there \(d.png, d.jpg\) any could be meant"),
    ],
)
def test_a_list_that_can_not_be_used_is_told(text: str, message: str, tmp_path: Path) -> None:
    write(tmp_path / "data", ["a.png", "b.png", "d.png", "d.jpg"])
    with pytest.raises(GtcalError, match=message) as caught:
        image_list(listing(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_missing_lists_and_folders_are_told(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=r"data\.csv: the list of images can't be read"):
        image_list(tmp_path / "data.csv")
    with pytest.raises(GtcalError, match="nowhere: there is no such folder"):
        image_list(listing(tmp_path, "5000000,a.png\n"), tmp_path / "nowhere")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".bmp", ".pgm", ".webp"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.97])
def test_a_cut_off_image_is_refused(suffix: str, share: float, tmp_path: Path) -> None:
    path = tmp_path / f"1{suffix}"
    cv2.imwrite(str(path), cv2.resize(PICTURE, (640, 480)))
    assert read_grey(path).shape == (480, 640)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(GtcalError, match=f"1{suffix}: (the image file is cut off|not an image that can be read)"):
        read_grey(path)


def test_other_files_are_no_images(tmp_path: Path) -> None:
    path = tmp_path / "1000000000.png"
    path.write_text("hello")
    with pytest.raises(GtcalError, match=r"not an image that can be read \(5 bytes\)"):
        image_folder(tmp_path).read(0)
    path.unlink()
    with pytest.raises(GtcalError, match="the image can't be read"):
        read_grey(path)


def test_an_image_of_another_size_is_refused(tmp_path: Path) -> None:
    images = image_folder(write(tmp_path, ["1000000000.png"]))
    assert images.expecting(16, 12).read(0).shape == (12, 16)
    with pytest.raises(GtcalError, match="16 x 12 pixels, but the camera's image size is 12 x 16"):
        images.expecting(12, 16).read(0)
