"""Lists of poses without time: one for each image, as robots and scripts write them down.

A row is a position and a rotation, or a matrix; a matrix may also take four rows of four numbers. What the columns'
names do not say (the order of a quaternion, the unit of angles, the order of Euler angles) the manifest must. A NumPy
file (.npy) holds (N, 4, 4).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from factors.rigid import inverse
from gtcal.camera import FloatArray
from gtcal.errors import GtcalError
from gtcal.files import TABLE_BYTES, check_regular, write_aside
from gtcal.readers.mocap_take import RotationKind
from gtcal.readers.mocap_take import rotations as rotations_of
from gtcal.readers.poses import (
    LENGTHS_M,
    LengthUnit,
    PoseConventions,
    check_distance,
    farthest_row,
    stated_once,
    unit_quaternions,
)
from gtcal.readers.selection import BodySelection, refuse_unused
from gtcal.recordings.detections import IntArray
from gtcal.recordings.numbering import LARGEST_NUMBER, listed_numbers, number_of_name
from gtcal.recordings.text_table import Kind, TextTable, open_table
from gtcal.recordings.trajectory import poses_from_quaternions, quaternions_from_poses

FORMAT = "pose_list"

AngleUnit = Literal["deg", "rad"]

_NUMBER = ("number", "image", "frame", "index", "id", "i", "n")
_NAME = ("name", "file", "filename", "image_name")
_POSITION = re.compile(r"^(?:p|t|pos|position)?_?(?P<axis>[xyz])(?:_?(?P<unit>mm|m)|\s*[\[(](?P<bracket>mm|m)[\])])?$")
_QUATERNION = re.compile(r"^(?:q|quat|quaternion)_?(?P<axis>[wxyz])$")
_ANGLE = re.compile(
    r"^(?:r|rot|rotvec|rv|a|e|euler)_?(?P<axis>[xyz123])(?:_?(?P<unit>deg|rad)|\s*[\[(](?P<bracket>deg|rad)[\])])?$"
)
_NUMBERS_OF = {16: "a 4 x 4 matrix", 12: "a 3 x 4 matrix", 7: "a position and a quaternion", 6: "a position and angles"}
_BOTTOM = np.array([0.0, 0.0, 0.0, 1.0])
# A turn of half a circle is the largest that a rotation vector needs, and one of a full circle the largest of an Euler
# angle; larger ones are degrees. Degrees none of which is larger than 3.2 are radians: arms that turn so little
# calibrate nothing.
_MOST_RAD, _LEAST_DEG = 2.0 * np.pi + 0.01, 3.2
_FEWEST_JUDGED = 3


@dataclass(frozen=True)
class PoseList:
    """world_T_body: (N, 4, 4). numbers: (N,) of the images that they belong to, None where the file has no column of
    them: then there is one for each image, in order."""

    path: Path
    world_T_body: FloatArray
    numbers: IntArray | None

    @property
    def counted(self) -> IntArray:
        """(N,) the numbers, or where there are none 1 to N."""
        return np.arange(1, len(self.world_T_body) + 1) if self.numbers is None else np.sort(self.numbers)

    def for_images(self, body: str, images: IntArray) -> tuple[IntArray, FloatArray]:
        """The numbers (M,), increasing, of images that are numbered so, and their poses (M, 4, 4).

        Raises GtcalError where the counts differ and no number says which is whose, or no image has a pose."""
        if self.numbers is None:
            if len(self.world_T_body) != len(images):
                raise GtcalError(
                    f"{self.path}: {body}: {len(self.world_T_body)} poses for {len(images)} images (numbers "
                    f"{images.min()} to {images.max()}); give one for each, or a column 'number'"
                )
            return images, self.world_T_body
        if not np.isin(images, self.numbers).any():
            raise GtcalError(
                f"{self.path}: {body}: no image has a pose: the poses have the numbers {listed_numbers(self.numbers)}, "
                f"the images {listed_numbers(images)}"
            )
        order = np.argsort(self.numbers)
        return self.numbers[order], self.world_T_body[order]


def read_pose_list(
    path: Path,
    body: str,
    declared: PoseConventions,
    selection: BodySelection,
    angle_unit: AngleUnit | None = None,
) -> PoseList:
    """Read a list of the poses of ``body``. ``declared``, ``selection.rotation`` and ``angle_unit`` are what the
    manifest states.

    Raises GtcalError naming file and line for a pose that is none, for what neither file nor manifest states, and
    where both contradict each other."""
    refuse_unused(path, body, selection, {"rotation"}, FORMAT)
    if declared.time_unit is not None:
        raise GtcalError(f"{path}: {body}.time_unit: a list of poses has no time; leave it out")
    if path.suffix.lower() == ".npy":
        return _placed(_numpy_poses(path), None, path, body, declared, _Columns((), {}))
    table, columns = open_pose_list(path)
    listed = _Rows(table, columns, body, declared.quaternion, selection.rotation, angle_unit)
    return _placed(listed.poses(), listed.numbers(), path, body, declared, columns)


@dataclass(frozen=True)
class _Columns:
    """names: of each column, what it is: number, name, x, y, z, q0..q3, a0..a2, m0..m15, ignored_...; () where the file
    doesn't say. stated: what the header states of ``PoseConventions`` and of angle_unit."""

    names: tuple[str, ...]
    stated: dict[str, str]


def open_pose_list(path: Path) -> tuple[TextTable, _Columns]:
    """The table of a list of poses, and what its header says. Raises GtcalError where it can't be opened."""
    table = open_table(path, _separator(path))
    return table, _named(table.header(), table.n_columns)


def inspect_pose_list(path: Path) -> tuple[int, tuple[str, ...]] | None:
    """How many poses a file holds, and the fields of the manifest that it leaves open; None where it is no list of
    poses, or only could be one.

    Raises GtcalError where it can't be read."""
    if path.suffix.lower() == ".npy":
        return len(_numpy_poses(path)), ("length_unit",)
    table, columns = open_pose_list(path)
    names = columns.names or _unnamed(table, None)
    if names is None or ("a0" in names and not columns.names):
        return None
    if "a0" in names:
        needed = ["rotation", "angle_unit"]
        n_poses = len(table.read([(name, _kind(name)) for name in names]))
    else:
        order = columns.stated.get("quaternion", "xyzw") if "q0" in names else None  # which, a norm does not tell
        listed = _Rows(table, columns, "", order, None, None)
        n_poses, needed = len(listed.poses()), ["quaternion"] if "q0" in names else []
    return n_poses, tuple(name for name in ("length_unit", *needed) if name not in columns.stated)


def _separator(path: Path) -> str | None:
    check_regular(path, TABLE_BYTES)
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            first = next((line for line in file if line.strip() and not line.lstrip().startswith("#")), "")
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from None
    return "," if "," in first else None


def _named(header: tuple[str, ...], n_columns: int) -> _Columns:
    """By the header's names; nothing where it doesn't name as many columns as there are, or not a pose's."""
    if len(header) != n_columns:
        return _Columns((), {})
    names: list[str] = []
    stated: dict[str, set[str]] = {"length_unit": set(), "angle_unit": set()}
    quaternion = ""
    for index, column in enumerate(header):
        word = column.strip().lower()
        if word in _NUMBER:
            names.append("number")
        elif word in _NAME:
            names.append("name")
        elif match := _QUATERNION.match(word):
            names.append(f"q{len(quaternion)}")
            quaternion += match["axis"]
        elif match := _POSITION.match(word):
            names.append(match["axis"])
            stated["length_unit"] |= {match["unit"] or match["bracket"]} - {None}
        elif match := _ANGLE.match(word):
            names.append(f"a{sum(name.startswith('a') for name in names)}")
            stated["angle_unit"] |= {match["unit"] or match["bracket"]} - {None}
        else:
            names.append(f"ignored_{index}")
    complete = {"x", "y", "z"} <= set(names) and (quaternion in ("xyzw", "wxyz") or "a2" in names)
    if not complete:
        return _Columns((), {})
    units = {name: next(iter(values)) for name, values in stated.items() if len(values) == 1}
    return _Columns(tuple(names), {**units, **({"quaternion": quaternion} if quaternion else {})})


def _unnamed(table: TextTable, rotation: RotationKind | None) -> tuple[str, ...] | None:
    """By their count: a pose, before it perhaps the image's number. None where no pose has so many numbers."""
    angles, quaternion = ("x", "y", "z", "a0", "a1", "a2"), ("x", "y", "z", "q0", "q1", "q2", "q3")
    of_count = {
        4: tuple(f"m{i}" for i in range(4)),
        6: angles,
        7: ("number", *angles) if rotation is not None and rotation != "quaternion_xyzw" else quaternion,
        8: ("number", *quaternion),
        12: tuple(f"m{i}" for i in range(12)),
        13: ("number", *(f"m{i}" for i in range(12))),
        16: tuple(f"m{i}" for i in range(16)),
        17: ("number", *(f"m{i}" for i in range(16))),
    }
    return of_count.get(table.n_columns)


class _Rows:
    """The rows of a list, read by what the file and the manifest say of its columns."""

    def __init__(
        self,
        table: TextTable,
        columns: _Columns,
        body: str,
        quaternion: str | None,
        rotation: RotationKind | None,
        angle_unit: AngleUnit | None,
    ) -> None:
        self.table, self.columns, self.body = table, columns, body
        self.quaternion, self.rotation, self.angle_unit = quaternion, rotation, angle_unit
        names = columns.names or _unnamed(table, rotation)
        if names is None:
            listed = ", ".join(f"{count} ({what})" for count, what in _NUMBERS_OF.items())
            raise GtcalError(
                f"{table.path}:{table.skip_lines + 1}: {table.n_columns} columns; expected {listed}, each with an "
                "image's number before it or without, or names of the columns, as number,x,y,z,qx,qy,qz,qw"
            )
        self.names = names
        kinds: list[tuple[str, Kind]] = [(name, _kind(name)) for name in names]
        self.rows = table.read(kinds)
        if not len(self.rows):
            raise GtcalError(f"{table.path}: there are no poses in the file")

    def numbers(self) -> IntArray | None:
        """(N,) of the images; None where the file has none."""
        found: IntArray | None = None
        if "name" in self.names:
            found = np.array([self._number_of_name(row) for row in range(len(self.rows))], dtype=np.int64)
        elif "number" in self.names:
            given = self.rows["number"]
            bad = np.flatnonzero((given != np.rint(given)) | (given < 0) | (given > LARGEST_NUMBER))
            if len(bad):
                raise self.table.error(
                    int(bad[0]),
                    f"the image's number is {given[bad[0]]:g}; expected a whole number (a time? then this "
                    "is no list by number: use format tum or euroc_csv)",
                )
            found = given.astype(np.int64)
        if found is not None:
            distinct, counts = np.unique(found, return_counts=True)
            if (counts > 1).any():
                number = distinct[counts > 1][0]
                row = int(np.flatnonzero(found == number)[1])
                raise self.table.error(row, f"image {number} has a pose already; give one for each image")
        return found

    def _number_of_name(self, row: int) -> int:
        try:
            return number_of_name(self.rows["name"][row].decode("latin-1"))
        except GtcalError as error:
            raise self.table.error(row, str(error)) from None

    def poses(self) -> FloatArray:
        """(N, 4, 4), lengths as in the file."""
        if any(name.startswith("m") for name in self.names):
            return self._matrices()
        positions = np.stack([self.rows[axis] for axis in "xyz"], axis=1)
        if "q0" in self.names:
            if self.rotation not in (None, "quaternion_xyzw"):
                raise self._error("rotation", f"is {self.rotation}, but the file has quaternions")
            self._refuse_angle_unit("quaternions")
            order = stated_once(
                self.table.path,
                self.body,
                "quaternion",
                self.columns.stated.get("quaternion"),
                self.quaternion or ("xyzw" if self.rotation else None),
                "xyzw or wxyz",
            )
            quats = unit_quaternions(self.table, np.stack([self.rows[f"q{i}"] for i in range(4)], axis=1))
            return poses_from_quaternions(quats, order, positions)  # type: ignore[arg-type]
        return self._by_angles(positions)

    def _by_angles(self, positions: FloatArray) -> FloatArray:
        path, n = self.table.path, len(self.rows)
        kinds = [kind for kind in get_args(RotationKind) if kind == "helical" or kind.startswith("euler")]
        choices = f"helical (a rotation vector), {kinds[1]} or the like; 'gtcal schema' lists them"
        kind = stated_once(path, self.body, "rotation", None, self.rotation, choices)
        if kind not in kinds:
            raise self._error("rotation", f"is {kind}, but the file has three angles; choose helical or {kinds[1]} ...")
        if self.quaternion is not None:
            raise self._error("quaternion", "is stated, but the file has three angles; leave it out")
        unit = stated_once(
            path, self.body, "angle_unit", self.columns.stated.get("angle_unit"), self.angle_unit, "deg or rad"
        )
        angles = np.stack([self.rows[f"a{i}"] for i in range(3)], axis=1)
        self._check_unit(angles, unit)
        poses = np.tile(np.eye(4), (n, 1, 1))
        poses[:, :3, :3] = rotations_of(kind, angles, unit == "deg", str(path))  # type: ignore[arg-type]
        poses[:, :3, 3] = positions
        return poses

    def _check_unit(self, angles: FloatArray, unit: str) -> None:
        largest = np.abs(angles).max(axis=1)
        if unit == "rad" and largest.max() > _MOST_RAD:
            row = int(largest.argmax())
            raise self.table.error(
                row,
                f"an angle is {largest[row]:g} rad, more than a turn; are these degrees? then "
                f"set {self.body}.angle_unit: deg",
            )
        if unit == "deg" and len(angles) >= _FEWEST_JUDGED and 0.0 < largest.max() < _LEAST_DEG:
            raise GtcalError(
                f"{self.table.path}: as deg, no angle of {self.body} is larger than {largest.max():.3g}; are these "
                f"radians? then set {self.body}.angle_unit: rad"
            )

    def _matrices(self) -> FloatArray:
        self._refuse_angle_unit("matrices")
        if self.quaternion is not None:
            raise self._error("quaternion", "is stated, but the file has matrices; leave it out")
        if self.rotation not in (None, "matrix_by_rows", "matrix_by_columns"):
            raise self._error("rotation", f"is {self.rotation}, but the file has matrices")
        names = [name for name in self.names if name.startswith("m")]
        numbers = np.stack([self.rows[name] for name in names], axis=1)
        if len(names) == 4:
            if len(numbers) % 4:
                raise GtcalError(
                    f"{self.table.path}: {len(numbers)} rows of four numbers; a 4 x 4 matrix takes four rows"
                )
            numbers = numbers.reshape(-1, 16)
        rows_each = 4 if len(names) == 4 else 1
        if self.rotation == "matrix_by_columns":
            if len(names) == 12:
                numbers = np.swapaxes(numbers.reshape(-1, 4, 3), 1, 2).reshape(-1, 12)
            else:
                numbers = np.swapaxes(numbers.reshape(-1, 4, 4), 1, 2).reshape(-1, 16)
        if len(names) == 12:
            numbers = np.hstack([numbers, np.tile(_BOTTOM, (len(numbers), 1))])
        return checked_matrices(
            numbers.reshape(-1, 4, 4), lambda index: f"{self.table.path}:{self.table.line_of(rows_each * index)}"
        )

    def _refuse_angle_unit(self, what: str) -> None:
        if self.angle_unit is not None:
            raise self._error("angle_unit", f"is stated, but the file has {what}; leave it out")

    def _error(self, field: str, message: str) -> GtcalError:
        return GtcalError(f"{self.table.path}: {self.body}.{field}: {message}")


def _kind(name: str) -> Kind:
    if name == "name":
        return "stamp"  # text
    return "ignored" if name.startswith("ignored") else "number"


def checked_matrices(matrices: FloatArray, where: object) -> FloatArray:
    """Rigid transforms (N, 4, 4), their rotations made orthonormal to the last digit. where(index): file and line.

    Raises GtcalError for the first that is none: not finite, by columns, scaled, mirrored."""
    at = where if callable(where) else (lambda index: f"{where}: pose {index + 1}")
    for index, matrix in enumerate(matrices):
        if fault := _fault(matrix):
            raise GtcalError(f"{at(index)}: {fault}")
    U, _, Vt = np.linalg.svd(matrices[:, :3, :3])
    fixed = matrices.astype(np.float64).copy()
    fixed[:, :3, :3] = U @ Vt
    return fixed


_ORTHONORMAL = 5e-3  # what three decimals leave of it


def _fault(matrix: FloatArray) -> str:
    if not np.isfinite(matrix).all():
        return "the matrix has NaN or infinite numbers in it"
    if not np.allclose(matrix[3], _BOTTOM, atol=1e-6):
        if np.allclose(matrix[:, 3], _BOTTOM, atol=1e-6):
            return "the matrix has its position in the last row; set rotation: matrix_by_columns"
        return f"the matrix ends with {', '.join(f'{number:g}' for number in matrix[3])}; expected 0, 0, 0, 1"
    R = matrix[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > _ORTHONORMAL:
        return f"the matrix's 3 x 3 part is no rotation: its rows are off orthonormal by {off:.3g}"
    if np.linalg.det(R) < 0.0:
        return "the matrix's 3 x 3 part is no rotation: its determinant is -1, the axes are left-handed"
    return ""


def _numpy_poses(path: Path) -> FloatArray:
    check_regular(path, TABLE_BYTES)
    try:
        matrices = np.load(path, allow_pickle=False)
    except Exception as error:  # whatever a damaged file makes numpy raise
        raise GtcalError(f"{path}: can't be read as a NumPy file: {error}") from None
    if not isinstance(matrices, np.ndarray) or matrices.ndim != 3 or matrices.shape[1:] != (4, 4) or not len(matrices):
        shape = getattr(matrices, "shape", "not an array")
        raise GtcalError(f"{path}: its shape is {shape}; expected (N, 4, 4)")
    if matrices.dtype.kind not in "fiu":
        raise GtcalError(f"{path}: holds {matrices.dtype}; expected numbers")
    return checked_matrices(matrices.astype(np.float64), str(path))


def _placed(
    poses: FloatArray,
    numbers: IntArray | None,
    path: Path,
    body: str,
    declared: PoseConventions,
    columns: _Columns,
) -> PoseList:
    """In metres, as world_T_body."""
    said = columns.stated.get("length_unit")
    unit: LengthUnit = stated_once(path, body, "length_unit", said, declared.length_unit, "m or mm")  # type: ignore[assignment]
    poses = poses.copy()
    poses[:, :3, 3] *= LENGTHS_M[unit]
    world_T_body = inverse(poses) if declared.pose == "body_T_world" else poses
    check_distance(path, world_T_body[:, :3, 3], body, unit)
    if (row := farthest_row(world_T_body[:, :3, 3])) is not None:
        distance_m = float(np.linalg.norm(world_T_body[row, :3, 3]))
        raise GtcalError(f"{path}: pose {row + 1} is {distance_m:.6g} m from the origin")
    return PoseList(path, world_T_body, numbers)


def write_pose_list(path: Path, numbers: IntArray, world_T_body: FloatArray) -> None:
    """Write poses (N, 4, 4) by number, every digit; what is needed to read them stands in the header."""
    quats = quaternions_from_poses(world_T_body, "xyzw")
    rows = np.concatenate([world_T_body[:, :3, 3], quats], axis=1).tolist()
    with write_aside(path) as file:
        file.write("number,x_m,y_m,z_m,qx,qy,qz,qw\n")
        for number, row in zip(numbers.tolist(), rows, strict=True):
            file.write(f"{number},{','.join(map(repr, row))}\n")
