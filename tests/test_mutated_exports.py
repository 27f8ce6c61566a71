"""Exports that were cut off, damaged, or passed through other programs: refused in one line, or read as they were."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mocap_files import CUBE_M, from_zero, markers_of, write_motive, write_qualisys, write_trc, write_vicon
from support import wandering_trajectory

from gtcal.errors import GtcalError
from gtcal.readers import (
    TRAJECTORY_READERS,
    BodySelection,
    PoseConventions,
    detect_mocap_format,
    inspect_mocap,
    write_euroc_csv,
    write_tum,
)
from gtcal.readers.selection import WHOLE_FILE
from gtcal.recordings.trajectory import Trajectory

A = from_zero(wandering_trajectory("a", n=12, interval_ns=10_000_000))
POSES = A.world_T_body.copy()
POSES[5] = np.nan
LABELS = tuple(f"a:m{i}" for i in range(len(CUBE_M)))
MARKERS = dict(zip(LABELS, np.moveaxis(markers_of(A.world_T_body), 1, 0), strict=True))
EXPORTS = "data/mocap_exports"


@dataclass(frozen=True)
class Case:
    """A kind of export: how it is written, what is read of it, its lines of header and its separator."""

    format: str
    write: Callable[[Path], object]
    selection: BodySelection = WHOLE_FILE
    header: int = 1
    separator: str = ","


CASES = {
    "motive": Case("motive_csv", lambda path: write_motive(path, {"a": POSES}, rate_hz=100.0), header=7),
    "motive with markers": Case(
        "motive_csv",
        lambda path: write_motive(path, {"a": POSES}, markers=MARKERS, rate_hz=100.0, separator=";"),
        header=7,
        separator=";",
    ),
    "motive markers": Case(
        "motive_csv",
        lambda path: write_motive(path, {}, markers=MARKERS, rate_hz=100.0),
        BodySelection(markers=LABELS),
        header=7,
    ),
    "vicon segments": Case(
        "vicon_csv",
        lambda path: write_vicon(path, segments={"a:root": POSES}),
        BodySelection(rotation="helical"),
        header=5,
    ),
    "vicon markers": Case(
        "vicon_csv", lambda path: write_vicon(path, markers=MARKERS), BodySelection(markers=LABELS), header=5
    ),
    "qualisys": Case("qualisys_tsv", lambda path: write_qualisys(path, {"a": POSES}), header=11, separator="\t"),
    "qualisys with times": Case(
        "qualisys_tsv", lambda path: write_qualisys(path, {"a": POSES}, times=True), header=11, separator="\t"
    ),
    "trc": Case("trc", lambda path: write_trc(path, MARKERS), BodySelection(markers=LABELS), header=6, separator="\t"),
    "euroc": Case("euroc_csv", lambda path: write_euroc_csv(path, A)),
    "tum": Case("tum", lambda path: write_tum(path, A), separator=" "),
}
each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def read(path: Path, case: Case) -> Trajectory:
    return TRAJECTORY_READERS[case.format](path, "a", PoseConventions(), case.selection)


def outcome(path: Path, data: bytes, case: Case, truth: Trajectory) -> str:
    """'refused' in one line, or 'same': the same poses at the same times, of some of the frames or all.

    Anything else raises."""
    path.write_bytes(data)
    problems = []
    try:
        found = read(path, case)
    except GtcalError as error:
        problems.append(str(error))
    try:
        inspect_mocap(path, case.format)
    except GtcalError as error:
        problems.append(str(error))
    assert not any("\n" in problem for problem in problems), problems
    assert all(path.name in problem for problem in problems), problems
    if problems and "found" not in locals():
        return "refused"
    assert isinstance(found, Trajectory)
    nearest = np.abs(truth.stamps_ns[:, None] - found.stamps_ns).argmin(axis=0)
    assert np.abs(truth.stamps_ns[nearest] - found.stamps_ns).max() <= 1_000, found.stamps_ns
    np.testing.assert_allclose(found.world_T_body, truth.world_T_body[nearest], atol=1e-8)
    return "same" if found.n_samples == truth.n_samples else "some"


@pytest.fixture
def written(tmp_path: Path) -> Callable[[Case], tuple[Path, bytes, Trajectory]]:
    """A case's file, its bytes, and what is read of it undamaged."""

    def make(case: Case) -> tuple[Path, bytes, Trajectory]:
        path = tmp_path / f"take.{case.format}"
        case.write(path)
        return path, path.read_bytes(), read(path, case)

    return make


Written = Callable[[Case], tuple[Path, bytes, Trajectory]]


@pytest.mark.long
@each_case
def test_the_file_is_recognised_by_its_head(case: Case, written: Written) -> None:
    path, data, truth = written(case)
    assert detect_mocap_format(path) == case.format
    assert truth.n_samples in (11, 12)
    assert outcome(path, data, case, truth) == "same"


@each_case
def test_cut_off_anywhere(case: Case, written: Written) -> None:
    path, data, truth = written(case)
    places = {*range(0, len(data), max(1, len(data) // 90)), *range(len(data) - 60, len(data))}
    outcomes = [outcome(path, data[:keep], case, truth) for keep in sorted(places)]
    assert {"refused", "some"} <= set(outcomes) or case is CASES["qualisys"]
    assert outcomes[0] == "refused"


@each_case
def test_dressed_otherwise(case: Case, written: Written) -> None:
    path, data, truth = written(case)
    text = data.replace(b"\r\n", b"\n")
    for dressed in (text, text.replace(b"\n", b"\r\n"), b"\xef\xbb\xbf" + text, text + b"\n\n", text + b"\r\n"):
        assert outcome(path, dressed, case, truth) == "same"
    assert outcome(path, text.decode().encode("utf-16"), case, truth) == "refused"
    assert outcome(path, b"\0" * 100 + text, case, truth) in ("refused", "same")


@each_case
def test_another_locales_decimal_comma(case: Case, written: Written) -> None:
    """Where commas separate, decimal commas are refused; elsewhere they are read, or refused."""
    path, data, truth = written(case)
    lines = data.decode().split("\n")
    rows = "\n".join(line.replace(".", ",") for line in lines[case.header :])
    swapped = "\n".join(lines[: case.header]) + "\n" + rows
    expected = {",": {"refused"}, ";": {"same"}, "\t": {"same"}, " ": {"refused"}}[case.separator]
    assert outcome(path, swapped.encode(), case, truth) in expected
    if case.separator == ",":
        mixed = "\n".join([*lines[: case.header], lines[case.header].replace(".", ",", 1), *lines[case.header + 1 :]])
        assert outcome(path, mixed.encode(), case, truth) == "refused"


@each_case
def test_without_frames(case: Case, written: Written) -> None:
    path, data, truth = written(case)
    lines = data.decode().split("\n")
    assert outcome(path, "\n".join([*lines[: case.header], ""]).encode(), case, truth) == "refused"


@each_case
def test_columns_missing(case: Case, written: Written) -> None:
    """Of all lines, of the rows only, and of the header only."""
    path, data, truth = written(case)
    table = [line.rstrip("\r").split(case.separator) for line in data.decode().split("\n")]
    n_columns = max(len(row) for row in table)
    first_of_table = next(i for i, row in enumerate(table) if len(row) > n_columns - 3)
    outcomes = set()
    for column in range(n_columns):
        for chosen in (
            range(first_of_table, len(table)),
            range(case.header, len(table)),
            range(first_of_table, case.header),
            [case.header + 2],
        ):
            cut = [row[:column] + row[column + 1 :] if i in chosen else row for i, row in enumerate(table)]
            outcomes.add(outcome(path, "\n".join(case.separator.join(row) for row in cut).encode(), case, truth))
    assert "refused" in outcomes


@each_case
def test_header_damaged(case: Case, written: Written) -> None:
    """Any character of it replaced, any line of it missing or twice, any two exchanged."""
    path, data, truth = written(case)
    lines = data.decode().split("\n")
    end = len("\n".join(lines[: case.header]))
    outcomes = [
        outcome(path, data[:at] + b"#" + data[at + 1 :], case, truth) for at in range(0, end, max(1, end // 120))
    ]
    for i in range(case.header):
        outcomes.append(outcome(path, "\n".join(lines[:i] + lines[i + 1 :]).encode(), case, truth))
        outcomes.append(outcome(path, "\n".join(lines[: i + 1] + lines[i:]).encode(), case, truth))
        for j in range(i):
            exchanged = [lines[{i: j, j: i}.get(k, k)] for k in range(len(lines))]
            outcomes.append(outcome(path, "\n".join(exchanged).encode(), case, truth))
    assert "refused" in outcomes or case.format == "tum"  # which needs no header


@each_case
def test_rows_damaged(case: Case, written: Written) -> None:
    """Any character of the rows replaced by one that is in no number; rows exchanged, twice, or empty."""
    path, data, truth = written(case)
    lines = data.decode().split("\n")
    start = len("\n".join(lines[: case.header])) + 1
    for at in range(start, len(data) - 2, max(1, (len(data) - start) // 120)):
        for byte in (b"x", b"_", b"\xff"):
            outcome(path, data[:at] + byte + data[at + 1 :], case, truth)
    row = case.header + 3
    exchanged = [*lines[:row], lines[row + 1], lines[row], *lines[row + 2 :]]
    for damaged in (
        *([exchanged] if case is not CASES["qualisys"] else []),  # whose rows have no number
        [*lines[:row], lines[row], lines[row], *lines[row + 1 :]],
        [*lines[:row], "", *lines[row:]],
        [*lines[:row], case.separator * 5, *lines[row:]],
    ):
        outcome(path, "\n".join(damaged).encode(), case, truth)


@pytest.mark.parametrize(
    ("name", "selection"),
    [
        ("motive_rigid_body_120hz_m.csv", BodySelection()),
        ("motive_rigid_bodies_120hz_m.csv", BodySelection()),
        ("vicon_trajectories_100hz_mm.csv", BodySelection(name="boite")),
    ],
)
def test_real_exports_cut_off_anywhere(
    name: str, selection: BodySelection, shared: Callable[[str], Path], tmp_path: Path
) -> None:
    """Cut off, a take gives another mean shape, and with it solved poses that differ by its noise: judged are those
    that the file has itself, and the counts."""
    path = shared(f"{EXPORTS}/{name}")
    data, kind = path.read_bytes(), str(detect_mocap_format(path))
    whole = TRAJECTORY_READERS[kind](path, "a", PoseConventions(), selection)
    seen = set()
    for keep in np.linspace(0, len(data) - 1, 25).astype(int).tolist():
        (tmp_path / name).write_bytes(data[:keep])
        try:
            found = TRAJECTORY_READERS[kind](tmp_path / name, "a", PoseConventions(), selection)
        except GtcalError as error:
            seen.add("refused" if "\n" not in str(error) else "told in more than a line")
            continue
        seen.add("read")
        n = found.n_samples
        rows = np.searchsorted(whole.stamps_ns, found.stamps_ns)
        kept = whole.world_T_body[np.minimum(rows, whole.n_samples - 1)]
        assert np.abs(found.stamps_ns - whole.stamps_ns[np.minimum(rows, whole.n_samples - 1)]).max() == 0
        off_m = np.linalg.norm(found.world_T_body[:, :3, 3] - kept[:, :3, 3], axis=1)
        assert np.median(off_m) < 2e-4
        assert n <= whole.n_samples + 1
    assert seen == {"refused", "read"}


@pytest.mark.long
@pytest.mark.parametrize("kind", ["motive", "trc"])
def test_a_million_rows_would_take_seconds(kind: str, tmp_path: Path) -> None:
    """50,000 rows in a twentieth of the time that is allowed for a million: twenty seconds of a processor."""
    n = 50_000
    poses = np.tile(wandering_trajectory("a", n=500).world_T_body, (n // 500, 1, 1))
    path = tmp_path / "long"
    if kind == "motive":
        write_motive(path, {"a": poses})
        read(path, CASES["motive"])  # compiles what is not compiled yet
        start = time.process_time()
        found = read(path, CASES["motive"])
    else:
        write_trc(path, dict(zip(LABELS, np.moveaxis(markers_of(poses), 1, 0), strict=True)))
        start = time.process_time()
        found = read(path, CASES["trc"])
    took_s = time.process_time() - start
    assert found.n_samples == n
    np.testing.assert_allclose(found.world_T_body[-1, 3], [0, 0, 0, 1])
    assert took_s < 1.0
