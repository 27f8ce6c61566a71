from pathlib import Path

import numpy as np
import pytest
from mocap_files import CUBE_M, from_zero, markers_of, write_motive, write_vicon
from support import EPOCH_NS, wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import detect_mocap_format, inspect_mocap, write_euroc_csv, write_tum
from gtcal.recordings.trajectory import Trajectory

A = wandering_trajectory("a")
LOST = from_zero(A).world_T_body.copy()
LOST[[5, 6, 30]] = np.nan


def test_a_motive_export(tmp_path: Path) -> None:
    labels = [f"a:m{i}" for i in range(len(CUBE_M))]
    at = dict(zip(labels, np.moveaxis(markers_of(LOST), 1, 0), strict=True))
    summary = inspect_mocap(write_motive(tmp_path / "take.csv", {"a": LOST, "b": A.world_T_body}, markers=at))
    a, b = summary.bodies
    assert (a.name, a.n_seen, a.n_gaps, a.rotation) == ("a", 57, 2, "quaternion_xyzw")
    assert a.longest_gap_s == pytest.approx(0.025)
    assert a.markers == tuple(labels)
    assert (b.name, b.n_seen, b.n_gaps, b.longest_gap_s, b.markers) == ("b", 60, 0, 0.0, ())
    assert summary.markers == dict.fromkeys(labels, 57)
    assert (summary.n_frames, summary.rate_hz, summary.start_ns, summary.length_unit) == (60, 120.0, 0, "m")
    assert summary.duration_s == pytest.approx(59 / 120)
    assert summary.stated["Coordinate Space"] == "Global"
    assert summary.open_fields == ()


def test_what_the_manifest_has_to_say_is_listed(tmp_path: Path) -> None:
    path = write_vicon(tmp_path / "take.csv", segments={"a:root": LOST}, units=True)
    assert inspect_mocap(path).open_fields == ("rotation",)
    euroc = tmp_path / "body.csv"
    euroc.write_text("timestamp [ns],x,y,z,qx,qy,qz,qw\n10,1,2,3,0,0,0,1\n20,1,2,3,0,0,0,1\n")
    assert inspect_mocap(euroc).open_fields == ("length_unit",)
    euroc.write_text("10,1,2,3,0,0,0,1\n20,1,2,3,0,0,0,1\n")
    summary = inspect_mocap(euroc)
    assert summary.open_fields == ("quaternion", "length_unit", "time_unit")
    assert (summary.n_frames, summary.rate_hz, summary.duration_s) == (2, None, None)


@pytest.mark.parametrize(("write", "name"), [(write_euroc_csv, "euroc_csv"), (write_tum, "tum")])
def test_files_of_one_body(write: object, name: str, tmp_path: Path) -> None:
    kept = np.delete(np.arange(60), [5, 6, 30])
    write(tmp_path / "headset.csv", Trajectory("a", A.stamps_ns[kept], A.world_T_body[kept]))  # type: ignore[operator]
    summary = inspect_mocap(tmp_path / "headset.csv")
    (body,) = summary.bodies
    assert (summary.format, body.name, body.n_seen, body.n_gaps) == (name, "headset", 57, 2)
    assert body.longest_gap_s == pytest.approx(0.025, abs=1e-6)
    assert (summary.start_ns, summary.length_unit, summary.open_fields) == (EPOCH_NS, "m", ())
    assert summary.rate_hz == pytest.approx(120, abs=0.01)


def test_what_is_no_mocap_file_is_of_no_format(tmp_path: Path) -> None:
    for name, content in (
        ("notes.txt", b"hello\nworld\n"),
        ("corners.csv", b"timestamp [ns],corner,u,v\n1,2,3.5,4.5\n"),
        ("images.csv", b"#timestamp [ns],filename\n1,1.png\n"),
        ("empty.csv", b""),
        ("picture.png", b"\x89PNG\r\n\0\0\0\0"),
    ):
        (tmp_path / name).write_bytes(content)
        assert detect_mocap_format(tmp_path / name) is None
        with pytest.raises(GtcalError, match=rf"{name}: is of no format that gtcal knows; formats: euroc_csv, tum,"):
            inspect_mocap(tmp_path / name)
    assert detect_mocap_format(tmp_path) is None
    assert detect_mocap_format(tmp_path / "nothing.csv") is None
    with pytest.raises(GtcalError, match=r"nothing\.csv: there is no such file"):
        inspect_mocap(tmp_path / "nothing.csv")
    with pytest.raises(GtcalError, match=r"notes\.txt: 'fbx' is no format; formats: "):
        inspect_mocap(tmp_path / "notes.txt", "fbx")
