"""gtcal's own calibration.json as a camera file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gtcal.camera_files.fields import Field
from gtcal.camera_files.lenses import Expressed, Form
from gtcal.camera_files.rig import ReadOptions, Rig, RigCamera, image_size, rig_camera, with_pose


def recognises(document: object) -> bool:
    """Whether this is what a calibration.json looks like."""
    return isinstance(document, dict) and "gtcal_calibration" in document


def read_gtcal(path: Path, options: ReadOptions) -> Rig:
    """The cameras of a calibration.json, in its ref. Raises GtcalError for a file that is none, or damaged."""
    # a calibration holds recordings, whose manifests know the camera files: imported at the top, this would go round
    from gtcal.camera_files.export import calibration_rig
    from gtcal.results.calibration_file import read_calibration

    rig = calibration_rig(read_calibration(path))
    return replace(rig, cameras=tuple(_checked(path, camera, options) for camera in rig.cameras))


def _checked(path: Path, camera: RigCamera, options: ReadOptions) -> RigCamera:
    """The camera, where it doesn't contradict the options."""
    field, model = Field(path, f"cameras.{camera.name}", None), camera.camera.model
    sides = [Field(path, f"{field.where}.image_size_px", side) for side in camera.image_size_px]
    size = image_size(field, sides, options)
    lens = Expressed(Form(model, model.n_parameters), camera.camera.theta)
    return with_pose(rig_camera(field, camera.name, lens, size, options), camera.camera_T_ref)
