"""Files that are none, or far too much, or lie about themselves: one line, at once, for every reader."""

from __future__ import annotations

import json
import os
import time
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from gtcal.baselines.marker_file import COLUMNS, read_marker_sightings
from gtcal.board import load_board
from gtcal.camera_files.formats import CAMERA_FILE_READERS, read_rig
from gtcal.documents import load_document, load_plain_yaml
from gtcal.errors import GtcalError
from gtcal.estimation.priors_file import read_priors
from gtcal.files import check_regular, fingerprint, read_bytes
from gtcal.fleet.index import insert, opened_index, records
from gtcal.fleet.record import Contents, Record
from gtcal.npz import load_arrays
from gtcal.readers import TRAJECTORY_READERS, detect_mocap_format
from gtcal.readers.poses import PoseConventions
from gtcal.readers.text_export import Line
from gtcal.recordings.bag_images import bag_images
from gtcal.recordings.images import image_list, read_grey
from gtcal.recordings.recording import load_recording
from gtcal.recordings.text_table import open_table
from gtcal.recordings.video_images import video_images
from gtcal.recordings.vrs_images import vrs_images
from gtcal.results.calibration_file import read_calibration
from gtcal.simulation.ground_truth import read_ground_truth
from gtcal.verification.lollypop_recording import load_lollypop_recording, read_device
from gtcal.verification.verification_file import read_verification

READERS: dict[str, Callable[[Path], object]] = {
    **{
        f"trajectory {name}": lambda path, read=read: read(path, "body", PoseConventions())
        for name, read in TRAJECTORY_READERS.items()
    },
    **{f"cameras {name}": lambda path, name=name: read_rig(path, name) for name in CAMERA_FILE_READERS},
    "cameras": lambda path: read_rig(path, None),
    "table": lambda path: open_table(path, ","),
    "image": read_grey,
    "image list": image_list,
    "video": lambda path: video_images(path, 0, None),
    "bag": lambda path: bag_images(path, "/image", 0),
    "vrs": lambda path: vrs_images(path, "1201-1", 0),
    "recording": load_recording,
    "lollypop recording": load_lollypop_recording,
    "device": read_device,
    "board": lambda path: load_board(str(path)),
    "priors": read_priors,
    "document": load_document,
    "calibration": read_calibration,
    "verification": read_verification,
    "markers": lambda path: read_marker_sightings(path, None),  # type: ignore[arg-type]
    "fingerprint": fingerprint,
}
"""Every reader of a file of others."""

NO_FILES = ["fifo", "/dev/zero", "/proc/self/mem", "x" * 5000, "nul\0"]


@pytest.mark.parametrize("path", NO_FILES, ids=lambda path: repr(path)[:20])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_told_at_once(reader: str, path: str, tmp_path: Path) -> None:
    if path == "fifo":
        path = str(tmp_path / "fifo")
        os.mkfifo(path)
    started = time.perf_counter()
    with pytest.raises(GtcalError) as raised:
        READERS[reader](Path(path))
    assert "\n" not in str(raised.value)
    assert time.perf_counter() - started < 5.0


@pytest.mark.parametrize("name", ["ground_truth.json"])
def test_a_ground_truth_too(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(GtcalError, match="is a pipe or a device"):
        detect_mocap_format(tmp_path / name)
    with pytest.raises(GtcalError, match="is a pipe or a device"):
        read_ground_truth(tmp_path)


def test_sizes_are_bounded(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(10 * 2**30)
    with pytest.raises(GtcalError, match="holds 10240 MiB, and such a file at most 256; is it another"):
        load_document(tmp_path / "sparse")
    with pytest.raises(GtcalError, match="at most 1;"):
        check_regular(tmp_path / "sparse", 2**20)
    with pytest.raises(GtcalError, match="does not end"):
        read_bytes(Path("/proc/kallsyms"), 10)


def npz_of(path: Path, name: str, header: str, content: bytes = b"") -> Path:
    """An npz whose one array states what it likes."""
    text = header.encode().ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content)
    return path


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 2), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1,1,1,1), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }",
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': 'x', }",
        "((((((((((((((((((((((((((((((((((((((((",
    ],
)
def test_an_array_that_lies_about_itself(header: str, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=r"rig\.npz: "):
        load_arrays(npz_of(tmp_path / "rig.npz", "names.npy", header, bytes(16)), 2**20)


def test_an_npz_that_inflates_is_refused_packed(tmp_path: Path) -> None:
    bomb = BytesIO()
    np.save(bomb, np.zeros(2 * 10**7))
    with zipfile.ZipFile(tmp_path / "rig.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("names.npy", bomb.getvalue())
    assert (tmp_path / "rig.npz").stat().st_size < 200_000
    with pytest.raises(GtcalError, match="unpacks to more than 4 MiB"):
        read_rig(tmp_path / "rig.npz", "numpy")


def test_arrays_come_back_as_they_were(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(["é", "xy"]), "c": np.asfortranarray(np.eye(2)), "d": 3}
    np.savez(tmp_path / "a.npz", **arrays)
    read = load_arrays(tmp_path / "a.npz", 2**20)
    assert all(np.array_equal(read[name], arrays[name]) for name in arrays)


@pytest.mark.parametrize("suffix", [".yaml", ".json", ".toml"])
def test_depth_is_bounded(suffix: str, tmp_path: Path) -> None:
    deep = {".yaml": "a: " + "[" * 100_000, ".json": "[" * 100_000, ".toml": "a = " + "[" * 10_000 + "]" * 10_000}
    for text in (deep[suffix], json.dumps({"a": 1}) if suffix != ".toml" else "a = 1"):
        (tmp_path / f"file{suffix}").write_text(text)
        if len(text) < 100:
            load_document(tmp_path / f"file{suffix}")
        else:
            started = time.process_time()
            with pytest.raises(GtcalError, match=f"file{suffix}"):
                load_document(tmp_path / f"file{suffix}")
            assert time.process_time() - started < 1.0


@pytest.mark.long
@pytest.mark.parametrize("reader", ["recording", "device", "board", "cameras", "priors", "document"])
@pytest.mark.parametrize("kind", ["itself", "many"])
def test_an_alias_to_itself_or_to_far_too_much(reader: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "recording.yaml"
    itself = "board: &a {cameras: *a}\ncameras: *a\n"
    many = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
    )
    path.write_text(itself if kind == "itself" else many)
    with pytest.raises(GtcalError, match=r"without end|more than"):
        READERS[reader](path)
    with pytest.raises(GtcalError, match=r"without end|more than"):
        load_plain_yaml(path, path.read_text())


@pytest.mark.parametrize("text", ["", "\r", "  ", '"'])
def test_a_line_has_a_cell(text: str) -> None:
    assert Line(1, 0, len(text), text).fields(",") in (("",), ('"',))


@pytest.mark.parametrize("row", ["cam0,99999999999999999999,1,2,3,4,5", "cam0,1,1e300,2,3,4,5", "cam0,1,nan,2,3,4,5"])
def test_numbers_of_markers_are_bounded(row: str, tmp_path: Path) -> None:
    (tmp_path / "markers.csv").write_text(",".join(COLUMNS) + f"\n{row}\n")
    with pytest.raises(GtcalError, match=r"markers\.csv:2: a number that is not finite, or far too large"):
        read_marker_sightings(tmp_path / "markers.csv", None)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [None, "{", b"\xff"])
def test_an_index_whose_rows_are_none_is_damaged(value: object, tmp_path: Path) -> None:
    record = Record("a", "calibrate", "rec", "k", "done", "", "", 1, True, "", {}, {}, (), "2026", 1.0, (), "0" * 64)
    with opened_index(tmp_path / "index.sqlite") as connection:
        insert(connection, record, Contents())
        assert [found for _, found in records(connection)] == [record]
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute("UPDATE job SET options = ?", (value or "",))
    with (
        pytest.raises(GtcalError, match=r"index\.sqlite: the index is damaged \(a row is no record"),
        opened_index(tmp_path / "index.sqlite") as connection,
    ):
        list(records(connection))
