"""gtcal demo: the whole way on a rendered recording, and how far the answer is from the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def demo(
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("gtcal-demo"),
    frames: int = 60,
    image_scale: float = 0.5,
    seed: int = 1,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Render a small recording, detect the board in it, calibrate, and compare with the truth.

    The recording is that of a headset with four fisheye cameras (the front pair with a real Quest 3's lenses) and the
    paper's A2 board, both tracked by a mocap with 0.05 mm and 0.005 deg of noise. The folder it leaves behind is a
    recording like any other: look at its manifest and images, and run 'gtcal calibrate' on it yourself.

    Args:
        output: Folder for the recording and its calibration.json; it must be new, empty, or of an earlier demo.
        frames: Frames per camera.
        image_scale: Size of the images as a share of 1280 x 1024.
        seed: Another number, another recording.
        quiet: Show no progress and print nothing.
    """
    from gtcal.calibration_file import write_calibration
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.tables import print_calibration, print_errors
    from gtcal.options import CalibrationOptions, MocapSigmas
    from gtcal.recording import load_recording
    from gtcal.simulation import MocapNoise, SimulationOptions, quest3_like_rig, simulate, write_simulation
    from gtcal.workflow import calibrate

    _clear_earlier_demo(output)
    noise = MocapNoise(translation_mm=0.05, rotation_deg=0.005)
    options = SimulationOptions(rig=quest3_like_rig().scaled(image_scale), n_frames=frames, mocap=noise)
    simulation = simulate(options, seed=seed)
    with shown_progress(quiet) as progress:
        manifest = write_simulation(simulation, output, images=True, progress=progress)
        (output / _MARK).touch()
        known = CalibrationOptions(mocap=MocapSigmas(noise.translation_mm, noise.rotation_deg))
        calibration = calibrate(load_recording(manifest), known, progress=progress)
    write_calibration(output / "calibration.json", calibration)
    if not quiet:
        print_calibration(calibration, verbose=True)
        print_errors(calibration, simulation.truth)
        print(f"recording and result: {output}/ (try: gtcal calibrate {output} --refine-intrinsics)")


_MARK = ".gtcal-demo"


def _clear_earlier_demo(folder: Path) -> None:
    """Empty the folder of an earlier demo, which bears a mark; any other folder is left to its owner."""
    import shutil

    if (folder / _MARK).is_file():
        shutil.rmtree(folder)
