"""Folders laid out as the EuRoC/ASL data sets and TUM-VI are, as fields of a manifest.

Such a folder (or its ``mav0``) holds ``cam0``, ``cam1``, ... with ``data`` and ``data.csv``, the cameras' lenses in
``cam0/sensor.yaml`` (ASL) or ``dso/camchain.yaml`` (TUM-VI, Kalibr's), and each tracked body in a folder of its own
with ``data.csv``. What was tracked and which board was shown it does not say.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gtcal.camera_files.fields import Field
from gtcal.camera_files.kalibr import lens_of
from gtcal.documents import load_plain_yaml, read_text
from gtcal.errors import GtcalError
from gtcal.recordings.capture import Capture
from gtcal.recordings.images import IMAGE_SUFFIXES, relative

LAYOUTS = ("euroc",)

_CAMERA = re.compile(r"cam\w*\d+$")
# What the data sets call their bodies. A ground truth that was estimated is no measurement of the mocap.
_PLATFORM = re.compile(r"(body|vicon|mocap|platform|headset|rig)\d*$")
_BOARD = re.compile(r"(target|board|board_body|device|device_body|lollypop)\d*$")
_CAMCHAINS = ("dso/camchain.yaml", "camchain.yaml")
_COEFFICIENTS = ("distortion_coefficients", "distortion_coeffs")
_LENS_FIELDS = ("camera_model", "distortion_model", "intrinsics", "resolution")


@dataclass(frozen=True)
class Layout:
    """A folder of this kind. cameras, platforms, boards: the folders, by name; of the tracked bodies those that by
    their names carry the cameras, or the board or device. lenses: by camera, the manifest's fields and their file."""

    folder: Path
    cameras: dict[str, Path]
    platforms: dict[str, Path]
    boards: dict[str, Path]
    lenses: dict[str, tuple[dict[str, Any], Path]]

    def camera_fields(self, name: str) -> dict[str, Any]:
        """The manifest's entry of a camera, as far as the layout states it."""
        camera = self.cameras[name]
        listing = {"image_list": relative(camera / "data.csv", self.folder)} if (camera / "data.csv").is_file() else {}
        lens = self.lenses[name][0] if name in self.lenses else {}
        return {**lens, "images": relative(camera / "data", self.folder), **listing}

    def body_fields(self, body: Path) -> dict[str, Any]:
        """The manifest's entry of a tracked body."""
        return {"trajectory": relative(body / "data.csv", self.folder), "format": "euroc_csv"}


def find_layout(folder: Path) -> Layout | None:
    """The layout of a folder, None where it has no cameras laid out like that.

    Raises GtcalError where a file with lenses can't be read."""
    root = folder / "mav0" if (folder / "mav0").is_dir() else folder
    inside = sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
    cameras = {path.name: path for path in inside if _CAMERA.match(path.name) and _has_images(path / "data")}
    if not cameras:
        return None
    bodies = [path for path in inside if (path / "data.csv").is_file()]
    return Layout(
        folder,
        cameras,
        {path.name: path for path in bodies if _PLATFORM.match(path.name)},
        {path.name: path for path in bodies if _BOARD.match(path.name)},
        _lenses(folder, cameras),
    )


def lens_files(folder: Path) -> tuple[Path, ...]:
    """The files in which the layout of a folder states its lenses."""
    layout = find_layout(folder)
    return () if layout is None else tuple(dict.fromkeys(file for _, file in layout.lenses.values()))


def expanded(path: Path, fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of the manifest at ``path`` with what its ``layout`` states filled in; what they state themselves
    stands. Fields without ``layout`` are returned as they are.

    Raises GtcalError where the layout is unknown, the folder isn't laid out like that, or it leaves open which body a
    capture needs."""
    if "layout" not in fields:
        return dict(fields)
    if fields["layout"] not in LAYOUTS:
        raise GtcalError(f"{path}: layout: {fields['layout']!r} is not a layout; choose from {', '.join(LAYOUTS)}")
    layout = find_layout(path.parent)
    if layout is None:
        raise GtcalError(
            f"{path}: layout: {path.parent} is not laid out as EuRoC's: it has no images in cam0/data or mav0/cam0/data"
        )
    filled = dict(fields)
    own = filled.get("cameras") or {}
    cameras = {name: layout.camera_fields(name) for name in layout.cameras}
    filled["cameras"] = {name: _merged(cameras.get(name, {}), own.get(name, {})) for name in {**cameras, **own}}
    for body in _bodies_needed(fields):
        filled[body] = _merged(_body(path, layout, body, fields), fields.get(body) or {})
    return filled


def _has_images(folder: Path) -> bool:
    return folder.is_dir() and any(path.suffix.lower() in IMAGE_SUFFIXES for path in folder.iterdir())


def _merged(stated: dict[str, Any], own: Any) -> Any:
    """The layout's fields under one's own. Another source of images takes the place of the layout's."""
    if not isinstance(own, Mapping):
        return own
    if {"video", "bag", "vrs", "images"} & own.keys():
        stated = {name: value for name, value in stated.items() if name not in ("images", "image_list")}
    return {**stated, **own}


def _bodies_needed(fields: Mapping[str, Any]) -> tuple[str, ...]:
    """By the capture; none where that is missing or wrong, which the manifest's own check tells."""
    capture = fields.get("capture")
    bodies = Capture(capture).bodies if isinstance(capture, str) and capture in list(Capture) else ()
    return tuple("device_body" if body == "board_body" and "device" in fields else body for body in bodies)


def _body(path: Path, layout: Layout, body: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    own = fields.get(body)
    if isinstance(own, Mapping) and "trajectory" in own:
        return {}
    found = dict(layout.platforms if body == "platform" else layout.boards)
    if body != "platform" and not found and fields.get("capture") == Capture.FIXED_CAMERAS:
        found = dict(layout.platforms)  # all that is tracked is the board
    if len(found) == 1:
        return layout.body_fields(next(iter(found.values())))
    listed = ", ".join(sorted({**layout.platforms, **layout.boards})) or "none"
    what = "no folder that is named like it" if not found else f"{' and '.join(found)}, any of which it could be"
    raise GtcalError(
        f"{path}: {body}: the layout has {what}; tracked bodies: {listed}; name its file: "
        f"{body}: {{trajectory: mocap0/data.csv, format: euroc_csv}}"
    )


def _lenses(folder: Path, cameras: dict[str, Path]) -> dict[str, tuple[dict[str, Any], Path]]:
    chain = next((folder / name for name in _CAMCHAINS if (folder / name).is_file()), None)
    in_chain = _yaml_fields(chain) if chain is not None else {}
    found = {}
    for name, camera in cameras.items():
        sensor = camera / "sensor.yaml"
        if sensor.is_file():
            found[name] = (lens_fields(Field(sensor, "", _yaml_fields(sensor))), sensor)
        elif chain is not None and isinstance(in_chain.get(name), Mapping):
            found[name] = (lens_fields(Field(chain, name, in_chain[name])), chain)
    return {name: (lens, file) for name, (lens, file) in found.items() if lens}


def _yaml_fields(path: Path) -> dict[str, Any]:
    found = load_plain_yaml(path, read_text(path))
    return found if isinstance(found, dict) else {}


def lens_fields(block: Field) -> dict[str, Any]:
    """A lens as ASL's sensor.yaml and Kalibr's camchain describe it, as fields of a manifest; nothing where the block
    describes none.

    Raises GtcalError where its model is one that gtcal has not, or the numbers are not those of the model."""
    if any(name not in block for name in _LENS_FIELDS) or block.get(*_COEFFICIENTS) is None:
        return {}
    lens = lens_of(_trimmed(block))
    parameters = dict(zip(lens.model.parameter_names, lens.theta.tolist(), strict=True))
    size_px = [side.size() for side in block["resolution"].entries()]
    return {"model": lens.model.name, "image_size_px": size_px, "parameters": parameters}


def _trimmed(block: Field) -> Field:
    """Without the zeros that some list for coefficients that the model has not."""
    lists = {name: block.value[name] for name in _COEFFICIENTS if isinstance(block.value.get(name), list)}
    short = {name: given[:4] for name, given in lists.items() if not any(given[4:])}
    return replace(block, value={**block.value, **short})
