"""NumPy's npz: every model as it is, so that nothing is lost.

names (C,), models (C,), image_size_px (C, 2), theta_<name> (K,) in gtcal's order, camera_T_ref (C, 4, 4) in m where
there are poses, body_T_board (4, 4) of a calibration, other_boards (B,) the names of those beside it and
body_T_board_<name> (4, 4) of each, ref and notes. Pixels: integer coordinates are pixel centres.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from factors.camera_models import CAMERA_MODELS
from gtcal.camera_files.fields import Field
from gtcal.camera_files.lenses import Expressed, Form
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera, image_size, rig_camera, with_pose
from gtcal.errors import GtcalError
from gtcal.files import MiB, check_regular, is_there, write_aside
from gtcal.npz import load_arrays

TITLE = "NumPy's npz"
_MOST_BYTES = 4 * MiB  # of ten thousand cameras


def read_numpy(path: Path, options: ReadOptions) -> Rig:
    """The cameras of an npz that gtcal wrote. Raises GtcalError naming the file and the array that is wrong."""
    document = Field(path, "", _load(path))
    names = document["names"].entries()
    models, sizes = document["models"].entries(), document["image_size_px"].entries()
    if not len(names) == len(models) == len(sizes):
        raise document.error(f"holds {len(names)} names, {len(models)} models and {len(sizes)} image sizes")
    poses = document["camera_T_ref"].entries() if "camera_T_ref" in document else []
    if poses and len(poses) != len(names):
        raise document["camera_T_ref"].error(f"holds {len(poses)} poses for {len(names)} cameras")
    cameras = [_camera(document, *parts, options) for parts in zip(names, models, sizes, strict=True)]
    placed = [with_pose(camera, poses[i].rigid() if poses else None) for i, camera in enumerate(cameras)]
    board = document["body_T_board"].rigid() if "body_T_board" in document else None
    others = document["other_boards"].entries() if "other_boards" in document else []
    other_boards = {name.text(): document[f"body_T_board_{name.text()}"].rigid() for name in others}
    ref = document["ref"].entries() if "ref" in document else None
    ref_name, words = ("ref", "not known") if ref is None or len(ref) != 2 else (ref[0].text(), ref[1].text())
    return Rig(tuple(placed), ref_name, words, "" if poses else "the file holds no camera_T_ref", board, other_boards)


def write_numpy(rig: Rig, path: Path, notes: Sequence[str], nearest: bool) -> None:
    """Write an npz. Raises GtcalError where it can't be written; no lens is refused."""
    arrays = {f"theta_{camera.name}": camera.camera.theta for camera in rig.cameras}
    if rig.posed:
        arrays["camera_T_ref"] = np.stack(list(rig.poses(TITLE).values()))
    if rig.body_T_board is not None:
        arrays["body_T_board"] = rig.body_T_board
    if rig.other_boards:
        arrays["other_boards"] = np.array(list(rig.other_boards))
        arrays |= {f"body_T_board_{name}": pose for name, pose in rig.other_boards.items()}
    with write_aside(path, binary=True) as file:
        np.savez(
            file,
            notes=np.array(notes),
            ref=np.array([rig.ref, rig.ref_words]),
            names=np.array([camera.name for camera in rig.cameras]),
            models=np.array([camera.camera.model.name for camera in rig.cameras]),
            image_size_px=np.array([camera.image_size_px for camera in rig.cameras]),
            **arrays,  # type: ignore[arg-type]
        )


def _camera(document: Field, name: Field, model: Field, size: Field, options: ReadOptions) -> RigCamera:
    known = CAMERA_MODELS.get(model.text())
    if known is None:
        raise model.error(f"is {model.text()!r}; expected one of {', '.join(CAMERA_MODELS)}")
    theta = document[f"theta_{name.text()}"].numbers(known.n_parameters)
    sides = size.entries()
    if len(sides) != 2:
        raise size.error(f"has {len(sides)} numbers; expected width and height")
    lens = Expressed(Form(known, known.n_parameters), theta)
    return rig_camera(document, name.text(), lens, image_size(document, sides, options), options)


def _load(path: Path) -> dict[str, object]:
    check_regular(path)
    if is_there(path) and path.is_file() and _starts_as_array(path):
        raise GtcalError(f"{path}: is a single array; expected an npz with names, models, theta_<name>")
    return {name: array.tolist() for name, array in load_arrays(path, _MOST_BYTES).items()}


def _starts_as_array(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"\x93NUMPY"
