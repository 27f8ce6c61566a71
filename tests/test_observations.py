from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from support import random_detections

from factors.rigid import inverse
from gtcal.errors import GtcalError
from gtcal.estimation.observations import Dropped, pooled, synchronise
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import CameraDetections
from gtcal.recordings.recording import Recording, load_recording
from gtcal.recordings.trajectory import Trajectory

MS = 1_000_000


def as_capture(recording: Recording, capture: Capture) -> Recording:
    bodies = {name: getattr(recording, name) if name in capture.bodies else None for name in ("platform", "board_body")}
    return replace(recording, capture=capture, **bodies)


def with_stamps(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """The same detections at other times."""
    detections = {
        name: replace(columns, stamps_ns=change(columns.stamps_ns)) for name, columns in recording.detections.items()
    }
    return replace(recording, detections=detections)


def without_samples(trajectory: Trajectory | None, drop: slice) -> Trajectory:
    assert trajectory is not None
    keep = np.ones(trajectory.n_samples, dtype=bool)
    keep[drop] = False
    return replace(trajectory, stamps_ns=trajectory.stamps_ns[keep], world_T_body=trajectory.world_T_body[keep])


def expected_ref_T_body(recording: Recording, stamp_ns: int) -> gtsam.Pose3:
    at = {
        name: gtsam.Pose3(trajectory.interpolate(np.array([stamp_ns]), 1).world_T_body[0])
        for name, trajectory in recording.motion.trajectories.items()
    }
    if recording.capture is Capture.FIXED_CAMERAS:
        return at["board_body"]
    if recording.capture is Capture.STANDING_BOARD:
        return at["platform"].inverse()
    return at["platform"].inverse() * at["board_body"]


@pytest.mark.parametrize("capture", list(Capture))
def test_every_view_has_ref_T_body_at_its_time(capture: Capture, small_recording: Recording) -> None:
    recording = as_capture(small_recording, capture)
    observations = synchronise(recording)
    assert observations.dropped == ()
    for name, views in observations.views.items():
        np.testing.assert_array_equal(views.stamps_ns, recording.detections[name].stamps_ns)
        for stamp_ns, ref_T_body in zip(views.stamps_ns, views.ref_T_body, strict=True):
            np.testing.assert_allclose(ref_T_body, expected_ref_T_body(recording, stamp_ns).matrix(), atol=1e-12)


def test_corners_come_with_their_place_on_the_board(small_recording: Recording) -> None:
    for name, views in synchronise(small_recording).views.items():
        detections = small_recording.detections[name]
        assert views.camera is small_recording.cameras[name]
        np.testing.assert_array_equal(views.corners_px, detections.corners_px)
        np.testing.assert_array_equal(views.corners_m, small_recording.board.corners_m[detections.corner_ids])
        np.testing.assert_array_equal(views.view_of_corner, detections.view_of_corner)


def test_views_of_one_instant_share_a_frame(small_recording: Recording) -> None:
    right = small_recording.detections["right"]
    later = replace(right, stamps_ns=right.stamps_ns + np.where(np.arange(10) < 4, 0, 5 * MS))
    observations = synchronise(replace(small_recording, detections=small_recording.detections | {"right": later}))
    assert observations.n_frames == 4 + 2 * 6
    for views in observations.views.values():
        np.testing.assert_array_equal(observations.frame_stamps_ns[views.frame_index], views.stamps_ns)
    assert observations.views["left"].frame_index[:4].tolist() == observations.views["right"].frame_index[:4].tolist()


def test_what_is_dropped_is_counted_by_camera_and_first_reason(small_recording: Recording) -> None:
    left = small_recording.detections["left"]
    few = [(int(left.stamps_ns[0]) - 300 * MS, np.arange(3), np.ones((3, 2)))]
    early = [(int(left.stamps_ns[0]) - 200 * MS, np.arange(5), np.ones((5, 2)))]
    rest = [
        (int(stamp), left.corner_ids[a:b], left.corners_px[a:b])
        for stamp, a, b in zip(left.stamps_ns, left.view_start[:-1], left.view_start[1:], strict=True)
    ]
    recording = replace(
        small_recording,
        detections=small_recording.detections | {"left": CameraDetections.from_views(few + early + rest)},
        board_body=without_samples(small_recording.board_body, slice(19, 24)),
        max_gap_s=0.02,
    )
    observations = synchronise(recording)
    in_gap = np.flatnonzero(observations.motion.at(left.stamps_ns).gaps["board_body"])
    assert len(in_gap) == 1
    counts = np.diff(left.view_start)[in_gap].sum()
    right_counts = np.diff(small_recording.detections["right"].view_start)[in_gap].sum()
    assert [(d.camera, d.reason, d.n_views, d.n_corners) for d in observations.dropped] == [
        ("left", "fewer than 4 corners", 1, 3),
        ("left", "outside the platform trajectory", 1, 5),
        ("left", "gap > 20 ms in board_body", 1, counts),
        ("right", "gap > 20 ms in board_body", 1, right_counts),
    ]
    assert observations.views["left"].n_views == 9
    assert np.isfinite(observations.views["left"].ref_T_body).all()
    assert synchronise(recording, min_corners=3).dropped[0].reason == "outside the platform trajectory"


@pytest.mark.parametrize("factor", [1_000, 1_000_000])
def test_another_time_base_is_named(factor: int, small_recording: Recording) -> None:
    larger = with_stamps(small_recording, lambda stamps_ns: stamps_ns // factor)
    times = f"{factor:,}"
    with pytest.raises(
        GtcalError,
        match=rf"'left' and the platform trajectory share .*about {times} times smaller: check platform.time",
    ):
        synchronise(larger)


def test_clocks_that_share_no_time_are_told_with_both_ranges(small_recording: Recording) -> None:
    late = with_stamps(small_recording, lambda stamps_ns: stamps_ns + 3_600_000_000_000)
    with pytest.raises(
        GtcalError, match=r"has 1606157463\.396 s to 1606157463\.696 s, the trajectory 1606153863\.362 s"
    ):
        synchronise(late)


def test_a_camera_without_views_is_named(small_recording: Recording) -> None:
    nothing = small_recording.detections | {"right": CameraDetections.from_views([])}
    with pytest.raises(GtcalError, match="camera 'right' has no views: the board was not found"):
        synchronise(replace(small_recording, detections=nothing))


def test_a_camera_that_loses_all_its_views_is_told_why(small_recording: Recording) -> None:
    sparse = without_samples(small_recording.platform, slice(1, -1))
    with pytest.raises(
        GtcalError, match=r"camera 'left' has no views left.*: 10 gap > 200 ms in platform \(.*every 0\.492 s"
    ):
        synchronise(replace(small_recording, platform=sparse))
    few = {name: random_detections(camera, 9, np.array([5, 6]), 0) for name, camera in small_recording.cameras.items()}
    few = {
        name: replace(columns, stamps_ns=small_recording.detections[name].stamps_ns[:2])
        for name, columns in few.items()
    }
    with pytest.raises(GtcalError, match="2 fewer than 9 corners"):
        synchronise(replace(small_recording, detections=few), min_corners=9)


def test_images_must_be_detected_first(vicon_recording: Callable) -> None:
    recording = load_recording(vicon_recording(given_corners=False))
    with pytest.raises(GtcalError, match="camera 'cam0' has images but no detections yet"):
        synchronise(recording)


def test_the_real_vicon_recording_keeps_all_its_views(vicon_recording: Callable) -> None:
    with_board = synchronise(load_recording(vicon_recording(Capture.TRACKED_PLATFORM)))
    standing = synchronise(load_recording(vicon_recording(Capture.STANDING_BOARD)))
    assert with_board.dropped == standing.dropped == ()
    assert with_board.views["cam0"].n_views == standing.views["cam0"].n_views == 30
    # What is between them is the pose of the board's body in the world, which stood still to within mocap noise.
    world_T_body = inverse(standing.views["cam0"].ref_T_body) @ with_board.views["cam0"].ref_T_body
    assert np.ptp(world_T_body[:, :3, 3], axis=0).max() < 1e-3


def test_what_is_dropped_twice_for_one_reason_is_one_entry() -> None:
    parts = [Dropped("left", "gap", 1, 30), Dropped("right", "gap", 2, 40), Dropped("left", "gap", 3, 5)]
    assert pooled(parts) == (Dropped("left", "gap", 4, 35), Dropped("right", "gap", 2, 40))
    assert pooled([*parts[:2], Dropped("left", "gross", 1, 9)])[2].reason == "gross"
