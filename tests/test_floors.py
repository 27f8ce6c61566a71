"""What may import what: rooms on floors, and no circle of files."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FLOORS = (
    "factors",
    "gtcal",  # the modules that stand in no room: cameras, files, errors
    "gtcal.board gtcal.board_base gtcal.plain_boards gtcal.tag_boards gtcal.drawing gtcal.readers gtcal.camera_files "
    "gtcal.recordings gtcal.observed gtcal.results",
    "gtcal.estimation gtcal.uncertainty gtcal.clock gtcal.detection gtcal.verification gtcal.effects",
    "gtcal.workflow gtcal.steps gtcal.guided gtcal.differences gtcal.doctor gtcal.report gtcal.overview "
    "gtcal.baselines gtcal.selfchecks gtcal.simulation gtcal.convert",
    "gtcal.pose_recordings gtcal.several_boards gtcal.fleet",
    "gtcal.cli gtcal.presentation gtcal.__main__",
)
"""From the ground up: a room imports from its own floor and from those below. A new one is to be named here."""

FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for top in ("factors", "gtcal")
    for path in (ROOT / top).rglob("*.py")
}


def imported(node: ast.AST) -> Iterator[str]:
    """The modules that are named below a node, also within functions; not those for the type checker only."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        if isinstance(child, ast.ImportFrom) and child.module is not None:
            yield from (f"{child.module}.{alias.name}" for alias in child.names)
            yield child.module
        yield from imported(child)


def imports_of(name: str) -> set[str]:
    """Of a file, the files that it imports; packages only where one is meant."""
    named = set(imported(ast.parse(FILES[name].read_text())))
    return {one for one in named if one in FILES and not any(other.startswith(f"{one}.") for other in named)} - {name}


IMPORTS = {name: imports_of(name) for name in FILES if name not in ("factors", "gtcal")}


def floor_of(name: str) -> int:
    room = ".".join(name.split(".")[:2])
    known = {room: i for i, rooms in enumerate(FLOORS) for room in rooms.split()}
    if room not in known and (ROOT / room.replace(".", "/")).is_dir():
        pytest.fail(f"{room} stands on no floor")
    return known.get(room, known[name.split(".")[0]])


def test_no_files_import_each_other_in_a_circle() -> None:
    TopologicalSorter(IMPORTS).prepare()  # raises CycleError with the circle


def test_no_room_imports_from_a_floor_above() -> None:
    climbs = [(name, other) for name, others in IMPORTS.items() for other in others if floor_of(other) > floor_of(name)]
    assert not climbs
