"""The command line: help that is there at once, exit codes, what is printed and what is written."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from calibration_support import HEADSET, errors, near, simulated
from cli_support import all_in, files_in, run

from factors import ROBUST_KERNELS
from gtcal.cli import COMMANDS, _EndedError
from gtcal.cli.calibrate import KernelName
from gtcal.recordings.detection_files import read_detections
from gtcal.recordings.recording import load_recording
from gtcal.results.calibration_file import read_calibration
from gtcal.simulation import MocapNoise, write_simulation

HEAVY = (
    *("gtsam", "numba", "cv2", "numpy", "scipy", "pydantic", "reportlab", "matplotlib", "pandas", "pyarrow"),
    *("rich", "loky", "jinja2", "typeguard", "asyncio"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of detections on disk."""
    path = tmp_path_factory.mktemp("cli") / "recording"
    write_simulation(simulated(HEADSET), path, images=False)
    return path


def in_a_process_of_its_own(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


# Help


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)], ids=" ".join
)
def test_help_waits_for_no_heavy_import(arguments: list[str]) -> None:
    code = f"""
import sys
from gtcal.cli import main
try:
    main({arguments!r})
except SystemExit as exit:
    assert not exit.code
print("heavy:", [name for name in {HEAVY!r} if name in sys.modules])
"""
    *shown, last = in_a_process_of_its_own(code).splitlines()
    assert len(shown) >= 1
    assert last == "heavy: []"


def test_the_overview_names_every_command() -> None:
    ran = run("--help")
    assert ran.code == 0
    assert ran.err == ""
    assert all_in(ran.out, [f"\n  {name} " for name in COMMANDS])
    assert "exit codes" in ran.out


@pytest.mark.parametrize("command", list(COMMANDS))
def test_every_command_teaches_itself(command: str) -> None:
    ran = run(command, "--help")
    assert ran.code == 0
    assert ran.err == ""
    assert f"gtcal {command}" in ran.out
    assert len(ran.out.splitlines()) >= 8


def test_version_is_that_of_the_package() -> None:
    assert run("--version").out == f"gtcal {version('gtcal')}\n"


# Usage


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "usage: gtcal COMMAND"),
        (
            ["calibrat"],
            "'calibrat' is no command; did you mean 'calibrate'?; commands: demo, board, ",
        ),
        (["calibrate"], "RECORDING"),
        (["calibrate", "recording", "--kernel", "Foo"], "Foo"),
        (["calibrate", "recording", "--eps", "small"], "small"),
        (["calibrate", "recording", "--no-such-option"], "--no-such-option"),
        (["simulate"], "output"),
        (["simulate", "-o", "x", "--rig", "tripod"], "tripod"),
        (["detect"], "RECORDING"),
    ],
)
def test_wrong_usage_exits_with_2(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = run(*arguments)
    assert ran.code == 2
    assert said.lower() in (ran.out + ran.err).lower()
    assert files_in(tmp_path) == set()


def test_kernels_are_those_of_the_factors() -> None:
    assert set(get_args(KernelName)) == set(ROBUST_KERNELS)


# Running


def test_calibrate_writes_the_result_and_prints_a_table_to_judge_it_by(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "new" / "calibration.json"
    ran = run("calibrate", folder, "-o", output)
    assert ran.code == 0
    assert ran.err == ""  # no terminal: no progress bars in a log
    calibration = read_calibration(output)
    assert near(errors(calibration, simulated(HEADSET)), mm=0.5, deg=0.05)
    for name, camera in calibration.cameras.items():
        (residuals,) = [
            line for line in ran.out.splitlines() if name in line and f"{camera.residuals.rmse_px:.3f}" in line
        ]
        assert str(camera.residuals.n_corners) in residuals
        assert f"{1e3 * camera.camera_T_ref.position_of_a_in_b_m[0]:.2f}" in ran.out
    assert str(output) in ran.out
    assert max(len(line) for line in ran.out.splitlines() if str(output) not in line) <= 100
    assert files_in(tmp_path) == {"new/calibration.json"}


@pytest.mark.long
def test_quiet_prints_nothing_and_verbose_prints_the_stages(folder: Path, tmp_path: Path) -> None:
    quiet = run("calibrate", folder, "-o", tmp_path / "c.json", "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    verbose = run("calibrate", folder, "-o", tmp_path / "c.json", "-v")
    assert all_in(verbose.out, ["PnP", "Procrustes sweep", "3-D alignment", "pixels"])


def test_options_reach_the_solver_and_are_kept(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "c.json"
    solving = "--kernel Huber --kernel-parameter 2.5 --stages 1 3 --eps 1e-5 --seed 7 --no-screen --sigma-px 0.2"
    others = "--pnp-views 40 --refine-intrinsics --intrinsics-prior stated --mocap-noise exact"
    ran = run("calibrate", folder, "-o", output, "-q", *solving.split(), *others.split())
    assert (ran.code, ran.err) == (0, "")
    calibration = read_calibration(output)
    options = calibration.provenance.options
    assert options["robust"] == {"name": "Huber", "parameter": 2.5}
    assert options["stages"] == [1, 3]
    assert (options["eps"], options["seed"], options["screen"], options["pnp_views"]) == (1e-5, 7, False, 40)
    assert (options["intrinsics"], options["intrinsics_prior"]) == ("refine", "stated")
    assert (options["mocap"], calibration.sigma_px) == ("exact", 0.2)
    assert [stage.stage for stage in calibration.stages] == [0, 1, 3]
    assert all(camera.theta_covariance is not None for camera in calibration.cameras.values())


@pytest.mark.long
def test_the_result_keeps_the_command_line_and_the_inputs(folder: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gtcal", "calibrate", str(folder), "-o", str(tmp_path / "c.json"), "-q"]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")
    provenance = read_calibration(tmp_path / "c.json").provenance
    assert provenance.command_line[1:] == ("calibrate", str(folder), "-o", str(tmp_path / "c.json"), "-q")
    names = {entry.path.name for entry in provenance.inputs}
    assert {"recording.yaml", "platform.csv", "board_body.csv", "side_left_detections.csv"} <= names
    assert all(len(entry.sha256) == 64 for entry in provenance.inputs)


@pytest.mark.long
def test_intrinsics_are_found_where_they_are_asked_for(tmp_path: Path) -> None:
    simulation = simulated(HEADSET, intrinsics="none")
    write_simulation(simulation, tmp_path / "recording", images=False)
    without = run("calibrate", tmp_path / "recording", "-o", tmp_path / "c.json", "-q", "--intrinsics", "exact")
    assert without.code == 1
    assert "--calibrate-intrinsics" in without.err
    for asked in ((), ("--calibrate-intrinsics",)):
        ran = run("calibrate", tmp_path / "recording", "-o", tmp_path / "c.json", "-q", *asked)
        assert (ran.code, ran.err) == (0, "")
        assert near(errors(read_calibration(tmp_path / "c.json"), simulation), mm=1.0, deg=0.1)


def test_a_degenerate_motion_is_refused_and_allowed_with_a_warning(tmp_path: Path) -> None:
    write_simulation(simulated(HEADSET, motion="single_axis"), tmp_path / "recording", images=False)
    refused = run("calibrate", tmp_path / "recording", "-o", tmp_path / "c.json")
    assert refused.code == 1
    assert "single axis" in refused.err
    assert not (tmp_path / "c.json").exists()
    allowed = run("calibrate", tmp_path / "recording", "-o", tmp_path / "c.json", "--allow-degenerate")
    assert allowed.code == 0
    assert "single axis" in allowed.out.replace("\n", " ")
    assert any("single axis" in warning for warning in read_calibration(tmp_path / "c.json").warnings)


def test_known_mocap_noise_adds_a_stage(tmp_path: Path) -> None:
    simulation = simulated(HEADSET, mocap=MocapNoise(translation_mm=0.2, rotation_deg=0.02))
    write_simulation(simulation, tmp_path / "recording", images=False)
    sigmas = ["--mocap-sigma-mm", "0.2", "--mocap-sigma-deg", "0.02"]
    assert run("calibrate", tmp_path / "recording", "-o", tmp_path / "c.json", "-q", *sigmas).code == 0
    assert [stage.stage for stage in read_calibration(tmp_path / "c.json").stages] == [0, 1, 2, 3, 4]
    half = run("calibrate", tmp_path / "recording", "-o", tmp_path / "d.json", *sigmas[:2])
    assert half.code == 1
    assert "--mocap-sigma-deg go together" in half.err
    assert not (tmp_path / "d.json").exists()


def test_simulate_is_reproducible_and_refuses_a_folder_in_use(tmp_path: Path) -> None:
    for name in ("a", "b"):
        ran = run("simulate", "-o", tmp_path / name, "--frames", 20, "--duration-s", 20, "--seed", 3, "-q")
        assert (ran.code, ran.out, ran.err) == (0, "", "")
    assert files_in(tmp_path / "a") == files_in(tmp_path / "b")
    for name in files_in(tmp_path / "a"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    again = run("simulate", "-o", tmp_path / "a", "--frames", 20)
    assert again.code == 1
    assert "holds something already" in again.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--frames", 0], "n_frames is 0"),
        (["--mocap-noise-mm", -1], "mocap.translation_mm is -1"),
        (["--wrong-tag-share", 2], "corners.wrong_tag_share is 2"),
        (["--board", "no_such_board"], "'no_such_board' is no preset"),
        (["--seed", -3], "seed is -3"),
    ],
)
def test_simulate_refuses_what_makes_no_sense(arguments: list[object], said: str, tmp_path: Path) -> None:
    ran = run("simulate", "-o", tmp_path / "recording", *arguments)
    assert ran.code == 1
    assert ran.err.startswith("gtcal: ")
    assert ran.err.count("\n") == 1
    assert said in ran.err
    assert files_in(tmp_path) == set()


def completed(shell: str, *words: str) -> list[str]:
    """What the script offers for the last of these words."""
    script = run("completion", shell)
    assert (script.code, script.err) == (0, "")
    here = script.out.splitlines()
    start = next(number for number, line in enumerate(here) if "<< 'PYTHON_EOF'" in line)
    code = "\n".join(here[start + 1 : here.index("PYTHON_EOF")])
    arguments = [sys.executable, "-c", code, *words, str(len(words) - 1)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    return [line.partition("\t")[0] for line in done.stdout.splitlines()]


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_completes_commands_options_choices_and_files(shell: str) -> None:
    assert set(COMMANDS) <= set(completed(shell, "gtcal", ""))
    assert completed(shell, "gtcal", "dri") == ["drift"]
    assert completed(shell, "gtcal", "calibrate", "--mocap-n") == ["--mocap-noise"]
    assert completed(shell, "gtcal", "export", "cal.json", "--to", "ka") == ["kalibr"]
    assert completed(shell, "gtcal", "calibrate", "some") == ["__TYRO_COMPLETE_FILES__"]


def test_bash_and_fish_are_told_what_to_call() -> None:
    shown = run("completion", "fish").out
    assert "complete --no-files --command 'gtcal'" in shown
    assert all(f"'{name}'" in shown for name in COMMANDS)
    if bash := shutil.which("bash"):
        ask = "COMP_WORDS=(gtcal exp); COMP_CWORD=1; _tyro_gtcal; echo ${COMPREPLY[@]}; complete -p gtcal"
        done = subprocess.run([bash, "-c", run("completion", "bash").out + ask], capture_output=True, text=True)
        assert done.stdout.splitlines() == ["export", "complete -F _tyro_gtcal gtcal"]


def test_every_intrinsic_that_was_found_is_shown_with_its_sigma(folder: Path, tmp_path: Path) -> None:
    assert run("calibrate", folder, "-o", tmp_path / "c.json", "--no-effects", "-q").code == 0
    shown = run("info", tmp_path / "c.json").out
    for camera in read_calibration(tmp_path / "c.json").cameras.values():
        sigmas = np.sqrt(np.diag(camera.theta_covariance))
        for value, sigma in zip(camera.camera.theta[4:], sigmas[4:], strict=True):
            digits = int(1 - np.floor(np.log10(sigma)))
            assert f"{value:.{digits}f} ± {sigma:.{digits}f}" in shown


def test_what_the_machine_refuses_is_a_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("gtcal.recordings.recording.load_recording", refuse)
    ran = run("calibrate", folder)
    assert (ran.code, ran.err) == (1, f"gtcal: {folder}: Permission denied\n")


def test_schema_is_json_on_the_screen_and_in_a_file(tmp_path: Path) -> None:
    shown = run("schema")
    assert shown.code == 0
    schema = json.loads(shown.out)
    assert {"cameras", "board", "capture"} <= set(schema["properties"])
    assert run("schema", "-o", tmp_path / "schema.json").out == ""
    assert json.loads((tmp_path / "schema.json").read_text()) == schema


def test_corners_are_written_as_parquet_which_a_manifest_takes(folder: Path, tmp_path: Path) -> None:
    ran = run("detect", folder, "-o", tmp_path / "corners", "--format", "parquet", "-q")
    assert (ran.code, ran.out, ran.err) == (0, "", "")
    shutil.copytree(folder, tmp_path / "recording")
    shutil.copytree(tmp_path / "corners", tmp_path / "recording", dirs_exist_ok=True)
    manifest = tmp_path / "recording" / "recording.yaml"
    manifest.write_text(manifest.read_text().replace("_detections.csv", ".parquet"))
    before, after = load_recording(folder).detections, load_recording(tmp_path / "recording").detections
    assert before
    for name, corners in before.items():
        np.testing.assert_array_equal(after[name].corners_px, corners.corners_px)
    assert {f"{name}.parquet" for name in before} == files_in(tmp_path / "corners")


@pytest.mark.long
def test_demo_shows_all_of_it_and_how_far_from_the_truth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendered images, detected, calibrated and verified; then the recording is one like any other. The report, whose
    many figures take most of the time, has tests of its own."""
    reported = {}

    def write_report(path: Path, calibration: object, **given: object) -> None:
        reported.update(given, path=path)

    monkeypatch.setattr("gtcal.report.write_report", write_report)
    ran = run("demo", "-o", tmp_path / "demo", "--frames", 12, "--image-scale", 0.3)
    assert (ran.code, ran.err) == (0, "")
    assert "difference from the truth" in ran.out
    assert reported["path"] == tmp_path / "demo" / "report.html"
    assert reported["evidence"] is not None
    assert reported["verification"] is not None
    results = {"calibration.json", "verification.json"}
    assert results | {"recording/recording.yaml", "recording/ground_truth.json"} <= files_in(tmp_path / "demo")
    calibration = read_calibration(tmp_path / "demo" / "calibration.json")
    assert all(camera.residuals.rmse_px < 0.15 for camera in calibration.cameras.values())

    detected = run("detect", tmp_path / "demo" / "recording", "-o", tmp_path / "corners")
    assert detected.code == 0
    recording = load_recording(tmp_path / "demo" / "recording")
    for name, camera in recording.cameras.items():
        corners = read_detections(tmp_path / "corners" / f"{name}.csv", recording.board, camera)
        assert name in detected.out
        assert str(corners.n_corners) in detected.out
    again = run("calibrate", tmp_path / "demo" / "recording", "-o", tmp_path / "again.json", "-q")
    assert (again.code, again.err) == (0, "")
    found = read_calibration(tmp_path / "again.json")
    difference = found.body_T_board.a_T_b[:3, 3] - calibration.body_T_board.a_T_b[:3, 3]
    assert np.linalg.norm(difference) < 1e-3


def test_demo_leaves_a_folder_alone_that_is_not_its_own(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    ran = run("demo", "-o", tmp_path / "mine")
    assert ran.code == 1
    assert "is there already, and not from an earlier demo" in ran.err
    assert (tmp_path / "mine" / "notes.txt").read_text() == "keep"


# What goes wrong inside


def breaking(error: BaseException) -> Callable[..., None]:
    def load_recording(path: Path) -> None:
        raise error

    return load_recording


def test_a_bug_ends_in_a_traceback_and_1(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("gtcal.recordings.recording.load_recording", breaking(ZeroDivisionError("oh")))
    assert run("calibrate", folder).code == 1
    assert "this is a bug in gtcal" in caplog.text
    assert "ZeroDivisionError: oh" in caplog.text


def test_a_full_disk_is_no_bug(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr("gtcal.recordings.recording.load_recording", breaking(full))
    assert run("calibrate", folder).err == "gtcal: No space left on device\n"


@pytest.mark.parametrize(("by", "code"), [(_EndedError(), 143), (KeyboardInterrupt(), 130)])
def test_an_end_within_an_import_is_one_too(
    by: BaseException, code: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python 3.11 hands on what comes up while a class is made as a RuntimeError."""
    wrapped = RuntimeError("Error calling __set_name__")
    wrapped.__cause__ = by
    monkeypatch.setattr("gtcal.recordings.recording.load_recording", breaking(wrapped))
    ran = run("calibrate", folder)
    assert ran.code == code
    assert ran.err.count("\n") == 1


def test_an_interrupt_ends_quietly_with_130(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gtcal.recordings.recording.load_recording", breaking(KeyboardInterrupt()))
    ran = run("calibrate", folder)
    assert (ran.code, ran.out, ran.err) == (130, "", "gtcal: interrupted\n")


def test_a_failure_while_writing_leaves_nothing_behind(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    ran = run("calibrate", folder, "-o", tmp_path / "c.json", "-q")
    assert ran.code == 1
    assert ran.err == f"gtcal: {tmp_path / 'c.json'}: can't be written: No space left on device\n"
    assert files_in(tmp_path) == set()


def test_an_output_that_can_not_be_written_is_named(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    ran = run("calibrate", folder, "-o", tmp_path / "file" / "c.json")
    assert ran.code == 1
    assert ran.err.startswith(f"gtcal: {tmp_path / 'file' / 'c.json'}: can't be written")
    assert ran.err.count("\n") == 1


@pytest.mark.long
def test_a_scheduler_ends_it_with_a_line_and_143(folder: Path, tmp_path: Path) -> None:
    """While it writes: nothing half-written stays."""
    code = """
import os, signal, sys
from gtcal.files import write_text
def written(path, text):
    from gtcal.files import write_aside
    with write_aside(path) as file:
        file.write(text[:100])
        os.kill(os.getpid(), signal.SIGTERM)
        for _ in range(10**9): pass
import gtcal.results.calibration_file as results
results.write_text = written
from gtcal.cli import main
sys.exit(main(sys.argv[1:]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, "calibrate", str(folder), "-o", str(tmp_path / "c.json"), "-q", "--no-effects"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 143
    assert done.stderr == "gtcal: ended by a signal (SIGTERM)\n"
    assert done.stdout == ""
    assert files_in(tmp_path) == set()
    assert not list(tmp_path.iterdir())
