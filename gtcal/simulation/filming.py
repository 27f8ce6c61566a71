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
from gtcal.simulation.scene import Scene
from gtcal.simulation.simulate import Simulation


@dataclass(frozen=True)
class Studio:
    """What all images of a simulation have in common. others: boards that are carried along with its own, each with
    its place on that, board_T_other (4, 4): the other faces of a device. beside: simulations of the same rig at the
    same times, whose boards are before the cameras too."""

    simulation: Simulation
    others: Sequence[tuple[Board, FloatArray]] = ()
    beside: Sequence[Simulation] = ()

    @cached_property
    def plates(self) -> tuple[_Carried, ...]:
        boards = ((self.simulation.options.board, np.eye(4)), *self.others)
        own = [_Carried(self.simulation.scene, plate_of(board), place) for board, place in boards]
        return (*own, *(_Carried(one.scene, plate_of(one.options.board), np.eye(4)) for one in self.beside))

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
        n = max(sub_exposures(lens.camera, one.plate, one.poses(camera_index, ends_s)) for one in self.plates)
        steps_s = options.exposure_s * ((np.arange(n) + 0.5) / n - 0.5)
        at_s = time_s + self._rows_after_s(lens, camera_index, time_s)[:, None] + steps_s
        shown = [Shown(one.plate, one.poses(camera_index, at_s)) for one in self.plates]
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
        n = max(bands(camera, one.plate, one.poses(camera_index, ends_s)) for one in self.plates)
        edges = band_edges(n, height_px)
        middles_px = 0.5 * (edges[:-1] + edges[1:] - 1.0).astype(np.float64)
        return np.asarray(shutter.readout_s * shutter.readout_shares(middles_px, height_px))


@dataclass(frozen=True)
class _Carried:
    """A plate that moves with a scene's board, at a place on it, board_T_plate (4, 4)."""

    scene: Scene
    plate: Plate
    board_T_plate: FloatArray

    def poses(self, camera_index: int, at_s: FloatArray) -> FloatArray:
        """(..., 4, 4) before a camera, at times (...)."""
        camera_T_board = self.scene.camera_T_board(camera_index, at_s.ravel()).reshape(*at_s.shape, 4, 4)
        return np.asarray(camera_T_board @ self.board_T_plate)


def film(
    simulation: Simulation,
    folder: Path,
    progress: Progress,
    *,
    others: Sequence[tuple[Board, FloatArray]] = (),
    beside: Sequence[Simulation] = (),
) -> dict[str, Images]:
    """Render every frame of every camera into ``folder/<camera>/<stamp_ns>.png``. others, beside: as of ``Studio``.

    Raises GtcalError where the folder can't be written."""
    studio = Studio(simulation, others, beside)
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
