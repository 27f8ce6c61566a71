"""Videos: every frame as it was encoded, at its own time stamp, in whatever order it is asked for."""

from __future__ import annotations

import random
import sys
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from media_support import write_video

from gtcal.errors import GtcalError
from gtcal.recordings.video_images import video_images

pytest.importorskip("av")

N = 60
PICTURES = [np.random.default_rng(i).integers(0, 255, (48, 64), dtype=np.uint8) for i in range(N)]
PTS = [33 * i + (i % 3) for i in range(N)]


def test_stamps_are_exact_and_frames_are_as_encoded(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", PICTURES, PTS)
    offset_ns = 1_606_153_907_495_166_541
    images = video_images(path, offset_ns)
    assert images.stamps_ns.dtype == np.int64
    assert images.stamps_ns.tolist() == [offset_ns + 1_000_000 * stamp for stamp in PTS]
    assert images.notes == ()
    for index, picture in enumerate(PICTURES):
        np.testing.assert_array_equal(images.read(index), picture)


def test_a_time_base_that_is_no_decimal_is_rounded_by_whole_numbers(tmp_path: Path) -> None:
    base, stamps = Fraction(1, 90_000), [3_003 * i for i in range(N)]
    path = write_video(tmp_path / "a.mp4", PICTURES, stamps, time_base=base, codec="libx264", pixel_format="yuv420p")
    expected = [round(stamp * base * 10**9) for stamp in stamps]
    assert np.abs(video_images(path, 0).stamps_ns - expected).max() == 0


@pytest.mark.parametrize("codec", ["ffv1", "libx264"])
def test_frames_may_be_asked_for_in_any_order_and_by_threads(codec: str, tmp_path: Path) -> None:
    """With B-frames across key frames far apart, which is where counting frames after a seek goes wrong."""
    smooth = [np.full((48, 64), 4 * i, np.uint8) for i in range(N)]
    options = {} if codec == "ffv1" else {"g": "20", "bf": "2", "qp": "0", "x264-params": "open-gop=1"}
    pixel_format = "gray" if codec == "ffv1" else "yuv420p"
    path = write_video(tmp_path / "a.mkv", smooth, PTS, codec=codec, pixel_format=pixel_format, options=options)
    images = video_images(path, 0)
    order = [*range(N), *range(N)]
    random.Random(0).shuffle(order)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda index: float(images.read(index).mean()), order))
    np.testing.assert_allclose(found, [4.0 * index for index in order], atol=1.5)


def test_an_uneven_rate_is_taken_and_said(tmp_path: Path) -> None:
    pts = [0, 33, 67, 200, 233, *range(300, 300 + 33 * (N - 5), 33)]
    images = video_images(write_video(tmp_path / "a.mkv", PICTURES, pts), 0)
    assert images.stamps_ns[:5].tolist() == [0, 33_000_000, 67_000_000, 200_000_000, 233_000_000]
    assert "its frame rate varies (intervals of 33.0 to 133.0 ms)" in images.notes[0]


def test_stamps_count_from_the_first_frame(tmp_path: Path) -> None:
    images = video_images(write_video(tmp_path / "a.mkv", PICTURES, [500 + stamp for stamp in PTS]), 3)
    assert images.stamps_ns.tolist() == [3 + 1_000_000 * stamp for stamp in PTS]
    np.testing.assert_array_equal(images.read(7), PICTURES[7])


# The matrix that an MP4 shows a track by: as it is, and turned by a quarter.
UPRIGHT = bytes.fromhex("00010000" + 3 * "00000000" + "00010000" + 3 * "00000000" + "40000000")
TURNED = bytes.fromhex("00000000" + "00010000" + "00000000" + "ffff0000" + 4 * "00000000" + "40000000")


def test_a_video_marked_as_turned_is_taken_as_stored_and_said(tmp_path: Path) -> None:
    base = Fraction(1, 25)
    path = write_video(tmp_path / "a.mp4", PICTURES, range(N), time_base=base, codec="libx264", pixel_format="yuv420p")
    upright = video_images(path, 0)
    data = path.read_bytes()
    at = data.rindex(UPRIGHT)  # the track's comes after the movie's
    path.write_bytes(data[:at] + TURNED + data[at + len(TURNED) :])
    turned = video_images(path, 0)
    assert "marked to be shown turned by -90 deg; the frames are taken as they are stored, 64 x 48" in turned.notes[0]
    np.testing.assert_array_equal(turned.read(5), upright.read(5))


def test_an_interlaced_video_is_refused(tmp_path: Path) -> None:
    options = {"flags": "+ilme+ildct", "x264-params": "tff=1"}
    path = write_video(tmp_path / "a.mkv", PICTURES, PTS, codec="libx264", pixel_format="yuv420p", options=options)
    with pytest.raises(GtcalError, match=r"a\.mkv: is interlaced: each frame is two half images"):
        video_images(path, 0)


def test_colour_becomes_grey(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", [np.dstack([p] * 3) for p in PICTURES], PTS, pixel_format="bgr0")
    assert int(np.abs(video_images(path, 0).read(4).astype(int) - PICTURES[4]).max()) <= 1


def test_deep_pixels_are_scaled_and_said(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", PICTURES, PTS, pixel_format="gray10le")
    images = video_images(path, 0)
    assert "pixels of 10 bits are scaled to 8" in images.notes[0]
    assert int(np.abs(images.read(3).astype(int) - PICTURES[3]).max()) <= 1


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.9])
@pytest.mark.parametrize("suffix", [".mkv", ".mp4", ".avi"])
def test_a_cut_off_video_is_told(suffix: str, share: float, tmp_path: Path) -> None:
    codec, pixel_format = ("ffv1", "gray") if suffix == ".mkv" else ("mjpeg", "yuvj420p")
    path = write_video(
        tmp_path / f"a{suffix}", PICTURES, range(N), time_base=Fraction(1, 25), codec=codec, pixel_format=pixel_format
    )
    assert len(video_images(path, 0)) == N
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(GtcalError, match=rf"a{suffix}: .*(cut off|holds no)") as caught:
        video_images(path, 0)
    assert "\n" not in str(caught.value)


def test_a_damaged_frame_is_told(tmp_path: Path) -> None:
    path = write_video(
        tmp_path / "a.avi", PICTURES, range(N), time_base=Fraction(1, 25), codec="mjpeg", pixel_format="yuvj420p"
    )
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 200] = b"\xff\xd9" * 100  # ends of images
    path.write_bytes(data)
    images = video_images(path, 0)
    with pytest.raises(GtcalError, match=r"a\.avi: (the frame before )?frame \d+ .*(can't be decoded|damaged)"):
        list(map(images.read, range(N)))


def damaged(path: Path, seed: int) -> Path:
    """A copy with three bytes in its middle eight tenths changed."""
    chance = random.Random(seed)
    data = bytearray(path.read_bytes())
    at = chance.randrange(len(data) // 10, 9 * len(data) // 10)
    for i in range(at, at + 3):
        data[i] ^= chance.randrange(1, 256)
    copy = path.with_stem(f"damaged_{seed}")
    copy.write_bytes(data)
    return copy


def outcome(path: Path, right: list[np.ndarray]) -> str:
    try:
        images = video_images(path, 0)
        frames = [images.read(index) for index in range(len(images))]
    except GtcalError as error:
        return "told" if str(error).startswith(str(path)) and "\n" not in str(error) else str(error)
    same = len(frames) == len(right) and all(map(np.array_equal, frames, right))
    return "same" if same else "unseen"


def test_damage_in_lossless_video_is_always_told(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", PICTURES, PTS, options={"slicecrc": "1", "level": "3"})
    assert outcome(path, PICTURES) == "same"
    found = [outcome(damaged(path, seed), PICTURES) for seed in range(30)]
    assert "unseen" not in found
    assert found.count("told") > 25


@pytest.mark.long
def test_damage_in_h264_is_mostly_told(tmp_path: Path) -> None:
    moving = [np.roll(np.kron(PICTURES[0], np.ones((4, 4), np.uint8)), i, axis=1) for i in range(N)]
    path = write_video(
        tmp_path / "a.mp4", moving, range(N), time_base=Fraction(1, 30), codec="libx264", pixel_format="yuv420p"
    )
    right = [video_images(path, 0).read(index) for index in range(N)]
    found = [outcome(damaged(path, seed), right) for seed in range(30)]
    assert found.count("told") >= 20


@pytest.mark.long
@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_a_healthy_video_whose_groups_are_open_is_read_in_any_order(codec: str, tmp_path: Path) -> None:
    parameters = f"{codec.removeprefix('lib')}-params"
    path = write_video(
        tmp_path / "a.mp4",
        [np.kron(picture, np.ones((4, 4), np.uint8)) for picture in PICTURES],
        range(N),
        time_base=Fraction(1, 30),
        codec=codec,
        pixel_format="yuv420p",
        options={parameters: "open-gop=1:keyint=12:min-keyint=12:bframes=3:log-level=none"},
    )
    images, again = video_images(path, 0), video_images(path, 0)
    right = [images.read(index) for index in range(N)]
    for index in random.Random(0).sample(range(N), N):
        np.testing.assert_array_equal(again.read(index), right[index])


def test_streams_are_named(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", PICTURES, PTS)
    assert len(video_images(path, 0, "0")) == N
    with pytest.raises(GtcalError, match=r"has no video stream '1'; video streams: 0 \(64 x 48\)"):
        video_images(path, 0, "1")


def test_several_streams_need_one_named(tmp_path: Path) -> None:
    import av

    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("ffv1", rate=30) for _ in range(2)]
        for stream in streams:
            stream.width, stream.height, stream.pix_fmt = 64, 48, "gray"
        for i in range(4):
            for k, stream in enumerate(streams):
                frame = av.VideoFrame.from_ndarray(PICTURES[10 * k + i], format="gray")
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode(None))
    with pytest.raises(GtcalError, match=r"holds 2 video streams; name one with 'stream': 0 \(64 x 48\), 1"):
        video_images(path, 0)
    np.testing.assert_array_equal(video_images(path, 0, "1").read(2), PICTURES[12])


def test_tags_that_are_no_text_are_no_hindrance(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", PICTURES[:3], [0, 40, 80])
    content = path.read_bytes()
    assert b"Lavf" in content
    path.write_bytes(content.replace(b"Lavf", b"\xff\x80\xfe\xff"))
    assert len(video_images(path, 0)) == 3


def test_other_files_are_no_videos(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("hello")
    with pytest.raises(GtcalError, match=r"a\.mp4: is not a video that can be read"):
        video_images(tmp_path / "a.mp4", 0)
    with pytest.raises(GtcalError, match=r"b\.mp4: is not a video that can be read, or is cut off: No such file"):
        video_images(tmp_path / "b.mp4", 0)


def test_a_frame_of_another_size_is_refused(tmp_path: Path) -> None:
    images = video_images(write_video(tmp_path / "a.mkv", PICTURES, PTS), 0)
    assert images.expecting(64, 48).read(0).shape == (48, 64)
    with pytest.raises(GtcalError, match=r"a\.mkv, frame 5: the image is 64 x 48 pixels, but .* 48 x 64"):
        images.expecting(48, 64).read(5)


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(GtcalError, match=r"pip install 'gtcal\[video\]'"):
        video_images(tmp_path / "a.mkv", 0)
