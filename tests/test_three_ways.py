"""The guide's three ways to bring the same capture: each manifest as printed there, over files of one simulation."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from guide_support import block
from media_support import image_message, small_simulation, write_bag, write_video
from mocap_files import write_motive

from gtcal import Recording, detected, load_recording
from gtcal.camera_files.formats import write_rig
from gtcal.camera_files.rig import Rig, RigCamera
from gtcal.readers import write_euroc_csv
from gtcal.recordings.trajectory import Trajectory, quaternions_from_poses
from gtcal.simulation import write_simulation

pytest.importorskip("av")
pytest.importorskip("rosbags")

BODIES = {"platform": "headset", "board_body": "plate"}


@pytest.fixture(scope="module", name="filmed")
def _filmed(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The capture with image files, as gtcal itself writes it; with a lens that all formats know, Kalibr's too."""
    folder = tmp_path_factory.mktemp("filmed")
    write_simulation(small_simulation(), folder / "own", images=True)
    recording = load_recording(folder / "own")
    camera = recording.cameras["cam0"]
    without_k3 = replace(camera, parameters=np.append(camera.theta[:8], 0.0))
    return replace(recording, cameras={"cam0": without_k3})


def manifest(way: str) -> str:
    """The block that follows this marker in the guide."""
    return block(f"way: {way}", "yaml")


def start_ns(recording: Recording) -> int:
    return int(recording.images["cam0"].stamps_ns[0])


def as_euroc(recording: Recording, folder: Path) -> str:
    images, camera = recording.images["cam0"], recording.cameras["cam0"]
    data = folder / "mav0" / "cam0" / "data"
    data.mkdir(parents=True)
    rows = []
    for index, stamp in enumerate(images.stamps_ns.tolist()):
        cv2.imwrite(str(data / f"{stamp}.png"), images.read(index))
        rows.append(f"{stamp},{stamp}.png\n")
    (data.parent / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(rows))
    sensor = {
        "camera_model": "pinhole",
        "distortion_model": "radial-tangential",
        "intrinsics": camera.theta[:4].tolist(),
        "distortion_coefficients": camera.theta[4:8].tolist(),
        "resolution": [camera.image_width_px, camera.image_height_px],
    }
    (data.parent / "sensor.yaml").write_text(yaml.safe_dump(sensor))
    for name, called in {"platform": "mocap0", "board_body": "target0"}.items():
        (folder / "mav0" / called).mkdir()
        write_euroc_csv(folder / "mav0" / called / "data.csv", recording.motion.trajectories[name])
    return manifest("EuRoC folder")


def as_motive_and_video(recording: Recording, folder: Path) -> str:
    images, bodies = recording.images["cam0"], recording.motion.trajectories
    pts = np.rint((images.stamps_ns - start_ns(recording)) / 1e3).astype(int)
    pictures = [images.read(i) for i in range(len(images))]
    write_video(folder / "cam0.mkv", pictures, pts.tolist(), time_base=Fraction(1, 1_000_000))
    write_rig(rig_of(recording), folder / "camchain.yaml", "kalibr", ())
    write_motive(folder / "take.csv", {BODIES[name]: body.world_T_body for name, body in bodies.items()})
    text = manifest("Motive, video and Kalibr")
    text = text.replace("1700000000000000000", str(start_ns(recording)))
    return text.replace("1699999999500000000", str(bodies["platform"].stamps_ns[0]))


def as_bag(recording: Recording, folder: Path) -> str:
    images = recording.images["cam0"]
    topics = {
        "/cam0/image_raw": [
            (stamp, stamp, image_message(images.read(index))) for index, stamp in enumerate(images.stamps_ns.tolist())
        ]
    }
    for name, called in BODIES.items():
        topics[f"/{called}/pose"] = pose_messages(recording.motion.trajectories[name])
    write_bag(folder / "take.bag", topics)
    write_rig(rig_of(recording), folder / "camera_info", "ros", ())
    return manifest("ROS bag")


def rig_of(recording: Recording) -> Rig:
    camera = recording.cameras["cam0"]
    return Rig((RigCamera(camera),), "ref", "ref", "not asked for")


def pose_messages(trajectory: Trajectory) -> list:
    quats_xyzw = quaternions_from_poses(trajectory.world_T_body, "xyzw")
    return [
        (stamp, stamp, pose_message(pose[:3, 3], quat))
        for stamp, pose, quat in zip(
            trajectory.stamps_ns.tolist(), trajectory.world_T_body, quats_xyzw.tolist(), strict=True
        )
    ]


def pose_message(position_m: np.ndarray, quat_xyzw: list[float]):
    def make(store, stamp_ns: int):
        of = store.types
        time = of["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        header = of["std_msgs/msg/Header"](seq=0, stamp=time, frame_id="world")
        point = of["geometry_msgs/msg/Point"](*position_m.tolist())
        pose = of["geometry_msgs/msg/Pose"](point, of["geometry_msgs/msg/Quaternion"](*quat_xyzw))
        return of["geometry_msgs/msg/PoseStamped"](header, pose)

    return make


@pytest.mark.parametrize("way", [as_euroc, as_motive_and_video, as_bag])
def test_the_capture_is_the_same_in_each_of_the_readmes_three_ways(way, filmed: Recording, tmp_path: Path) -> None:
    text = way(filmed, tmp_path)
    (tmp_path / "recording.yaml").write_text(text)
    brought = load_recording(tmp_path)
    np.testing.assert_allclose(brought.cameras["cam0"].theta, filmed.cameras["cam0"].theta, rtol=1e-12)
    off_ns = np.abs(brought.images["cam0"].stamps_ns - filmed.images["cam0"].stamps_ns).max()
    assert off_ns <= (500_000 if way is as_motive_and_video else 0)  # Matroska keeps whole milliseconds
    stamps_ns = filmed.images["cam0"].stamps_ns
    poses = [recording.motion.at(stamps_ns).ref_T_body for recording in (brought, filmed)]
    np.testing.assert_allclose(*poses, atol=1e-6)
    ours, theirs = detected(filmed).detections["cam0"], detected(brought).detections["cam0"]
    np.testing.assert_array_equal(theirs.corner_ids, ours.corner_ids)
    np.testing.assert_array_equal(theirs.corners_px, ours.corners_px)
