"""A field of a camera file, with where it stands: what it should hold is asked of it, and told in one line if not."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gtcal.bounds import LARGEST_SIDE_PX, within
from gtcal.camera import FloatArray
from gtcal.documents import short as _short
from gtcal.errors import GtcalError

# Files print rotations with as few as four decimals; a typo or a transposed row is further off than that.
_RIGID_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Field:
    """A value in the file at ``path``; ``where`` is its dotted name, empty for the whole document."""

    path: Path
    where: str
    value: Any

    def error(self, message: str) -> GtcalError:
        return GtcalError(f"{self.path}: {self.where}: {message}" if self.where else f"{self.path}: {message}")

    def __contains__(self, name: str) -> bool:
        return isinstance(self.value, dict) and self.value.get(name) is not None

    def __getitem__(self, name: str) -> Field:
        """The field of this name. Raises GtcalError where it is missing."""
        fields = self._fields()
        if fields.get(name) is None:
            near = get_close_matches(name, list(fields), n=1)
            hint = f"; there is {near[0]!r}" if near else ""
            raise self._at(name, None).error(f"is missing{hint}")
        return self._at(name, fields[name])

    def first(self, *names: str) -> Field:
        """The field of the first of these names that is there. Raises GtcalError where none is."""
        for name in names:
            if name in self:
                return self[name]
        return self[names[0]]

    def get(self, *names: str) -> Field | None:
        """``first``, or None."""
        return next((self[name] for name in names if name in self), None)

    def items(self) -> list[tuple[str, Field]]:
        return [(name, self._at(name, value)) for name, value in self._fields().items()]

    def entries(self) -> list[Field]:
        """The entries of a list."""
        if not isinstance(self.value, list) or not self.value:
            raise self.error(f"is {_short(self.value)}; expected a list")
        return [self._at(str(i), value) for i, value in enumerate(self.value)]

    def text(self) -> str:
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.error(f"is {_short(self.value)}; expected text")
        return self.value.strip()

    def flag(self) -> bool:
        """true or false, also as 1 or 0."""
        if self.value not in (True, False, 0, 1):
            raise self.error(f"is {_short(self.value)}; expected true or false")
        return bool(self.value)

    def number(self) -> float:
        if not _is_number(self.value):
            raise self.error(f"is {_short(self.value)}; expected a finite number")
        return float(self.value)

    def size(self) -> int:
        """A positive whole number, also as 640.0."""
        number = self.number()
        if number < 1 or number != round(number):
            raise self.error(f"is {_short(self.value)}; expected a positive whole number of pixels")
        if number > LARGEST_SIDE_PX:
            raise self.error(f"is {_short(self.value)} px; no image has more than {LARGEST_SIDE_PX}")
        return round(number)

    def numbers(self, *counts: int) -> FloatArray:
        """(N,) numbers; N must be one of the counts, if any are given. A list, or a matrix of OpenCV or ROS."""
        value = self.value
        if isinstance(value, dict) and "data" in value:
            value = value["data"]
        if isinstance(value, np.ndarray):
            value = value.ravel().tolist()
        if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list):
            value = value[0]
        if not isinstance(value, list) or not all(_is_number(number) for number in value):
            raise self.error(f"is {_short(self.value)}; expected a list of finite numbers")
        if counts and len(value) not in counts:
            raise self.error(f"has {len(value)} numbers; expected {' or '.join(map(str, counts))}")
        return np.array(value, dtype=np.float64)

    def matrix(self, rows: int, columns: int) -> FloatArray:
        """(rows, columns): a list of rows, a matrix of OpenCV or ROS, or all numbers in one list."""
        value = self.value
        if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
            if len(value) != rows or any(len(row) != columns for row in value):
                raise self.error(f"expected {rows} rows of {columns} numbers")
            return np.stack([Field(self.path, self.where, row).numbers(columns) for row in value])
        return self.numbers(rows * columns).reshape(rows, columns)

    def rigid(self) -> FloatArray:
        """(4, 4) a rigid transform."""
        matrix = self.matrix(4, 4)
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
            raise self.error("the last row of a rigid transform is 0 0 0 1; is the matrix transposed?")
        matrix[:3, :3] = self.rotation(matrix[:3, :3])
        return matrix

    def rotation(self, matrix: FloatArray) -> FloatArray:
        """A rotation matrix (3, 3) made exact. Raises GtcalError where this one is none."""
        off = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
        if off > _RIGID_TOLERANCE or np.linalg.det(matrix) < 0:
            raise self.error(f"is no rotation: its axes are off by {off:.2g} from unit length and right angles")
        if off < 1e-9:
            return matrix
        u, _, vt = np.linalg.svd(matrix)
        return u @ vt

    def unit_quaternion(self) -> FloatArray:
        """(4,) of length 1, in the order of the file."""
        quat = self.numbers(4)
        norm = float(np.linalg.norm(quat))
        if abs(norm - 1.0) > _RIGID_TOLERANCE:
            raise self.error(f"the quaternion's length is {norm:.6g}; expected 1")
        return quat / norm

    def _fields(self) -> dict[str, Any]:
        if not isinstance(self.value, dict):
            raise self.error(f"is {_short(self.value)}; expected named fields")
        return self.value

    def _at(self, name: str, value: Any) -> Field:
        return Field(self.path, f"{self.where}.{name}" if self.where else name, value)


def rigid_from_quaternion(quat_wxyz: Sequence[float] | FloatArray, translation_m: FloatArray) -> FloatArray:
    """(4, 4) a_T_b of a unit quaternion of a_R_b and the position of b in a."""
    return rigid_from_matrix(Rotation.from_quat(np.roll(quat_wxyz, -1)).as_matrix(), translation_m)


def rigid_from_matrix(rotation: FloatArray, translation_m: FloatArray) -> FloatArray:
    """(4, 4) of a rotation matrix and a translation."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3], a_T_b[:3, 3] = rotation, translation_m
    return a_T_b


def quoted(text: str) -> str:
    """A text for YAML, TOML and OpenCV's FileStorage, which don't all know JSON's escapes of letters."""
    return json.dumps(text, ensure_ascii=False)


def float_text(value: float) -> str:
    """Every digit, and a number to all readers of YAML, TOML and JSON: to PyYAML 1e-05 is text, 1.0e-05 a number."""
    text = repr(float(value))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def row_text(values: Sequence[float] | FloatArray) -> str:
    """Numbers as a list of YAML, TOML or JSON."""
    return "[" + ", ".join(float_text(value) for value in values) + "]"


def _is_number(value: Any) -> bool:
    try:
        return (
            isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and within(value)
        )
    except OverflowError:  # a whole number beyond the largest float
        return False
