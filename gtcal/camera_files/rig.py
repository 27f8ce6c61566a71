"""Cameras between files: what a reader of any format gives and a writer of any format takes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from factors.camera_models import CAMERA_MODELS
from gtcal.bounds import LARGEST_LENS
from gtcal.camera import Camera, FloatArray
from gtcal.camera_files.fields import Field
from gtcal.camera_files.lenses import RADTAN5, RATIONAL, Expressed, ForeignLens, Form, as_model, fit_foreign
from gtcal.errors import GtcalError
from gtcal.names import check_name

LengthUnit = Literal["m", "mm"]
_LENGTHS_M: dict[LengthUnit, float] = {"m": 1.0, "mm": 1e-3}

OUR_PIXELS = "integer pixel coordinates are pixel centres"


@dataclass(frozen=True)
class ReadOptions:
    """What a camera file may leave unsaid. Readers take it where the file is silent; ``agreeing`` compares it with what
    the file says of a camera.

    model: of every camera, a name of gtcal's. image_size_px: of every image. length_unit: of translations.
    nearest: take the nearest lens where gtcal has no model of the file's, in place of refusing.
    Raises GtcalError for a model that there isn't."""

    model: str | None = None
    image_size_px: tuple[int, int] | None = None
    length_unit: LengthUnit | None = None
    nearest: bool = False

    def __post_init__(self) -> None:
        if self.model is not None and self.model not in CAMERA_MODELS:
            raise GtcalError(f"{self.model!r} is no camera model; choose from {', '.join(CAMERA_MODELS)}")

    def length_m(self, stated: Field | None) -> float | None:
        """The file's unit of length in m, None where neither the file nor these options tell. Raises GtcalError where
        they contradict each other."""
        unit = None if stated is None else stated.text()
        if stated is not None and unit not in _LENGTHS_M:
            raise stated.error(f"is {unit!r}; expected m or mm")
        if stated is not None and self.length_unit not in (None, unit):
            raise stated.error(f"is {unit}, but length_unit says {self.length_unit}; correct the one that is wrong")
        return None if unit is None and self.length_unit is None else _LENGTHS_M[unit or self.length_unit]  # type: ignore[index]


@dataclass(frozen=True)
class RigCamera:
    """A camera, and where it is.

    camera_T_ref: (4, 4), None where that is not known. lens_off_px: by how much the camera's lens differs from the
    file's at most, over the image; 0 where it is the same."""

    camera: Camera
    camera_T_ref: FloatArray | None = None
    lens_off_px: float = 0.0

    @property
    def name(self) -> str:
        return self.camera.name

    @property
    def image_size_px(self) -> tuple[int, int]:
        return self.camera.image_width_px, self.camera.image_height_px


@dataclass(frozen=True)
class Rig:
    """Cameras placed in one frame.

    ref: the frame's name, letters, digits and _ / . - only. ref_words: what it is.
    unposed: why no camera has a pose; empty where all have.
    body_T_board: (4, 4) of a calibration. other_boards: by name, the same of those beside it.
    Raises GtcalError where a camera's or a board's name can be none, two cameras have the same, only some have a pose,
    or ref is no name of a frame."""

    cameras: tuple[RigCamera, ...]
    ref: str
    ref_words: str
    unposed: str = ""
    body_T_board: FloatArray | None = None
    other_boards: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_/.-]+", self.ref):
            raise GtcalError(f"the frame {self.ref!r} of the cameras: a frame's name has letters, digits, _ / . - only")
        for board in self.other_boards:
            check_name("board", board)
        names = [camera.name for camera in self.cameras]
        for name in names:
            check_name("camera", name)
            if names.count(name) > 1:
                raise GtcalError(f"there are two cameras named {name!r}; rename one")
        posed = [camera.name for camera in self.cameras if camera.camera_T_ref is not None]
        if posed and len(posed) < len(names):
            missing = next(name for name in names if name not in posed)
            raise GtcalError(f"camera {posed[0]!r} has a pose but camera {missing!r} has none")

    @property
    def posed(self) -> bool:
        return all(camera.camera_T_ref is not None for camera in self.cameras)

    def poses(self, format_name: str) -> dict[str, FloatArray]:
        """camera_T_ref by camera. Raises GtcalError where there are none."""
        if not self.posed:
            raise GtcalError(f"{format_name} needs every camera's pose, and there is none: {self.unposed}")
        return {camera.name: camera.camera_T_ref for camera in self.cameras if camera.camera_T_ref is not None}

    def file_names(self) -> dict[str, str]:
        """By camera: its name for files, frames and topics. Raises GtcalError for a name that is fit for none."""
        for camera in self.cameras:
            if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", camera.name):
                raise GtcalError(
                    f"camera {camera.name!r}: its name is to name a file and a frame; use letters, digits, _ . - only"
                )
        return {camera.name: camera.name for camera in self.cameras}


Lens = Expressed | ForeignLens


def rig_camera(field: Field, name: str, lens: Lens, image_size_px: tuple[int, int], options: ReadOptions) -> RigCamera:
    """A camera as read at ``field``, without a pose.

    Raises GtcalError for a focal length that is not positive, a lens that gtcal has no model of unless
    ``options.nearest``."""
    if (np.abs(lens.theta) > LARGEST_LENS).any():
        raise field.error(f"a parameter of the lens is {np.abs(lens.theta).max():.3g}, beyond any lens")
    if not (lens.theta[:2] > 0).all():
        raise field.error(f"the focal lengths are {lens.theta[0]:g} and {lens.theta[1]:g}; expected positive numbers")
    found = _known(field, lens, image_size_px, options) if isinstance(lens, ForeignLens) else lens
    return RigCamera(found.camera(name, image_size_px), lens_off_px=found.max_px)


def with_pose(camera: RigCamera, camera_T_ref: FloatArray | None) -> RigCamera:
    return replace(camera, camera_T_ref=camera_T_ref)


def image_size(field: Field, stated: Sequence[Field] | None, options: ReadOptions) -> tuple[int, int]:
    """Width and height as the file states them, else as the options do. Raises GtcalError where neither does."""
    if not stated:
        if options.image_size_px is None:
            raise field.error("the file doesn't state the size of the images; give image_size_px")
        return options.image_size_px
    width, height = (part.size() for part in stated)
    return width, height


def agreeing(path: Path, camera: RigCamera, options: ReadOptions) -> RigCamera:
    """The camera in the model that the options state, if they do. Raises GtcalError naming the file where its lens is
    of another, or its images are of another size."""
    field, size, stated = Field(path, "", None), camera.image_size_px, options.image_size_px
    if stated not in (None, size):
        raise field.error(
            f"camera {camera.name!r} is for images of {size[0]} x {size[1]} px, but image_size_px says "
            f"{' x '.join(map(str, stated or ()))}; which is right?"
        )
    if options.model is None:
        return camera
    model = CAMERA_MODELS[options.model]
    theta = as_model(camera.camera.model, camera.camera.theta, model)
    if theta is None:
        raise field.error(
            f"the lens of camera {camera.name!r} is a {camera.camera.model.name}, but model says {options.model}; "
            "which is right?"
        )
    return replace(camera, camera=replace(camera.camera, model=model, parameters=theta))


def opencv_pinhole(focal_and_centre: FloatArray, coefficients: FloatArray) -> Lens:
    """OpenCV's pinhole: fx fy cx cy (4,), and 0, 1, 2, 4, 5, 8, 12 or 14 coefficients in its order."""
    if not coefficients[5:].any():
        return padded(RADTAN5, np.concatenate([focal_and_centre, coefficients[:5]]))
    rational = padded(RATIONAL, np.concatenate([focal_and_centre, coefficients[:8]]))
    if not coefficients[8:].any():
        return rational
    fx, fy, cx, cy = focal_and_centre
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(bearings: FloatArray) -> FloatArray:
        return np.asarray(cv2.projectPoints(bearings, np.zeros(3), np.zeros(3), K, coefficients)[0][:, 0], np.float64)

    return ForeignLens(f"OpenCV's pinhole with {len(coefficients)} coefficients", RATIONAL, rational.theta, project)


OPENCV_COUNTS = (4, 5, 8, 12, 14)


def padded(form: Form, values: FloatArray) -> Expressed:
    """The form's first parameters, the rest zero."""
    return Expressed(form, np.concatenate([values, np.zeros(form.model.n_parameters - len(values))]))


def _known(field: Field, lens: ForeignLens, size_px: tuple[int, int], options: ReadOptions) -> Expressed:
    found = fit_foreign(lens, size_px)
    what = f"the lens is {lens.name}, which gtcal has no model of"
    if found is None:
        raise field.error(f"{what}, and none of gtcal's comes near it over the whole image")
    if not options.nearest:
        raise field.error(
            f"{what}; the nearest {found.model.name} is off by {found.rms_px:.3g} px rms and {found.max_px:.3g} px at "
            "most over the image: if that will do, make a file of it with 'gtcal convert --nearest'"
        )
    return found
