"""gtcal convert: from any format to any other, with one line for what can't be."""

from __future__ import annotations

import hashlib
import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from camera_files_support import (
    ARIA_FACTORY,
    CAMERA_INFO_MESSAGE,
    KALIBR,
    POSE2SIM,
    file_of,
    points_in,
    rig_of,
    written,
)
from cli_support import files_in, run
from support import wandering_trajectory

from gtcal.camera_files.formats import CAMERA_FILE_WRITERS, read_rig
from gtcal.readers import TRAJECTORY_READERS, TRAJECTORY_WRITERS, PoseConventions, write_euroc_csv, write_tum


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    (tmp_path / "chain.yaml").write_text(KALIBR)
    return tmp_path / "chain.yaml"


def refused(*arguments: object, folder: Path) -> str:
    """The line that an operator sees; nothing is written."""
    before = files_in(folder)
    ran = run("convert", *arguments)
    assert (ran.code, ran.out) == (1, ""), ran.err
    assert ran.err.startswith("gtcal: ")
    assert ran.err.count("\n") == 1, ran.err
    assert files_in(folder) == before
    return ran.err


@pytest.mark.parametrize("to", CAMERA_FILE_WRITERS)
def test_one_camera_goes_through_every_format_and_back(to: str, tmp_path: Path) -> None:
    rig = rig_of("fisheye")  # the one lens that all of them hold
    source = written(tmp_path, "numpy", rig)
    there, back = file_of(tmp_path / "there", to), tmp_path / "back.npz"
    ran = run("convert", source, "--to", to, "-o", there)
    assert ran.code == 0, ran.err
    assert f"read {source} as numpy: fisheye; in the frame of the platform\nwrote {there} as {to}\n" == ran.out
    ran = run("convert", there, "--to", "numpy", "-o", back)
    assert ran.code == 0, ran.err
    assert f"read {there} as {to}: fisheye; in the frame of " in ran.out
    (camera,), (before,) = read_rig(back, None).rig.cameras, rig.cameras
    np.testing.assert_allclose(camera.camera_T_ref, before.camera_T_ref, atol=1e-12)
    points = points_in(before.camera)
    np.testing.assert_allclose(camera.camera.project(points)[0], before.camera.project(points)[0], atol=1e-9)


def test_a_file_says_how_it_was_made_and_in_what_frames(chain: Path) -> None:
    out = chain.with_name("chain.toml")
    assert run("convert", chain, "--to", "pose2sim", "-o", out).code == 0
    text = out.read_text()
    sha256 = hashlib.sha256(chain.read_bytes()).hexdigest()
    assert f"made by gtcal convert, version {version('gtcal')} from chain.yaml, SHA-256 {sha256}" in text
    assert "ref is the IMU; camera_T_ref takes coordinates in ref to coordinates in the camera" in text


def test_one_camera_out_of_several(chain: Path) -> None:
    out = chain.with_name("info")
    assert run("convert", chain, "--to", "ros", "-o", out, "--name", "cam1").code == 0
    assert files_in(out) == {"cam1.yaml", "static_transforms.launch.xml"}
    assert "there is no camera 'cam2'; cameras: cam0, cam1" in refused(
        chain, "--to", "ros", "-o", out, "--name", "cam2", folder=chain.parent
    )


def test_nearest_lenses_are_asked_for_in_reading_and_in_writing(tmp_path: Path) -> None:
    info = tmp_path / "info.yaml"
    thin_prism = "0.01, 0.02, 0.03, 0.01, 0.002, 0.0, -0.001, 0.0]\nk:"
    info.write_text(CAMERA_INFO_MESSAGE.replace("0.0, 0.0, 0.0, 0.0]\nk:", thin_prism))
    out = tmp_path / "out.json"
    assert "which gtcal has no model of; the nearest pinhole_rational is off by" in refused(
        info, "--to", "umetrack", "-o", out, folder=tmp_path
    )
    ran = run("convert", info, "--to", "umetrack", "-o", out, "--nearest")
    assert ran.code == 0, ran.err
    assert "px at most)" in ran.out  # in reading
    assert "camera 'info' as fisheye62: off by " in ran.out  # in writing
    assert 0 < json.loads(out.read_text())["cameras"][0]["Camera"]["lens_off_at_most_px"] < 5


@pytest.mark.parametrize(
    ("name", "content", "arguments", "message"),
    [
        ("x.toml", POSE2SIM, ["--to", "numpy"], "say which format it is: anipose"),
        (
            "x.toml",
            POSE2SIM,
            ["--to", "colmap", "--from", "anipose"],
            "needs every camera's pose, and there is none: anip",
        ),
        ("x.json", ARIA_FACTORY, ["--to", "numpy"], "give image_size_px"),
        (
            "x.yaml",
            KALIBR,
            ["--to", "tum"],
            "is a camera file (kalibr), which tum can't hold; give --to one of kalibr, ",
        ),
        ("x.yaml", KALIBR, ["--to", "calibr"], "'calibr' is no format to convert to; cameras: kalibr, "),
        ("x.yaml", KALIBR, ["--to", "tum", "--from", "x"], "'x' is no format to convert from; cameras: kalibr, "),
        ("x.yaml", KALIBR, ["--to", "aria"], "nearest fisheye624 with one focal length that it can is off by"),
        ("x.yaml", KALIBR, ["--to", "numpy", "--pose", "body_T_world"], "--pose says nothing about a camera file"),
        (
            "x.yaml",
            KALIBR,
            ["--to", "numpy", "--model", "fisheye62"],
            "'cam0' is a pinhole_radtan, but model says fish",
        ),
        (
            "x.yaml",
            KALIBR,
            ["--to", "numpy", "--image-size-px", "1", "2"],
            "752 x 480 px, but image_size_px says 1 x 2",
        ),
        ("x.yaml", "cam0: [", ["--to", "numpy"], "x.yaml:2: is not valid YAML"),
        (
            "x.yaml",
            "a: 1",
            ["--to", "numpy"],
            "is no file that gtcal knows by what is in it; say what it is with --from",
        ),
        ("x.bin", "\0\1", ["--to", "numpy"], "is no file that gtcal knows"),
    ],
)
def test_what_cant_be_converted_is_told_in_one_line(
    name: str, content: object, arguments: list[str], message: str, tmp_path: Path
) -> None:
    text = content if isinstance(content, str) else json.dumps(content)
    (tmp_path / name).write_text(text)
    assert message in refused(tmp_path / name, "-o", tmp_path / "out", *arguments, folder=tmp_path)


def test_what_is_missing_and_where_nothing_can_be_written_is_told(chain: Path) -> None:
    assert "there is no such file" in refused(
        chain.with_name("no"), "--to", "numpy", "-o", chain.with_name("x"), folder=chain.parent
    )
    for to in ("kalibr", "ros", "ros_bag", "numpy"):
        assert "can't be written" in refused(chain, "--to", to, "-o", chain / "x", folder=chain.parent)


# Trajectories


@pytest.mark.parametrize("to", TRAJECTORY_WRITERS)
@pytest.mark.parametrize("write", [write_euroc_csv, write_tum])
def test_a_trajectory_keeps_every_stamp_and_pose(write, to: str, tmp_path: Path) -> None:
    trajectory = wandering_trajectory("body")
    source, out = tmp_path / "in.txt", tmp_path / "out.txt"
    write(source, trajectory)
    ran = run("convert", source, "--to", to, "-o", out)
    assert ran.code == 0, ran.err
    assert f": a trajectory of {trajectory.n_samples} poses" in ran.out
    again = TRAJECTORY_READERS[to](out, "body", PoseConventions())
    np.testing.assert_array_equal(again.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_allclose(again.world_T_body, trajectory.world_T_body, atol=1e-14)


def test_what_a_trajectory_leaves_unsaid_is_asked_for_as_options(tmp_path: Path) -> None:
    trajectory = wandering_trajectory("body")
    source, out = tmp_path / "in.csv", tmp_path / "out.txt"
    write_euroc_csv(source, trajectory)
    source.write_text("\n".join(source.read_text().splitlines()[1:]) + "\n")
    arguments = [source, "--to", "tum", "-o", out]
    assert "doesn't state its quaternion, and gtcal doesn't guess it; give --quaternion: xyzw or wxyz" in refused(
        *arguments, folder=tmp_path
    )
    stated = ["--quaternion", "wxyz", "--length-unit", "m", "--time-unit", "ns"]
    assert run("convert", *arguments, *stated).code == 0
    again = TRAJECTORY_READERS["tum"](out, "body", PoseConventions())
    np.testing.assert_allclose(again.world_T_body, trajectory.world_T_body, atol=1e-14)
    told = refused(*arguments, *stated[:4], "--time-unit", "us", "--from", "euroc_csv", folder=tmp_path)
    assert "in.csv:1: " in told


def test_a_header_that_contradicts_an_option_is_told_in_options(tmp_path: Path) -> None:
    source = tmp_path / "in.csv"
    write_euroc_csv(source, wandering_trajectory("body"))
    arguments = [source, "--to", "tum", "-o", tmp_path / "out.txt", "--from", "euroc_csv", "--quaternion", "xyzw"]
    said = refused(*arguments, folder=tmp_path)
    assert "header says quaternion wxyz, but --quaternion says xyzw; correct the one that is wrong" in said
    assert "manifest" not in said


def test_a_trajectory_is_no_camera_file(tmp_path: Path) -> None:
    source = tmp_path / "in.csv"
    write_euroc_csv(source, wandering_trajectory("body"))
    out = tmp_path / "out"
    assert "is a trajectory (euroc_csv), which kalibr can't hold; give --to one of euroc_csv, tum" in refused(
        source, "--to", "kalibr", "-o", out, folder=tmp_path
    )
    assert "--model says nothing about a trajectory" in refused(
        source, "--to", "tum", "-o", out, "--model", "fisheye62", folder=tmp_path
    )
    cut = tmp_path / "cut.csv"
    cut.write_text(source.read_text()[:-40])
    assert "cut.csv:61: " in refused(cut, "--to", "tum", "-o", out, "--from", "euroc_csv", folder=tmp_path)
