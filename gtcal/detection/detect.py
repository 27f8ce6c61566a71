"""The board's corners in a sequence of images: on all cores, and kept beside the recording for the next time."""

from __future__ import annotations

import hashlib
import json
import logging
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from gtcal.board import Board, TaggedBoard
from gtcal.camera import Camera
from gtcal.detection.corner_search import PredictedBoard, SeenBoard
from gtcal.detection.many_images import Looking, Seen, look_at
from gtcal.detection.view_detection import detect_view as detect_view
from gtcal.errors import GtcalError
from gtcal.files import MiB, sha256_of, write_aside
from gtcal.npz import load_arrays
from gtcal.progress import Progress, silent
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.images import Images, left_out
from gtcal.verification.lollypop import Lollypop

CACHE_FOLDER = ".gtcal"

SAMPLED = 10
"""One in so many images that should not show the board is searched."""

# What decides what is found: a cache made by another version of one of these isn't taken.
DETECTOR = (
    "factors.camera_models",
    "gtcal.board",
    "gtcal.board_base",
    "gtcal.camera",
    "gtcal.plain_boards",
    *(
        f"gtcal.detection.{name}"
        for name in (
            "cholesky",
            "corner_search",
            "dots",
            "lens_guess",
            "local_warp",
            "plain_view",
            "refinement",
            "sight",
            "tags",
            "view_detection",
        )
    ),
    "gtcal.recordings.images",
    "gtcal.verification.lollypop",
    "gtcal.verification.lollypop_detection",
)

_log = logging.getLogger("gtcal")


def detect(
    images: Images,
    board: Board | Lollypop,
    camera: Camera | None = None,
    *,
    progress: Progress = silent,
    workers: int | None = None,
    of_all: int | None = None,
) -> CameraDetections:
    """Find the board in every image, as ``detect_view`` does, or a Lollypop, on ``workers`` cores (default: all that
    there are). What is found does not depend on their number.

    camera: where it has parameters, they help to predict corners. Views where the board isn't recognised are left
    out; where that is all of them, a warning of the logger "gtcal" says what was seen instead. of_all: how many images
    there are to detect in, where these are a part of them: many are worth processes, few are looked at in threads.

    Images that can't be read are left out, and a warning says how many.

    Raises GtcalError where more than MOST_UNREADABLE of them can't, or one isn't of the camera's size."""
    found, warning = _detect(images, board, camera, progress, workers, of_all=of_all)
    if warning:
        _log.warning("%s", warning)
    return found


@dataclass(frozen=True)
class Guidance:
    """What is known of a camera's images before the board is looked for in all of them.

    seen: by index, of those that were looked at already. predicted: by index, where the board should be."""

    seen: Mapping[int, Seen] = field(default_factory=dict)
    predicted: Mapping[int, PredictedBoard] = field(default_factory=dict)


class Guide(Protocol):
    """Gives a camera's guidance, by its name."""

    @property
    def rests_on(self) -> str:
        """A fingerprint of what that is computed from."""

    def __call__(self, camera_name: str) -> Guidance: ...


def _detect(
    images: Images,
    board: Board | Lollypop,
    camera: Camera | None,
    progress: Progress,
    workers: int | None,
    guidance: Guidance | None = None,
    of_all: int | None = None,
) -> tuple[CameraDetections, str]:
    """What is found, and what to say of images that can't be read."""
    guidance = guidance or Guidance()
    if camera is not None:
        images = images.expecting(camera.image_width_px, camera.image_height_px)
    name = camera.name if camera is not None else "the images"
    seen: list[Seen | None] = [None] * len(images)
    look = partial(look_at, images, looking=Looking(board, camera), jobs=workers, of_all=of_all or len(images))
    found = _looked_at(name, len(images), look, guidance)
    for done, (index, view) in enumerate(chain(guidance.seen.items(), found), start=1):
        seen[index] = view
        progress(f"detecting the board in {name}", done, len(images))
    warning = left_out(name, [view for view in seen if isinstance(view, GtcalError)], len(images))
    views = [
        (stamp, view.corner_ids, view.corners_px)
        for stamp, view in zip(images.stamps_ns.tolist(), seen, strict=True)
        if isinstance(view, SeenBoard) and len(view.corner_ids)
    ]
    if not views:
        _log.warning(
            "%s", _why_none(name, board, camera, [view.n_tags for view in seen if isinstance(view, SeenBoard)])
        )
    return CameraDetections.from_views(views), warning


def _looked_at(
    name: str, n_images: int, look: Callable[..., Iterator[tuple[int, Seen]]], guidance: Guidance
) -> Iterator[tuple[int, Seen]]:
    """What the images show that were not looked at before. The mocap's word that the board is outside an image is not
    taken unseen: every SAMPLED-th of those images is searched all the same, and where one shows the board, all are."""
    unsearched: dict[int, Seen] = {}
    left = [index for index in range(n_images) if index not in guidance.seen]
    for index, view in look(left, predicted=guidance.predicted):
        if isinstance(view, SeenBoard) and view.unsearched:
            unsearched[index] = view
        else:
            yield index, view
    if not unsearched:
        return
    sample = dict(look(sorted(unsearched)[::SAMPLED]))
    rest = sorted(unsearched.keys() - sample.keys())
    n_shown = sum(isinstance(view, SeenBoard) and len(view.corner_ids) > 0 for view in sample.values())
    yield from sample.items()
    if n_shown:
        _log.warning(
            "%s: by the mocap and a first calibration the board is outside %d images, but %d of %d that were searched "
            "all the same show it, so all are searched; does the mocap swap bodies or markers?",
            *(name, len(unsearched), n_shown, len(sample)),
        )
    yield from look(rest) if n_shown else ((index, unsearched[index]) for index in rest)


def cached_detect(
    recording_dir: Path,
    camera_name: str,
    images: Images,
    board: Board | Lollypop,
    camera: Camera | None = None,
    *,
    progress: Progress = silent,
    workers: int | None = None,
    redo: bool = False,
    guide: Guide | None = None,
    of_all: int | None = None,
) -> CameraDetections:
    """As ``detect``, but what was found is kept in ``.gtcal`` in the recording's folder and taken from there as long
    as the image files (names and contents), the board, the intrinsics and the detector are the same.

    redo: detect again all the same. A cache that can't be read is made anew, too. Where the folder can't be written,
    the corners are returned all the same, and a warning of the logger "gtcal" says so.

    guide: asked, where nothing is kept, for where the board should be. of_all: how many images of all cameras there are
    to detect in.

    Raises GtcalError where an image can't be read or isn't of the camera's size."""
    path = _cache_path(recording_dir, camera_name, images, board, camera)
    cached = None if redo else _read_cache(path, board, ("", guide.rests_on if guide is not None else ""))
    if cached is not None:
        progress(f"detecting the board in {camera_name} (kept from before)", len(images), len(images))
        return cached
    guidance = guide(camera_name) if guide is not None else None
    found, warning = _detect(images, board, camera, progress, workers, guidance, of_all)
    if warning:
        _log.warning("%s", warning)
    try:
        rests_on = guide.rests_on if guide is not None and guidance is not None and guidance.predicted else ""
        _write_cache(path, found, {_WARNING: warning, _GUIDE: rests_on})
    except GtcalError as error:
        _log.warning("the corners found in %s are not kept for the next time: %s", camera_name, error)
    return found


def kept_detections(
    recording_dir: Path, camera_name: str, images: Images, board: Board | Lollypop, camera: Camera | None = None
) -> CameraDetections | None:
    """What ``cached_detect`` kept, None where that is nothing or of other images.

    Raises GtcalError where an image file is gone."""
    return _read_cache(_cache_path(recording_dir, camera_name, images, board, camera), board)


def _cache_path(
    recording_dir: Path, camera_name: str, images: Images, board: Board | Lollypop, camera: Camera | None
) -> Path:
    key = _cache_key(images, board, camera)
    safe_name = re.sub(r"[^\w.-]", "_", camera_name)
    return recording_dir / CACHE_FOLDER / f"detections_{safe_name}_{key[:16]}.npz"


def _why_none(name: str, board: Board | Lollypop, camera: Camera | None, n_tags: list[int]) -> str:
    """What to say where no image shows the board. n_tags: how many of its tags were read in each image."""
    if isinstance(board, Board) and not isinstance(board, TaggedBoard):
        return (
            f"{name}: none of {len(n_tags)} images shows the board ({board.describe()}); check its columns and rows, "
            "and that all of it is in the image, with white around it"
        )
    # One or two of small codes are read by chance in any picture.
    some = sum(n >= min(3, len(board.tag_ids)) for n in n_tags)
    if not some:
        return (
            f"{name}: none of {len(n_tags)} images shows a tag of the board ({board.describe()}); "
            "check the board's dictionary and ids, and that the tags are large and sharp enough"
        )
    lens = " and the camera's parameters" if camera is not None and camera.parameters is not None else ""
    return (
        f"{name}: none of {len(n_tags)} images shows the board ({board.describe()}), but {some} show some of its tags, "
        "in other places than on the board or only one at a time; check the board's columns, rows, sides and gaps"
        + lens
    )


def _cache_key(images: Images, board: Board | Lollypop, camera: Camera | None) -> str:
    """A fingerprint of all that the corners depend on."""
    files = [(str(path.name), sha256_of(path)) for path in images.files]
    lens: Any = None
    if camera is not None:
        lens = [camera.model.name, camera.image_width_px, camera.image_height_px]
        lens.append(None if camera.parameters is None else camera.parameters.tolist())
    everything = {
        "detector": _detector_version(),
        "opencv": cv2.__version__,
        "board": board.to_manifest(),
        "lens": lens,
        "stamps_ns": images.stamps_ns.tolist(),
        "files": files,
        "source": images.source,
    }
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


def _files_of(module: str) -> list[Path]:
    """The source of a module, all of it for a package."""
    path = Path(str(import_module(module).__file__))
    return sorted(path.parent.glob("*.py")) if path.name == "__init__.py" else [path]


@lru_cache(maxsize=1)
def _detector_version() -> str:
    sources = (path.read_bytes() for name in DETECTOR for path in _files_of(name))
    return hashlib.sha256(b"\0".join(sources)).hexdigest()


def _read_cache(path: Path, board: Board | Lollypop, guides: tuple[str, ...] | None = None) -> CameraDetections | None:
    """What an earlier run kept, None where there is nothing whole, or what guided it is none of ``guides``."""
    if not path.is_file():
        return None
    try:
        kept = load_arrays(path, _MOST_CACHE_BYTES)
        found = CameraDetections(*(kept[name] for name in _CACHED))
        _check_whole(found, board)
        warning, guide = (str(kept[said]) if said in kept else "" for said in (_WARNING, _GUIDE))
    except Exception as error:  # whatever a damaged file makes numpy and zipfile raise
        _log.warning("%s is damaged (%s); the corners are detected again", path, error)
        return None
    if guides is not None and guide not in guides:
        return None
    if warning:
        _log.warning("%s", warning)
    return found


_WARNING = "warning"  # of images that can't be read; not in all
_GUIDE = "guide"  # what its guide rested on; not in all
_MOST_CACHE_BYTES = 512 * MiB
_CACHED = ("stamps_ns", "view_start", "corner_ids", "corners_px")


def _check_whole(found: CameraDetections, board: Board | Lollypop) -> None:
    start, ids = found.view_start, found.corner_ids
    whole = (
        all(column.dtype == np.int64 and column.ndim == 1 for column in (found.stamps_ns, start, ids))
        and found.corners_px.dtype == np.float64
        and len(start) == found.n_views + 1
        and start[0] == 0
        and start[-1] == found.n_corners
        and bool((np.diff(start) > 0).all())
        and found.corners_px.shape == (found.n_corners, 2)
        and bool(np.isfinite(found.corners_px).all())
        and bool((np.diff(found.stamps_ns) > 0).all())
        and bool(((ids >= 0) & (ids < board.n_corners)).all())
    )
    if not whole:
        raise ValueError("its columns don't fit together, or the board")


def _write_cache(path: Path, found: CameraDetections, said: dict[str, str]) -> None:
    columns: dict[str, Any] = {name: getattr(found, name) for name in _CACHED}
    columns |= {name: np.array(text) for name, text in said.items() if text}
    with write_aside(path, binary=True) as file:
        np.savez(file, **columns)
