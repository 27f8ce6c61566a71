"""Simulated recordings of several boards that are shown to one rig at once."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from gtcal.board import ArucoGrid, Board, aruco_dictionary
from gtcal.documents import read_text
from gtcal.errors import GtcalError
from gtcal.files import write_text
from gtcal.progress import Progress
from gtcal.recordings.capture import Capture
from gtcal.recordings.recording import Recording
from gtcal.simulation.filming import film
from gtcal.simulation.ground_truth import GROUND_TRUTH_NAME, write_ground_truth
from gtcal.simulation.options import SimulationOptions
from gtcal.simulation.simulate import Simulation, scene_of, seed_of_take, simulate, simulate_in

_TAKE_OF_SECOND = 1000  # no take that anybody asks for


def boards_like(board: Board, n: int) -> dict[str, Board]:
    """The board and others like it with tags of their own: 'board_1' and so on.

    Raises GtcalError for a board without tags that can be others, or where its dictionary has too few."""
    if not isinstance(board, ArucoGrid):
        raise GtcalError("several boards: need a grid of ArUco tags (board type aruco_grid), whose ids can differ")
    known = len(aruco_dictionary(board.dictionary).bytesList)
    last = board.first_tag_id + n * board.n_tags
    if last > known:
        raise GtcalError(f"{n} boards with {board.n_tags} tags each: {board.dictionary} has only {known}")
    others = [replace(board, first_tag_id=board.first_tag_id + i * board.n_tags) for i in range(n)]
    return {f"board_{i + 1}": other for i, other in enumerate(others)}


def simulate_boards(options: SimulationOptions, boards: Mapping[str, Board], *, seed: int) -> dict[str, Simulation]:
    """Each board's simulation: of the same rig and platform at the same times, with motion and noise of its own.

    Raises GtcalError for a standing board, of which there is one, or a negative seed."""
    if options.capture is Capture.STANDING_BOARD:
        raise GtcalError("several boards are simulated where each is tracked: choose another capture")
    found: dict[str, Simulation] = {}
    for index, (name, board) in enumerate(boards.items()):
        own = replace(options, board=board)
        if not found:
            found[name] = simulate(own, seed=seed)
            continue
        first = next(iter(found.values()))
        own_seed = seed_of_take(seed, _TAKE_OF_SECOND + index)
        scene = replace(
            scene_of(own, seed=own_seed),
            world_T_anchor=first.scene.world_T_anchor,
            rig_T_platform=first.scene.rig_T_platform,
        )
        simulation = simulate_in(scene, own, seed=own_seed)
        recording = replace(simulation.recording, cameras=first.recording.cameras, platform=first.recording.platform)
        found[name] = replace(simulation, recording=recording)
    return found


def film_boards(simulations: Mapping[str, Simulation], folder: Path, progress: Progress) -> dict[str, Recording]:
    """Render what each camera sees of all boards at once, into ``folder``: each board's recording with these images in
    place of its corners. Raises GtcalError where the folder can't be written."""
    first, *beside = simulations.values()
    images = film(first, folder, progress, beside=beside)
    return {name: replace(one.recording, detections={}, images=images) for name, one in simulations.items()}


def write_truth_of_boards(simulations: Mapping[str, Simulation], folder: Path) -> None:
    """Write ground_truth.json: that of the first board, and body_T_board of each under 'boards'."""
    first = next(iter(simulations.values()))
    path = write_ground_truth(first.truth, folder)
    document = json.loads(read_text(path))
    document["boards"] = {name: one.truth.body_T_board.tolist() for name, one in simulations.items()}
    write_text(folder / GROUND_TRUTH_NAME, json.dumps(document, indent=None, separators=(",", ":")) + "\n")
