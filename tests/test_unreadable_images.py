"""Images that can't be read are left out, counted and warned of, up to a share of all."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import wandering_trajectory

from factors import PINHOLE_RADTAN
from gtcal.board import PRESETS
from gtcal.camera import Camera
from gtcal.detection.board_guess import guess_board
from gtcal.detection.detect import cached_detect, detect
from gtcal.doctor.manifest_lines import ManifestFile
from gtcal.doctor.opening import opened
from gtcal.errors import GtcalError
from gtcal.readers import write_euroc_csv
from gtcal.recordings.images import MOST_UNREADABLE, ImageSequence, first_whole, image_folder, left_out
from gtcal.recordings.manifest import load_fields

N = 40
CAMERA = Camera("cam0", PINHOLE_RADTAN, None, 64, 48)


@pytest.fixture
def images(tmp_path: Path) -> ImageSequence:
    for i in range(N):
        cv2.imwrite(str(tmp_path / f"{1_000_000_000 + 50_000_000 * i}.png"), np.full((48, 64), 128, np.uint8))
    return image_folder(tmp_path)


def spoil(images: ImageSequence, *which: int) -> None:
    for index in which:
        images.paths[index].write_bytes(b"")


@pytest.mark.parametrize("which", [0, N - 1])
def test_one_bad_image_is_left_out_and_told_each_time(
    which: int, images: ImageSequence, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spoil(images, which)
    assert first_whole(images).shape == (48, 64)
    guess_board(images)
    for _ in range(2):  # found, and kept from before
        caplog.clear()
        with caplog.at_level(logging.WARNING, logger="gtcal"):
            cached_detect(tmp_path, "cam0", images, PRESETS["paper_a2"], CAMERA)
        assert (
            f"1 of {N} images of cam0 can't be read and are left out; the first: {images.paths[which]}" in caplog.text
        )


def test_too_many_are_an_error(images: ImageSequence) -> None:
    spoil(images, *range(N - 3, N))
    with pytest.raises(GtcalError, match=rf"not an image.*; 3 of {N} images of cam0 can't be read, too many to leave"):
        detect(images, PRESETS["paper_a2"], CAMERA)
    spoil(images, *range(N))
    with pytest.raises(GtcalError, match="not an image that can be read"):
        first_whole(images)


def test_the_share_that_may_be_left_out() -> None:
    error = GtcalError("x.png: not an image")
    assert left_out("cam0", [], 1) == ""
    assert left_out("cam0", [error], round(1 / MOST_UNREADABLE))
    with pytest.raises(GtcalError, match="too many"):
        left_out("cam0", [error], round(1 / MOST_UNREADABLE) - 1)


def test_another_size_is_an_error_in_any_number(images: ImageSequence) -> None:
    cv2.imwrite(str(images.paths[7]), np.zeros((64, 48), np.uint8))
    with pytest.raises(GtcalError, match="48 x 64 pixels, but the camera's image size is 64 x 48"):
        detect(images, PRESETS["paper_a2"], CAMERA)


@pytest.mark.parametrize("stated_px", ["[640, 500]", "[10, 70]"])
def test_the_size_of_the_others_is_told_where_the_first_is_bad(
    stated_px: str, images: ImageSequence, tmp_path: Path
) -> None:
    spoil(images, 0)
    write_euroc_csv(tmp_path / "board.csv", wandering_trajectory("board"))
    manifest = tmp_path / "recording.yaml"
    manifest.write_text(
        "gtcal_recording: 1\ncapture: fixed_cameras\nboard: {preset: paper_a2}\n"
        f"cameras:\n  cam0: {{model: fisheye62, image_size_px: {stated_px}, images: .}}\n"
        "board_body: {trajectory: board.csv, format: euroc_csv}\n"
    )
    (found, *_) = opened(ManifestFile(manifest, load_fields(manifest)))
    assert found.recording.cameras["cam0"].image_width_px == 64
    assert found.refusals[0][1] == ("cameras.cam0.image_size_px: [64, 48]",)
