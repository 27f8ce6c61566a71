"""gtcal calibrate: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from collections.abc import Mapping

    from factors import RobustKernel
    from gtcal.differences.carried_over import EarlierCalibration, Part
    from gtcal.estimation.options import CalibrationOptions, IntrinsicsMode, MocapSigmas
    from gtcal.pose_recordings.calibration import PoseCalibration
    from gtcal.progress import Progress
    from gtcal.recordings.recording import Recording
    from gtcal.results.calibration import Calibration

KernelName = Literal[
    "Null",
    "Fair",
    "Huber",
    "Cauchy",
    "Tukey",
    "Welsch",
    "GemanMcClure",
    "DCS",
    "L2WithDeadZone",
    "TruncatedLeastSquares",
    "AsymmetricCauchy",
    "AsymmetricTukey",
]


def calibrate(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RECORDING")],
    more: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="[RECORDING ...]")] = (),
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("calibration.json"),
    report: Path | None = None,
    intrinsics: Literal["exact", "fixed", "auto", "refine", "calibrate", "calibrate+refine"] = "auto",
    calibrate_intrinsics: bool = False,
    refine_intrinsics: bool = False,
    intrinsics_prior: Literal["weak", "stated"] = "weak",
    focal_sigma_px: float | None = None,
    centre_sigma_px: float | None = None,
    distortion_sigma: float | None = None,
    board: Literal["auto", "exact"] = "auto",
    kernel: KernelName = "Null",
    kernel_parameter: float | None = None,
    graduated: bool = False,
    priors: Path | None = None,
    from_: Annotated[Path | None, tyro.conf.arg(name="from", metavar="CALIBRATION")] = None,
    from_parts: tuple[Literal["lenses", "board", "rig"], ...] = ("lenses", "board", "rig"),
    from_days: float | None = None,
    from_growth: tuple[float, float, float] = (0.1, 0.01, 0.1),
    sigma_px: float | None = None,
    mocap_noise: Literal["estimate", "exact"] = "estimate",
    mocap_sigma_mm: float | None = None,
    mocap_sigma_deg: float | None = None,
    clock: Literal["test", "estimate", "per_camera", "trust"] = "test",
    clock_drift: bool = False,
    effects: bool = True,
    segments: Literal["none", "auto"] = "none",
    stages: tuple[int, ...] = (1, 2, 3),
    sweep: Literal["converged", "paper"] = "converged",
    eps: float = 1e-4,
    max_iterations: int = 100,
    screen: bool = True,
    pnp_views: int = 100,
    every: int = 1,
    views: int | None = None,
    seed: int = 0,
    allow_degenerate: bool = False,
    json: bool = False,
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Find every camera's extrinsic camera_T_ref and the board-to-body transform from a recording.

    Writes calibration.json (poses, covariances, residuals, how it was made) and prints a table to judge it by. Cameras
    that come as images are detected first; that is kept and reused.

    Good data: 60 or more views per camera, the board turned about two axes or more by 30 deg and more, over the whole
    image, near and far. Judge by the RMSE (a good lens model and mocap give 0.1 to 0.5 px) and by 'left out'.

    Args:
        recording: Folder with the manifest (recording.yaml or recording.json), or the manifest itself.
        more: Later recordings of the same rig, in the order in which they were taken: all that does not move between
            them is shared, and what moves is named; the result is the rig as it is in the last.
        output: File to write.
        report: HTML file to write with figures of the result (as 'gtcal report' does).
        intrinsics: 'auto': solved for jointly with the extrinsics, near the manifest's values, by their sigmas (stated
            as parameter_sigmas, else 0.3 % of the focal length and 3 px, what real factory values are off by); found
            first where the manifest states none. 'fixed': held at the manifest's values, whose sigmas count in the
            covariance. 'exact': held and taken for known exactly, as in the paper. 'refine': solved for jointly under
            --intrinsics-prior. 'calibrate': found first, by a plain calibration from the views, then solved for
            jointly near what was found; 'calibrate+refine': found first, then as 'refine'. The manifest's values are
            not used by these two.
        calibrate_intrinsics: Short for --intrinsics calibrate; with the next, for 'calibrate+refine'.
        refine_intrinsics: Short for --intrinsics refine.
        intrinsics_prior: Where they are refined. 'weak': the paper's prior (principal point to the image centre,
            distortion to zero, focal length free). 'stated': near the manifest's values, as for 'auto'.
        focal_sigma_px: 1-sigma of fx and fy of all cameras, in place of the manifest's or a factory's.
        centre_sigma_px: 1-sigma of cx and cy, likewise.
        distortion_sigma: 1-sigma of every distortion coefficient, likewise.
        board: 'auto': where intrinsics stay near what is known of them, the board's scale, stretch, bow and twist are
            solved for too, near a flat board as stated, by the manifest's board.scale_sigma (a share) and
            board.flatness_mm, else 0.1 % and a thousandth of its side, as of a board that was printed and glued.
            'exact': flat and as stated.
        kernel: Robust kernel of stage 3, by its name in gtsam.noiseModel.mEstimator, on each corner's whitened norm.
        kernel_parameter: Its parameter in sigmas; by default the kernel's usual one.
        graduated: Begin stage 3 with a kernel so wide that nothing is an outlier and narrow it step by step
            (graduated non-convexity), for many outliers; with --kernel GemanMcClure or TruncatedLeastSquares, and
            --no-screen where screening by medians would fail.
        priors: YAML file of what is known beforehand, with sigmas: of the board in its body, of cameras in the rig
            or in each other's frames, of intrinsics (see 'gtcal guide calibrate').
        from_: calibration.json of an earlier calibration of the same rig. What has not moved since (each camera on the
            rig, each lens, the board on its body) is known from it, as surely as it says, less by the day; what has
            moved is named and found anew. For recordings too short to tell all by themselves, and to be surer with
            others.
        from_parts: What to take of it.
        from_days: Days between the two; by default from when the earlier calibration was made until now.
        from_growth: By how much less is known after a day, 1-sigma, growing with the root of the days: mm and deg of
            each camera and the board, and a share of what a factory's intrinsics are off by.
        sigma_px: Standard deviation of a corner's coordinate; by default estimated from the residuals.
        mocap_noise: 'estimate': stage 4 estimates the mocap's noise from the recording and models it, for a more
            accurate estimate and a covariance that is true; stage 3's is taken where it predicts held-out frames
            better.
            'exact': the mocap's poses are taken as exact, as in the paper.
        mocap_sigma_mm: 1-sigma of a tracked body's position along each axis, if you know it (0.05 to 0.3 is common);
            stage 4 then takes it and the next one instead of estimating them.
        mocap_sigma_deg: 1-sigma of a tracked body's orientation about each axis (0.005 to 0.05 is common).
        clock: 'test': take the cameras' stamps as synchronised with the mocap's, and warn if the data want an offset.
            'estimate': find one offset between all cameras and the mocap, up to half a second, and correct it;
            'per_camera': one for each. 'trust': do not even test.
        clock_drift: With --clock estimate: let the offset grow linearly in time.
        effects: Look for what else the data want (markers or a camera that moved, a clock, a lens or a scale that is
            off), and how far each camera would move if that were let in.
        segments: 'auto': where markers or a camera moved during the recording, calibrate each stretch between on its
            own, all that did not move shared.
        stages: Stages to run, of 1 (Procrustes sweep), 2 (3-D alignment), 3 (pixels).
        sweep: Of stage 1. 'converged': from each start on to the minimum below, and by consensus of the views where no
            chain comes close to most of them; 'paper': the sweep of closed-form updates alone, as in the paper.
        eps: A minimisation stops where an iteration improves the error E by less than eps (1 + E).
        max_iterations: Most iterations of one minimisation.
        screen: Leave out views and corners that grossly contradict the others.
        pnp_views: At most this many views per camera guide stages 1 and 2; stage 3 takes all.
        every: Use every Nth image (or view, where corners are given), the same moments of cameras that are triggered
            together: for long recordings, whose images take most of the time.
        views: Use at most this many images of each camera, evenly spread over the recording. What all would gain is
            told.
        seed: Of the random starting rotations of stage 1.
        allow_degenerate: Solve even where the motion cannot determine the result.
        json: Print the result as JSON in place of tables, as calibration.json holds it ('gtcal schema calibration').
        verbose: Print the distortion with its sigmas, the stages, and what was left out and why.
        quiet: Show no progress and print nothing.
    """
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.tables import print_calibration
    from gtcal.estimation.options import CalibrationOptions
    from gtcal.estimation.priors import Priors
    from gtcal.estimation.priors_file import read_priors
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.recording import holds_poses
    from gtcal.recordings.recording import load_recording
    from gtcal.recordings.some_images import some_of
    from gtcal.results.calibration_file import calibration_document, write_calibration
    from gtcal.several_boards.recording import holds_boards
    from gtcal.workflow import calibrate_jointly

    options = CalibrationOptions(
        intrinsics=intrinsics_mode(intrinsics, calibrate=calibrate_intrinsics, refine=refine_intrinsics),
        intrinsics_prior=intrinsics_prior,
        focal_sigma_px=focal_sigma_px,
        centre_sigma_px=centre_sigma_px,
        distortion_sigma=distortion_sigma,
        board=board,
        robust=_kernel(kernel, kernel_parameter),
        graduated=graduated,
        priors=read_priors(priors) if priors is not None else Priors(),
        sigma_px=sigma_px,
        mocap=_mocap(mocap_sigma_mm, mocap_sigma_deg) or mocap_noise,
        clock=clock,
        clock_drift=clock_drift,
        effects=effects,
        segments=segments,
        stages=stages,
        sweep=sweep,
        eps=eps,
        max_iterations=max_iterations,
        screen=screen,
        pnp_views=pnp_views,
        seed=seed,
        allow_degenerate=allow_degenerate,
    )
    part = {"every": None if every == 1 else every, "views": views}
    asked = {"priors": priors, "from": from_, "more than one recording": more or None, **part}
    if holds_poses(recording):
        _calibrate_poses(recording, options, output, report, asked, json=json, verbose=verbose, quiet=quiet)
        return
    if holds_boards(recording):
        _calibrate_boards(recording, options, output, report, asked, json=json, verbose=verbose, quiet=quiet)
        return
    whole = [load_recording(path) for path in (recording, *more)]
    loaded = [some_of(one, every=every, views=views) for one in whole]
    earlier = None if from_ is None else _earlier(from_, from_parts, from_days, from_growth)
    read = [file for one in loaded for file in one.files] + [path for path in (priors, from_) if path is not None]
    check_outputs((output, report), read)
    with shown_progress(quiet) as progress:
        calibration = calibrate_jointly(loaded, options, earlier=earlier, progress=progress)
        if report is not None:
            _write_report(report, calibration, loaded[-1], progress)
    write_calibration(output, calibration)
    if json:
        print_json(calibration_document(calibration))
    elif not quiet:
        notes = [*(note for one in loaded for note in one.notes), *_part_used(whole, loaded, calibration)]
        print_calibration(calibration, notes=notes, verbose=verbose)
        print(f"written: {output}" + (f", {report}" if report is not None else ""))


def _part_used(whole: list[Recording], used: list[Recording], calibration: Calibration) -> list[str]:
    """What is to be said where a part of the images was used."""
    n_all, n_used = (sum(one.n_images for one in recordings) for recordings in (whole, used))
    if n_used == n_all:
        return []
    sigmas_mm = [camera.camera_T_ref.position_of_a_in_b_sigma_mm for camera in calibration.cameras.values()]
    largest_mm = max((float(of_camera.max()) for of_camera in sigmas_mm if of_camera is not None), default=float("nan"))
    of_all_mm = largest_mm * (n_used / n_all) ** 0.5
    return [
        f"used {n_used:,} of {n_all:,} images; all would lower the largest 1-sigma of a camera's place from "
        f"{largest_mm:.2g} to about {of_all_mm:.2g} mm"
    ]


def _calibrate_poses(
    recording: Path,
    options: CalibrationOptions,
    output: Path,
    report: Path | None,
    asked: Mapping[str, object],
    *,
    json: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    """Of a recording of poses in place of corners. asked: options given as None where they are not.

    Raises GtcalError for what needs corners."""
    from dataclasses import fields

    from gtcal.cli.json_output import print_json
    from gtcal.cli.pose_tables import print_pose_calibration
    from gtcal.cli.progress import shown_progress
    from gtcal.errors import GtcalError
    from gtcal.estimation.options import CalibrationOptions
    from gtcal.files import check_outputs
    from gtcal.pose_recordings.calibration import OF_POSES, calibrate_pose_recording
    from gtcal.pose_recordings.calibration_file import pose_calibration_document, write_pose_calibration
    from gtcal.pose_recordings.recording import load_pose_recording

    plain, count = CalibrationOptions(), {*OF_POSES, "priors"}
    given = [name for name, value in asked.items() if value is not None]
    given += [
        f.name for f in fields(options) if f.name not in count and getattr(options, f.name) != getattr(plain, f.name)
    ]
    if given:
        raise GtcalError(
            f"{recording}: has poses in place of corners, which have no use for {', '.join(given)}: leave it out"
        )
    loaded = load_pose_recording(recording)
    check_outputs((output, report), loaded.files)
    with shown_progress(quiet) as progress:
        found = calibrate_pose_recording(loaded, options, progress=progress)
    write_pose_calibration(output, found)
    if report is not None:
        _write_pose_report(report, found)
    if json:
        print_json(pose_calibration_document(found))
    elif not quiet:
        print_pose_calibration(found, notes=loaded.notes, verbose=verbose)
        print(f"written: {output}" + (f", {report}" if report is not None else ""))


def _calibrate_boards(
    recording: Path,
    options: CalibrationOptions,
    output: Path,
    report: Path | None,
    asked: Mapping[str, object],
    *,
    json: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    """Of a recording of several boards. asked: options that it has no use for, None where they are not given."""
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.cli.tables import print_calibration
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs
    from gtcal.results.calibration_file import calibration_document, write_calibration
    from gtcal.several_boards.calibration import calibrate_boards
    from gtcal.several_boards.recording import load_boards

    given = [name for name, value in asked.items() if value is not None]
    if given:
        raise GtcalError(f"{recording}: is of several boards, which can't be calibrated with {', '.join(given)}")
    loaded = load_boards(recording)
    check_outputs((output, report), {file for one in loaded.values() for file in one.files})
    with shown_progress(quiet) as progress:
        found = calibrate_boards(loaded, options, progress=progress)
        if report is not None:
            _write_report(report, found, next(iter(loaded.values())), progress)
    write_calibration(output, found)
    if json:
        print_json(calibration_document(found))
    elif not quiet:
        print_calibration(found, notes=[note for one in loaded.values() for note in one.notes], verbose=verbose)
        print(f"written: {output}" + (f", {report}" if report is not None else ""))


def _write_pose_report(path: Path, found: PoseCalibration) -> None:
    from gtcal.pose_recordings.report import write_pose_report

    write_pose_report(path, found)


def _earlier(
    path: Path, parts: tuple[Part, ...], days: float | None, growth: tuple[float, float, float]
) -> EarlierCalibration:
    import datetime

    from gtcal.differences.carried_over import EarlierCalibration
    from gtcal.errors import GtcalError
    from gtcal.estimation.earlier import Growth
    from gtcal.files import fingerprint
    from gtcal.results.calibration_file import read_calibration

    found = read_calibration(path)
    if found.covariance is None:
        raise GtcalError(f"{path}: has no covariance, so there is nothing to go on from; calibrate with all the stages")
    if days is None:
        try:
            made = datetime.datetime.fromisoformat(found.provenance.created_utc).astimezone(datetime.UTC)
        except ValueError:
            raise GtcalError(
                f"{path}: provenance.created_utc: {found.provenance.created_utc!r} is no time, so nobody can tell how "
                "old it is; say it with --from-days"
            ) from None
        days = max((datetime.datetime.now(datetime.UTC) - made).total_seconds() / 86400.0, 0.0)
    mm, deg, lens = growth
    return EarlierCalibration(found, Growth(mm, deg, lens, days), parts, inputs=(fingerprint(path),))


def intrinsics_mode(stated: IntrinsicsMode, *, calibrate: bool, refine: bool) -> IntrinsicsMode:
    """What --intrinsics and its two short forms mean together.

    Raises GtcalError where they contradict each other."""
    from gtcal.errors import GtcalError

    asked: dict[tuple[bool, bool], IntrinsicsMode] = {
        (True, False): "calibrate",
        (False, True): "refine",
        (True, True): "calibrate+refine",
    }
    short = asked.get((calibrate, refine), stated)
    if stated not in ("auto", short):
        raise GtcalError(f"--intrinsics {stated} and the short forms for {short} contradict each other: give one")
    return short


def _mocap(sigma_mm: float | None, sigma_deg: float | None) -> MocapSigmas | None:
    from gtcal.errors import GtcalError
    from gtcal.estimation.options import MocapSigmas

    if sigma_mm is None and sigma_deg is None:
        return None
    if sigma_mm is None or sigma_deg is None:
        raise GtcalError("--mocap-sigma-mm and --mocap-sigma-deg go together: give both, or neither")
    return MocapSigmas(sigma_mm, sigma_deg)


def _write_report(path: Path, calibration: Calibration, recording: Recording, progress: Progress) -> None:
    from gtcal.report import gather_evidence, write_report

    write_report(path, calibration, evidence=gather_evidence(calibration, recording, progress=progress))


def _kernel(name: str, parameter: float | None) -> RobustKernel:
    from factors import RobustKernel
    from gtcal.errors import GtcalError

    if parameter is None:
        return RobustKernel.named(name)
    try:
        return RobustKernel(name, parameter)
    except ValueError as error:
        raise GtcalError(str(error)) from error
