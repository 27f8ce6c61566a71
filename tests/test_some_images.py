"""A part of a recording: which images and views are used, and what is said of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_support import simulated
from cli_support import run

from gtcal import GtcalError, Recording, some_of, write_recording
from gtcal.recordings.images import ImageSequence
from gtcal.recordings.recording import load_recording
from gtcal.recordings.some_images import SomeImages


def stamps_of(recording: Recording) -> dict[str, np.ndarray]:
    return {name: found.stamps_ns for name, found in recording.detections.items()}


@pytest.fixture(scope="module", name="recording")
def _recording() -> Recording:
    return simulated(frames=60).recording


def test_all_is_the_default(recording: Recording) -> None:
    for name, stamps_ns in stamps_of(some_of(recording)).items():
        np.testing.assert_array_equal(stamps_ns, recording.detections[name].stamps_ns)


def test_cameras_that_are_triggered_together_keep_the_same_moments(recording: Recording) -> None:
    moments = np.unique(np.concatenate(list(stamps_of(recording).values())))[::4]
    for name, stamps_ns in stamps_of(some_of(recording, every=4)).items():
        expected = moments[np.isin(moments, recording.detections[name].stamps_ns)]
        np.testing.assert_array_equal(stamps_ns, expected)


def test_so_many_views_are_spread_from_end_to_end(recording: Recording) -> None:
    few = some_of(recording, views=10)
    counts = [found.n_views for found in few.detections.values()]
    assert 9 <= max(counts) <= 10
    taken, moments = (np.unique(np.concatenate(list(stamps_of(one).values()))) for one in (few, recording))
    assert np.ptp(taken) > 0.9 * np.ptp(moments)
    assert some_of(recording, views=10_000).n_images == recording.n_images


def test_cameras_with_clocks_of_their_own_are_thinned_each_by_itself(recording: Recording) -> None:
    one, other, *_ = recording.detections
    later = recording.detections[one].stamps_ns + 250_000_000
    apart = replace(
        recording,
        cameras={name: recording.cameras[name] for name in (one, other)},
        detections={one: recording.detections[one], other: replace(recording.detections[one], stamps_ns=later)},
    )
    chosen = stamps_of(some_of(apart, every=2))
    np.testing.assert_array_equal(chosen[one], recording.detections[one].stamps_ns[::2])
    np.testing.assert_array_equal(chosen[other], later[::2])


def test_images_of_a_folder_stay_a_folder_and_those_of_one_file_are_read_by_their_place(recording: Recording) -> None:
    stamps_ns = np.arange(10, dtype=np.int64) * 10**9
    folder = ImageSequence(stamps_ns, tuple(Path(f"{i}.png") for i in range(10)))
    name = next(iter(recording.cameras))

    class InOneFile(ImageSequence):
        @property
        def files(self) -> tuple[Path, ...]:
            return (Path("video.mp4"),)

        def read(self, index: int) -> np.ndarray:
            return np.full((2, 2), index, dtype=np.uint8)

    of_one = replace(recording, cameras={name: recording.cameras[name]}, detections={}, images={name: folder})
    with_folder = some_of(of_one, views=4).images[name]
    assert isinstance(with_folder, ImageSequence)
    assert [path.stem for path in with_folder.paths] == ["0", "3", "6", "9"]
    some = SomeImages(InOneFile(stamps_ns, folder.paths), np.array([1, 4]))
    assert [int(some.expecting(2, 2).read(i)[0, 0]) for i in range(len(some))] == [1, 4]
    np.testing.assert_array_equal(some.stamps_ns, stamps_ns[[1, 4]])
    with pytest.raises(GtcalError, match=r"can't name some of the images in video\.mp4"):
        some.entry("cam0", Path())


@pytest.mark.parametrize(("choice", "said"), [({"every": 0}, "every: 0"), ({"views": 2}, "views: 2 are fewer than 3")])
def test_a_choice_that_makes_no_sense_is_refused(recording: Recording, choice: dict[str, int], said: str) -> None:
    with pytest.raises(GtcalError, match=said):
        some_of(recording, **choice)


def test_the_command_says_what_all_would_gain(recording: Recording, tmp_path: Path) -> None:
    write_recording(recording, tmp_path)
    plain = ("--no-effects", "--clock", "trust", "--mocap-noise", "exact")
    ran = run("calibrate", tmp_path, "-o", tmp_path / "c.json", "--views", "30", *plain)
    assert ran.code == 0
    used, total = some_of(recording, views=30).n_images, load_recording(tmp_path).n_images
    assert f"used {used} of {total} images; all would lower the largest 1-sigma" in ran.out
