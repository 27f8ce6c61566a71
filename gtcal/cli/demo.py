"""gtcal demo: the whole way on rendered recordings: calibration, verdict, report, and the distance to the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from gtcal.progress import Progress
    from gtcal.recordings.recording import Recording
    from gtcal.results.calibration import Calibration
    from gtcal.simulation import Simulation
    from gtcal.verification.verification import Verification

MOCAP_MM, MOCAP_DEG = 0.05, 0.005
_FRAMES, _IMAGE_SCALE = 60, 0.5


def demo(
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("gtcal-demo"),
    frames: int = _FRAMES,
    image_scale: float = _IMAGE_SCALE,
    seed: int = 1,
    fleet: bool = False,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Render two small recordings, calibrate from one, verify with the other, and compare with the truth.

    The first is that of a headset with four fisheye cameras (the front pair with a real Quest 3's lenses) and the
    paper's A2 board, both tracked by a mocap with 0.05 mm and 0.005 deg of noise; the second shows the same headset
    the Lollypop. The folder they leave behind holds recordings like any other: look at their manifests and images,
    and run 'gtcal calibrate' and 'gtcal verify' on them yourself.

    Args:
        output: Folder for the recordings, calibration.json, verification.json and report.html; it must be new, empty,
            or of an earlier demo.
        frames: Frames per camera of the calibration's recording; the Lollypop's has two and a half times as many.
        image_scale: Size of the images as a share of 1280 x 1024.
        seed: Another number, other recordings.
        fleet: Show instead what 'gtcal batch', 'history' and 'site' make of many recordings: of five rigs over eight
            weeks, simulated without images; one drifts, one is bumped, a lens of one warms. Needs 'gtcal[fleet]'.
        json: Print the results as JSON in place of tables ('gtcal schema demo', and with --fleet 'history').
        quiet: Show no progress and print nothing.
    """
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.tables import errors, print_calibration, print_errors
    from gtcal.cli.verification_tables import print_verification
    from gtcal.errors import GtcalError
    from gtcal.estimation.options import CalibrationOptions, MocapSigmas
    from gtcal.files import check_outputs, write_text
    from gtcal.report import gather_evidence, write_report
    from gtcal.results.calibration_file import calibration_document, write_calibration
    from gtcal.simulation import MocapNoise, SimulationOptions, quest3_like_rig, simulate
    from gtcal.verification.verification_file import verification_document, write_verification
    from gtcal.workflow import calibrate

    if fleet and (frames, image_scale) != (_FRAMES, _IMAGE_SCALE):
        raise GtcalError("--frames and --image-scale are of the demo with images; --fleet has no use for them")
    check_outputs([output], folders=True)
    _clear_earlier_demo(output)
    write_text(output / _MARK, "")  # before the rest, so that an interrupted demo can be run again
    if fleet:
        _show_fleet(output, seed, json, quiet)
        return
    options = SimulationOptions(
        rig=quest3_like_rig().scaled(image_scale), n_frames=frames, mocap=MocapNoise(MOCAP_MM, MOCAP_DEG)
    )
    simulation = simulate(options, seed=seed)
    known = CalibrationOptions(mocap=MocapSigmas(MOCAP_MM, MOCAP_DEG))
    with shown_progress(quiet) as progress:
        recording = _recorded(simulation, output / "recording", progress)
        calibration = calibrate(recording, known, progress=progress)
        verification = _verified(simulation, calibration, output / "lollypop", round(2.5 * frames), progress)
        evidence = gather_evidence(calibration, recording, progress=progress)
        write_report(output / "report.html", calibration, evidence=evidence, verification=verification)
    write_calibration(output / "calibration.json", calibration)
    write_verification(output / "verification.json", verification)
    if json:
        names = ("what", "position_mm", "rotation_deg")
        document = {
            "gtcal_demo": 1,
            "folder": str(output),
            "calibration": calibration_document(calibration),
            "errors": [dict(zip(names, error, strict=True)) for error in errors(calibration, simulation.truth)],
            "verification": verification_document(verification),
        }
        print_json(document)
    elif not quiet:
        print_calibration(calibration, verbose=True)
        print_errors(calibration, simulation.truth)
        print_verification(verification)
        print(f"report: {output / 'report.html'}   (recordings and results: {output}/)")


def _show_fleet(folder: Path, seed: int, json: bool, quiet: bool) -> None:
    """Simulated recordings of a fleet, and all that the commands for fleets make of them."""
    import sys

    from gtcal.cli.history_tables import history_document, print_fleet
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.fleet.batch import run_batch
    from gtcal.fleet.history import RUN_LENGTH, histories
    from gtcal.fleet.jobs_file import read_jobs
    from gtcal.fleet.simulated import demo_fleet, write_fleet
    from gtcal.fleet.site import write_site
    from gtcal.fleet.store import Store
    from gtcal.fleet.workers import dask_workers

    store = Store.made(folder / "store")
    command_line = (Path(sys.argv[0]).name, *sys.argv[1:])
    with shown_progress(quiet) as progress, store.locked(), dask_workers() as workers:
        jobs = read_jobs(write_fleet(folder / "recordings", demo_fleet(seed), progress=progress))
        run_batch(store, jobs, workers, command_line, progress=progress)
        write_site(folder / "site", store, run_length=RUN_LENGTH, progress=progress)
    if json:
        print_json(history_document(list(histories(store).values()), RUN_LENGTH))
    elif not quiet:
        print_fleet(list(histories(store).values()))
        print(f"recordings, store and site: {folder}/; open {folder / 'site' / 'index.html'}")


def _recorded(simulation: Simulation, folder: Path, progress: Progress) -> Recording:
    """What the detector finds in the simulation's images."""
    from gtcal.recordings.recording import load_recording
    from gtcal.simulation import write_simulation
    from gtcal.workflow import detected

    manifest = write_simulation(simulation, folder, images=True, progress=progress)
    return detected(load_recording(manifest), progress=progress)


def _verified(
    simulation: Simulation, calibration: Calibration, folder: Path, frames: int, progress: Progress
) -> Verification:
    from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
    from gtcal.verification.lollypop_recording import load_lollypop_recording
    from gtcal.verification.workflow import verify

    options = LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene, n_frames=frames)
    lollypop = simulate_lollypop(options, seed=simulation.seed + 1)
    manifest = write_lollypop_simulation(lollypop, folder, images=True, progress=progress)
    return verify(load_lollypop_recording(manifest), calibration, progress=progress)


_MARK = ".gtcal-demo"


def _clear_earlier_demo(folder: Path) -> None:
    """Empty the folder of an earlier demo, which bears a mark; any other folder is left to its owner."""
    import shutil

    from gtcal.errors import GtcalError

    if (folder / _MARK).is_file():
        shutil.rmtree(folder)
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise GtcalError(f"{folder}: is there already, and not from an earlier demo; choose another with -o")
