import csv
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from calibration_support import simulated
from mocap_files import CUBE_M, from_zero, markers_of, write_motive
from scipy.ndimage import uniform_filter1d
from support import replace_once, wandering_trajectory

import gtcal
from gtcal.errors import GtcalError
from gtcal.readers import BodySelection, PoseConventions, detect_mocap_format, inspect_mocap, read_motive_csv
from gtcal.recordings.recording import load_recording, write_recording
from gtcal.recordings.trajectory import Trajectory

SAID_BY_THE_FILE = PoseConventions()
EXPORTS = "data/mocap_exports"
A, B = (from_zero(wandering_trajectory(name, seed=seed)).world_T_body for seed, name in enumerate("ab"))
LABELS = tuple(f"a:Marker{i + 1}" for i in range(len(CUBE_M)))


def blank(poses: np.ndarray, *rows: int) -> np.ndarray:
    out = poses.copy()
    out[list(rows)] = np.nan
    return out


def measured(poses: np.ndarray, noise_m: float = 0.0, seed: int = 0) -> dict[str, np.ndarray]:
    at = markers_of(poses) + np.random.default_rng(seed).normal(0, 1, (len(poses), len(CUBE_M), 3)) * noise_m
    return dict(zip(LABELS, np.moveaxis(at, 1, 0), strict=True))


@pytest.mark.parametrize("unit", ["Meters", "Centimeters", "Millimeters"])
@pytest.mark.parametrize("rotation", ["Quaternion", "XYZ", "ZYX", "YXZ"])
def test_what_is_written_is_read_back(unit: str, rotation: str, tmp_path: Path) -> None:
    path = write_motive(tmp_path / "take.csv", {"a": A, "b": blank(B, 3, 4)}, unit=unit, rotation=rotation)
    a = read_motive_csv(path, "platform", SAID_BY_THE_FILE, BodySelection(name="a"))
    np.testing.assert_allclose(a.world_T_body, A, atol=1e-12)
    assert a.stamps_ns[[0, 1, 59]].tolist() == [0, 8_333_333, 491_666_667]
    b = read_motive_csv(path, "board_body", SAID_BY_THE_FILE, BodySelection(name="b", stamp_offset_ns=10**18))
    np.testing.assert_allclose(b.world_T_body, np.delete(B, [3, 4], axis=0), atol=1e-12)
    assert (b.body, b.n_samples, b.stamps_ns[0]) == ("board_body", 58, 10**18)


@pytest.mark.parametrize(
    "dress",
    [
        {"ending": "\n"},
        {"ending": "\r"},
        {"separator": ";"},
        {"separator": "\t"},
        {"parents": True, "settings": {"Format Version": "1.25"}},
        {"settings": {"Take Name": '"a, b"', "Take Notes": "one, two"}},
        {"settings": {"Take Name": "a, unquoted, name"}},
    ],
)
def test_one_take_in_many_dresses(dress: dict, tmp_path: Path) -> None:
    path = write_motive(tmp_path / "take.csv", {"a": blank(A, 7)}, **dress)
    assert detect_mocap_format(path) == "motive_csv"
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    np.testing.assert_allclose(trajectory.world_T_body, np.delete(A, 7, axis=0), atol=1e-12)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    np.testing.assert_array_equal(
        read_motive_csv(path, "platform", SAID_BY_THE_FILE).world_T_body, trajectory.world_T_body
    )


def test_times_that_were_rounded_are_the_frames_by_the_rate(tmp_path: Path) -> None:
    """At 360 Hz with three decimals a time is off by up to 0.5 ms."""
    path = write_motive(tmp_path / "take.csv", {"a": A}, rate_hz=360.0)
    rows = path.read_text().split("\n")
    rounded = list(rows)
    for index, row in enumerate(rows[7:-1], start=7):
        frame, time_s, rest = row.split(",", 2)
        rounded[index] = f"{frame},{float(time_s):.3f},{rest}"
    path.write_text("\n".join(rounded))
    stamps_ns = read_motive_csv(path, "platform", SAID_BY_THE_FILE).stamps_ns
    assert stamps_ns[:4].tolist() == [0, 2_777_778, 5_555_556, 8_333_333]


def test_a_part_of_a_take_keeps_its_times(tmp_path: Path) -> None:
    """Frames that are numbered anew, times that are not: rounded to a millisecond, but exact by the rate."""
    path = write_motive(tmp_path / "take.csv", {"a": A}, rate_hz=360.0, ending="\n")
    lines = path.read_text().split("\n")
    for i in range(60):
        frame, _, rest = lines[7 + i].split(",", 2)
        lines[7 + i] = f"{frame},{(i + 1000) / 360:.3f},{rest}"
    path.write_text("\n".join(lines))
    stamps_ns = read_motive_csv(path, "platform", SAID_BY_THE_FILE).stamps_ns
    np.testing.assert_allclose(stamps_ns, np.arange(1000, 1060) / 360 * 1e9, atol=5e5)
    np.testing.assert_allclose(np.diff(stamps_ns), 1e9 / 360, atol=1)


def test_the_real_rigid_body_export(shared: Callable[[str], Path]) -> None:
    path = shared(f"{EXPORTS}/motive_rigid_body_120hz_m.csv")
    summary = inspect_mocap(path)
    (body,) = summary.bodies
    assert (summary.format, summary.n_frames, summary.rate_hz, summary.length_unit) == ("motive_csv", 499, 120.0, "m")
    assert (body.name, body.n_seen, body.n_gaps, len(body.markers)) == ("ernesto_body", 498, 1, 4)
    assert set(summary.markers.values()) == {499}
    assert not summary.open_fields
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    np.testing.assert_allclose(trajectory.world_T_body[0, :3, 3], [3.717927, 0.045963, -2.209530], atol=1e-12)
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[7:]
    kept = [float(cell) for row in rows if row[2] for cell in row[6:9]]
    in_file = np.delete(trajectory.world_T_body, 4, axis=0)[:, :3, 3]
    np.testing.assert_array_equal(in_file.ravel(), kept)
    assert trajectory.n_samples == 499
    assert trajectory.notes[0].startswith(
        "platform: 1 frame without a pose in the file solved from the measured markers"
    )
    steps = np.linalg.norm(np.diff(trajectory.world_T_body[:10, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.001


def test_the_real_export_of_two_bodies_of_markers(shared: Callable[[str], Path]) -> None:
    summary = inspect_mocap(shared(f"{EXPORTS}/motive_rigid_bodies_120hz_m.csv"))
    (body,) = summary.bodies
    assert (body.name, body.n_seen, summary.n_frames, len(body.markers)) == ("RigidBody", 711, 712, 6)
    assert len(summary.markers) == 9
    unlabelled = inspect_mocap(shared(f"{EXPORTS}/motive_unlabelled_markers_360hz_mm.csv"))
    assert (unlabelled.n_frames, unlabelled.rate_hz, unlabelled.length_unit) == (1353, 360.0, "mm")
    assert (len(unlabelled.markers), unlabelled.markers["Unlabeled 1053"]) == (18, 1)
    assert unlabelled.bodies == ()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("motive_no_bodies.csv", "it holds no body and no markers"),
        (
            "motive_unlabelled_markers_360hz_mm.csv",
            "in platform.markers; it holds no body, only markers Unlabeled 1036",
        ),
    ],
)
def test_an_export_without_a_body_says_what_it_holds(name: str, message: str, shared: Callable[[str], Path]) -> None:
    with pytest.raises(GtcalError, match=message):
        read_motive_csv(shared(f"{EXPORTS}/{name}"), "platform", SAID_BY_THE_FILE)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Format Version", "Version", "1: is no Motive CSV; expected the first line to start with 'Format Version'"),
        ("Length Units,Meters", "Length Units,Feet", "1: Length Units is 'Feet'; expected metres"),
        ("Length Units", "Length", "doesn't state its length_unit.* add platform.length_unit to the manifest: m or mm"),
        ("Space,Global", "Space,Local", "1: Coordinate Space is 'Local'; export with Coordinate Space: Global"),
        ("Type,Quaternion", "Type,Axis", "1: Rotation Type is 'Axis'; expected Quaternion or an order of axes"),
        ("Type,Quaternion", "Type,XYZ", "7: Rigid Body 'a' has rotations in X, Y, Z, W, but line 1 says"),
        ("Export Frame Rate,120.0", "Export Frame Rate,100.0", "header says 100 frames a second, but .* mean 120"),
        ("Export Frame Rate,120.0", "Export Frame Rate,-1", "1: the frame rate is '-100000'; expected frames a second"),
        (",Type,Rigid Body,", ",Type,Rigid Bxdy,", "7: Rigid Body 'a' has no column Rotation X"),
        ("Position,Position", "Position,Rotation", "7: Rigid Body 'a' has no column Position Y"),
        ("Z,W,X,Y,Z", "Z,W,X,X,Z", "7: Rigid Body 'a' has 2 column Position X"),
        (r"Seconds\),X,Y,Z,W", "Seconds),X,Y,Z", "3: 10 cells, but line 7 names 9 columns"),
        ("Frame,Time", "Frnme,Time", "no line of the first 12 starts with 'Frame'"),
        ("\n,Type", "\n,Tpye", "7: expected lines with the Type and the Name"),
        ("\n1,0.00", "\n0,0.00", "9: frame 0 follows frame 0; frame numbers must increase"),
        ("\n1,0.00", "\n1.5,0.00", "9: the frame number is 1.5; expected a whole number"),
        ("\n2,0.016667", "\n2,0.008333", "10: the time does not increase"),
        ("\n2,0.016667,", "\n2,0.016667,x", "10: column 3 is 'x.*; expected a number or a blank cell"),
        ("\n2,0.016667,", "\n2,0.016667,3,", "10: the row has more than 10 cells, the header's"),
        ("\n2,0.016667,", "\n2,", r"10: cells in the row: 9, expected 10 \(is the file cut off"),
        ("\n2,0.016667,", "\n\n2,0.016667,", "11: there are more rows after a blank line"),
        ("\n2,0.016667,", "\n2,0.016667,0,", "10: the row has more than 10 cells"),
        ("\n2,0.016667,[^,]*", "\n2,0.016667,9.5", "'a': a quaternion's length is 9"),
        ("\n2,0.016667,[^,]*", "\n2,0.016667,1e400", "10: column 3 is '1e400"),
    ],
)
def test_damage_is_named_by_file_and_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_motive(tmp_path / "take.csv", {"a": A}, ending="\n")
    text, n = re.subn(old, new, path.read_text(), count=1)
    assert n == 1
    path.write_text(text)
    with pytest.raises(GtcalError, match=message) as caught:
        read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("declared", "selection", "message"),
    [
        (PoseConventions(), BodySelection(), "say which one is platform, in platform.name; it holds bodies a, b"),
        (PoseConventions(), BodySelection(name="c"), "platform.name: the file holds no body 'c'; it holds bodies a, b"),
        (PoseConventions("wxyz"), BodySelection(name="a"), "platform.quaternion: wxyz, but format motive_csv has xyzw"),
        (
            PoseConventions(None, "mm"),
            BodySelection(name="a"),
            "length_unit m, but the manifest says .*length_unit: mm",
        ),
        (
            PoseConventions(time_unit="ns"),
            BodySelection(name="a"),
            "platform.time_unit: ns, but format motive_csv has s",
        ),
        (PoseConventions(pose="body_T_world"), BodySelection(name="a"), "platform.pose: body_T_world, but format"),
        (PoseConventions(), BodySelection(name="a", rate_hz=100.0), "120 frames a second, but .*platform.rate_hz: 100"),
        (PoseConventions(), BodySelection(name="a", rotation="helical"), "quaternion_xyzw rotations, but .* helical"),
        (PoseConventions(), BodySelection(name="a", markers=("x", "y", "z")), "markers: the file holds no marker 'x'"),
    ],
)
def test_what_the_manifest_says_must_agree_with_the_file(
    declared: PoseConventions, selection: BodySelection, message: str, tmp_path: Path
) -> None:
    path = write_motive(tmp_path / "take.csv", {"a": A, "b": B})
    with pytest.raises(GtcalError, match=message):
        read_motive_csv(path, "platform", declared, selection)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (
            "expected",
            r"its pose leaves its own marker 'a:Marker1' behind by .* mm \(median\); are the axes right-handed",
        ),
        (
            "markers",
            r"rotations differ from those of its markers a:Marker1, .* deg \(median\); are the axes right-hand",
        ),
    ],
)
def test_mirrored_axes_are_noticed_by_the_markers(kind: str, message: str, tmp_path: Path) -> None:
    """An export with custom axes that flips one is left-handed: its rotations do not carry its markers along."""
    mirror = np.array([1.0, 1.0, -1.0])
    poses = A.copy()
    poses[:, :3, 3] *= mirror
    path = write_motive(
        tmp_path / "take.csv", {"a": poses}, **{kind: {label: mirror * at for label, at in measured(A).items()}}
    )
    with pytest.raises(GtcalError, match=message):
        read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    path = write_motive(tmp_path / "good.csv", {"a": A}, **{kind: measured(A)})
    assert read_motive_csv(path, "platform", SAID_BY_THE_FILE).n_samples == len(A)


def test_measured_markers_fill_the_frames_without_a_pose(tmp_path: Path) -> None:
    path = write_motive(tmp_path / "take.csv", {"a": blank(A, 5, 6, 20)}, markers=measured(A, 5e-5))
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    assert trajectory.n_samples == len(A)
    others = np.delete(np.arange(len(A)), [5, 6, 20])
    np.testing.assert_allclose(trajectory.world_T_body[others], A[others], atol=1e-12)
    np.testing.assert_allclose(trajectory.world_T_body[[5, 6, 20]], A[[5, 6, 20]], atol=1e-3)
    (note,) = trajectory.notes
    assert "platform: 3 frames without a pose in the file solved from the measured markers" in note


def smoothed(poses: np.ndarray, width: int) -> np.ndarray:
    """As a filter that looks back does: lagging."""
    out = poses.copy()
    out[:, :3, 3] = uniform_filter1d(poses[:, :3, 3], width, axis=0, origin=width // 2 - 1)
    return out


def test_measured_markers_take_the_place_of_poses_that_lag_behind_them(tmp_path: Path) -> None:
    lagging = smoothed(A, 5)
    assert np.abs(lagging - A).max() > 0.005
    path = write_motive(tmp_path / "take.csv", {"a": lagging}, markers=measured(A, 1e-4))
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    assert "solved from its 5 measured markers, which the file's poses miss by" in trajectory.notes[0]
    lag = np.median(trajectory.world_T_body[:, :3, 3] - A[:, :3, 3], axis=0)
    errors_m = np.linalg.norm(trajectory.world_T_body[:, :3, 3] - A[:, :3, 3] - lag, axis=1)
    of_file_m = np.linalg.norm(lagging[:, :3, 3] - A[:, :3, 3], axis=1)
    assert np.median(errors_m) < 0.1 * np.median(of_file_m)


def test_poses_as_good_as_the_markers_stay(tmp_path: Path) -> None:
    path = write_motive(tmp_path / "take.csv", {"a": A}, markers=measured(A, 2e-4))
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    np.testing.assert_allclose(trajectory.world_T_body, A, atol=1e-12)
    assert trajectory.notes == ()


def test_markers_that_are_of_no_use_leave_the_poses_alone(tmp_path: Path) -> None:
    """One that was never seen; and some that move against each other."""
    at = measured(A, 1e-5)
    at[LABELS[2]] = np.full((len(A), 3), np.nan)
    path = write_motive(tmp_path / "take.csv", {"a": blank(A, 5)}, markers=at)
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    assert trajectory.n_samples == len(A)
    assert "1 frame without a pose in the file solved from the measured markers" in trajectory.notes[0]
    loose = {
        label: points + np.random.default_rng(i).normal(0, 0.02, (len(A), 3))
        for i, (label, points) in enumerate(measured(A).items())
    }
    path = write_motive(tmp_path / "loose.csv", {"a": blank(A, 5)}, markers=loose)
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE)
    np.testing.assert_allclose(trajectory.world_T_body, np.delete(A, 5, axis=0), atol=1e-12)
    assert "platform: the measured markers are not used: the markers a:Marker1, " in trajectory.notes[0]


def test_a_body_can_be_solved_from_labels_alone(tmp_path: Path) -> None:
    path = write_motive(tmp_path / "take.csv", {"b": B}, markers=measured(A))
    selection = BodySelection(markers=LABELS)
    trajectory = read_motive_csv(path, "platform", SAID_BY_THE_FILE, selection)
    np.testing.assert_allclose(trajectory.world_T_body[:, :3, 3], markers_of(A).mean(axis=1), atol=1e-9)
    body_T_body = np.linalg.inv(A) @ trajectory.world_T_body
    np.testing.assert_allclose(body_T_body, np.broadcast_to(body_T_body[0], body_T_body.shape), atol=1e-9)


def test_a_recording_with_motive_exports_calibrates_as_with_the_poses_themselves(tmp_path: Path) -> None:
    recording = simulated(frames=30).recording
    manifest = write_recording(recording, tmp_path / "own")
    bodies = recording.motion.trajectories
    write_motive(tmp_path / "own" / "take.csv", {name: body.world_T_body for name, body in bodies.items()})
    fields = yaml.safe_load(manifest.read_text())
    for name, body in bodies.items():
        fields[name] = {
            "trajectory": "take.csv",
            "format": "motive_csv",
            "name": name,
            "stamp_offset_ns": int(body.stamps_ns[0]),
        }
    (tmp_path / "own" / "motive.yaml").write_text(yaml.safe_dump(fields))
    loaded = load_recording(tmp_path / "own" / "motive.yaml")
    for name, body in bodies.items():
        again: Trajectory = loaded.motion.trajectories[name]
        assert np.abs(again.stamps_ns - body.stamps_ns).max() <= 1
        np.testing.assert_allclose(again.world_T_body, body.world_T_body, atol=1e-12)
    options = gtcal.CalibrationOptions(mocap="exact", clock="trust")
    ours, theirs = (gtcal.calibrate(given, options) for given in (recording, loaded))
    for name, camera in ours.cameras.items():
        np.testing.assert_allclose(
            theirs.cameras[name].camera_T_ref.a_T_b, camera.camera_T_ref.a_T_b, atol=1e-6, err_msg=name
        )


def test_a_manifest_field_without_use_is_refused(tmp_path: Path, recording_folder: Path) -> None:
    replace_once(recording_folder / "recording.yaml", "platform: {", "platform: {name: headset, ")
    with pytest.raises(GtcalError, match=r"platform\.name: format euroc_csv has no use for it; leave it out"):
        load_recording(recording_folder)
