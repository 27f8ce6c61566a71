import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mocap_files import CUBE_M, from_zero, markers_of, write_c3d, write_trc
from support import wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import BodySelection, PoseConventions, detect_mocap_format, inspect_mocap, read_c3d, read_trc

NOTHING = PoseConventions()
EXPORTS = "data/mocap_exports"
A = from_zero(wandering_trajectory("a")).world_T_body
LABELS = tuple(f"m{i}" for i in range(len(CUBE_M)))
BY_LABEL = BodySelection(markers=LABELS)
CENTROID_M = markers_of(A).mean(axis=1)


def markers(*lost: int) -> dict[str, np.ndarray]:
    """The markers; the first one is lost in these rows."""
    at = markers_of(A)
    at[list(lost), 0] = np.nan
    return dict(zip(LABELS, np.moveaxis(at, 1, 0), strict=True))


@pytest.mark.parametrize(
    "dress", [{}, {"unit": "m"}, {"separator": ","}, {"separator": ";"}, {"ending": "\r\n"}, {"blank_line": False}]
)
def test_trc_is_read_back(dress: dict, tmp_path: Path) -> None:
    path = write_trc(tmp_path / "t.trc", markers(3, 4), **dress)
    assert detect_mocap_format(path) == "trc"
    found = read_trc(path, "platform", NOTHING, BY_LABEL)
    assert found.stamps_ns[[0, 1, 59]].tolist() == [0, 10_000_000, 590_000_000]
    np.testing.assert_allclose(found.world_T_body[:, :3, 3], CENTROID_M, atol=1e-9)
    summary = inspect_mocap(path)
    assert (summary.n_frames, summary.rate_hz, summary.markers["m0"], summary.markers["m1"]) == (60, 100.0, 58, 60)


def test_c3d_is_read_back(tmp_path: Path) -> None:
    """C3D has single precision: a hundredth of a millimetre in a room."""
    path = write_c3d(tmp_path / "t.c3d", markers(3, 4))
    assert detect_mocap_format(path) == "c3d"
    found = read_c3d(path, "platform", NOTHING, BY_LABEL)
    np.testing.assert_allclose(found.world_T_body[:, :3, 3], CENTROID_M, atol=1e-6)
    assert found.stamps_ns[1] - found.stamps_ns[0] == 10_000_000
    summary = inspect_mocap(path)
    assert (summary.n_frames, summary.rate_hz, summary.length_unit, summary.markers["m0"]) == (60, 100.0, "mm", 58)


def test_the_real_trc(shared: Callable[[str], Path]) -> None:
    path = shared(f"{EXPORTS}/markers.trc")
    summary = inspect_mocap(path)
    assert (summary.format, summary.n_frames, summary.rate_hz, summary.length_unit) == ("trc", 93, 100.0, "mm")
    assert len(summary.markers) == 51
    assert set(summary.markers.values()) == {93}
    assert summary.notes == ("the header of markers.trc states 652 frames, but there are 93 rows",)
    box = tuple(label for label in summary.markers if label.startswith("boite_"))
    found = read_trc(path, "board_body", NOTHING, BodySelection(markers=box))
    assert found.n_samples == 93
    assert found.stamps_ns[-1] == 920_000_000
    assert summary.notes[0] in found.notes[0]


def test_the_real_c3d(shared: Callable[[str], Path]) -> None:
    pytest.importorskip("ezc3d")
    summary = inspect_mocap(shared(f"{EXPORTS}/markers_analogs.c3d"))
    assert (summary.n_frames, summary.rate_hz, summary.length_unit, summary.start_ns) == (580, 100.0, "mm", 0)
    assert 3 * sum(580 - seen for seen in summary.markers.values()) == 915
    assert summary.stated["SOFTWARE"] == "Vicon Nexus"
    assert [body.name for body in summary.bodies] == ["boite", "Daphnee"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PathFileType", "PathFile", "1: is no TRC file"),
        ("\tmm\t", "\tfurlong\t", "3: Units is 'furlong'; expected metres"),
        ("\t5\tmm", "\t6\tmm", "3: NumMarkers is 6, but line 4 names 5 markers"),
        ("\n100\t", "\n0\t", "3: DataRate is '0'; expected frames a second"),
        ("\n100\t", "\n50\t", "header says 50 frames a second, but the times of the rows mean 100"),
        ("Frame#", "Fr", "4: expected the columns to start with Frame# and Time"),
        ("m1\t", "\tm1", "4: expected the label of a marker above every third column"),
        ("m1\t", "m0\t", "4: the label 'm0' stands twice"),
        ("Y3", "Y4", "5: expected the axes X1, Y1, Z1 to Z5, for 5 markers"),
        ("\n3\t0.02000\t", "\n3\t0.02000\t\t", "9: the row has more than 17 cells"),
        ("\n3\t0.02000\t", "\n3\t", "9: cells in the row: 16, expected 17"),
        ("\n3\t0.02000\t", "\n3\t0.01000\t", "9: the time does not increase"),
        ("\n3\t0.02000\t", "\n3\t0.02000\tabc", "9: column 3 is 'abc"),
        ("\n3\t", "\n\n3\t", "10: there are more rows after a blank line"),
    ],
)
def test_damaged_trc_is_named_by_file_and_line(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_trc(tmp_path / "t.trc", markers())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(GtcalError, match=message) as caught:
        read_trc(path, "platform", NOTHING, BY_LABEL)
    assert "\n" not in str(caught.value)


def test_zeros_in_trc_are_markers_that_were_not_seen(tmp_path: Path) -> None:
    given = markers()
    given["m0"][5] = 0.0
    found = read_trc(write_trc(tmp_path / "t.trc", given), "platform", NOTHING, BY_LABEL)
    np.testing.assert_allclose(found.world_T_body[:, :3, 3], CENTROID_M, atol=1e-9)


@pytest.mark.parametrize("keep", [0, 1, 100, 511, 512, 600, 1500, 0.5, 0.9, 0.999])
def test_c3d_that_is_cut_off_is_refused(keep: float, tmp_path: Path) -> None:
    data = write_c3d(tmp_path / "t.c3d", markers()).read_bytes()
    # the file ends with the padding of its last block
    n = int(keep * (512 * 2 + 60 * 5 * 16)) if 0 < keep < 1 else int(keep)
    (tmp_path / "cut.c3d").write_bytes(data[:n])
    with pytest.raises(GtcalError, match=r"cut\.c3d: .*(is no C3D file|cut off|damaged)"):
        read_c3d(tmp_path / "cut.c3d", "platform", NOTHING, BY_LABEL)


def test_a_damaged_c3d_header_is_refused_or_changes_nothing(tmp_path: Path) -> None:
    """Every byte of the header block that has a meaning, set to three other values."""
    path = write_c3d(tmp_path / "t.c3d", markers())
    data, truth = path.read_bytes(), read_c3d(path, "platform", NOTHING, BY_LABEL).world_T_body
    outcomes = set()
    for at in range(24):
        for value in (0x00, 0x7F, 0xFF):
            damaged = bytearray(data)
            damaged[at] = value
            (tmp_path / "damaged.c3d").write_bytes(bytes(damaged))
            try:
                found = read_c3d(tmp_path / "damaged.c3d", "platform", NOTHING, BY_LABEL)
            except GtcalError:
                outcomes.add("refused")
                continue
            outcomes.add("read")
            assert found.n_samples == len(truth), f"byte {at} = {value}"
            np.testing.assert_array_equal(found.world_T_body, truth, err_msg=f"byte {at} = {value}")
    assert outcomes == {"refused", "read"}


def test_damaged_c3d_parameters_are_refused_or_change_nothing(tmp_path: Path) -> None:
    """Random bytes of them: the library, given such a file, would end the process."""
    path = write_c3d(tmp_path / "t.c3d", markers())
    data, truth = path.read_bytes(), read_c3d(path, "platform", NOTHING, BY_LABEL)
    random = np.random.default_rng(0)
    outcomes = []
    for _ in range(300):
        damaged = bytearray(data)
        damaged[int(random.integers(512, 1200))] = int(random.integers(256))
        (tmp_path / "damaged.c3d").write_bytes(bytes(damaged))
        try:
            found = read_c3d(tmp_path / "damaged.c3d", "platform", NOTHING, BY_LABEL)
        except GtcalError:
            outcomes.append("refused")
            continue
        outcomes.append("read")
        np.testing.assert_array_equal(found.stamps_ns, truth.stamps_ns)
        np.testing.assert_array_equal(found.world_T_body, truth.world_T_body)
    assert set(outcomes) == {"refused", "read"}


def test_c3d_units_are_stated_or_asked_for(tmp_path: Path) -> None:
    path = write_c3d(tmp_path / "t.c3d", markers(), unit="")
    with pytest.raises(GtcalError, match=r"add platform\.length_unit to the manifest"):
        read_c3d(path, "platform", NOTHING, BY_LABEL)
    path = write_c3d(tmp_path / "t.c3d", markers(), unit="ell")
    with pytest.raises(GtcalError, match="POINT:UNITS is 'ell'; expected metres"):
        read_c3d(path, "platform", NOTHING, BY_LABEL)


def test_a_missing_library_is_named_with_its_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_c3d(tmp_path / "t.c3d", markers())
    monkeypatch.setitem(__import__("sys").modules, "ezc3d", None)
    with pytest.raises(GtcalError, match=r"reading C3D needs ezc3d; pip install 'gtcal\[c3d\]'"):
        read_c3d(path, "platform", NOTHING, BY_LABEL)


def test_the_header_that_is_damaged_below_is_the_one_that_was_written(tmp_path: Path) -> None:
    head = write_c3d(tmp_path / "t.c3d", markers()).read_bytes()[:20]
    assert head[1] == 0x50
    n_points, _, first, last = struct.unpack("<4H", head[2:10])
    assert (n_points, last - first + 1) == (5, 60)
