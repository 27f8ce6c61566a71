"""Lists of poses without time: what is read, and the one line that each fault gets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import wandering_trajectory

from factors.rigid import inverse
from gtcal.errors import GtcalError
from gtcal.readers import PoseConventions
from gtcal.readers.pose_list import AngleUnit, PoseList, read_pose_list, write_pose_list
from gtcal.readers.selection import BodySelection

POSES = wandering_trajectory("arm", n=7).world_T_body
METRES = PoseConventions(length_unit="m")


def lines(path: Path, rows: np.ndarray, header: str = "", separator: str = " ") -> Path:
    text = "\n".join(separator.join(map(repr, row)) for row in rows.tolist())
    path.write_text(f"{header}\n{text}\n" if header else f"{text}\n")
    return path


def read(path: Path, angle_unit: AngleUnit | None = None, rotation: str | None = None, **declared: str) -> PoseList:
    conventions = PoseConventions(**{"length_unit": "m", **declared})  # type: ignore[arg-type]
    return read_pose_list(path, "platform", conventions, BodySelection(rotation=rotation), angle_unit)  # type: ignore[arg-type]


def with_rotation(numbers: np.ndarray) -> np.ndarray:
    return np.hstack([POSES[:, :3, 3], numbers])


ROTATIONS = Rotation.from_matrix(POSES[:, :3, :3])


@pytest.mark.parametrize(
    ("rows", "stated"),
    [
        (POSES.reshape(7, 16), {}),
        (POSES[:, :3].reshape(7, 12), {}),
        (POSES.reshape(28, 4), {}),
        (np.swapaxes(POSES, 1, 2).reshape(7, 16), {"rotation": "matrix_by_columns"}),
        (with_rotation(ROTATIONS.as_quat()), {"quaternion": "xyzw"}),
        (with_rotation(np.roll(ROTATIONS.as_quat(), 1, axis=1)), {"quaternion": "wxyz"}),
        (with_rotation(ROTATIONS.as_rotvec()), {"rotation": "helical", "angle_unit": "rad"}),
        (
            with_rotation(ROTATIONS.as_euler("xyz", degrees=True)),
            {"rotation": "euler_xyz_extrinsic", "angle_unit": "deg"},
        ),
        (with_rotation(ROTATIONS.as_euler("ZYX")), {"rotation": "euler_zyx_intrinsic", "angle_unit": "rad"}),
    ],
)
@pytest.mark.parametrize("separator", [" ", ","])
def test_every_way_of_writing_poses_is_read(rows: np.ndarray, stated: dict, separator: str, tmp_path: Path) -> None:
    found = read(lines(tmp_path / "poses.txt", rows, separator=separator), **stated)
    np.testing.assert_allclose(found.world_T_body, POSES, atol=1e-12)
    assert found.numbers is None


def test_numbers_names_units_and_orders_come_from_the_header(tmp_path: Path) -> None:
    quats = np.roll(ROTATIONS.as_quat(), 1, axis=1)
    rows = [
        f"frame_{10 - i:04d}.png,{','.join(map(repr, row))}" for i, row in enumerate((with_rotation(quats)).tolist())
    ]
    header = "name,x_mm,y_mm,z_mm,qw,qx,qy,qz"
    (tmp_path / "poses.csv").write_text("\n".join([header, *rows]) + "\n")
    found = read_pose_list(tmp_path / "poses.csv", "platform", PoseConventions(), BodySelection())
    assert found.numbers is not None
    assert found.numbers.tolist() == [10, 9, 8, 7, 6, 5, 4]
    np.testing.assert_allclose(found.world_T_body[:, :3, 3], 1e-3 * POSES[:, :3, 3], atol=1e-15)
    numbers, poses = found.for_images("platform", np.arange(1, 9))
    assert numbers.tolist() == [4, 5, 6, 7, 8, 9, 10]
    np.testing.assert_array_equal(poses, found.world_T_body[::-1])


def test_what_is_written_is_read_back_and_numpy_files_are_read(tmp_path: Path) -> None:
    write_pose_list(tmp_path / "poses.csv", np.arange(3, 10), POSES)
    found = read_pose_list(tmp_path / "poses.csv", "platform", PoseConventions(), BodySelection())
    np.testing.assert_allclose(found.world_T_body, POSES, atol=1e-14)
    np.save(tmp_path / "poses.npy", inverse(POSES))
    np.testing.assert_allclose(read(tmp_path / "poses.npy", pose="body_T_world").world_T_body, POSES, atol=1e-12)


SCALED = POSES.copy()
SCALED[2, :3, :3] *= 1.02
MIRRORED = POSES.copy()
MIRRORED[4, :3, 2] *= -1.0
DEGREES = with_rotation(ROTATIONS.as_rotvec(degrees=True))
RADIANS = with_rotation(ROTATIONS.as_rotvec())
QUATERNIONS = with_rotation(ROTATIONS.as_quat())
NUMBERED, BETWEEN = (np.column_stack([numbers, QUATERNIONS]) for numbers in ([1, 2, 3, 4, 4, 6, 7], np.arange(7) + 1.5))


@pytest.mark.parametrize(
    ("rows", "stated", "message"),
    [
        (SCALED.reshape(7, 16), {}, r"poses.txt:3: the matrix's 3 x 3 part is no rotation: .* off orthonormal by 0.04"),
        (SCALED.reshape(28, 4), {}, r"poses.txt:9: the matrix's 3 x 3 part is no rotation"),
        (MIRRORED.reshape(7, 16), {}, r"poses.txt:5: .* its determinant is -1, the axes are left-handed"),
        (np.swapaxes(POSES, 1, 2).reshape(7, 16), {}, "position in the last row; set rotation: matrix_by_columns"),
        (POSES.reshape(7, 16)[:, :15], {}, "15 columns; expected 16"),
        (POSES.reshape(28, 4)[:-1], {}, "27 rows of four numbers; a 4 x 4 matrix takes four rows"),
        (DEGREES, {"rotation": "helical", "angle_unit": "rad"}, r"rad, more than a turn; .* platform.angle_unit: deg"),
        (
            RADIANS,
            {"rotation": "helical", "angle_unit": "deg"},
            "no angle .* is larger .* platform.angle_unit: rad",
        ),
        (RADIANS, {"rotation": "helical"}, "doesn't state its angle_unit, and gtcal doesn't guess it"),
        (RADIANS, {}, "doesn't state its rotation"),
        (QUATERNIONS, {}, "doesn't state its quaternion, .* add platform.quaternion to the manifest: xyzw or wxyz"),
        (2.0 * QUATERNIONS, {"quaternion": "xyzw"}, r"poses.txt:1: the quaternion's length is 2"),
        (NUMBERED, {"quaternion": "xyzw"}, r"poses.txt:5: image 4 has a pose already"),
        (BETWEEN, {"quaternion": "xyzw"}, "image's number is 1.5; expected a whole number"),
    ],
)
def test_each_fault_is_told_in_one_line(rows: np.ndarray, stated: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message) as told:
        read(lines(tmp_path / "poses.txt", rows), **stated)
    assert "\n" not in str(told.value)


def test_counts_that_differ_and_numbers_that_no_image_has(tmp_path: Path) -> None:
    listed = read(lines(tmp_path / "poses.txt", POSES.reshape(7, 16)))
    with pytest.raises(GtcalError, match=r"platform: 7 poses for 6 images \(numbers 1 to 6\); give one for each"):
        listed.for_images("platform", np.arange(1, 7))
    write_pose_list(tmp_path / "poses.csv", np.arange(7), POSES)
    numbered = read_pose_list(tmp_path / "poses.csv", "platform", PoseConventions(), BodySelection())
    with pytest.raises(GtcalError, match="no image has a pose: the poses have the numbers 0, 1, 2, 3, 4, 5 and 1 more"):
        numbered.for_images("platform", np.arange(20, 27))
