"""Images of bags, ROS 1 and ROS 2: every encoding as grey, at the stamps of the headers."""

from __future__ import annotations

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from media_support import compressed_message, image_message, write_bag

from gtcal.errors import GtcalError
from gtcal.recordings.bag_images import bag_images, image_topics

pytest.importorskip("rosbags")

STORAGES = ("ros1", "sqlite3", "mcap")
N = 6
PICTURES = [np.random.default_rng(i).integers(0, 255, (12, 16), dtype=np.uint8) for i in range(N)]
HEADER_NS = [1_606_153_907_495_166_541 + 33_333_333 * i for i in range(N)]
RECEIVED_NS = [stamp + 5_000_001 for stamp in HEADER_NS]
COLOUR = np.random.default_rng(9).integers(0, 255, (12, 16, 3), dtype=np.uint8)


def messages(*makers) -> list:
    return list(zip(RECEIVED_NS, HEADER_NS, makers, strict=False))


def bag(folder: Path, storage: str = "ros1", *makers, topic: str = "/cam0") -> Path:
    makers = makers or tuple(image_message(picture) for picture in PICTURES)
    path = folder / ("a.bag" if storage == "ros1" else f"a_{storage}")
    return write_bag(path, {topic: messages(*makers)}, storage=storage)


@pytest.mark.parametrize("storage", STORAGES)
def test_images_are_as_written_at_the_stamps_of_their_headers(storage: str, tmp_path: Path) -> None:
    images = bag_images(bag(tmp_path, storage), "/cam0", 7)
    assert images.stamps_ns.tolist() == [stamp + 7 for stamp in HEADER_NS]
    assert images.notes == ()
    with ThreadPoolExecutor(3) as pool:
        for index, found in zip((3, 0, 5, 1), pool.map(images.read, (3, 0, 5, 1)), strict=True):
            np.testing.assert_array_equal(found, PICTURES[index])
    with pytest.raises(GtcalError, match=rf"/cam0 at {HEADER_NS[0]} ns: the image is 16 x 12 pixels, but .* 12 x 16"):
        images.expecting(12, 16).read(0)


@pytest.mark.parametrize("name", ["a_mcap.mcap", "a_sqlite3.db3"])
def test_the_file_of_a_ros2_bag_will_do(name: str, tmp_path: Path) -> None:
    path = bag(tmp_path, name[2:].split(".")[0])
    images = bag_images(path / name, "/cam0")
    np.testing.assert_array_equal(images.read(2), PICTURES[2])


def grey(code: int, pixels: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(pixels, code)


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("mono8", PICTURES[0], PICTURES[0]),
        ("8UC1", PICTURES[0], PICTURES[0]),
        ("bgr8", COLOUR, grey(cv2.COLOR_BGR2GRAY, COLOUR)),
        ("rgb8", COLOUR, grey(cv2.COLOR_RGB2GRAY, COLOUR)),
        ("bgra8", np.dstack([COLOUR, PICTURES[0]]), grey(cv2.COLOR_BGR2GRAY, COLOUR)),
        ("rgba8", np.dstack([COLOUR, PICTURES[0]]), grey(cv2.COLOR_RGB2GRAY, COLOUR)),
        ("yuv422", np.dstack([PICTURES[1], PICTURES[0]]), PICTURES[0]),
        ("yuv422_yuy2", np.dstack([PICTURES[0], PICTURES[1]]), PICTURES[0]),
    ],
)
def test_encodings_become_grey(encoding: str, pixels: np.ndarray, expected: np.ndarray, tmp_path: Path) -> None:
    path = bag(tmp_path, "ros1", image_message(pixels, encoding, padding=5))
    np.testing.assert_array_equal(bag_images(path, "/cam0").read(0), expected)


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_mosaics_become_the_grey_of_their_colour(order: str, tmp_path: Path) -> None:
    red, green, blue = 200, 100, 40
    of = {"r": red, "g": green, "b": blue}
    mosaic = np.empty((12, 16), np.uint8)
    for place, letter in zip(((0, 0), (0, 1), (1, 0), (1, 1)), order, strict=True):
        mosaic[place[0] :: 2, place[1] :: 2] = of[letter]
    found = bag_images(bag(tmp_path, "ros1", image_message(mosaic, f"bayer_{order}8")), "/cam0").read(0)
    expected = 0.299 * red + 0.587 * green + 0.114 * blue
    np.testing.assert_allclose(found[2:-2, 2:-2], expected, atol=1.0)


@pytest.mark.parametrize("storage", STORAGES)
def test_compressed_images_are_read(storage: str, tmp_path: Path) -> None:
    encoded = cv2.imencode(".png", PICTURES[0])[1].tobytes()
    path = bag(tmp_path, storage, compressed_message(encoded, "mono8; png compressed"))
    np.testing.assert_array_equal(bag_images(path, "/cam0").read(0), PICTURES[0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (image_message(PICTURES[0].astype(np.uint16), "mono16"), "encoding 'mono16' can't be read; scale it to 8 bits"),
        (image_message(COLOUR, "8UC3"), "encoding '8UC3' can't be read; encodings: mono8"),
        (image_message(PICTURES[0], "bgr8"), r"192 bytes in rows of 16 are no 16 x 12 image of bgr8"),
        (compressed_message(b"abc"), r"not an image that can be read \(3 bytes\)"),
        (compressed_message(b"\x89PNG abc"), "the image file is cut off"),
        (compressed_message(b"abc", "16UC1; compressedDepth png"), "is a depth image"),
    ],
)
def test_what_is_no_8_bit_image_is_refused(make, message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=rf"a\.bag, /cam0 at {HEADER_NS[0]} ns: .*{message}") as caught:
        bag_images(bag(tmp_path, "ros1", make), "/cam0").read(0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("storage", STORAGES)
def test_topics_with_images_are_listed(storage: str, tmp_path: Path) -> None:
    path = bag(tmp_path, storage)
    assert image_topics(path) == {"/cam0": N}
    with pytest.raises(GtcalError, match=rf"name the 'topic' .*; topics with images: /cam0 \({N}\)"):
        bag_images(path, None)
    with pytest.raises(GtcalError, match=rf"has no topic '/cam1'; topics with images: /cam0 \({N}\)"):
        bag_images(path, "/cam1")


def test_a_topic_of_another_type_is_named(tmp_path: Path) -> None:
    def make(store, stamp_ns: int):
        return store.types["std_msgs/msg/UInt8"](data=1)

    path = write_bag(tmp_path / "a.bag", {"/cam0": messages(image_message(PICTURES[0])), "/n": messages(make)})
    with pytest.raises(GtcalError, match=r"the topic '/n' holds std_msgs/msg/UInt8, no images; .*: /cam0 \(1\)"):
        bag_images(path, "/n")


@pytest.mark.parametrize(
    ("headers_ns", "message"),
    [
        ([0, 0], r"the headers of '/cam0' have no stamps \(all are 0\)"),
        ([5, 5], "two images of '/cam0' have the same header stamp 5 ns"),
    ],
)
def test_stamps_that_can_not_be_used_are_told(headers_ns: list[int], message: str, tmp_path: Path) -> None:
    rows = [(1_000 + i, stamp, image_message(PICTURES[i])) for i, stamp in enumerate(headers_ns)]
    with pytest.raises(GtcalError, match=message):
        bag_images(write_bag(tmp_path / "a.bag", {"/cam0": rows}), "/cam0")


def test_images_are_in_order_of_their_headers(tmp_path: Path) -> None:
    rows = [(10**9 + i, 10**9 + stamp, image_message(PICTURES[i])) for i, stamp in enumerate((30, 10, 20))]
    images = bag_images(write_bag(tmp_path / "a.bag", {"/cam0": rows}), "/cam0")
    assert images.stamps_ns.tolist() == [10**9 + 10, 10**9 + 20, 10**9 + 30]
    np.testing.assert_array_equal(images.read(0), PICTURES[1])


def test_headers_of_another_clock_are_taken_and_said(tmp_path: Path) -> None:
    rows = [(stamp, stamp - HEADER_NS[0] + 10**9, image_message(PICTURES[i])) for i, stamp in enumerate(HEADER_NS)]
    images = bag_images(write_bag(tmp_path / "a.bag", {"/cam0": rows}), "/cam0")
    assert images.stamps_ns[0] == 10**9
    assert "s before the times of recording, so of another clock" in images.notes[0]


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.95])
def test_a_cut_off_bag_is_told(storage: str, share: float, tmp_path: Path) -> None:
    path = bag(tmp_path, storage)
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(GtcalError, match=r"is not a ROS bag that can be read|cut off|damaged") as caught:
        bag_images(path, "/cam0").read(N - 1)
    assert "\n" not in str(caught.value)


def test_other_files_are_no_bags(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_text("hello")
    (tmp_path / "b").mkdir()
    for name in ("a.bag", "b"):
        with pytest.raises(GtcalError, match=rf"{name}: is not a ROS bag that can be read"):
            bag_images(tmp_path / name, "/cam0")


def test_metadata_nested_without_end_are_told_at_once(tmp_path: Path) -> None:
    path = bag(tmp_path, "sqlite3")
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text() + "x: " + "[" * 2000)
    started = time.process_time()
    with pytest.raises(GtcalError, match=r"metadata\.yaml: is not valid YAML: .*depth"):
        bag_images(path, "/cam0")
    assert time.process_time() - started < 1.0


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(GtcalError, match=r"pip install 'gtcal\[bags\]'"):
        bag_images(tmp_path / "a.bag", "/cam0")
