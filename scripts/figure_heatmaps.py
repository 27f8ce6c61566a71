"""The paper's heat maps: a good and a bad calibration of one fisheye camera, as the Lollypop shows them.

A headset's front camera (a real Quest 3's lens) is calibrated on a simulated recording of the paper's board. Then the
Lollypop is carried through its whole image, and the same recording verifies two calibrations: the good one, and one
that was computed with a lens whose focal length is wrong and taken for exact (--bad lens; the extrinsic has adapted to
it, as it would), or whose camera has turned since (--bad turned). Prints the numbers, and writes the figure as PNG and
SVG.

    python scripts/figure_heatmaps.py -o heatmaps
    python scripts/figure_heatmaps.py -o turned --bad turned --turn-deg 0.2
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from gtcal import (
    Calibration,
    CalibrationOptions,
    GtcalError,
    LollypopRecording,
    Recording,
    Verification,
    VerificationOptions,
    calibrate,
    verify,
)
from gtcal.camera import Camera
from gtcal.cli.progress import shown_progress
from gtcal.estimation.options import MocapSigmas
from gtcal.progress import Progress
from gtcal.report.pictures import styled_figure, write_figure
from gtcal.report.plots import image_axes
from gtcal.report.verification_figures import class_legend, draw_heat_map
from gtcal.simulation import MocapNoise, SimulationOptions, quest3_like_rig, simulate
from gtcal.simulation.fault import small_motion
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
from gtcal.verification.verification import ErrorClass

MOCAP_MM, MOCAP_DEG = 0.05, 0.005
BINS = VerificationOptions(heat_map_columns=12, heat_map_rows=10)


def recordings(frames: int, duration_s: float, seed: int) -> tuple[Recording, LollypopRecording]:
    """Of the board and of the Lollypop, before the same camera."""
    headset = quest3_like_rig()
    rig = replace(headset, cameras=headset.cameras[:1], rig_T_camera=headset.rig_T_camera[:1])
    mocap = MocapNoise(MOCAP_MM, MOCAP_DEG)
    board = simulate(SimulationOptions(rig=rig, n_frames=frames, mocap=mocap), seed=seed)
    options = LollypopOptions(rig=rig, calibrated_in=board.scene, duration_s=duration_s, mocap=mocap)
    return board.recording, simulate_lollypop(options, seed=seed + 1).recording


def with_wrong_lens(recording: Recording, percent: float) -> Recording:
    cameras = {name: _longer(camera, percent / 100) for name, camera in recording.cameras.items()}
    return replace(recording, cameras=cameras)


def _longer(camera: Camera, share: float) -> Camera:
    theta = camera.theta.copy()
    theta[:2] *= 1.0 + share
    return replace(camera, parameters=theta)


def turned(calibration: Calibration, angle_deg: float) -> Calibration:
    """The calibration of cameras that stood otherwise, turned about the image's diagonal."""
    turn = small_motion((0.0, 0.0, 0.0), angle_deg * np.array([0.6, 0.8, 0.0]))
    cameras = {}
    for name, camera in calibration.cameras.items():
        pose = camera.camera_T_ref
        cameras[name] = replace(camera, camera_T_ref=replace(pose, a_T_b=turn @ pose.a_T_b))
    return replace(calibration, cameras=cameras)


def verified(arguments: argparse.Namespace, progress: Progress) -> dict[str, Verification]:
    """The verifications of the good and of the bad calibration, by what they are."""
    progress("simulating", 0, 1)
    board, lollypop = recordings(arguments.frames, arguments.duration_s, arguments.seed)
    progress("simulating", 1, 1)
    known = CalibrationOptions(mocap=MocapSigmas(MOCAP_MM, MOCAP_DEG))
    good = calibrate(board, known, progress=progress)
    if arguments.bad == "turned":
        name, bad = f"turned by {arguments.turn_deg:g} deg", turned(good, arguments.turn_deg)
    else:
        name = f"focal length {arguments.focal_percent:g} % wrong"
        # As in the paper: by default the lens would be put right, and mocap poses take up part of what it gets wrong.
        believed = CalibrationOptions(intrinsics="exact", mocap="exact", effects=False)
        bad = calibrate(with_wrong_lens(board, arguments.focal_percent), believed, progress=progress)
    calibrations = {"good": good, name: bad}
    return {kind: verify(lollypop, each, BINS, progress=progress) for kind, each in calibrations.items()}


def table(verifications: Mapping[str, Verification]) -> Table:
    shown = Table(title="front camera of a headset, verified with the Lollypop", box=SIMPLE_HEAD)
    shown.add_column("calibration", no_wrap=True)
    for heading in ("verdict", "RMSE px", "95 % px", "worst px", "RMSE mm", "n", "image"):
        shown.add_column(heading, justify="right")
    for kind in ErrorClass:
        shown.add_column("bins: none" if kind is ErrorClass.NONE else kind.name.lower(), justify="right")
    for name, verification in verifications.items():
        for camera in verification.cameras.values():
            px, classes = camera.px, camera.heat_map.classes
            errors = [f"{value:.3f}" for value in (px.rmse, px.p95, px.worst, camera.mm.rmse)]
            bins = [str((classes == kind).sum()) for kind in ErrorClass]
            size = [str(camera.n_sightings), f"{camera.coverage:.0%}"]
            shown.add_row(name, str(camera.verdict), *errors, *size, *bins)
    return shown


def draw(verifications: Mapping[str, Verification], paths: tuple[Path, ...]) -> None:
    with styled_figure(7.6, 3.7) as figure:
        parts = figure.subfigures(1, 2, squeeze=False)[0]
        for part, (name, verification) in zip(parts, verifications.items(), strict=True):
            (camera,) = verification.cameras.values()
            axes = image_axes(part, verification.sightings[camera.camera].camera)
            draw_heat_map(axes, camera.heat_map, counts=True)
            axes.set_title(f"{name}: RMSE {camera.px.rmse:.2f} px, {camera.verdict}", size=9)
            class_legend(part)
        figure.supxlabel("RMSE of e_2D per bin of the image; the numbers count its sightings; white: none", size=8)
        for path in paths:
            write_figure(path, figure)


def main() -> None:
    arguments = _arguments()
    with shown_progress() as progress:
        verifications = verified(arguments, progress)
    paths = tuple(arguments.output.with_name(arguments.output.name + suffix) for suffix in (".png", ".svg"))
    draw(verifications, paths)
    console = Console(width=140)
    console.print(table(verifications))
    console.print(f"written: {', '.join(map(str, paths))}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("heatmaps"), help="files to write, less their suffix")
    parser.add_argument("--bad", choices=("lens", "turned"), default="lens", help="what the bad calibration is")
    parser.add_argument("--focal-percent", type=float, default=1.0, help="error of the focal length (--bad lens)")
    parser.add_argument("--turn-deg", type=float, default=0.2, help="error of the orientation (--bad turned)")
    parser.add_argument("--frames", type=int, default=100, help="views of the board")
    parser.add_argument("--duration-s", type=float, default=120.0, help="of the Lollypop's recording, at 30 Hz")
    parser.add_argument("--seed", type=int, default=1, help="another number, other recordings")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        main()
    except GtcalError as error:
        raise SystemExit(f"{error}") from None
