"""The images of a simulated recording, rendered on all cores."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from factors.rigid import inverse
from gtcal.cores import all_cores
from gtcal.errors import GtcalError
from gtcal.files import write_aside
from gtcal.progress import Progress
from gtcal.recordings.images import GreyImage, Images, ImageSequence
from gtcal.simulation.backdrop import GreyPicture, room
from gtcal.simulation.rendering import Lens, Plate, lens_of, plate_of, render, sub_exposures
from gtcal.simulation.simulate import Simulation


@dataclass(frozen=True)
class Studio:
    """What all images of a simulation have in common."""

    simulation: Simulation

    @cached_property
    def plate(self) -> Plate:
        return plate_of(self.simulation.options.board)

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
        n = sub_exposures(lens.camera, self.plate, scene.camera_T_board(camera_index, ends_s))
        steps_s = options.exposure_s * ((np.arange(n) + 0.5) / n - 0.5)
        camera_T_board = scene.camera_T_board(camera_index, time_s + steps_s)
        camera_T_world = inverse(scene.world_T_camera(camera_index, np.array([time_s])))[0]
        noise = self.simulation.stream("sensor", camera_index, frame)
        return render(lens, self.plate, self.room, camera_T_board, camera_T_world, options, noise)


def film(simulation: Simulation, folder: Path, progress: Progress) -> dict[str, Images]:
    """Render every frame of every camera into ``folder/<camera>/<stamp_ns>.png``.

    Raises GtcalError where the folder can't be written, or a camera has a rolling shutter."""
    for camera in simulation.options.rig.cameras:
        if camera.rolling_shutter is not None:
            raise GtcalError(
                f"camera {camera.name!r} has a rolling shutter, and images are rendered with all rows exposed at once; "
                "simulate detections in place of images"
            )
    studio = Studio(simulation)
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
