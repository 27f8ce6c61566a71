from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mocap_files import CUBE_M, from_zero, markers_of, write_vicon
from support import wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import BodySelection, PoseConventions, detect_mocap_format, inspect_mocap, read_c3d, read_vicon_csv

NOTHING = PoseConventions()
EXPORTS = "data/mocap_exports"
A, B = (from_zero(wandering_trajectory(name, seed=seed)).world_T_body for seed, name in enumerate("ab"))
LABELS = tuple(f"headset:m{i}" for i in range(len(CUBE_M)))
MARKERS = dict(zip(LABELS, np.moveaxis(markers_of(A), 1, 0), strict=True))


@pytest.mark.parametrize("angles", ["deg", "rad"])
@pytest.mark.parametrize(
    ("written", "declared"),
    [
        ("helical", "helical"),
        ("XYZ", "euler_xyz_intrinsic"),
        ("xyz", "euler_xyz_extrinsic"),
        ("ZXY", "euler_zxy_intrinsic"),
    ],
)
def test_what_is_written_is_read_back(angles: str, written: str, declared: str, tmp_path: Path) -> None:
    b = B.copy()
    b[[3, 9]] = np.nan
    path = write_vicon(
        tmp_path / "t.csv", segments={"headset:root": A, "board:root": b}, rotation=written, angles=angles
    )
    assert detect_mocap_format(path) == "vicon_csv"
    selection = BodySelection(name="headset:root", rotation=declared)
    trajectory = read_vicon_csv(path, "platform", NOTHING, selection)
    np.testing.assert_allclose(trajectory.world_T_body, A, atol=1e-12)
    assert trajectory.stamps_ns[[0, 1, 59]].tolist() == [0, 10_000_000, 590_000_000]
    board = read_vicon_csv(path, "board_body", NOTHING, BodySelection(name="board:root", rotation=declared))
    np.testing.assert_allclose(board.world_T_body, np.delete(B, [3, 9], axis=0), atol=1e-12)


def test_how_rotations_are_written_is_asked_for_never_guessed(tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "t.csv", segments={"headset:root": A})
    with pytest.raises(GtcalError, match=r"state how it writes rotations.*add platform\.rotation to.*helical, or"):
        read_vicon_csv(path, "platform", NOTHING)
    with pytest.raises(GtcalError, match=r"platform\.rotation: quaternion_xyzw takes 4 numbers, but the file has 3"):
        read_vicon_csv(path, "platform", NOTHING, BodySelection(rotation="quaternion_xyzw"))
    assert inspect_mocap(path).open_fields == ("rotation",)


def test_the_wrong_notation_is_noticed_by_the_markers(tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "t.csv", segments={"headset:root": A}, markers=MARKERS, rotation="XYZ")
    good = read_vicon_csv(path, "platform", NOTHING, BodySelection(rotation="euler_xyz_intrinsic"))
    np.testing.assert_allclose(good.world_T_body, A, atol=1e-12)
    for wrong in ("helical", "euler_xyz_extrinsic", "euler_zyx_intrinsic"):
        with pytest.raises(GtcalError, match="rotations differ from those of its markers headset:m0"):
            read_vicon_csv(path, "platform", NOTHING, BodySelection(rotation=wrong))


def test_segments_and_markers_in_one_file(tmp_path: Path) -> None:
    lost = A.copy()
    lost[10:13] = np.nan
    path = write_vicon(tmp_path / "t.csv", segments={"headset:root": lost}, markers=MARKERS, ending="\r\n")
    trajectory = read_vicon_csv(path, "platform", NOTHING, BodySelection(rotation="helical"))
    np.testing.assert_allclose(trajectory.world_T_body, A, atol=1e-6)
    assert "3 frames without a pose in the file solved from the measured markers" in trajectory.notes[0]


def test_frames_count_from_one_and_gaps_stay_gaps(tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "t.csv", markers=MARKERS, first_frame=101)
    assert read_vicon_csv(path, "p", NOTHING, BodySelection(name="headset")).stamps_ns[0] == 1_000_000_000
    lines = path.read_text().split("\n")
    path.write_text("\n".join(lines[:20] + lines[25:]))
    stamps_ns = read_vicon_csv(path, "p", NOTHING, BodySelection(name="headset")).stamps_ns
    assert sorted(set(np.diff(stamps_ns).tolist())) == [10_000_000, 60_000_000]


def test_the_real_trajectories(shared: Callable[[str], Path]) -> None:
    path = shared(f"{EXPORTS}/vicon_trajectories_100hz_mm.csv")
    summary = inspect_mocap(path)
    assert (summary.format, summary.n_frames, summary.rate_hz, summary.length_unit) == ("vicon_csv", 580, 100.0, "mm")
    assert summary.duration_s == pytest.approx(5.79)
    assert len(summary.markers) == 51
    assert 3 * sum(580 - seen for seen in summary.markers.values()) == 915
    assert [(body.name, len(body.markers), body.from_markers) for body in summary.bodies] == [
        ("boite", 8, True),
        ("Daphnee", 43, True),
    ]
    box = read_vicon_csv(path, "board_body", NOTHING, BodySelection(name="boite"))
    assert 575 <= box.n_samples <= 580
    assert "solved from 8 markers, residual 0.18" in box.notes[0]
    first = [(44.1628, -276.862, 675.697), (32.5723, -243.141, 676.575), (-93.7218, 124.786, 674.279)]
    first += [(-105.003, 158.004, 673.881), (42.109, -191.127, 722.982), (-55.3104, 89.9533, 721.819)]
    first += [(226.504, 188.591, 725.891), (324.851, -95.219, 727.229)]
    np.testing.assert_allclose(box.world_T_body[0, :3, 3], np.mean(first, axis=0) / 1000, atol=1e-3)


def test_the_same_take_as_c3d(shared: Callable[[str], Path]) -> None:
    pytest.importorskip("ezc3d")
    selection = BodySelection(name="boite")
    csv = read_vicon_csv(shared(f"{EXPORTS}/vicon_trajectories_100hz_mm.csv"), "b", NOTHING, selection)
    c3d = read_c3d(shared(f"{EXPORTS}/markers_analogs.c3d"), "b", NOTHING, selection)
    np.testing.assert_array_equal(csv.stamps_ns, c3d.stamps_ns)
    np.testing.assert_allclose(csv.world_T_body, c3d.world_T_body, atol=1e-4)  # the CSV has six digits


def test_people_are_no_rigid_bodies(shared: Callable[[str], Path]) -> None:
    path = shared(f"{EXPORTS}/vicon_trajectories_100hz_mm.csv")
    with pytest.raises(
        GtcalError, match=r"csv: platform: the markers Daphnee.* move against each other by .* mm rms; are"
    ):
        read_vicon_csv(path, "platform", NOTHING, BodySelection(name="Daphnee"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Trajectories", "Trajectoris", "1: 'Trajectoris' is no title of a section; expected one of Trajectories, Seg"),
        ("\n100\n", "\nfast\n", "2: the rate is 'fast'; expected frames a second"),
        ("\n100\n", "\n\n", r"doesn't state their rate; add platform\.rate_hz"),
        ("Frame,Sub Frame", "Frm,Sub Frame", "4: expected the columns to start with Frame and Sub Frame"),
        ("Sub Frame,X,Y,Z", "Sub Frame,X,Y,Q", "4: columns 3 on are X, Y, Q; expected X, Y, Z under each name"),
        ("headset:m1", "headset:m0", "3: the name 'headset:m0' stands twice"),
        ("headset:m1,,", ",headset:m1,", "3: expected one name above the columns 6 on"),
        ("\n,,mm,mm,mm", "\n,,mm,mm,m", "5: positions are in 'm', 'mm'; expected one unit"),
        (",mm,mm", ",ft,ft", "5: positions are in"),
        ("\n2,0,", "\n2,1,", "7: Sub Frame is not 0; expected one row per frame"),
        ("\n2,0,", "\n1,0,", "7: frame 1 follows frame 1"),
        ("\n2,0,", "\n2,0,,", "7: the row has more than 17 cells"),
        ("\n2,0,", "\n2,", "7: cells in the row: 16, expected 17"),
        ("\n2,0,", "\n2,0,--", "7: column 3 is '--"),
    ],
)
def test_damage_is_named_by_file_and_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "t.csv", markers=MARKERS)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(GtcalError, match=message) as caught:
        read_vicon_csv(path, "platform", NOTHING, BodySelection(name="headset"))
    assert "\n" not in str(caught.value)


def test_a_rate_or_unit_that_the_file_does_not_state_is_asked_for(tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "t.csv", markers=MARKERS, units=False)
    path.write_text(path.read_text().replace("\n100\n", "\n,\n", 1))
    assert set(inspect_mocap(path).open_fields) == {"length_unit", "rate_hz"}
    with pytest.raises(GtcalError, match=r"add platform\.length_unit to the manifest: m or mm"):
        read_vicon_csv(path, "platform", NOTHING, BodySelection(name="headset"))
    millimetres = PoseConventions(length_unit="mm")
    with pytest.raises(GtcalError, match=r"doesn't state their rate; add platform\.rate_hz"):
        read_vicon_csv(path, "platform", millimetres, BodySelection(name="headset"))
    found = read_vicon_csv(path, "platform", millimetres, BodySelection(name="headset", rate_hz=50.0))
    assert found.stamps_ns[1] == 20_000_000
    np.testing.assert_allclose(found.world_T_body[:, :3, 3], markers_of(A).mean(axis=1), atol=1e-9)


def test_other_sections_are_passed_over(tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "t.csv", markers=MARKERS)
    devices = "Devices\n1000\n,,Force\nFrame,Sub Frame,Fx\n,,N\n1,0,1.5\n1,1,1.25\n\n"
    path.write_text(devices + path.read_text())
    assert detect_mocap_format(path) == "vicon_csv"
    assert read_vicon_csv(path, "p", NOTHING, BodySelection(name="headset")).n_samples == len(A)
    path.write_text(devices)
    with pytest.raises(GtcalError, match="there is no section Segments or Trajectories"):
        read_vicon_csv(path, "p", NOTHING)
