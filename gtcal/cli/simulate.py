"""gtcal simulate: a recording whose answer is known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from gtcal.simulation import SimulationOptions
    from gtcal.simulation.fault import RigFault

RigName = Literal["headset", "fixed"]
MocapFormatName = Literal["euroc_csv", "tum", "motive_csv", "vicon_csv", "rosbag"]
CaptureName = Literal["tracked_platform", "standing_board", "fixed_cameras"]


def simulate(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    *,
    images: bool = False,
    rig: RigName = "headset",
    capture: CaptureName | None = None,
    board: str = "paper_a2",
    boards: int = 1,
    seed: int = 0,
    frames: int = 80,
    duration_s: float = 60.0,
    image_scale: float = 1.0,
    motion: Literal["free", "single_axis", "translation"] = "free",
    pixel_noise_px: float = 0.1,
    missed_share: float = 0.0,
    wrong_tag_share: float = 0.0,
    wrong_corner_share: float = 0.0,
    mocap_rate_hz: float = 120.0,
    mocap_noise_mm: float = 0.1,
    mocap_noise_deg: float = 0.01,
    mocap_correlation_s: float = 0.0,
    mocap_jitter_ms: float = 0.0,
    mocap_gap_share: float = 0.0,
    swap_share: float = 0.0,
    clock_offset_ms: float = 0.0,
    mocap_format: MocapFormatName = "euroc_csv",
    intrinsics: Literal["true", "perturbed", "none"] = "true",
    lollypop: bool = False,
    take: int = 1,
    fault: Literal["none", "markers", "camera", "lens"] = "none",
    fault_camera: str | None = None,
    fault_mm: float = 1.0,
    fault_deg: float = 0.1,
    fault_percent: float = 0.2,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Simulate a recording with known ground truth, to try gtcal on or to plan a capture.

    Writes a folder that 'gtcal detect' and 'gtcal calibrate' read like any other, and ground_truth.json beside
    it: every camera_T_ref, body_T_board, the intrinsics, the true motion, and what was spoilt on purpose. The
    same options and seed give the same files, byte for byte.

    Args:
        output: Folder to write; it must be new or empty.
        images: Render images (about 20 s for the default 4 x 80 of 1280 x 1024 on two cores) in place of simulated
            detections (instantly).
        rig: 'headset': four Fisheye62 cameras like a Quest 3's, two in front and two on the sides. 'fixed': four
            cameras with pinhole and Kannala-Brandt lenses on half a circle around a volume.
        capture: Who is tracked. 'tracked_platform': the rig and the board. 'standing_board': the rig; the board
            stands still. 'fixed_cameras': the board; the cameras stand still. By default what suits the rig.
        board: 'paper_a2', 'chessboard' or 'dots' (see 'gtcal board'), or a YAML file with a board block as in a
            recording's manifest.
        boards: So many of them at once, each tracked, with tags of its own; in images the nearer hides the farther.
        seed: Decides everything random.
        frames: Frames per camera, evenly spread over the duration.
        duration_s: Length of the recording.
        image_scale: Size of the images as a share of 1280 x 1024, lens and all.
        motion: 'free': rich, as it should be. 'single_axis' and 'translation': too poor to find everything, to see
            what gtcal says then.
        pixel_noise_px: 1-sigma of simulated corners, each coordinate. Like the next three it does not matter to
            images: there the detector makes its own errors.
        missed_share: Share of readable tags that the simulated detector misses.
        wrong_tag_share: Share of tags that it takes for another.
        wrong_corner_share: Share of corners that it puts 5 to 50 px aside.
        mocap_rate_hz: Sampling rate of the mocap; its samples do not coincide with frames.
        mocap_noise_mm: 1-sigma of a tracked body's position, each coordinate.
        mocap_noise_deg: 1-sigma of a tracked body's orientation, about each axis.
        mocap_correlation_s: Time over which the mocap's noise forgets itself; 0 for white noise.
        mocap_jitter_ms: 1-sigma of the mocap's time stamps.
        mocap_gap_share: Share of the mocap's samples lost in gaps of 0.25 s.
        swap_share: Share of the frames in which the mocap gives a grossly wrong pose (a marker swap).
        clock_offset_ms: The cameras' stamps run ahead of the mocap's clock by this.
        mocap_format: What the mocap's file is: CSVs as EuRoC's, texts as TUM's, one CSV as Motive's or as Vicon Nexus',
            or a ROS 2 bag; the manifest says how to read it.
        intrinsics: What the recording says about the lenses: the truth, wrong values, or nothing.
        lollypop: Simulate a recording of the Lollypop instead, to verify with: of the rig, and the rigid bodies on it,
            that the same rig, capture and seed give without this. Frames, duration, image scale, pixel noise and
            mocap count as above, but for 'frames': all frames at 30 Hz.
        take: Another number, another recording of the same rig.
        fault: What happened to the rig before this recording, with --lollypop or a take other than the first: the
            markers on it were bumped, a camera was moved, or a lens warmed up.
        fault_camera: The camera of that fault; by default the first.
        fault_mm: How far the markers or the camera moved, along a direction that the seed chooses.
        fault_deg: How far they turned.
        fault_percent: By how much the lens's focal length grew.
        quiet: Show no progress and print nothing.
    """
    from gtcal.board import load_board
    from gtcal.cli.progress import shown_progress
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, is_there
    from gtcal.recordings.capture import Capture
    from gtcal.simulation import (
        CornerNoise,
        MocapNoise,
        SimulationOptions,
        fixed_cameras_rig,
        quest3_like_rig,
        write_simulation,
    )
    from gtcal.simulation import simulate as run
    from gtcal.simulation.simulate import simulate_take

    cameras = quest3_like_rig() if rig == "headset" else fixed_cameras_rig()
    usual = Capture.TRACKED_PLATFORM if rig == "headset" else Capture.FIXED_CAMERAS
    options = SimulationOptions(
        rig=cameras if image_scale == 1.0 else cameras.scaled(image_scale),
        board=load_board(board),
        capture=usual if capture is None else Capture(capture),
        motion=motion,
        duration_s=duration_s,
        n_frames=frames,
        corners=CornerNoise(pixel_noise_px, missed_share, wrong_tag_share, wrong_corner_share),
        mocap_rate_hz=mocap_rate_hz,
        mocap=MocapNoise(mocap_noise_mm, mocap_noise_deg, mocap_correlation_s, 1e-3 * mocap_jitter_ms, mocap_gap_share),
        swap_share=swap_share,
        clock_offset_s=1e-3 * clock_offset_ms,
        intrinsics=intrinsics,
    )
    check_outputs([output], [Path(board)] if is_there(Path(board)) else (), folders=True)
    if boards != 1:
        if boards < 1 or lollypop or take != 1 or fault != "none" or mocap_format != "euroc_csv":
            raise GtcalError(
                "--boards: two or more are simulated as the first take and with mocap CSVs: leave --lollypop, --take, "
                "--fault and --mocap-format out"
            )
        _simulate_boards(options, boards, output, images=images, seed=seed, quiet=quiet)
        return
    sizes = fault_mm, fault_deg, fault_percent
    if lollypop:
        happened = _fault(options, fault, fault_camera, *sizes, seed)
        _simulate_lollypop(
            options, happened, output, images=images, mocap_format=mocap_format, seed=seed, take=take, quiet=quiet
        )
        return
    if take == 1 and fault != "none":
        raise GtcalError("a fault is what happened since the first recording: ask for another with --take 2")
    simulation = (
        run(options, seed=seed)
        if take == 1
        else simulate_take(options, seed=seed, take=take, fault=_fault(options, fault, fault_camera, *sizes, seed))
    )
    with shown_progress(quiet) as progress:
        manifest = write_simulation(simulation, output, images=images, mocap_format=mocap_format, progress=progress)
    if not quiet:
        print(f"{manifest}: {frames} frames of {len(cameras.cameras)} cameras; the truth is in ground_truth.json")


def _simulate_boards(
    options: SimulationOptions, boards: int, output: Path, *, images: bool, seed: int, quiet: bool
) -> None:
    from gtcal.cli.progress import shown_progress
    from gtcal.several_boards.recording import write_boards
    from gtcal.simulation.several import boards_like, film_boards, simulate_boards, write_truth_of_boards
    from gtcal.simulation.writing import check_empty

    simulations = simulate_boards(options, boards_like(options.board, boards), seed=seed)
    check_empty(output)
    recordings = {name: one.recording for name, one in simulations.items()}
    if images:
        with shown_progress(quiet) as progress:
            recordings = film_boards(simulations, output / "images", progress)
    write_truth_of_boards(simulations, output)
    manifest = write_boards(recordings, output)
    if not quiet:
        print(f"{manifest}: {options.n_frames} frames of {boards} boards; the truth is in ground_truth.json")


def _simulate_lollypop(
    options: SimulationOptions,
    fault: RigFault,
    output: Path,
    *,
    images: bool,
    mocap_format: MocapFormatName,
    seed: int,
    take: int,
    quiet: bool,
) -> None:
    from gtcal.cli.progress import shown_progress
    from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation
    from gtcal.simulation.simulate import scene_of, seed_of_take

    of_device = LollypopOptions(
        rig=options.rig,
        fault=fault,
        capture=options.capture,
        calibrated_in=scene_of(options, seed=seed),
        duration_s=options.duration_s,
        corners=options.corners,
        mocap_rate_hz=options.mocap_rate_hz,
        mocap=options.mocap,
    )
    simulation = simulate_lollypop(of_device, seed=seed_of_take(seed, take))
    with shown_progress(quiet) as progress:
        manifest = write_lollypop_simulation(
            simulation, output, images=images, mocap_format=mocap_format, progress=progress
        )
    if not quiet:
        print(f"{manifest}: a recording of the Lollypop; try: gtcal verify calibration.json {output}")


def _fault(
    options: SimulationOptions, kind: str, camera: str | None, mm: float, deg: float, percent: float, seed: int
) -> RigFault:
    import numpy as np

    from gtcal.simulation.fault import RigFault, small_motion

    name = camera or options.rig.cameras[0].name
    directions = np.random.default_rng([seed, 77]).standard_normal((2, 3))
    shift, turn = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    moved = small_motion(mm * shift, deg * turn)
    if kind == "markers":
        return RigFault(markers=moved)
    if kind == "camera":
        return RigFault(cameras={name: moved})
    return RigFault(focal_shares={name: percent / 100}) if kind == "lens" else RigFault()
