"""The Lollypop: a hand-held device whose printed centre and mocap centroid coincide by construction.

Body frame: the rigid body that the mocap tracks. Its origin is the centroid of the markers, as mocap systems set it by
default. Face frame: origin in the middle of the printed pattern, x right along the upright print, y up, z out of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.board import ArucoGrid
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.recordings.detections import IntArray

Vector = tuple[float, float, float]

# Nobody holds up a device larger than this; 60 is millimetres written where metres belong.
_LARGEST_M = 1.0
_CENTRED_M = 5e-4
_DEFAULT_MARKER_DIAMETER_M = 0.008
_DEFAULT_TAPE_M = 0.00012
_SINGLE_TAG_GAP_OF_SIDE = 0.25  # a tag alone has no neighbour; the grid it is a case of asks for a gap


@dataclass(frozen=True)
class Face:
    """One printed face.

    board: its tag or small grid of tags.
    centre_in_body_m: the middle of the pattern; quat_wxyz: body_R_face as a unit quaternion."""

    board: ArucoGrid
    centre_in_body_m: Vector = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @cached_property
    def body_T_face(self) -> FloatArray:
        """(4, 4)."""
        w, x, y, z = self.quat_wxyz
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
        T[:3, 3] = self.centre_in_body_m
        return T

    @cached_property
    def corners_in_face_m(self) -> FloatArray:
        """(C, 3) the board's corners about the middle of the pattern."""
        return self.board.corners_m - self._middle_m

    @cached_property
    def body_T_board(self) -> FloatArray:
        """(4, 4) from the frame of the face's board, whose origin is at the lower left."""
        T = self.body_T_face.copy()
        T[:3, 3] -= T[:3, :3] @ self._middle_m
        return T

    @property
    def _middle_m(self) -> FloatArray:
        corners_m = self.board.corners_m
        return 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))


@dataclass(frozen=True)
class Lollypop:
    """A device. Corners are numbered face after face; within a face as on its board.

    markers_m: (x, y, z) of each retroreflective disc or ball in the body frame; empty where unknown.
    tape_thickness_m: how far the discs stand proud of the print.

    Raises GtcalError where a field is out of range, two faces share a tag, or the markers' centroid is not the
    centre of the only face."""

    faces: tuple[Face, ...]
    markers_m: tuple[Vector, ...] = ()
    marker_diameter_m: float = _DEFAULT_MARKER_DIAMETER_M
    tape_thickness_m: float = _DEFAULT_TAPE_M
    preset: str | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not self.faces:
            raise GtcalError("device field 'faces' is empty; expected one face or more")
        self._check_ids()
        self._check_lengths()
        if len(self.faces) == 1 and self.markers_m:
            self._check_centred()

    @property
    def dictionary(self) -> str:
        return self.faces[0].board.dictionary

    @property
    def n_corners(self) -> int:
        return int(self.face_start[-1])

    @property
    def border_modules(self) -> int:
        """Width of the black border around each code, in modules."""
        return self.faces[0].board.border_modules

    @cached_property
    def tag_ids(self) -> IntArray:
        """(T,) the ids of the tags, face after face."""
        return np.concatenate([face.board.tag_ids for face in self.faces])

    @cached_property
    def face_start(self) -> IntArray:
        """(F + 1,) the first corner id of each face, and the number of corners."""
        return np.cumsum([0, *(face.board.n_corners for face in self.faces)])

    @cached_property
    def corner_faces(self) -> IntArray:
        """(C,) the face of each corner."""
        return np.repeat(np.arange(len(self.faces)), np.diff(self.face_start))

    @cached_property
    def corners_m(self) -> FloatArray:
        """(C, 3) the corners in the body frame."""
        return np.concatenate(
            [face.corners_in_face_m @ face.body_T_face[:3, :3].T + face.body_T_face[:3, 3] for face in self.faces]
        )

    @cached_property
    def corners_in_face_m(self) -> FloatArray:
        """(C, 3) each corner in the frame of its own face."""
        return np.concatenate([face.corners_in_face_m for face in self.faces])

    @cached_property
    def centres_in_body_m(self) -> FloatArray:
        """(F, 3) the middle of each face's pattern in the body frame."""
        return np.array([face.centre_in_body_m for face in self.faces])

    @property
    def markers_in_body_m(self) -> FloatArray:
        """(M, 3)."""
        return np.array(self.markers_m, dtype=np.float64).reshape(-1, 3)

    def corner_name(self, corner_id: int) -> str:
        """What a person calls this corner, as 'tag 7 corner 2'."""
        face = int(self.corner_faces[corner_id])
        return self.faces[face].board.corner_name(corner_id - int(self.face_start[face]))

    def describe(self) -> str:
        """The device in one line."""
        ids = ", ".join(str(tag) for face in self.faces for tag in face.board.tag_ids.tolist())
        sides = sorted({1000 * face.board.tag_side_m for face in self.faces})
        of = "one face" if len(self.faces) == 1 else f"{len(self.faces)} faces"
        tags = f"tag {ids}" if "," not in ids else f"tags {ids}"
        return f"Lollypop of {of}, {tags} of {self.dictionary}, side {' and '.join(f'{s:g}' for s in sides)} mm"

    def to_manifest(self) -> dict[str, Any]:
        """The device as a manifest's ``device`` block; ``device_from_manifest`` reads it back."""
        if self.preset is not None:
            return {"preset": self.preset}
        block: dict[str, Any] = {"dictionary": self.dictionary, "faces": [_face_block(face) for face in self.faces]}
        if self.markers_m:
            block["markers_m"] = [list(marker) for marker in self.markers_m]
        block["marker_diameter_m"] = self.marker_diameter_m
        block["tape_thickness_m"] = self.tape_thickness_m
        return block

    def _check_ids(self) -> None:
        dictionaries = {face.board.dictionary for face in self.faces}
        if len(dictionaries) > 1:
            raise GtcalError(f"the device's faces are of {' and '.join(sorted(dictionaries))}; take one dictionary")
        distinct, counts = np.unique(self.tag_ids, return_counts=True)
        if (counts > 1).any():
            raise GtcalError(
                f"tag {distinct[np.argmax(counts)]} is on the device twice; every tag needs an id of its own"
            )

    def _check_lengths(self) -> None:
        if not 0.0 < self.marker_diameter_m <= 0.1:
            raise GtcalError(
                f"device field 'marker_diameter_m' is {self.marker_diameter_m:g}; expected 0 to 0.1 metres"
            )
        if not 0.0 <= self.tape_thickness_m <= 0.01:
            raise GtcalError(f"device field 'tape_thickness_m' is {self.tape_thickness_m:g}; expected 0 to 0.01 metres")
        for name, points in (("markers_m", self.markers_in_body_m), ("centre_in_body_m", self.centres_in_body_m)):
            if not np.isfinite(points).all() or (np.abs(points) > _LARGEST_M).any():
                raise GtcalError(
                    f"device field {name!r} has a coordinate beyond {_LARGEST_M:g} m; lengths are in metres: "
                    "60 mm is 0.06"
                )

    def _check_centred(self) -> None:
        off_m = self.markers_in_body_m.mean(axis=0) - self.centres_in_body_m[0]
        if np.linalg.norm(off_m) > _CENTRED_M:
            x, y, z = 1e3 * off_m
            raise GtcalError(
                f"the centroid of the device's markers lies ({x:.2f}, {y:.2f}, {z:.2f}) mm from its face's centre; "
                "by construction they coincide: check 'markers_m' and 'centre_offset_m'"
            )


def device_from_manifest(block: object) -> Lollypop:
    """The device that a manifest's ``device`` block, or a device file, describes:

    - ``{preset: paper_lollypop}``;
    - ``{dictionary: DICT_5X5_50, tag_id: 0, tag_side_m: 0.06}``: one tag, its middle at the body's origin or at
      ``centre_offset_m``. Or a small grid: ``tag_id`` is that of its first tag, with ``tag_columns``, ``tag_rows``
      and ``tag_gap_m``;
    - ``{dictionary: ..., faces: [...]}``: each face with the fields of a tag or grid and ``centre_in_body_m`` and
      ``quat_wxyz``, its pose in the body;

    and with each of the last two ``markers_m``, ``marker_diameter_m``, ``tape_thickness_m``.

    Raises GtcalError naming the field that is unknown, missing, of the wrong type or implausible."""
    if not isinstance(block, Mapping):
        raise GtcalError(f"'device' is {block!r}; expected fields, as 'preset: {PAPER_LOLLYPOP}' or 'dictionary: ...'")
    given = dict(block)
    if "preset" in given:
        return _preset(given)
    faces = _faces(given)
    _check_known("device", given, {*_DEVICE_FIELDS, *(() if "faces" in given else _ONE_FACE_FIELDS)})
    markers = given.get("markers_m", [])
    if not isinstance(markers, list | tuple):
        raise GtcalError(f"device field 'markers_m' is {markers!r}; expected a list of [x, y, z]")
    return Lollypop(
        faces=faces,
        markers_m=tuple(_vector(f"markers_m[{i}]", marker) for i, marker in enumerate(markers)),
        marker_diameter_m=_number("marker_diameter_m", given.get("marker_diameter_m", _DEFAULT_MARKER_DIAMETER_M)),
        tape_thickness_m=_number("tape_thickness_m", given.get("tape_thickness_m", _DEFAULT_TAPE_M)),
    )


def device_manifest_schema() -> dict[str, Any]:
    """The JSON schema of a manifest's ``device`` block."""
    numbers = {"type": "array", "items": {"type": "number"}}
    vector = {**numbers, "minItems": 3, "maxItems": 3}
    tag = {
        "tag_id": {"type": "integer", "minimum": 0},
        "tag_side_m": {"type": "number"},
        "tag_columns": {"type": "integer", "default": 1},
        "tag_rows": {"type": "integer", "default": 1},
        "tag_gap_m": {"type": "number"},
    }
    quat = {**numbers, "minItems": 4, "maxItems": 4}
    face = _object({**tag, "centre_in_body_m": vector, "quat_wxyz": quat}, ["tag_id", "tag_side_m"])
    common = {
        "dictionary": {"type": "string"},
        "markers_m": {"type": "array", "items": vector},
        "marker_diameter_m": {"type": "number", "default": _DEFAULT_MARKER_DIAMETER_M},
        "tape_thickness_m": {"type": "number", "default": _DEFAULT_TAPE_M},
    }
    return {
        "oneOf": [
            _object({"preset": {"enum": list(DEVICE_PRESETS)}}, ["preset"]),
            _object({**common, **tag, "centre_offset_m": vector}, ["dictionary", "tag_id", "tag_side_m"]),
            _object({**common, "faces": {"type": "array", "items": face, "minItems": 1}}, ["dictionary", "faces"]),
        ]
    }


_DEVICE_FIELDS = ("dictionary", "faces", "markers_m", "marker_diameter_m", "tape_thickness_m")
_TAG_FIELDS = ("tag_id", "tag_side_m", "tag_columns", "tag_rows", "tag_gap_m")
_ONE_FACE_FIELDS = (*_TAG_FIELDS, "centre_offset_m")
_FACE_FIELDS = (*_TAG_FIELDS, "centre_in_body_m", "quat_wxyz")


def _object(properties: dict[str, Any], required: list[str]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def _preset(given: dict[str, Any]) -> Lollypop:
    name = given.pop("preset")
    if given:
        raise GtcalError(f"'device' has a preset and also {', '.join(given)}; a preset stands alone")
    if name not in list(DEVICE_PRESETS):  # it may be a list, which has no hash
        raise GtcalError(f"device preset {name!r} is not known; presets: {', '.join(DEVICE_PRESETS)}")
    return DEVICE_PRESETS[name]


def _faces(given: dict[str, Any]) -> tuple[Face, ...]:
    dictionary = given.get("dictionary")
    if not isinstance(dictionary, str):
        raise GtcalError("device field 'dictionary' is missing; expected OpenCV's name, as DICT_5X5_50")
    if "faces" not in given:
        tag = {name: given[name] for name in _TAG_FIELDS if name in given}
        offset = _vector("centre_offset_m", given.get("centre_offset_m", (0.0, 0.0, 0.0)))
        return (Face(_board("device", dictionary, tag), offset),)
    blocks = given["faces"]
    if not isinstance(blocks, list | tuple):
        raise GtcalError(f"device field 'faces' is {blocks!r}; expected a list of faces")
    return tuple(_face(f"faces[{index}]", dictionary, block) for index, block in enumerate(blocks))


def _face(where: str, dictionary: str, block: object) -> Face:
    if not isinstance(block, Mapping):
        raise GtcalError(f"device field {where!r} is {block!r}; expected {', '.join(_FACE_FIELDS)}")
    _check_known(where, dict(block), set(_FACE_FIELDS))
    tag = {name: block[name] for name in _TAG_FIELDS if name in block}
    return Face(
        _board(where, dictionary, tag),
        _vector(f"{where}.centre_in_body_m", block.get("centre_in_body_m", (0.0, 0.0, 0.0))),
        _quaternion(f"{where}.quat_wxyz", block.get("quat_wxyz", (1.0, 0.0, 0.0, 0.0))),
    )


def _board(where: str, dictionary: str, tag: dict[str, Any]) -> ArucoGrid:
    for name in ("tag_id", "tag_side_m"):
        if name not in tag:
            raise GtcalError(f"{where}: the field {name!r} is missing")
    columns, rows = (_count(where, name, tag.get(name, 1)) for name in ("tag_columns", "tag_rows"))
    if columns * rows > 1 and "tag_gap_m" not in tag:
        raise GtcalError(f"{where}: the field 'tag_gap_m' is missing; a grid of tags needs the white between two")
    side_m = _number(f"{where}.tag_side_m", tag["tag_side_m"])
    gap_m = _number(f"{where}.tag_gap_m", tag.get("tag_gap_m", _SINGLE_TAG_GAP_OF_SIDE * side_m))
    try:
        return ArucoGrid(dictionary, columns, rows, side_m, gap_m, first_tag_id=_count(where, "tag_id", tag["tag_id"]))
    except GtcalError as error:
        raise GtcalError(str(error).replace("board", where, 1)) from None


def _face_block(face: Face) -> dict[str, Any]:
    grid = {name: value for name, value in asdict(face.board).items() if name in _TAG_FIELDS}
    return {
        "tag_id": face.board.first_tag_id,
        **grid,
        "centre_in_body_m": list(face.centre_in_body_m),
        "quat_wxyz": list(face.quat_wxyz),
    }


def _check_known(where: str, given: dict[str, Any], known: set[str]) -> None:
    for name in given:
        if name not in known:
            raise GtcalError(f"{where} has no field {name!r}; fields: {', '.join(sorted(known))}")


def _count(where: str, name: str, value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise GtcalError(f"{where}: {name!r} is {value!r}; expected a whole number")
    return value


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise GtcalError(f"device field {name!r} is {value!r}; expected a number")
    return float(value)


def _vector(name: str, value: object) -> Vector:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise GtcalError(f"device field {name!r} is {value!r}; expected [x, y, z] in metres")
    x, y, z = (_number(name, component) for component in value)
    return x, y, z


def _quaternion(name: str, value: object) -> tuple[float, float, float, float]:
    if not isinstance(value, list | tuple) or len(value) != 4:
        raise GtcalError(f"device field {name!r} is {value!r}; expected [w, x, y, z]")
    w, x, y, z = (_number(name, component) for component in value)
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if abs(norm - 1.0) > 1e-3:
        raise GtcalError(f"device field {name!r} has the norm {norm:.4g}; expected a unit quaternion, w first")
    return w / norm, x / norm, y / norm, z / norm


PAPER_LOLLYPOP = "paper_lollypop"
# One tag and six discs around it on a plate of hand size. A tag alone has no neighbours to vouch for it, hence codes of
# 5 x 5 bits, which chance does not give. No two of the fifteen distances between discs are within 3 mm of each other,
# so that the mocap takes no disc for another; and their centroid is the tag's middle, exactly.
_PAPER_DISCS_MM = ((-8, 48), (22, -52), (60, -4), (-60, -54), (-50, 14), (36, 48))
DEVICE_PRESETS: dict[str, Lollypop] = {
    PAPER_LOLLYPOP: Lollypop(
        faces=(Face(ArucoGrid("DICT_5X5_50", 1, 1, 0.06, _SINGLE_TAG_GAP_OF_SIDE * 0.06, first_tag_id=0)),),
        markers_m=tuple((x / 1000, y / 1000, 0.0) for x, y in _PAPER_DISCS_MM),
        preset=PAPER_LOLLYPOP,
    )
}
