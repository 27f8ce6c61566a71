from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import EPOCH_NS, wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import BodySelection, PoseConventions, detect_mocap_format, inspect_mocap, read_rosbag
from gtcal.recordings.trajectory import Trajectory, quaternions_from_poses

pytest.importorskip("rosbags")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NOTHING = PoseConventions()
HEADSET, BOARD = (wandering_trajectory(name, seed=seed, n=40) for seed, name in enumerate(("headset", "board")))
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
TF = ["tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"]
for name in TF:
    ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
KINDS = ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry"]
Sent = list[tuple[str, str, int, Any]]  # topic, type, time of receipt, message


def message(
    types: Any, kind: str, stamp_ns: int, pose: np.ndarray, frame: str = "world", child: str = "headset"
) -> Any:
    """A message of this kind with a pose in it."""
    of = types.types
    time = of["builtin_interfaces/msg/Time"](int(stamp_ns // 10**9), int(stamp_ns % 10**9))
    sequence = {"seq": 7} if types is ROS1 else {}
    header = of["std_msgs/msg/Header"](stamp=time, frame_id=frame, **sequence)
    x, y, z = pose[:3, 3].tolist()
    turned = of["geometry_msgs/msg/Quaternion"](*quaternions_from_poses(pose[None], "xyzw")[0].tolist())
    if kind == "TransformStamped":
        at = of["geometry_msgs/msg/Transform"](of["geometry_msgs/msg/Vector3"](x, y, z), turned)
        return of["geometry_msgs/msg/TransformStamped"](header, child, at)
    at = of["geometry_msgs/msg/Pose"](of["geometry_msgs/msg/Point"](x, y, z), turned)
    if kind == "PoseStamped":
        return of["geometry_msgs/msg/PoseStamped"](header, at)
    sure = of["geometry_msgs/msg/PoseWithCovariance"](at, np.arange(36.0))
    if kind == "PoseWithCovarianceStamped":
        return of["geometry_msgs/msg/PoseWithCovarianceStamped"](header, sure)
    nothing = of["geometry_msgs/msg/Vector3"](0.5, 0.5, 0.5)
    twist = of["geometry_msgs/msg/TwistWithCovariance"](
        of["geometry_msgs/msg/Twist"](nothing, nothing), np.arange(36.0)
    )
    return of["nav_msgs/msg/Odometry"](header, child, sure, twist)


def type_of(kind: str) -> str:
    return f"{'nav_msgs' if kind == 'Odometry' else 'geometry_msgs'}/msg/{kind}"


def poses(types: Any, topic: str, kind: str, body: Trajectory, **names: str) -> Sent:
    """The messages of a body, received 5 ms after what they tell."""
    stamps = body.stamps_ns.tolist()
    return [
        (topic, type_of(kind), stamp + 5_000_000, message(types, kind, stamp, pose, **names))
        for stamp, pose in zip(stamps, body.world_T_body, strict=True)
    ]


def write_ros1(path: Path, sent: Sent) -> Path:
    topics: dict[tuple[str, str], Any] = {}
    with Writer1(path.with_suffix(".bag")) as writer:
        for topic, kind, time, content in sent:
            if (topic, kind) not in topics:
                topics[topic, kind] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(topics[topic, kind], time, ROS1.serialize_ros1(content, kind))
    return path.with_suffix(".bag")


def write_ros2(path: Path, sent: Sent, plugin: Any = StoragePlugin.SQLITE3) -> Path:
    topics: dict[tuple[str, str], Any] = {}
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        for topic, kind, time, content in sent:
            if (topic, kind) not in topics:
                topics[topic, kind] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(topics[topic, kind], time, ROS2.serialize_cdr(content, kind))
    return path


def write_mcap(path: Path, sent: Sent) -> Path:
    return write_ros2(path, sent, StoragePlugin.MCAP)


WRITERS = [(ROS1, write_ros1), (ROS2, write_ros2), (ROS2, write_mcap)]
each_bag = pytest.mark.parametrize(("types", "write"), WRITERS, ids=["ros1", "ros2_db3", "ros2_mcap"])
Write = Callable[[Path, Sent], Path]


def same(found: Trajectory, body: Trajectory) -> None:
    np.testing.assert_array_equal(found.stamps_ns, body.stamps_ns)
    np.testing.assert_allclose(found.world_T_body, body.world_T_body, atol=1e-12)


@each_bag
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frame", ["w", "world", "mocap_1"])
def test_what_is_written_is_read_back(types: Any, write: Write, kind: str, frame: str, tmp_path: Path) -> None:
    """Frames of all lengths: CDR pads what follows them."""
    path = write(tmp_path / "bag", poses(types, "/headset", kind, HEADSET, frame=frame))
    assert detect_mocap_format(path) == "rosbag"
    same(read_rosbag(path, "platform", NOTHING), HEADSET)


@pytest.mark.parametrize(("types", "write", "kind"), [(*WRITERS[0], TF[0]), (*WRITERS[0], TF[1]), (*WRITERS[1], TF[0])])
def test_tf_holds_many_bodies(types: Any, write: Write, kind: str, tmp_path: Path) -> None:
    sent: Sent = []
    for stamp, a, b in zip(HEADSET.stamps_ns.tolist(), HEADSET.world_T_body, BOARD.world_T_body, strict=True):
        both = [message(types, "TransformStamped", stamp, a, child="headset")]
        both.append(message(types, "TransformStamped", stamp, b, child="calib_board"))
        sent.append(("/tf", kind, stamp, types.types[kind](both)))
    path = write(tmp_path / "bag", sent)
    same(read_rosbag(path, "platform", NOTHING, BodySelection(name="headset")), HEADSET)
    same(read_rosbag(path, "board_body", NOTHING, BodySelection(name="/tf:calib_board")), BOARD)
    with pytest.raises(
        GtcalError, match=r"say which one .* platform\.name; it holds bodies /tf:calib_board, /tf:headset"
    ):
        read_rosbag(path, "platform", NOTHING)
    with pytest.raises(
        GtcalError, match=r"platform\.name: the bag holds no body 'nose'; it holds bodies /tf:calib_board"
    ):
        read_rosbag(path, "platform", NOTHING, BodySelection(name="nose"))


@each_bag
def test_topics_among_others(types: Any, write: Write, tmp_path: Path) -> None:
    other = types.types["std_msgs/msg/String"]("hello")
    sent = poses(types, "/headset", "PoseStamped", HEADSET) + poses(types, "/board/odom", "Odometry", BOARD)
    sent.append(("/chat", "std_msgs/msg/String", EPOCH_NS, other))
    path = write(tmp_path / "bag", sorted(sent, key=lambda row: row[2]))
    same(read_rosbag(path, "platform", NOTHING, BodySelection(name="/headset")), HEADSET)
    same(read_rosbag(path, "board_body", NOTHING, BodySelection(name="/board/odom")), BOARD)
    summary = inspect_mocap(path)
    assert [(body.name, body.n_seen) for body in summary.bodies] == [("/board/odom", 40), ("/headset", 40)]
    assert (summary.start_ns, summary.length_unit, summary.open_fields) == (EPOCH_NS, "m", ())
    assert summary.rate_hz == pytest.approx(120, abs=0.01)


def test_the_offset_is_added_to_the_headers_stamps(tmp_path: Path) -> None:
    path = write_ros2(tmp_path / "bag", poses(ROS2, "/headset", "PoseStamped", HEADSET))
    found = read_rosbag(path, "platform", NOTHING, BodySelection(stamp_offset_ns=-EPOCH_NS))
    np.testing.assert_array_equal(found.stamps_ns, HEADSET.stamps_ns - EPOCH_NS)


def test_a_storage_file_without_its_folder_is_read_too(tmp_path: Path) -> None:
    sent = poses(ROS2, "/headset", "PoseStamped", HEADSET)
    for folder, suffix in ((write_ros2(tmp_path / "a", sent), "db3"), (write_mcap(tmp_path / "b", sent), "mcap")):
        (storage,) = folder.glob(f"*.{suffix}")
        same(read_rosbag(storage, "platform", NOTHING), HEADSET)


def test_messages_out_of_order_are_sorted_and_repeated_ones_dropped(tmp_path: Path) -> None:
    sent = poses(ROS2, "/headset", "PoseStamped", HEADSET)
    sent = [sent[1], sent[0], *sent[2:], sent[5]]
    times = sorted(row[2] for row in sent)
    path = write_ros2(tmp_path / "bag", [(*row[:2], time, row[3]) for row, time in zip(sent, times, strict=True)])
    found = read_rosbag(path, "platform", NOTHING)
    same(found, HEADSET)
    assert found.notes == (
        "platform: messages of /headset are not in the order of their time stamps, and were sorted",
        "platform: 1 messages of /headset repeat the one before, and were left out",
    )


def test_what_contradicts_itself_is_refused(tmp_path: Path) -> None:
    sent = poses(ROS2, "/headset", "PoseStamped", HEADSET)
    again = message(ROS2, "PoseStamped", int(HEADSET.stamps_ns[3]), HEADSET.world_T_body[4])
    path = write_ros2(tmp_path / "twice", [*sent, (*sent[-1][:3], again)])
    with pytest.raises(GtcalError, match=r"/headset: two messages have the time stamp 16.* ns and other poses"):
        read_rosbag(path, "platform", NOTHING)
    path = write_ros2(
        tmp_path / "frames", [*sent[:9], *poses(ROS2, "/headset", "PoseStamped", HEADSET, frame="map")[9:]]
    )
    with pytest.raises(GtcalError, match="/headset: its poses are given in the frames 'map', 'world'; expected one"):
        read_rosbag(path, "platform", NOTHING)
    unstamped = [(*row[:3], message(ROS2, "PoseStamped", 0, HEADSET.world_T_body[0])) for row in sent]
    with pytest.raises(GtcalError, match="/headset: the headers of its messages have no time stamps"):
        read_rosbag(write_ros2(tmp_path / "unstamped", unstamped), "platform", NOTHING)
    zero = sent[0][3]
    zero.pose.orientation.w = zero.pose.orientation.x = zero.pose.orientation.y = zero.pose.orientation.z = 0.0
    with pytest.raises(GtcalError, match="'/headset': a quaternion's length is 0; expected 1"):
        read_rosbag(write_ros2(tmp_path / "zero", sent), "platform", NOTHING)


def test_fields_without_use_are_refused(tmp_path: Path) -> None:
    path = write_ros2(tmp_path / "bag", poses(ROS2, "/headset", "PoseStamped", HEADSET))
    for field, value in (("markers", ("a", "b", "c")), ("rotation", "helical"), ("rate_hz", 100.0)):
        with pytest.raises(GtcalError, match=f"platform.{field}: format rosbag has no use for it"):
            read_rosbag(path, "platform", NOTHING, BodySelection(**{field: value}))
    with pytest.raises(GtcalError, match=r"platform\.time_unit: s, but format rosbag has ns here"):
        read_rosbag(path, "platform", PoseConventions(time_unit="s"))


@each_bag
def test_a_bag_without_poses_says_so(types: Any, write: Write, tmp_path: Path) -> None:
    text = types.types["std_msgs/msg/String"]("hello")
    path = write(tmp_path / "bag", [("/chat", "std_msgs/msg/String", EPOCH_NS, text)])
    with pytest.raises(GtcalError, match=r"the bag holds no message of PoseStamped, .*, Odometry, TFMessage"):
        read_rosbag(path, "platform", NOTHING)


@each_bag
def test_a_bag_that_is_cut_off_ends_in_one_line_or_reads_the_same(types: Any, write: Write, tmp_path: Path) -> None:
    path = write(tmp_path / "bag", poses(types, "/headset", "PoseStamped", HEADSET))
    storage = path if path.is_file() else next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))
    data = storage.read_bytes()
    refused = 0
    for keep in np.linspace(0, len(data) - 1, 25).astype(int).tolist():
        storage.write_bytes(data[:keep])
        try:
            found = read_rosbag(path, "platform", NOTHING)
        except GtcalError as error:
            refused += "\n" not in str(error)
            continue
        np.testing.assert_array_equal(found.stamps_ns, HEADSET.stamps_ns[: found.n_samples])
        np.testing.assert_allclose(found.world_T_body, HEADSET.world_T_body[: found.n_samples], atol=1e-12)
        refused += 1
    assert refused == 25
    storage.unlink()
    with pytest.raises(GtcalError, match=r"there is no such file|is not a ROS bag that can be read"):
        read_rosbag(path, "platform", NOTHING)


def test_no_bag_and_no_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(GtcalError, match=r"bag\.bag: there is no such file"):
        read_rosbag(tmp_path / "bag.bag", "platform", NOTHING)
    with pytest.raises(GtcalError, match=r"is no bag; expected a \.bag, \.db3 or \.mcap file or a folder with"):
        read_rosbag(tmp_path, "platform", NOTHING)
    path = write_ros1(tmp_path / "bag", poses(ROS1, "/headset", "PoseStamped", HEADSET))
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(GtcalError, match=r"reading a ROS bag needs rosbags: pip install 'gtcal\[bags\]'"):
        read_rosbag(path, "platform", NOTHING)
