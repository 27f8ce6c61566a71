"""The images of a simulated recording, rendered on all cores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from factors.rigid import inverse
from gtcal.board import Board
from gtcal.camera import FloatArray
from gtcal.cores import all_cores
from gtcal.files import write_aside
from gtcal.progress import Progress
from gtcal.recordings.images import GreyImage, Images, ImageSequence
from gtcal.simulation.backdrop import GreyPicture, room
from gtcal.simulation.rendering import (
    Lens,
    Plate,
    Shown,
    band_edges,
    bands,
    lens_of,
    plate_of,
    render_all,
    sub_exposures,
)
from gtcal.simulation.simulate import Simulation


@dataclass(frozen=True)
class Studio:
    """What all images of a simulation have in common. others: boards that are carried along with its own, each with
    its place on that, board_T_other (4, 4): the other faces of a device."""

    simulation: Simulation
    others: Sequence[tuple[Board, FloatArray]] = ()

    @cached_property
    def plates(self) -> tuple[tuple[Plate, FloatArray], ...]:
        """With their places on the first."""
        boards = ((self.simulation.options.board, np.eye(4)), *self.others)
        return tuple((plate_of(board), board_T_other) for board, board_T_other in boards)

    @cached_property
    def room(self) -> GreyPicture:
        return room(self.simulation.stream("room"))

    def lens(self, camera_index: int) -> Lens:
        camera = self.simulation.options.rig.cameras[camera_index]
        return lens_of(camera, self.simulation.options.images, self.simulation.stream("lens", camera_index))

    def take(self, lens: Lens, camera_index: int, frame: int) -> GreyImage:
        """The image that one camera, with its ``lens``, takes of one frame: the same each time."""
        options, scene = self.simulation.options.images, self.simulation.scene
        time_s = self.simulation.frame_times_s[frame]
        ends_s = time_s + options.exposure_s * np.array([-0.5, 0.5])
        ends = scene.camera_T_board(camera_index, ends_s)
        n = max(sub_exposures(lens.camera, plate, ends @ board_T_other) for plate, board_T_other in self.plates)
        steps_s = options.exposure_s * ((np.arange(n) + 0.5) / n - 0.5)
        at_s = time_s + self._rows_after_s(lens, camera_index, time_s)[:, None] + steps_s
        camera_T_board = scene.camera_T_board(camera_index, at_s.ravel()).reshape(*at_s.shape, 4, 4)
        shown = [Shown(plate, camera_T_board @ board_T_other) for plate, board_T_other in self.plates]
        camera_T_world = inverse(scene.world_T_camera(camera_index, np.array([time_s])))[0]
        noise = self.simulation.stream("sensor", camera_index, frame)
        return render_all(lens, shown, self.room, camera_T_world, options, noise)

    def _rows_after_s(self, lens: Lens, camera_index: int, time_s: float) -> FloatArray:
        """(R,) how long after the image's stamp each band of rows is exposed: a single band, at once, of a shutter that
        does not roll."""
        camera = lens.camera
        shutter = camera.rolling_shutter
        if shutter is None or shutter.readout_s is None:
            return np.zeros(1)
        height_px = camera.image_height_px
        ends_s = time_s + shutter.readout_s * shutter.readout_shares(np.array([0.0, height_px - 1.0]), height_px)
        ends = self.simulation.scene.camera_T_board(camera_index, ends_s)
        n = max(bands(camera, plate, ends @ board_T_other) for plate, board_T_other in self.plates)
        edges = band_edges(n, height_px)
        middles_px = 0.5 * (edges[:-1] + edges[1:] - 1.0).astype(np.float64)
        return np.asarray(shutter.readout_s * shutter.readout_shares(middles_px, height_px))


def film(
    simulation: Simulation, folder: Path, progress: Progress, *, others: Sequence[tuple[Board, FloatArray]] = ()
) -> dict[str, Images]:
    """Render every frame of every camera into ``folder/<camera>/<stamp_ns>.png``. others: as of ``Studio``.

    Raises GtcalError where the folder can't be written."""
    studio = Studio(simulation, others)
    done, total = 0, len(simulation.options.rig.cameras) * len(simulation.frame_times_s)
    sequences: dict[str, Images] = {}
    with all_cores() as pool:
        for index, camera in enumerate(simulation.options.rig.cameras):
            stamps_ns = simulation.truth.cameras[camera.name].stamps_ns
            paths = tuple(folder / camera.name / f"{stamp}.png" for stamp in stamps_ns.tolist())
            for _ in pool.map(_Shoot(studio, studio.lens(index), index, paths), range(len(paths))):
                done += 1
                progress("rendering images", done, total)
            sequences[camera.name] = ImageSequence(stamps_ns, paths)
    return sequences


@dataclass(frozen=True)
class _Shoot:
    """Takes and writes one frame of one camera after the other."""

    studio: Studio
    lens: Lens
    camera_index: int
    paths: tuple[Path, ...]

    def __call__(self, frame: int) -> None:
        image = self.studio.take(self.lens, self.camera_index, frame)
        _, encoded = cv2.imencode(".png", image)
        with write_aside(self.paths[frame], binary=True) as file:
            file.write(encoded.tobytes())
