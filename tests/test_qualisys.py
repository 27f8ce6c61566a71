from pathlib import Path

import numpy as np
import pytest
from mocap_files import from_zero, write_qualisys
from support import wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import BodySelection, PoseConventions, detect_mocap_format, inspect_mocap, read_qualisys_tsv

NOTHING = PoseConventions()
A, B = (from_zero(wandering_trajectory(name, seed=seed)).world_T_body for seed, name in enumerate("ab"))


@pytest.mark.parametrize("by", ["columns", "rows"])
@pytest.mark.parametrize("times", [False, True])
@pytest.mark.parametrize("lost", ["zeros", "blank"])
def test_what_is_written_is_read_back(by: str, times: bool, lost: str, tmp_path: Path) -> None:
    """Columns or rows: the angles confirm it."""
    b = B.copy()
    b[[3, 9]] = np.nan
    path = write_qualisys(tmp_path / "t.tsv", {"the headset": A, "board": b}, by=by, times=times, lost=lost)
    assert detect_mocap_format(path) == "qualisys_tsv"
    headset = read_qualisys_tsv(path, "platform", NOTHING, BodySelection(name="the headset"))
    np.testing.assert_allclose(headset.world_T_body, A, atol=1e-12)
    assert headset.stamps_ns[[0, 1, 59]].tolist() == [0, 10_000_000, 590_000_000]
    board = read_qualisys_tsv(path, "board_body", NOTHING, BodySelection(name="board"))
    np.testing.assert_allclose(board.world_T_body, np.delete(B, [3, 9], axis=0), atol=1e-12)
    assert 40_000_000 not in board.stamps_ns[:3]
    summary = inspect_mocap(path)
    assert [(body.name, body.n_seen, body.n_gaps) for body in summary.bodies] == [
        ("the headset", 60, 0),
        ("board", 58, 2),
    ]
    assert summary.open_fields == ()


def test_angles_of_ones_own_definition_leave_the_order_of_the_matrix_open(tmp_path: Path) -> None:
    path = write_qualisys(tmp_path / "t.tsv", {"a": A}, euler="ZYX")
    assert inspect_mocap(path).open_fields == ("rotation",)
    with pytest.raises(
        GtcalError, match=r"add platform\.rotation to the manifest: matrix_by_columns or matrix_by_rows"
    ):
        read_qualisys_tsv(path, "platform", NOTHING)
    said = read_qualisys_tsv(path, "platform", NOTHING, BodySelection(rotation="matrix_by_columns"))
    np.testing.assert_allclose(said.world_T_body, A, atol=1e-12)


def test_without_the_matrix_the_definition_of_the_angles_is_asked_for(tmp_path: Path) -> None:
    path = write_qualisys(tmp_path / "t.tsv", {"a": A}, euler="ZYX", matrix=False)
    with pytest.raises(GtcalError, match=r"add platform\.rotation to the manifest: helical, or euler_xyz_intrinsic"):
        read_qualisys_tsv(path, "platform", NOTHING)
    said = read_qualisys_tsv(path, "platform", NOTHING, BodySelection(rotation="euler_zyx_intrinsic"))
    np.testing.assert_allclose(said.world_T_body, A, atol=1e-12)


def test_decimal_commas_are_read(tmp_path: Path) -> None:
    path = write_qualisys(tmp_path / "t.tsv", {"a": A})
    head, rows = path.read_text().split("Rot[8]", 1)
    path.write_text(f"{head}Rot[8]{rows.replace('.', ',')}")
    np.testing.assert_allclose(read_qualisys_tsv(path, "platform", NOTHING).world_T_body, A, atol=1e-12)
    path.write_text(f"{head}Rot[8]{rows.replace('.', ',', 40)}")
    with pytest.raises(GtcalError, match="the numbers have both points and commas"):
        read_qualisys_tsv(path, "platform", NOTHING)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("NO_OF_FRAMES", "FRAMES", "1: is no TSV of Qualisys QTM"),
        ("BODY_NAMES", "NAMES", "1: there is no line BODY_NAMES; is this an export of 6D data"),
        ("NO_OF_BODIES\t1", "NO_OF_BODIES\t2", "1: NO_OF_BODIES is 2, but BODY_NAMES has 1"),
        ("DATA_INCLUDED\t6D", "DATA_INCLUDED\t3D", "DATA_INCLUDED is 3D; export 6D data from QTM"),
        ("FREQUENCY\t100", "FREQUENCY\tEXT", "FREQUENCY is 'EXT'; expected frames a second"),
        ("FREQUENCY\t100", "FREQ\t100", r"doesn't state their rate; add platform\.rate_hz"),
        ("a X\tY", "a X\tX", "there is no line of column names"),
        ("Rot[5]", "Rot[4]", "11: a column of body 'a' stands twice"),
        ("\tRot[5]", "", r"11: body 'a' has no column ROT\[5\]"),
        ("Rot[5]", "Rxt", r"11: body 'a' has no column ROT\[5\]"),
    ],
)
def test_damage_is_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_qualisys(tmp_path / "t.tsv", {"a": A})
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(GtcalError, match=message) as caught:
        read_qualisys_tsv(path, "platform", NOTHING)
    assert "\n" not in str(caught.value)


def test_markers_and_metres_are_nothing_of_this_format(tmp_path: Path) -> None:
    path = write_qualisys(tmp_path / "t.tsv", {"a": A})
    with pytest.raises(GtcalError, match=r"platform\.markers: format qualisys_tsv has no use for it"):
        read_qualisys_tsv(path, "platform", NOTHING, BodySelection(markers=("x", "y", "z")))
    with pytest.raises(GtcalError, match=r"length_unit mm, but the manifest says platform\.length_unit: m"):
        read_qualisys_tsv(path, "platform", PoseConventions(length_unit="m"))


def test_a_matrix_that_is_no_rotation_is_refused(tmp_path: Path) -> None:
    scaled = A.copy()
    scaled[:, :3, :3] *= 1.1
    path = write_qualisys(tmp_path / "t.tsv", {"a": scaled})
    with pytest.raises(GtcalError, match=r"'a': a rotation matrix is off orthonormal by 0\.21"):
        read_qualisys_tsv(path, "platform", NOTHING, BodySelection(rotation="matrix_by_columns"))
    path = write_qualisys(tmp_path / "t.tsv", {"a": A}, euler="ZYX")
    rows = [line.split("\t") for line in path.read_text().splitlines()]
    for row in rows[11:]:
        row[7:10] = [repr(-float(cell)) for cell in row[7:10]]
    path.write_text("\n".join("\t".join(row) for row in rows) + "\n")
    with pytest.raises(GtcalError, match="the axes are left-handed"):
        read_qualisys_tsv(path, "platform", NOTHING, BodySelection(rotation="matrix_by_columns"))
