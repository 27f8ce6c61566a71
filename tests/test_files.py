import sqlite3
from pathlib import Path

import pytest

from gtcal.errors import GtcalError
from gtcal.files import fingerprint, staged, write_aside, write_folder, write_text


def test_a_failure_halfway_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    write_text(path, "old")

    def fail_halfway() -> None:
        with write_aside(path) as file:
            file.write("half of the n")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_halfway()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_text_and_bytes_are_written_into_folders_that_are_not_there_yet(tmp_path: Path) -> None:
    write_text(tmp_path / "a" / "b" / "text", "µ\n")
    assert (tmp_path / "a" / "b" / "text").read_bytes() == "µ\n".encode()
    with write_aside(tmp_path / "c" / "bytes", binary=True) as file:
        file.write(b"\x00\xff")
    assert (tmp_path / "c" / "bytes").read_bytes() == b"\x00\xff"


def test_a_place_that_takes_no_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GtcalError, match=r"file/result\.json: can't be written"):
        write_text(tmp_path / "file" / "result.json", "")


def test_fingerprint_is_sha256_and_tells_folders_apart_by_name_and_content(tmp_path: Path) -> None:
    (tmp_path / "one").write_bytes(b"abc")
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert fingerprint(tmp_path / "one").sha256 == known
    before = fingerprint(tmp_path).sha256
    (tmp_path / "one").rename(tmp_path / "two")
    renamed = fingerprint(tmp_path).sha256
    (tmp_path / "two").write_bytes(b"abd")
    assert len({before, renamed, fingerprint(tmp_path).sha256}) == 3
    with pytest.raises(GtcalError, match="absent: can't be read"):
        fingerprint(tmp_path / "absent")


def test_a_folder_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_folder(tmp_path / "new" / "rig", {"a.txt": "a", "b.txt": "b"})
    (tmp_path / "new" / "rig" / "kept.txt").write_text("kept")
    write_folder(tmp_path / "new" / "rig", {"a.txt": "again"})
    texts = {file.name: file.read_text() for file in (tmp_path / "new" / "rig").iterdir()}
    assert texts == {"a.txt": "again", "b.txt": "b", "kept.txt": "kept"}
    with pytest.raises(GtcalError, match="can't be written"):
        write_folder(tmp_path / "new" / "other", {"a.txt": "a", "b" * 300: "b"})
    with pytest.raises(GtcalError, match="can't be written"):
        write_folder(tmp_path / "new" / "rig" / "a.txt", {"a.txt": "a"})
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"rig"}


@pytest.mark.parametrize("error", [OSError(28, "No space"), sqlite3.OperationalError("is full")])
def test_what_a_library_can_not_write_is_one_line_of_the_path_asked_for(error: Exception, tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=rf"^{tmp_path}/bag: can't be written: ") as raised, staged(tmp_path / "bag"):
        raise error
    assert ".part" not in str(raised.value)
    assert not list(tmp_path.iterdir())


def test_an_error_within_speaks_of_the_path_asked_for(tmp_path: Path) -> None:
    with pytest.raises(GtcalError, match=rf"^{tmp_path}/bag/a: is odd$"), staged(tmp_path / "bag") as aside:
        raise GtcalError(f"{aside}/a: is odd")
