"""The doctor: injected faults named with the lines that mend them, clean recordings left alone."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_support import all_in, files_in, run
from doctor_support import (
    Change,
    corner_ids,
    fields_of,
    mirrored_world,
    pixels,
    poses,
    scaled,
    since_start,
    stamps,
    swapped_bodies,
    swapped_cameras,
    theta,
    write_bare,
    write_lines,
    written,
)
from media_support import small_simulation

from factors.rigid import inverse
from gtcal import Diagnosis, GtcalError, diagnose, load_recording
from gtcal.board import AprilGrid, ArucoGrid, CharucoBoard, board_from_manifest
from gtcal.doctor.alone_search import with_found_intrinsics
from gtcal.doctor.diagnose import diagnose_recording
from gtcal.doctor.hint import likely_mistake, looks_wrong
from gtcal.doctor.manifest_lines import line_of, with_lines
from gtcal.estimation.observations import synchronise
from gtcal.estimation.options import CalibrationOptions
from gtcal.estimation.solver import DisagreementError
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording
from gtcal.simulation import (
    CornerNoise,
    MocapNoise,
    SimulationOptions,
    fixed_cameras_rig,
    quest3_like_rig,
    simulate,
    write_simulation,
)
from gtcal.workflow import calibrate

NOISE = {
    "mocap": MocapNoise(translation_mm=0.1, rotation_deg=0.01, gap_share=0.05),
    "corners": CornerNoise(pixel_px=0.1, missed_share=0.05, wrong_tag_share=0.01, wrong_corner_share=0.01),
}
HEADSET, STANDING, FIXED = "headset, two cameras", "one camera carried, AprilGrid stands", "fixed pinhole and fisheye"
_QUEST = quest3_like_rig()
SMALL = {
    HEADSET: {
        "rig": replace(_QUEST, cameras=_QUEST.cameras[::2], rig_T_camera=_QUEST.rig_T_camera[::2]),
        "capture": Capture.TRACKED_PLATFORM,
    },
    STANDING: {
        "rig": fixed_cameras_rig(1, models=("fisheye62",)),
        "capture": Capture.STANDING_BOARD,
        "board": AprilGrid(6, 6, 0.06, 0.3),
    },
    FIXED: {"rig": fixed_cameras_rig(2, models=("pinhole_radtan", "fisheye62")), "capture": Capture.FIXED_CAMERAS},
}
"""One recording of each capture kind, with few cameras: the alignment costs by camera."""
BOTH = ("platform", "board_body")


@cache
def recorded(kind: str, seed: int = 0) -> Recording:
    return simulate(SimulationOptions(n_frames=50, duration_s=33.0, **NOISE, **SMALL[kind]), seed=seed).recording


def same(recording: Recording) -> Recording:
    return recording


@dataclass(frozen=True)
class Fault:
    """Something wrong. change: of the data; lines: in the manifest, in place of the true ones. name: the fault's kind;
    fixes: what the doctor must say. mends: whether its lines alone make it right."""

    kind: str
    name: str
    fixes: tuple[str, ...]
    change: Change = same
    lines: tuple[str, ...] = ()
    mends: bool = True


def reordered(*order: int) -> Callable[[np.ndarray], np.ndarray]:
    """Coefficients in another order, of the lenses that have so many."""
    return lambda values: (
        np.concatenate([values[:4], values[4:][list(order)]]) if len(values) == 4 + len(order) else values
    )


def upside_down(recording: Recording) -> Recording:
    size = lambda camera: np.array([camera.image_width_px - 1.0, camera.image_height_px - 1.0])  # noqa: E731
    return pixels(recording, lambda camera, px: size(camera) - px, ["cam0"])


def wrong_lens(recording: Recording) -> Recording:
    return theta(recording, lambda values: values * np.array([1.08] * 2 + [1.0] * 10))


def left_for_right(recording: Recording) -> Recording:
    return pixels(recording, lambda camera, px: np.column_stack([camera.image_width_px - 1.0 - px[:, 0], px[:, 1]]))


def by_column(recording: Recording) -> Recording:
    """Tags numbered column by column."""
    board = recording.board
    place = np.arange(board.n_tags).reshape(board.tag_rows, board.tag_columns).T.ravel()
    return corner_ids(recording, (4 * np.argsort(place)[:, None] + np.arange(4)).ravel())


A2 = {**board_from_manifest({"preset": "paper_a2"}).to_manifest()}
FAULTS = {
    "quaternion order": Fault(
        HEADSET, "quaternion order", ("platform.quaternion: wxyz",), lines=("platform.quaternion: xyzw",)
    ),
    "quaternion order of both": Fault(
        HEADSET,
        "quaternion order",
        ("platform.quaternion: wxyz", "board_body.quaternion: wxyz"),
        lines=("platform.quaternion: xyzw", "board_body.quaternion: xyzw"),
    ),
    "quaternion order not stated": Fault(
        STANDING, "quaternion order", ("platform.quaternion: wxyz",), lines=("platform.quaternion: null",)
    ),
    "inverse poses": Fault(
        FIXED, "inverse poses", ("board_body.pose: body_T_world",), lambda r: poses(r, ("board_body",), inverse)
    ),
    "poses that are not inverse": Fault(
        STANDING, "inverse poses", ("platform.pose: world_T_body",), lines=("platform.pose: body_T_world",)
    ),
    "mm said to be m": Fault(
        HEADSET,
        "units",
        ("platform.length_unit: mm", "board_body.length_unit: mm"),
        lambda r: poses(r, BOTH, scaled(1000.0)),
    ),
    "m said to be mm": Fault(FIXED, "units", ("board_body.length_unit: m",), lines=("board_body.length_unit: mm",)),
    "cm": Fault(
        FIXED,
        "units",
        ("they are in cm",),
        lambda r: poses(r, ("board_body",), scaled(100.0)),
        ("board_body.length_unit: mm",),
        mends=False,
    ),
    "left-handed": Fault(
        HEADSET,
        "handedness",
        ("export platform in right-handed coordinates", "export board_body in right-handed coordinates"),
        lambda r: poses(r, BOTH, mirrored_world),
        mends=False,
    ),
    "swapped bodies": Fault(
        HEADSET,
        "swapped bodies",
        ("platform: {trajectory: board_body.csv", "board_body: {trajectory: platform.csv"),
        swapped_bodies,
    ),
    "swapped cameras": Fault(
        HEADSET,
        "swapped cameras",
        (
            "cameras.front_left.detections: side_left_detections.csv",
            "cameras.side_left.detections: front_left_detections.csv",
        ),
        lambda r: swapped_cameras(r, "front_left", "side_left"),
    ),
    "board scale": Fault(STANDING, "board scale", ("board.tag_side_m: 0.0",), lines=("board.tag_side_m: 0.0582",)),
    "board in mm": Fault(STANDING, "board size", ("board.tag_side_m: 0.06",), lines=("board.tag_side_m: 60.0",)),
    "board gaps": Fault(STANDING, "board gaps", ("board.tag_spacing: 0.3",), lines=("board.tag_spacing: 0.25",)),
    "board gaps of an ArUco grid": Fault(
        FIXED,
        "board gaps",
        ("board.tag_gap_m: 0.0295",),
        lines=(line_of("board", A2 | {"tag_gap_m": 0.02}),),
    ),
    "columns and rows": Fault(
        FIXED,
        "board columns and rows",
        ("board.tag_columns: 6", "board.tag_rows: 4"),
        lines=(line_of("board", A2 | {"tag_columns": 4, "tag_rows": 6}),),
    ),
    "board type": Fault(
        STANDING,
        "board type",
        ("board: {type: aprilgrid",),
        lines=(
            line_of(
                "board",
                ArucoGrid("DICT_APRILTAG_36H11", 6, 6, 0.06, 0.018, corner_squares=True).to_manifest(),
            ),
        ),
    ),
    "tag order": Fault(FIXED, "tag order", ("the tags are counted column by column",), by_column, mends=False),
    "p order": Fault(
        HEADSET,
        "tangential order",
        ("cameras.front_left.parameters: {", "cameras.side_left.parameters: {"),
        lambda r: theta(r, reordered(0, 1, 2, 3, 4, 5, 7, 6)),
    ),
    "k and p order": Fault(
        HEADSET,
        "coefficient order",
        ("cameras.front_left.parameters: {", "cameras.side_left.parameters: {"),
        lambda r: theta(r, reordered(0, 1, 6, 7, 2, 3, 4, 5)),
    ),
    "k3 before p1 and p2": Fault(
        FIXED, "coefficient order", ("cameras.cam0.parameters: {",), lambda r: theta(r, reordered(0, 1, 4, 2, 3))
    ),
    "images of half the size": Fault(
        FIXED,
        "image size",
        ("cameras.cam0.image_size_px: [640, 512]", "cameras.cam1.image_size_px: [640, 512]"),
        lambda r: pixels(r, lambda _, px: (px + 0.5) / 2.0 - 0.5),
    ),
    "width and height exchanged": Fault(
        FIXED,
        "image size",
        ("cameras.cam0.image_size_px: [1280, 1024]",),
        lines=("cameras.cam0.image_size_px: [1024, 1280]",),
    ),
    "image upside down": Fault(FIXED, "image upside down", ("cameras.cam0.parameters: {",), upside_down),
    "mirrored images": Fault(HEADSET, "mirrored images", ("left for right",), left_for_right, mends=False),
    "wrong lens": Fault(
        STANDING,
        "intrinsics",
        ("cameras.cam0.parameters: {",),
        wrong_lens,
    ),
    "us said to be ns": Fault(
        FIXED, "time unit", ("board_body.time_unit: us",), lambda r: stamps(r, lambda ns: ns // 1000, bodies=True)
    ),
    "us said to be ms": Fault(
        STANDING,
        "time unit",
        ("platform.time_unit: us",),
        lambda r: stamps(since_start(r), lambda ns: ns // 1000, bodies=True),
        ("platform.time_unit: ms",),
    ),
    "images stamped in us": Fault(
        HEADSET,
        "time unit",
        ("multiply them by 1,000",),
        lambda r: stamps(r, lambda ns: ns // 1000, bodies=False),
        mends=False,
    ),
    "clock ahead": Fault(
        FIXED,
        "clock offset",
        ("gtcal calibrate --clock estimate or add -0.",),
        lambda r: stamps(r, lambda ns: ns + 200_000_000, bodies=False),
        mends=False,
    ),
    "clock seconds behind": Fault(
        STANDING,
        "clock offset",
        ("platform.stamp_offset_ns: -3000",),
        lambda r: stamps(r, lambda ns: ns - 3_000_000_000, bodies=False),
    ),
    "clock of another epoch": Fault(
        FIXED,
        "clock offset",
        ("board_body.stamp_offset_ns: 1599999999999",),
        lambda r: stamps(r, lambda ns: ns - 1_600_000_000_000_000_000, bodies=True),
    ),
    "one camera's clock": Fault(
        HEADSET,
        "clock offset",
        ("--clock per_camera", "to the time stamps of side_left"),
        lambda r: stamps(r, lambda ns: ns + 25_000_000, bodies=False, cameras=("side_left",)),
        mends=False,
    ),
}


def check(folder: Path, fault: Fault, clean: dict[str, object] | None = None) -> Diagnosis:
    """The fault is named, with its fix and evidence; and where the fix is in the manifest, it mends it: the manifest
    is then the ``clean`` one, or the doctor finds nothing more."""
    found = diagnose(folder)
    assert not found.healthy
    assert {finding.fault for finding in found.findings} == {fault.name}
    assert found.unexplained is None
    said = " | ".join(fix for finding in found.findings for fix in finding.fixes)
    assert all_in(said, fault.fixes)
    assert all(finding.evidence for finding in found.findings)
    if fault.mends:
        assert not any(finding.advice for finding in found.findings)
        write_lines(folder, found.lines)
        assert fields_of(folder) == clean or diagnose(folder).healthy
    return found


QUICK = ("quaternion order", "board scale", "us said to be ms", "clock ahead")
"""One fault of each kind of search; the others are ``long``."""


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in FAULTS]
)
def test_a_fault_is_named_with_the_lines_that_mend_it(name: str, tmp_path: Path) -> None:
    fault = FAULTS[name]
    folder = written(fault.change(recorded(fault.kind)), tmp_path / "r", fault.lines)
    check(folder, fault, clean_fields(fault, tmp_path))


def clean_fields(fault: Fault, folder: Path) -> dict[str, object] | None:
    """The right manifest of data that are right: with it the recording is the one that the clean test looks at."""
    return fields_of(written(recorded(fault.kind), folder / "clean")) if fault.change is same else None


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "said", "was", "body"),
    [
        (FIXED, Capture.STANDING_BOARD, "board_body", "platform"),
        (STANDING, Capture.FIXED_CAMERAS, "platform", "board_body"),
    ],
)
def test_another_capture_is_as_likely_as_inverse_poses(kind: str, said: Capture, was: str, body: str) -> None:
    recording = recorded(kind)
    bodies = {was: None, body: replace(getattr(recording, was), body=body)}
    found = diagnose_recording(replace(recording, capture=said, **bodies))
    (finding,) = found.findings
    assert finding.fault == "inverse poses"
    assert finding.alternatives == (f"write capture: {recording.capture.value}, and {was} in place of {body}",)


@pytest.mark.long
@pytest.mark.parametrize("kind", SMALL)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_clean_recording_is_healthy(kind: str, seed: int, tmp_path: Path) -> None:
    found = diagnose(written(recorded(kind, seed), tmp_path / "r"))
    assert (found.healthy, found.findings) == (True, ())
    assert found.misfit_mm < 5.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (STANDING, {"board": CharucoBoard("DICT_5X5_100", 8, 6, 0.06, 0.045), "intrinsics": "none"}),
        (FIXED, {"board": ArucoGrid("DICT_4X4_50", 5, 7, 0.05, 0.0125)}),
        (HEADSET, {"swap_share": 0.05, "corners": CornerNoise(pixel_px=0.3)}),
    ],
)
def test_other_boards_and_noise_are_healthy_too(kind: str, changes: dict[str, object], tmp_path: Path) -> None:
    options = SimulationOptions(n_frames=50, duration_s=33.0, **{**NOISE, **SMALL[kind], **changes})
    recording = simulate(options, seed=7).recording
    assert diagnose(written(recording, tmp_path / "r")).findings == ()


@pytest.mark.long
def test_without_intrinsics_too_the_board_is_judged(tmp_path: Path) -> None:
    recording = recorded(STANDING)
    bare = replace(recording, cameras={name: replace(c, parameters=None) for name, c in recording.cameras.items()})
    wrong = AprilGrid(4, 9, 0.06, 0.3)
    folder = written(bare, tmp_path / "r", [line_of("board", wrong.to_manifest())])
    found = diagnose(folder)
    assert found.lines == ("board.tag_columns: 6", "board.tag_rows: 6")


@pytest.mark.long
def test_a_camera_with_too_few_views_for_its_lens_is_left_out(tmp_path: Path) -> None:
    recording = recorded(FIXED)
    bare = {name: replace(camera, parameters=None) for name, camera in recording.cameras.items()}
    few = recording.detections["cam1"].select_views(np.arange(recording.detections["cam1"].n_views) < 3)
    poor = replace(recording, cameras=bare, detections=recording.detections | {"cam1": few})
    found = diagnose(written(poor, tmp_path / "r"))
    assert found.healthy
    assert any("left out: camera 'cam1'" in note for note in found.notes)


@pytest.mark.long
def test_two_faults_that_only_show_together(tmp_path: Path) -> None:
    wrong = poses(recorded(FIXED), ("board_body",), inverse)
    folder = written(wrong, tmp_path / "r", ["board_body.quaternion: xyzw"])
    found = diagnose(folder)
    assert set(found.lines) == {"board_body.quaternion: wxyz", "board_body.pose: body_T_world"}
    assert all(finding.before > 100.0 * finding.after for finding in found.findings)
    write_lines(folder, found.lines)
    assert diagnose(folder).healthy


@pytest.mark.long
def test_faults_of_lens_and_trajectory_and_clock_are_all_named(tmp_path: Path) -> None:
    wrong = theta(recorded(FIXED), reordered(0, 1, 4, 2, 3))
    wrong = stamps(wrong, lambda ns: ns + 120_000_000, bodies=False)
    folder = written(wrong, tmp_path / "r", ["board_body.quaternion: xyzw"])
    found = diagnose(folder)
    assert {finding.fault for finding in found.findings} == {"coefficient order", "quaternion order", "clock offset"}
    assert "board_body.quaternion: wxyz" in found.lines


@pytest.mark.long
def test_what_can_not_be_told_apart_is_listed(tmp_path: Path) -> None:
    found = diagnose(written(recorded(STANDING), tmp_path / "r", ["board.tag_side_m: 0.0582"]))
    (finding,) = found.findings
    side_m = float(finding.lines[0].partition(": ")[2])
    assert side_m == pytest.approx(0.06, rel=2e-3)
    assert re.search(r"mocap's positions by 0\.9[67]\d\d", finding.alternatives[0])
    alike = recorded(FIXED)
    lens = replace(alike.cameras["cam1"], name="cam0")
    twins = replace(alike, cameras={**alike.cameras, "cam0": lens}, detections={**alike.detections})
    twins = replace(twins, detections={"cam0": alike.detections["cam1"], "cam1": alike.detections["cam1"]})
    found = diagnose(written(twins, tmp_path / "twins"))
    assert any("cam0, cam1 are so alike" in note for note in found.notes)


@pytest.mark.long
def test_a_header_that_is_wrong_is_to_be_corrected_where_it_stands(tmp_path: Path) -> None:
    folder = written(recorded(STANDING), tmp_path / "r")
    csv = folder / "platform.csv"
    csv.write_text("timestamp [ns],x [m],y [m],z [m],qx,qy,qz,qw\n" + csv.read_text())
    fields = fields_of(folder)["platform"]
    write_lines(folder, [line_of("platform", {key: fields[key] for key in ("trajectory", "format")})])
    found = diagnose(folder)
    (finding,) = found.findings
    assert (finding.fault, finding.lines) == ("quaternion order", ())
    assert "correct the header of platform.csv" in finding.advice[0]
    assert "platform.quaternion: wxyz" in finding.advice[0]


@pytest.mark.long
def test_other_recordings_are_told_to_be_so(tmp_path: Path) -> None:
    """A trajectory of another recording: no reading helps, and nothing is made up."""
    recording = recorded(STANDING)
    other = recorded(STANDING, 3).platform
    found = diagnose_recording(replace(recording, platform=other))
    assert not found.healthy
    assert "no other reading of the files brings them together" in found.unexplained
    far = replace(other, stamps_ns=other.stamps_ns - 7 * 10**17)
    assert "share no time" in diagnose_recording(replace(recording, platform=far)).unexplained


# The real recording


_FOUND: dict[str, Recording] = {}


@pytest.fixture(name="vicon")
def _vicon(vicon_recording: Callable[..., Path]) -> Recording:
    """With intrinsics, found once: none are published."""
    if not _FOUND:
        _FOUND["vicon"] = with_found_intrinsics(load_recording(vicon_recording()), frozenset({"cam0"}))
    return _FOUND["vicon"]


@pytest.mark.long
def test_the_real_recording_is_healthy(vicon_recording: Callable[..., Path], vicon: Recording, tmp_path: Path) -> None:
    found = diagnose(vicon_recording(Capture.STANDING_BOARD))  # as it stands, without intrinsics
    assert found.healthy
    found = diagnose(written(vicon, tmp_path / "r"))
    assert found.healthy
    assert any("board_body stands still" in note for note in found.notes)


BOTH_BODIES = "both bodies"
VICON_FAULTS = {
    "quaternion order": Fault(
        BOTH_BODIES, "quaternion order", ("platform.quaternion: wxyz",), lines=("platform.quaternion: xyzw",)
    ),
    "inverse poses": Fault(
        "", "inverse poses", ("platform.pose: body_T_world",), lambda r: poses(r, ("platform",), inverse)
    ),
    "units": Fault(
        "",
        "units",
        ("platform.length_unit: mm",),
        lambda r: poses(r, ("platform",), scaled(1000.0)),
    ),
    "handedness": Fault(
        "",
        "handedness",
        ("export platform in right-handed",),
        lambda r: poses(r, ("platform",), mirrored_world),
        mends=False,
    ),
    "swapped bodies": Fault(BOTH_BODIES, "swapped bodies", ("platform: {trajectory: board_body.csv",), swapped_bodies),
    "board scale": Fault("", "board scale", ("board.tag_side_m: 0.08",), lines=("board.tag_side_m: 0.08",)),
    "board gaps": Fault("", "board gaps", ("board.tag_spacing: 0.3",), lines=("board.tag_spacing: 0.25",)),
    "board type": Fault(
        "",
        "board type",
        ("board: {type: aprilgrid",),
        lines=(
            line_of("board", ArucoGrid("DICT_APRILTAG_36H11", 6, 6, 0.088, 0.0264, corner_squares=True).to_manifest()),
        ),
    ),
    "clock": Fault(
        "",
        "clock offset",
        ("to the time stamps of all cameras",),
        lambda r: stamps(r, lambda ns: ns + 200_000_000, bodies=False),
        mends=False,
    ),
    "time unit": Fault(
        "",
        "time unit",
        ("platform.time_unit: us",),
        lambda r: stamps(r, lambda ns: ns // 1000, bodies=True),
    ),
    "p order": Fault(
        "", "tangential order", ("cameras.cam0.parameters: {",), lambda r: theta(r, reordered(0, 1, 3, 2, 4))
    ),
    "image size": Fault(
        "",
        "image size",
        ("cameras.cam0.image_size_px: [320, 240]",),
        lambda r: pixels(r, lambda _, px: (px + 0.5) / 2.0 - 0.5),
    ),
    "image upside down": Fault("", "image upside down", ("cameras.cam0.parameters: {",), upside_down),
    "mirrored images": Fault("", "mirrored images", ("left for right",), left_for_right, mends=False),
}


@pytest.mark.long
@pytest.mark.parametrize("name", VICON_FAULTS)
def test_a_fault_of_the_real_recording_is_named(name: str, vicon: Recording, tmp_path: Path) -> None:
    """Mostly without the board's trajectory: it stands, and one body has fewer readings to try."""
    fault = VICON_FAULTS[name]
    if fault.kind != BOTH_BODIES:
        vicon = replace(vicon, capture=Capture.STANDING_BOARD, board_body=None)
    check(written(fault.change(vicon), tmp_path / "r", fault.lines), fault)


@pytest.mark.long
def test_the_real_files_say_what_board_they_are_of(vicon_recording: Callable[..., Path]) -> None:
    folder = vicon_recording()
    write_lines(folder, ["board.tag_side_m: 0.08"])
    (finding,) = diagnose(folder).findings
    assert (finding.fault, finding.lines, finding.before) == ("board size", ("board.tag_side_m: 0.088",), None)


# calibrate points to the doctor


def test_calibrate_names_the_likely_mistake_and_the_doctor(tmp_path: Path) -> None:
    folder = written(recorded(FIXED), tmp_path / "r", ["board_body.quaternion: xyzw"])
    with pytest.raises(DisagreementError, match=r"set board_body\.quaternion: wxyz in the manifest") as caught:
        calibrate(load_recording(folder))
    assert f"'gtcal doctor {folder}' tells more" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_calibrate_has_no_hint_where_no_reading_helps(tmp_path: Path) -> None:
    wrong = stamps(recorded(FIXED), lambda ns: ns + 600_000_000, bodies=False)
    with pytest.raises(DisagreementError, match=r"check quaternion order, inverse poses, units.*'gtcal doctor"):
        calibrate(load_recording(written(wrong, tmp_path / "r")))


def test_calibrate_warns_of_what_looks_wrong_and_of_nothing_else(tmp_path: Path) -> None:
    options = CalibrationOptions(clock="trust", mocap="exact")
    wrong = stamps(recorded(FIXED), lambda ns: ns + 30_000_000, bodies=False)
    folder = written(wrong, tmp_path / "r")
    calibration = calibrate(load_recording(folder), options)
    assert any(f"'gtcal doctor {folder}' may tell why" in warning for warning in calibration.warnings)
    clean = calibrate(load_recording(written(recorded(FIXED), tmp_path / "clean")), options)
    assert not looks_wrong(clean)
    assert not any("doctor" in warning for warning in clean.warnings)


@pytest.mark.parametrize("kind", [HEADSET, FIXED])
def test_a_right_reading_is_not_suspected(kind: str) -> None:
    assert likely_mistake(synchronise(recorded(kind)), seed=0, max_views=40) == ""


# The command


@pytest.mark.long
def test_the_command_prints_and_writes_what_it_found(tmp_path: Path) -> None:
    folder = written(recorded(FIXED), tmp_path / "r", ["board_body.quaternion: xyzw"])
    before = files_in(folder)
    ran = run("doctor", folder, "-o", tmp_path / "d.json")
    assert (ran.code, ran.err) == (1, "")
    evidence = re.search(r"median misfit of mocap and images falls from ([\d.]+) to ([\d.]+) mm", ran.out)
    assert float(evidence[1]) > 100.0 * float(evidence[2])
    assert all_in(ran.out, ["1. quaternion order", "write in the manifest:  board_body.quaternion: wxyz", "written:"])
    document = json.loads((tmp_path / "d.json").read_text())
    assert document["healthy"] is False
    assert document["findings"][0]["manifest_lines"] == ["board_body.quaternion: wxyz"]
    assert files_in(folder) == before


def test_the_command_is_content_with_a_good_recording(tmp_path: Path) -> None:
    folder = written(recorded(STANDING), tmp_path / "r")
    ran = run("doctor", folder / "recording.yaml")
    assert (ran.code, ran.err) == (0, "")
    assert "nothing wrong found; mocap and images agree to" in ran.out
    assert run("doctor", folder, "--quiet").out == ""


def test_the_command_says_what_it_can_not_look_at(tmp_path: Path) -> None:
    for bad, words in (
        (tmp_path / "nowhere", "there is no such recording"),
        (tmp_path, "there is no manifest in this folder"),
    ):
        ran = run("doctor", bad)
        assert (ran.code, ran.out) == (1, "")
        assert words in ran.err
        assert ran.err.count("\n") == 1
    folder = written(recorded(STANDING), tmp_path / "r", ["capture: sideways"])
    assert "not a capture kind" in run("doctor", folder).err
    folder = written(recorded(STANDING), tmp_path / "r2")
    (folder / "platform.csv").write_text("1,2,3\n")
    ran = run("doctor", folder, "-o", tmp_path / "d.json")
    assert ran.code == 1
    assert "unexplained: " in ran.out
    assert "platform.csv" in json.loads((tmp_path / "d.json").read_text())["unexplained"]


def test_a_board_that_no_camera_sees_is_told(tmp_path: Path) -> None:
    folder = written(recorded(STANDING), tmp_path / "r")
    (folder / "images").mkdir()
    stamps_ns = recorded(STANDING).detections["cam0"].stamps_ns
    for stamp_ns in stamps_ns[:3]:
        cv2.imwrite(str(folder / "images" / f"{stamp_ns}.png"), np.full((1024, 1280), 200, np.uint8))
    write_lines(folder, ["cameras.cam0.images: images", "cameras.cam0.detections: null"])
    assert "no camera has a view of the board" in diagnose(folder).unexplained


@pytest.fixture(scope="module", name="rendered")
def _rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_simulation(small_simulation(), tmp_path_factory.mktemp("images") / "r", images=True).parent


@pytest.mark.long
@pytest.mark.parametrize(
    ("stated", "lines"),
    [
        ({"tag_columns": 4, "tag_rows": 6}, ("board.tag_columns: 6", "board.tag_rows: 4")),
        ({"dictionary": "DICT_5X5_50"}, ("board.dictionary: DICT_4X4_50",)),
        (
            {"first_tag_id": 100, "dictionary": "DICT_4X4_250"},
            ("board.dictionary: DICT_4X4_50", "board.first_tag_id: 0"),
        ),
    ],
)
def test_the_board_that_the_images_show_is_named(
    stated: dict[str, object], lines: tuple[str, ...], rendered: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "r"
    shutil.copytree(rendered, folder)
    write_lines(folder, [line_of("board", A2 | stated), "cameras.cam0.detections: null"])
    found = diagnose(folder)
    assert found.findings[0].fault == "board"
    assert "the images show tags of DICT_4X4_50, ids 0 to 23" in found.findings[0].says
    assert found.lines == lines
    assert found.unexplained is None
    write_lines(folder, found.lines)
    assert diagnose(folder).healthy


# Lines of a manifest


def test_lines_are_written_where_they_say() -> None:
    fields = {"platform": {"trajectory": "a.csv"}, "board": {"preset": "paper_a2"}}
    changed = with_lines(fields, ["platform.quaternion: wxyz", "board: {type: aprilgrid, tag_side_m: 0.06}"])
    assert changed == {
        "platform": {"trajectory": "a.csv", "quaternion": "wxyz"},
        "board": {"type": "aprilgrid", "tag_side_m": 0.06},
    }
    assert fields["platform"] == {"trajectory": "a.csv"}
    assert line_of("cameras.cam0.image_size_px", [640, 480]) == "cameras.cam0.image_size_px: [640, 480]"
    for line in ("platform", "board.preset.name: x"):
        with pytest.raises(GtcalError, match="is no line of this manifest"):
            with_lines(fields, [line])


def test_a_bare_trajectory_reads_back(tmp_path: Path) -> None:
    """The tests' own files say what they should."""
    recording = recorded(FIXED)
    folder = written(recording, tmp_path / "r")
    np.testing.assert_allclose(
        load_recording(folder).board_body.world_T_body, recording.board_body.world_T_body, atol=1e-12
    )
    write_bare(tmp_path / "b.csv", recording.board_body)
    assert (tmp_path / "b.csv").read_text() == (folder / "board_body.csv").read_text()
