"""Images of a VRS file: each as it was written, at its capture time stamp."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from vrs_support import Stream, image_stream, write_vrs

from gtcal.errors import GtcalError
from gtcal.recordings.vrs_images import image_streams, vrs_images

pytest.importorskip("pyvrs")

PICTURES = [np.random.default_rng(i).integers(0, 255, (48, 64), dtype=np.uint8) for i in range(5)]
TIMES_S = [12.25 + 0.1 * i for i in range(5)]
CAPTURED_NS = [9_007_199_254_740_993 + 100_000_001 * i for i in range(5)]  # no float64 holds these
IMU = Stream(1202, 1, "custom", [(12.3, b"abcd")])


def file(folder: Path, *, captured: list[int] | None = CAPTURED_NS, pixel: str = "grey8") -> Path:
    return write_vrs(folder / "a.vrs", [image_stream(PICTURES, TIMES_S, captured, pixel=pixel), IMU])


def test_images_are_as_written_at_their_capture_times(tmp_path: Path) -> None:
    images = vrs_images(file(tmp_path), "1201-1", 7)
    assert images.stamps_ns.tolist() == [stamp + 7 for stamp in CAPTURED_NS]
    assert images.notes == ()
    for index in (3, 0, 4, 1, 2):
        np.testing.assert_array_equal(images.read(index), PICTURES[index])
    with pytest.raises(GtcalError, match=r"image 0 of stream 1201-1: the image is 64 x 48 pixels, but .* 48 x 64"):
        images.expecting(48, 64).read(0)


def test_without_capture_times_those_of_the_records_are_taken_and_said(tmp_path: Path) -> None:
    images = vrs_images(file(tmp_path, captured=None), "1201-1")
    assert images.stamps_ns.tolist() == [12_250_000_000 + 100_000_000 * i for i in range(5)]
    assert "no capture_timestamp_ns; the time stamps of their records are taken" in images.notes[0]


def test_images_are_in_order_of_their_capture_times(tmp_path: Path) -> None:
    images = vrs_images(file(tmp_path, captured=CAPTURED_NS[::-1]), "1201-1")
    assert images.stamps_ns.tolist() == CAPTURED_NS
    np.testing.assert_array_equal(images.read(0), PICTURES[4])


def test_colour_becomes_grey(tmp_path: Path) -> None:
    colour = [np.dstack([picture] * 3) for picture in PICTURES]
    path = write_vrs(tmp_path / "a.vrs", [image_stream(colour, TIMES_S, CAPTURED_NS, pixel="rgb8")])
    images = vrs_images(path, "1201-1")
    np.testing.assert_array_equal(images.read(1), PICTURES[1])


def test_streams_with_images_are_listed(tmp_path: Path) -> None:
    path = file(tmp_path)
    assert image_streams(path) == {"1201-1": 5}
    with pytest.raises(GtcalError, match=r"name the 'stream' .*; streams with images: 1201-1 \(5\)"):
        vrs_images(path, None)
    for name in ("1202-1", "214-1"):
        with pytest.raises(GtcalError, match=rf"has no stream '{name}' with images; streams .*: 1201-1 \(5\)"):
            vrs_images(path, name)


def test_repeated_capture_times_are_refused(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=f"two images of stream 1201-1 have the time stamp {CAPTURED_NS[1]} ns"):
        vrs_images(file(tmp_path, captured=[*CAPTURED_NS[:2], CAPTURED_NS[1], *CAPTURED_NS[3:]]), "1201-1")


def test_pixels_that_are_no_grey_are_refused(tmp_path: Path) -> None:
    depths = [np.zeros((48, 64), np.float32) for _ in PICTURES]
    path = write_vrs(tmp_path / "a.vrs", [image_stream(depths, TIMES_S, CAPTURED_NS, pixel="undefined")])
    with pytest.raises(GtcalError, match=r"image 0 of stream 1201-1: can't be"):
        vrs_images(path, "1201-1").read(0)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6, 0.95])
def test_a_cut_off_file_is_told(share: float, tmp_path: Path) -> None:
    path = file(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(GtcalError, match=r"a\.vrs: is .*cut off"):
        vrs_images(path, "1201-1")


def test_what_ends_the_library_does_not_end_this_program(tmp_path: Path) -> None:
    """An index with a record of a stream that isn't there."""
    path = file(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[:-2] + (301).to_bytes(2, "little"))
    with pytest.raises(GtcalError, match="is damaged: VRS's reader does not survive reading it"):
        vrs_images(path, "1201-1")
    path.write_bytes(content)
    assert len(vrs_images(path, "1201-1")) == len(PICTURES)


@pytest.mark.parametrize("from_the_end", [80, 4])
def test_nor_does_a_record_that_ends_it(from_the_end: int, tmp_path: Path) -> None:
    """An index with sizes of records that are none: at the first, and at the last."""
    path = write_vrs(tmp_path / "a.vrs", [image_stream(PICTURES, TIMES_S, CAPTURED_NS)])
    content = path.read_bytes()
    at = len(content) - from_the_end
    path.write_bytes(content[:at] + b"\xff\xff\xff\x7f" + content[at + 4 :])
    with pytest.raises(GtcalError, match="is damaged: VRS's reader does not survive reading it"):
        vrs_images(path, "1201-1")


def test_other_files_are_no_vrs(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    (tmp_path / "a.vrs").write_text("hello")
    with pytest.raises(GtcalError, match=r"a\.vrs: is not a VRS file that can be read"):
        vrs_images(tmp_path / "a.vrs", "1201-1")
    assert capfd.readouterr() == ("", "")


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvrs", None)
    with pytest.raises(GtcalError, match=r"pip install 'gtcal\[vrs\]'"):
        vrs_images(tmp_path / "a.vrs", "1201-1")
