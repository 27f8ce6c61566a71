"""Calibrations and cameras in the files of other tools."""

from gtcal.camera_files.export import EXPORT_FORMATS, export_calibration
from gtcal.camera_files.expressible import Expressed, express

__all__ = ["EXPORT_FORMATS", "Expressed", "export_calibration", "express"]
