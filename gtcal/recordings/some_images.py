"""A part of a recording's images and corners, evenly spread over its time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, Images, ImageSequence
from gtcal.recordings.recording import Recording

FEWEST = 3

_IN_COMMON = 0.1


@dataclass(frozen=True)
class SomeImages:
    """Those at ``index`` (V,), increasing, of images that are kept in one file."""

    of: Images
    index: IntArray

    @property
    def stamps_ns(self) -> IntArray:
        return self.of.stamps_ns[self.index]

    @property
    def size_px(self) -> tuple[int, int] | None:
        return self.of.size_px

    @property
    def notes(self) -> tuple[str, ...]:
        return self.of.notes

    @property
    def files(self) -> tuple[Path, ...]:
        return self.of.files

    @property
    def inputs(self) -> tuple[Path, ...]:
        return self.of.inputs

    @property
    def source(self) -> str:
        return self.of.source

    def __len__(self) -> int:
        return len(self.index)

    def expecting(self, width_px: int, height_px: int) -> SomeImages:
        return replace(self, of=self.of.expecting(width_px, height_px))

    def read(self, index: int) -> GreyImage:
        return self.of.read(int(self.index[index]))

    def entry(self, camera: str, folder: Path) -> dict[str, Any]:
        """Raises GtcalError: a manifest points to all of a file's images."""
        raise GtcalError(f"camera {camera!r}: a manifest can't name some of the images in {self.files[0]}")


def some_of(recording: Recording, *, every: int = 1, views: int | None = None) -> Recording:
    """The recording with every Nth of its images and views, and of these at most ``views`` a camera, evenly
    spread. Of cameras that are triggered together the same moments are taken.

    Raises GtcalError for less than every image, or views that are too few."""
    if every < 1:
        raise GtcalError(f"every: {every} is less than 1")
    if views is not None and views < FEWEST:
        raise GtcalError(f"views: {views} are fewer than {FEWEST}, which a camera's extrinsic needs")
    if every == 1 and views is None:
        return recording
    stamps_ns = {name: _stamps_ns(recording, name) for name in recording.cameras}
    if _triggered_together(stamps_ns):
        of_all = list(stamps_ns.values())
        taken = dict.fromkeys(stamps_ns, _chosen(np.unique(np.concatenate(of_all)), every, views, of_all))
    else:
        taken = {name: _chosen(own, every, views, [own]) for name, own in stamps_ns.items()}
    return replace(
        recording,
        images={name: _some(images, taken[name]) for name, images in recording.images.items()},
        detections={
            name: found.select_views(np.isin(found.stamps_ns, taken[name]))
            for name, found in recording.detections.items()
        },
    )


def _stamps_ns(recording: Recording, name: str) -> IntArray:
    """Of a camera's images, or of its views where it has none."""
    return (recording.images[name] if name in recording.images else recording.detections[name]).stamps_ns


def _triggered_together(stamps_ns: Mapping[str, IntArray]) -> bool:
    """Whether cameras have many stamps in common, which those with clocks of their own have by rare chance."""
    _, counts = np.unique(np.concatenate(list(stamps_ns.values())), return_counts=True)
    return bool(np.mean(counts > 1) > _IN_COMMON)


def _chosen(moments_ns: IntArray, every: int, views: int | None, of_cameras: Sequence[IntArray]) -> IntArray:
    """Every Nth of the moments, or so many of those, evenly, that no camera has more than ``views`` among them."""
    moments_ns = moments_ns[::every]
    most = max(_n_among(stamps, moments_ns) for stamps in of_cameras)
    if views is None or most <= views:
        return moments_ns
    n = -(-views * len(moments_ns) // most)
    while True:
        chosen = moments_ns[np.linspace(0, len(moments_ns) - 1, n).round().astype(np.int64)]
        if max(_n_among(stamps, chosen) for stamps in of_cameras) <= views:
            return chosen
        n -= 1


def _n_among(stamps_ns: IntArray, moments_ns: IntArray) -> int:
    return int(np.isin(stamps_ns, moments_ns).sum())


def _some(images: Images, taken_ns: IntArray) -> Images:
    index = np.flatnonzero(np.isin(images.stamps_ns, taken_ns))
    if len(index) == len(images):
        return images
    if isinstance(images, ImageSequence):
        paths = tuple(images.paths[i] for i in index.tolist())
        return replace(images, stamps_ns=images.stamps_ns[index], paths=paths)
    return SomeImages(images, index)
