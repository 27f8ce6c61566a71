"""Which board images show, as far as its tags tell: their dictionary, how many there are, and how they are arranged.

Sizes in metres no image tells, nor the gap between tags to the hundredth: these are for the user to measure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from gtcal.board import aruco_dictionary
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage, Images, read_if_whole

# Families that hold each other are represented by their largest member: DICT_4X4_50 is the head of DICT_4X4_1000.
_ARUCO = {bits: tuple(f"DICT_{bits}X{bits}_{n}" for n in (50, 100, 250, 1000)) for bits in (4, 5, 6, 7)}
_APRILTAGS = ("DICT_APRILTAG_36h11", "DICT_APRILTAG_36h10", "DICT_APRILTAG_25h9", "DICT_APRILTAG_16h5")
_KALIBR_BORDER = 2
_USUAL = [(members[-1], 1) for members in _ARUCO.values()] + [(_APRILTAGS[0], 1), (_APRILTAGS[0], _KALIBR_BORDER)]
# All dictionaries are tried on a few images, the one that is found on more.
_FEW_IMAGES, _MOST_IMAGES, _FEWEST_IMAGES = 8, 40, 4
# Threshold in grey levels and enlargement, the next where the ones before read nothing: the small tags of a ChArUco
# board, or of a board far away, need what ``gtcal.detection.tags`` tries too.
_PASSES = ((7, 1), (25, 1), (7, 2), (3, 2))
# Fewer tags are read by chance in any picture.
_FEWEST_TAGS = 3
_SURE_TAGS, _FEWEST_TO_ARRANGE, _MOST_COLUMNS = 8, 6, 40
# A tag alone has no others beside it to vouch for it: its id must be read in this many images, and no other as often.
_FEWEST_SIGHTINGS = 3
# An arrangement must place the tags this well, in units of the grid, and another one must not do so in as many images
# and nearly as well.
_FITS, _FITS_BETTER = 0.15, 2.0


@dataclass(frozen=True)
class BoardGuess:
    """What the tags in some images tell.

    kind: 'aprilgrid', 'aruco_grid', 'charuco'. dictionary: OpenCV's name, the smallest that holds the ids.
    ids: all tag ids that were read. columns, rows: of tags (charuco: of squares), None where they don't tell.
    first_tag_id: of the whole board, where the arrangement is known.
    """

    kind: str
    dictionary: str
    ids: IntArray
    columns: int | None
    rows: int | None
    first_tag_id: int = 0


@dataclass(frozen=True)
class LoneTag:
    """The one tag that images show, as on a Lollypop. dictionary: OpenCV's name, the smallest that holds the id."""

    dictionary: str
    tag_id: int


@dataclass(frozen=True)
class _Seen:
    """Tags of one image: ids (F,) and corners_px (F, 4, 2)."""

    ids: IntArray
    corners_px: FloatArray

    @property
    def centres_px(self) -> FloatArray:
        return self.corners_px.mean(axis=1)


@dataclass
class _Arranged:
    """How well one arrangement fits: rms in units of the grid, of each image."""

    kind: str
    columns: int
    rms: list[float] = field(default_factory=list)

    @property
    def n_fitting(self) -> int:
        """The images that it fits."""
        return sum(rms <= _FITS for rms in self.rms)

    @property
    def typical(self) -> float:
        return float(np.median(self.rms)) if self.rms else np.inf


def guess_board(images: Images, *, thorough: bool = False) -> BoardGuess | None:
    """From some images, evenly spread, those that can't be read left out. None where none shows three tags of one
    dictionary. thorough: look for small and faint tags too, as the detector does, which takes its time.

    Raises GtcalError where an image is of another size."""
    passes = _PASSES if thorough else _PASSES[:1]
    reading = next((one for how in passes if (one := _first_reading(images, how)) is not None), None)
    if reading is None:
        return None
    (family, border), how = reading
    shown = _whole(images, _MOST_IMAGES)
    seen = [found for image in shown if len((found := _read(image, family, border, how)).ids)]
    counts = Counter(int(i) for found in seen for i in found.ids)
    # An id read once in many images is a misreading where others are read over and over.
    often = 1 if len(seen) < 4 else 2
    ids = np.array(sorted(i for i, count in counts.items() if count >= often), dtype=np.int64)
    if len(ids) < _FEWEST_TAGS:
        return None
    seen = [_of(found, ids) for found in seen]
    return _described(seen, ids, family, border)


def guess_lone_tag(images: Images) -> LoneTag | None:
    """The one tag that some images show, evenly spread, those that can't be read left out. None where they show none,
    or several of one dictionary.

    Raises GtcalError where an image is of another size."""
    shown = list(_whole(images, _MOST_IMAGES))
    for dictionary, border in _codes():
        if border == _KALIBR_BORDER:  # such tags are of grids
            continue
        ids = Counter(int(i) for image in shown for i in set(_read(image, dictionary, border, _PASSES[0]).ids.tolist()))
        often = [tag for tag, count in ids.items() if count >= _FEWEST_SIGHTINGS]
        if often:
            return LoneTag(_smallest(dictionary, often[0]), often[0]) if len(often) == 1 else None
    return None


def _first_reading(images: Images, how: tuple[int, int]) -> tuple[tuple[str, int], tuple[int, int]] | None:
    first = how == _PASSES[0]
    codes = list(_codes()) if first else _USUAL
    code = _best_code(list(_whole(images, _FEW_IMAGES if first else _FEWEST_IMAGES)), codes, how)
    return None if code is None else (code, how)


def _whole(images: Images, most: int) -> Iterator[GreyImage]:
    """At most so many that can be read, evenly spread."""
    for index in _spread(len(images), most):
        image = read_if_whole(images, index)
        if not isinstance(image, GtcalError):
            yield image


def _spread(n: int, most: int) -> list[int]:
    """At most so many of n, evenly spread."""
    return [int(i) for i in np.unique(np.linspace(0, n - 1, most).astype(int))]


def _described(seen: list[_Seen], ids: IntArray, family: str, border: int) -> BoardGuess:
    kinds = ("aprilgrid",) if border == _KALIBR_BORDER else ("aruco_grid", "charuco")
    dictionary = family if border == _KALIBR_BORDER else _smallest(family, int(ids.max()))
    found = _arrangement(seen, ids, kinds)
    if found is None:
        return BoardGuess(kinds[0], dictionary, ids, None, None)
    lowest, highest = _grid(found.kind, found.columns, ids)[:, 1][[0, -1]].astype(int)
    first_row = 0 if found.kind == "charuco" else int(lowest)
    rows = int(highest) - first_row + 1
    return BoardGuess(found.kind, dictionary, ids, found.columns, rows, first_row * found.columns)


def _of(found: _Seen, ids: IntArray) -> _Seen:
    kept = np.isin(found.ids, ids)
    return _Seen(found.ids[kept], found.corners_px[kept])


def _codes() -> Iterator[tuple[str, int]]:
    """Each dictionary to try, and the modules of its border; those in wide use first."""
    yield _APRILTAGS[0], _KALIBR_BORDER
    yield from ((members[-1], 1) for members in _ARUCO.values())
    yield "DICT_ARUCO_ORIGINAL", 1
    yield _APRILTAGS[0], 1
    yield from ((family, border) for family in _APRILTAGS[1:] for border in (1, _KALIBR_BORDER))


def _best_code(shown: list[GreyImage], codes: list[tuple[str, int]], how: tuple[int, int]) -> tuple[str, int] | None:
    """The dictionary and border of which an image shows enough tags to be sure, else that of which most are read."""
    total: Counter[tuple[str, int]] = Counter()
    for image in shown:
        for code in codes:
            total[code] += len(_read(image, *code, how).ids)
            if total[code] >= _SURE_TAGS:
                return code
    (best, n), *_ = total.most_common(1)
    return best if n >= _FEWEST_TAGS else None


def _read(image: GreyImage, dictionary: str, border: int, how: tuple[int, int]) -> _Seen:
    """Without correcting errors: a chance reading is worse here than a missed tag. how: one of ``_PASSES``."""
    threshold, scale = how
    shown = image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale)
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    parameters.errorCorrectionRate = 0.0
    parameters.adaptiveThreshConstant = threshold
    quads, ids, _ = cv2.aruco.ArucoDetector(aruco_dictionary(dictionary), parameters).detectMarkers(shown)
    if ids is None or not len(ids):
        return _Seen(np.empty(0, dtype=np.int64), np.empty((0, 4, 2)))
    return _Seen(ids.ravel().astype(np.int64), (np.concatenate(quads).astype(np.float64) + 0.5) / scale - 0.5)


def _smallest(family: str, largest_id: int) -> str:
    """The smallest dictionary of the family that holds the id."""
    members = next((members for members in _ARUCO.values() if family in members), (family,))
    return next(name for name in members if largest_id < len(aruco_dictionary(name).bytesList))


def _arrangement(seen: list[_Seen], ids: IntArray, kinds: tuple[str, ...]) -> _Arranged | None:
    """The arrangement that places the tags of every image, None where none does, or two do nearly as well."""
    enough = sorted((found for found in seen if len(found.ids) >= _FEWEST_TO_ARRANGE), key=lambda f: -len(f.ids))[:6]
    candidates = [
        _fitted(enough, kind, columns)
        for kind in kinds
        for columns in range(2, min(int(ids.max()) + 2, _MOST_COLUMNS + 1))
    ]
    best, *others = sorted(candidates, key=lambda c: (-c.n_fitting, c.typical))
    if best.typical > _FITS:
        return None
    as_good = [c for c in others if c.n_fitting == best.n_fitting and c.typical < _FITS_BETTER * best.typical]
    return None if as_good else best


def _fitted(seen: list[_Seen], kind: str, columns: int) -> _Arranged:
    arranged = _Arranged(kind, columns)
    for found in seen:
        grid = _grid(kind, columns, found.ids)
        if np.linalg.matrix_rank(grid - grid.mean(axis=0)) < 2:
            continue
        grid_H_image, _ = cv2.findHomography(found.centres_px, grid, 0)
        if grid_H_image is None:
            continue
        off = cv2.perspectiveTransform(found.centres_px[:, None], grid_H_image)[:, 0] - grid
        arranged.rms.append(float(np.sqrt((off**2).sum(axis=1).mean())))
    return arranged


def _grid(kind: str, columns: int, ids: IntArray) -> FloatArray:
    """(F, 2) where the tags lie, in units of the pitch (charuco: of the squares), row by row. Which way up does not
    matter to a homography."""
    if kind != "charuco":
        return np.stack([ids % columns, ids // columns], axis=1).astype(np.float64)
    squares = np.arange(2 * (int(ids.max()) + 1 + columns))
    white = squares[(squares // columns + squares % columns) % 2 == 1]
    return np.stack([white[ids] % columns, white[ids] // columns], axis=1).astype(np.float64)
