import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import EPOCH_NS, wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import PoseConventions, read_euroc_csv, read_tum, write_euroc_csv, write_tum
from gtcal.recordings.trajectory import Trajectory

METRES = PoseConventions(length_unit="m")
PLAIN_HEADER = "timestamp [ns],x,y,z,qx,qy,qz,qw"

ROW = "1606153863362296104,-0.5,1.25,2,0.6,0,0.8,0"
SECOND = "1606153863412387371,-0.5,1.25,2,0.6,0,0.8,0"
THIRD = "1606153863463091850,-0.5,1.25,2,0.6,0,0.8,0"


def csv(path: Path, *lines: str, ending: str = "\n") -> Path:
    (path / "body.csv").write_bytes((ending.join(lines) + ending).encode())
    return path / "body.csv"


def quat_wxyz_to_matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize(("write", "read"), [(write_euroc_csv, read_euroc_csv), (write_tum, read_tum)])
def test_what_is_written_is_read_back(write: Callable, read: Callable, tmp_path: Path) -> None:
    trajectory = wandering_trajectory("board_body")
    write(tmp_path / "out", trajectory)
    back: Trajectory = read(tmp_path / "out", "board_body", PoseConventions())
    np.testing.assert_array_equal(back.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_array_equal(back.world_T_body[:, :3, 3], trajectory.world_T_body[:, :3, 3])
    np.testing.assert_allclose(back.world_T_body, trajectory.world_T_body, atol=2e-15)


def test_tum_stamps_before_the_epoch_survive(tmp_path: Path) -> None:
    trajectory = replace(wandering_trajectory("b", n=3), stamps_ns=np.array([-1_500_000_000, -5, 7]))
    write_tum(tmp_path / "out", trajectory)
    assert read_tum(tmp_path / "out", "b", PoseConventions()).stamps_ns.tolist() == [-1_500_000_000, -5, 7]


def test_the_real_vicon_export_keeps_its_nanoseconds(shared: Callable[[str], Path]) -> None:
    trajectory = read_euroc_csv(shared("data/vicon_aprilgrid/body0/data.csv"), "platform", METRES)
    assert trajectory.n_samples == 6128
    assert trajectory.stamps_ns[[0, 1, -1]].tolist() == [
        1606153863362296104,
        1606153863412387371,
        1606154170382315397,
    ]
    np.testing.assert_allclose(trajectory.world_T_body[0, :3, 3], [-0.873523, 1.00945, 0.88692])
    x, y, z, w = 0.311367, -0.125602, -0.938746, 0.0776556
    np.testing.assert_allclose(trajectory.world_T_body[0, :3, :3], quat_wxyz_to_matrix(w, x, y, z), atol=2e-6)
    assert trajectory.median_interval_s == pytest.approx(0.050118, abs=1e-6)


@pytest.mark.parametrize(
    "lines",
    [
        [PLAIN_HEADER, ROW, SECOND],
        ["#timestamp_ns, px_m, py_m, pz_m, qx, qy, qz, qw", ROW, SECOND],
        ["# recorded in the lab", "", f"#{PLAIN_HEADER}", ROW, "", f"{SECOND} # the last", ""],
        ["\ufeff" + PLAIN_HEADER, ROW, SECOND],
        [PLAIN_HEADER + ",vx,vy", ROW + ",1,x", SECOND + ",,0"],
        [
            PLAIN_HEADER.replace("qx,qy,qz,qw", "qw,qx,qy,qz"),
            ROW.replace("0.6,0,0.8,0", "0,0.6,0,0.8"),
            SECOND.replace("0.6,0,0.8,0", "0,0.6,0,0.8"),
        ],
    ],
)
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_one_trajectory_in_many_dresses(lines: list[str], ending: str, tmp_path: Path) -> None:
    trajectory = read_euroc_csv(csv(tmp_path, *lines, ending=ending), "b", METRES)
    assert trajectory.stamps_ns.tolist() == [1606153863362296104, 1606153863412387371]
    np.testing.assert_array_equal(trajectory.world_T_body[0, :3, 3], [-0.5, 1.25, 2])
    np.testing.assert_allclose(trajectory.world_T_body[0, :3, :3], quat_wxyz_to_matrix(0, 0.6, 0, 0.8), atol=1e-12)


def test_asl_names_say_everything(tmp_path: Path) -> None:
    names = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    velocity = ", v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1]"
    path = csv(tmp_path, names + velocity, "1403636580838555648, 4.6, -1.7, 0.7, 0.5, -0.5, 0.5, 0.5, 9, 8")
    trajectory = read_euroc_csv(path, "b", PoseConventions())
    assert trajectory.stamps_ns.tolist() == [1403636580838555648]
    np.testing.assert_allclose(trajectory.world_T_body[0, :3, :3], quat_wxyz_to_matrix(0.5, -0.5, 0.5, 0.5))
    np.testing.assert_array_equal(trajectory.world_T_body[0, :3, 3], [4.6, -1.7, 0.7])


def test_without_a_header_the_manifest_says_it_all(tmp_path: Path) -> None:
    path = csv(tmp_path, "12.5,-500,1250,2000,0,0.6,0,0.8", "20.75,-500,1250,2000,0,0.6,0,0.8")
    declared = PoseConventions("wxyz", "mm", "ms", "world_T_body")
    trajectory = read_euroc_csv(path, "b", declared)
    assert trajectory.stamps_ns.tolist() == [12_500_000, 20_750_000]
    np.testing.assert_allclose(trajectory.world_T_body[1, :3, 3], [-0.5, 1.25, 2], atol=1e-15)
    inverse = read_euroc_csv(path, "b", replace(declared, pose="body_T_world"))
    np.testing.assert_allclose(inverse.world_T_body @ trajectory.world_T_body, [np.eye(4)] * 2, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "unit", "stamp_ns"),
    [
        ("1606153863.362296104", "s", 1606153863362296104),
        ("1606153863362296104", "ns", 1606153863362296104),
        ("1606153863362296104.0", "ns", 1606153863362296104),
        ("1606153863362296.104", "us", 1606153863362296104),
        ("1606153863362.2961040000", "ms", 1606153863362296104),
        ("1.606153863362296104e+09", "s", 1606153863362296104),
        ("1606153863", "s", 1606153863_000000000),
        ("0.0083333333333", "s", 8333333),
        ("0.0000000006", "s", 1),
        ("-0.5", "s", -500_000_000),
    ],
)
def test_stamps_are_exact_to_the_nanosecond(text: str, unit: str, stamp_ns: int, tmp_path: Path) -> None:
    path = csv(tmp_path, f"{text} 1 2 3 0 0 0 1")
    assert read_tum(path, "b", PoseConventions(time_unit=unit)).stamps_ns.tolist() == [stamp_ns]


def test_tum_is_seconds_metres_and_xyzw_unless_said_otherwise(tmp_path: Path) -> None:
    path = csv(tmp_path, "# ground truth trajectory", "# file: 'a.bag'", "1.5 1 2 3 0.6 0 0.8 0")
    as_tum = read_tum(path, "b", PoseConventions())
    np.testing.assert_allclose(as_tum.world_T_body[0, :3, :3], quat_wxyz_to_matrix(0, 0.6, 0, 0.8), atol=1e-12)
    np.testing.assert_array_equal(as_tum.world_T_body[0, :3, 3], [1, 2, 3])
    declared = read_tum(path, "b", PoseConventions(quaternion="wxyz", length_unit="mm"))
    np.testing.assert_allclose(declared.world_T_body[0, :3, :3], quat_wxyz_to_matrix(0.6, 0, 0.8, 0), atol=1e-12)
    np.testing.assert_allclose(declared.world_T_body[0, :3, 3], [1e-3, 2e-3, 3e-3])
    named = csv(tmp_path, "# time x y z qw qx qy qz", "1.5 1 2 3 0.6 0 0.8 0")
    by_name = read_tum(named, "b", PoseConventions())
    np.testing.assert_array_equal(by_name.world_T_body[0, :3, :3], declared.world_T_body[0, :3, :3])
    with pytest.raises(GtcalError, match=r"header says quaternion wxyz, but the manifest says b.quaternion: xyzw"):
        read_tum(named, "b", PoseConventions(quaternion="xyzw"))


@pytest.mark.parametrize(
    ("header", "declared", "message"),
    [
        (PLAIN_HEADER, PoseConventions(), "doesn't state its length_unit.*add platform.length_unit.*m or mm"),
        (PLAIN_HEADER.replace(" [ns]", ""), METRES, "doesn't state its time_unit.*ns, us, ms or s"),
        ("", PoseConventions(None, "m", "ns"), "doesn't state its quaternion.*xyzw or wxyz"),
        (
            PLAIN_HEADER,
            PoseConventions("wxyz", "m"),
            "quaternion xyzw, but the manifest says platform.quaternion: wxyz",
        ),
        (
            PLAIN_HEADER,
            PoseConventions(None, "m", "us"),
            "time_unit ns, but the manifest says platform.time_unit: us",
        ),
        (
            "timestamp [ns],x [mm],y [mm],z [mm],qx,qy,qz,qw",
            METRES,
            "length_unit mm, but .* platform.length_unit: m;",
        ),
        (
            "timestamp [ns],x,y,z,q1,q2,q3,q4",
            METRES,
            r"body.csv:1: the header names the columns timestamp \[ns\], x",
        ),
        ("timestamp [ns],x [cm],y [cm],z [cm],qx,qy,qz,qw", METRES, "header has x in cm, .*expected one unit of m, mm"),
        ("timestamp [ns],x [mm],y [mm],z [m],qx,qy,qz,qw", METRES, "x in mm, y in mm, z in m; expected one unit"),
        ("timestamp [sec],x,y,z,qx,qy,qz,qw", METRES, "header has stamp in sec; expected one unit of ns, us, ms, s"),
        ("timestamp [ns],x,y,z,qx,qw,qz,qy", METRES, "qx, qw, qz, qy; expected"),
        ("frame,x,y,z,qx,qy,qz,qw", METRES, "expected a timestamp first"),
    ],
)
def test_what_is_not_stated_or_contradicted_is_not_guessed(
    header: str, declared: PoseConventions, message: str, tmp_path: Path
) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        read_euroc_csv(csv(tmp_path, *filter(None, [header]), ROW, SECOND), "platform", declared)
    assert str(caught.value).startswith(str(tmp_path / "body.csv"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([ROW, SECOND[:30], THIRD], r"body\.csv:3: fields in the row: 4, expected 8 \(is the file cut off"),
        ([ROW, SECOND + ",7"], r"body\.csv:3: fields in the row: 9, expected 8"),
        ([ROW, SECOND.replace("1.25", "one")], r"body\.csv:3: y is 'one'; expected a number"),
        ([ROW, "", SECOND.replace("1.25", "")], r"body\.csv:4: y is empty; expected a number"),
        ([ROW, SECOND.replace("1.25", "nan")], r"body\.csv:3: y is nan; expected a finite number"),
        ([ROW, SECOND.replace("0.8", "-inf")], r"body\.csv:3: q2 is -inf; expected a finite number"),
        ([ROW, SECOND.replace("0.6,0,0.8", "0,0,0")], r"body\.csv:3: the quaternion is zero"),
        ([ROW, SECOND.replace("0.6", "0.61")], r"body\.csv:3: the quaternion's length is 1\.0060"),
        ([ROW, ROW], r"body\.csv:3: time stamp 1606153863362296104 ns repeats"),
        ([ROW, THIRD, SECOND], r"body\.csv:4: time stamp 1606153863412387371 ns goes backward"),
        ([ROW, "nan" + SECOND[19:]], r"body\.csv:3: time stamp 'nan' is not a finite number"),
        ([ROW, "x" + SECOND], r"body\.csv:3: time stamp 'x1606"),
        ([ROW, SECOND.replace(",", ";").replace(".", ",")], r"body\.csv:3: .*decimal commas"),
        ([ROW, SECOND.replace("1.25", "1_000")], r"body\.csv:3: y is '1_000'"),
        ([ROW, SECOND.replace("1.25", "1.2\xff")], r"body\.csv:3: y is '1\.2.'; expected a number"),
        ([ROW, "99999999999999999999" + SECOND[19:]], r"body\.csv:3: time stamp 9{20} is too large for ns"),
        (
            [ROW, SECOND, THIRD.replace("1.25", "1e5")],
            r"body\.csv:4: the position is 100000 m from the mocap origin",
        ),
        ([], r"body\.csv: there are no poses"),
    ],
)
def test_damaged_rows_are_named_by_file_and_line(lines: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message) as caught:
        read_euroc_csv(csv(tmp_path, PLAIN_HEADER, *lines), "platform", METRES)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["1.5,1,2,3,0,0,0,1"], r"body\.csv:1: fields separated by white space in the row: 1, expected 8"),
        (
            ["# t x y z qx qy qz qw", "1.5 1 2 3 0 0 0"],
            r"body\.csv:2: fields separated by white space in the row: 7",
        ),
        (["1.5 1 2 3 0 0 0 1", "2.5 1 2 3 0 0 0"], r"body\.csv:2: fields in the row: 7, expected 8"),
        (["1.5 1 2 3 0 0 0 1", "1e99 1 2 3 0 0 0 1"], r"body\.csv:2: time stamp 1e99 is too large for s"),
        (["1606153863362296104 1 2 3 0 0 0 1"], r"body\.csv:1: time stamp 1606153863362296104 is too large for s"),
        (["# only a comment"], r"body\.csv: there are no poses"),
    ],
)
def test_damaged_tum_rows_too(lines: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=message):
        read_tum(csv(tmp_path, *lines), "platform", PoseConventions())


@pytest.mark.parametrize("read", [read_euroc_csv, read_tum])
def test_missing_and_empty_files_are_named(read: Callable, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=r"body\.csv: there is no such file"):
        read(tmp_path / "body.csv", "b", METRES)
    for nothing in ("", "\ufeff", "\n \n"):
        (tmp_path / "body.csv").write_text(nothing, encoding="utf-8")
        with pytest.raises(GtcalError, match=r"body\.csv: the file is empty"):
            read(tmp_path / "body.csv", "b", METRES)
    with pytest.raises(GtcalError, match="can't be read"):
        read(tmp_path, "b", METRES)


def test_millimetres_declared_as_metres_are_noticed(tmp_path: Path) -> None:
    rows = (f"{EPOCH_NS + 8_333_333 * i},{-500 + i},1250,2000,0,0,0,1" for i in range(5))
    path = csv(tmp_path, PLAIN_HEADER, *rows)
    with pytest.raises(GtcalError, match=r"positions are 2410.* m from the mocap origin.*platform.length_unit: mm"):
        read_euroc_csv(path, "platform", METRES)
    assert read_euroc_csv(path, "platform", PoseConventions(length_unit="mm")).world_T_body[0, 0, 3] == -0.5


def test_seconds_declared_as_milliseconds_are_noticed_by_the_rate(tmp_path: Path) -> None:
    path = csv(tmp_path, *(f"{i / 120:.6f} 1 2 3 0 0 0 1" for i in range(5)))
    with pytest.raises(GtcalError, match=r"as ms, .* 120005 poses a second.*check platform.time_unit"):
        read_tum(path, "platform", PoseConventions(time_unit="ms"))


def test_quaternions_rounded_to_three_decimals_are_made_unit(tmp_path: Path) -> None:
    path = csv(tmp_path, "0.5 1 2 3 0.577 0.577 0.577 0.001")
    world_R_body = read_tum(path, "b", PoseConventions()).world_T_body[0, :3, :3]
    np.testing.assert_allclose(world_R_body @ world_R_body.T, np.eye(3), atol=1e-15)


def test_a_million_rows_would_take_seconds(tmp_path: Path) -> None:
    """50,000 rows in a twentieth of the time that is allowed for a million: twenty seconds on a busy machine."""
    trajectory = wandering_trajectory("b", n=200)
    repeated = Trajectory("b", EPOCH_NS + 8_333_333 * np.arange(50_000), np.tile(trajectory.world_T_body, (250, 1, 1)))
    write_euroc_csv(tmp_path / "long.csv", repeated)
    start = time.perf_counter()
    assert read_euroc_csv(tmp_path / "long.csv", "b", PoseConventions()).n_samples == 50_000
    assert time.perf_counter() - start < 1.0
