"""The worst frames: what the image shows and where the mocap, through the calibration, says it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gtcal.camera import FloatArray
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage
from gtcal.report.pictures import BLUE, ORANGE, Picture, picture, styled_figure
from gtcal.verification.lollypop_recording import LollypopRecording
from gtcal.verification.verification import Sightings, Verification

MOST_OVERLAYS = 12
_APART_NS = 1_000_000_000
_RED = "#d7191c"
_LEAST_HALF_PX = 16
_MARGIN = 1.5
_NEAR_PX = 4.0
_NEAR_SHARE = 0.4
_SIDE_IN = 2.9


@dataclass(frozen=True)
class _Worst:
    """One sighting: row ``index`` of a camera's ``Sightings``."""

    camera: str
    index: int
    e_2d_px: float


def overlays(verification: Verification) -> tuple[Picture, ...]:
    """Pictures of the worst sightings of every camera, a second or more apart, worst first; none where the
    verification has no images at hand.

    Raises GtcalError where an image can't be read."""
    recording = verification.recording
    if recording is None:
        return ()
    seen = {name: found for name, found in verification.sightings.items() if name in recording.images and len(found)}
    if not seen:
        return ()
    of_each = max(MOST_OVERLAYS // len(seen), 1)
    worst = [entry for name, found in seen.items() for entry in _worst(name, found, of_each)]
    worst.sort(key=lambda entry: -entry.e_2d_px)
    return tuple(_overlay(recording, seen[entry.camera], entry) for entry in worst[:MOST_OVERLAYS])


def _worst(name: str, sightings: Sightings, most: int) -> list[_Worst]:
    picked: list[int] = []
    for index in np.argsort(-sightings.e_2d_px, kind="stable"):
        apart = np.abs(sightings.stamps_ns[picked] - sightings.stamps_ns[index])
        if not picked or apart.min() >= _APART_NS:
            picked.append(int(index))
        if len(picked) == most:
            break
    return [_Worst(name, index, float(sightings.e_2d_px[index])) for index in picked]


def _overlay(recording: LollypopRecording, sightings: Sightings, worst: _Worst) -> Picture:
    image = _image(recording, worst.camera, sightings.stamps_ns[worst.index])
    face_px, markers_px = _outline(recording, sightings, worst.index)
    centre_px = sightings.image_centre_px[worst.index]
    mocap_px = sightings.mocap_centre_px[worst.index]
    half_px = max(_MARGIN * np.abs(np.vstack([face_px, markers_px]) - centre_px).max(), _LEAST_HALF_PX)
    near_px = max(_NEAR_PX, 2.0 * worst.e_2d_px)
    with styled_figure(_SIDE_IN, _SIDE_IN, laid_out=False) as figure:
        axes = _cut_out(figure, (0.0, 0.0, 1.0, 1.0), image, centre_px, half_px)
        axes.plot(*markers_px.T, "o", markerfacecolor="none", color=ORANGE, markersize=9, markeredgewidth=1.4)
        _mark(axes, centre_px, mocap_px, 0.7)
        close = _cut_out(figure, (0.0, 0.0, _NEAR_SHARE, _NEAR_SHARE), image, centre_px, near_px)
        close.add_patch(_frame(close))
        _mark(close, centre_px, mocap_px, 1.0)
        seconds = (sightings.stamps_ns[worst.index] - sightings.stamps_ns[0]) * 1e-9
        return picture(
            figure,
            f"{worst.camera}: {worst.e_2d_px:.2f} px",
            f"{seconds:.2f} s after its first sighting, at {sightings.distance_m[worst.index]:.2f} m, seen "
            f"{np.rad2deg(sightings.viewing_angle_rad[worst.index]):.0f} deg off its normal; image at "
            f"({centre_px[0]:.0f}, {centre_px[1]:.0f}) px.",
        )


def _image(recording: LollypopRecording, camera: str, stamp_ns: int) -> GreyImage:
    sequence = recording.images[camera]
    stamps_ns: IntArray = sequence.stamps_ns
    return sequence.read(int(np.searchsorted(stamps_ns, stamp_ns)))


def _outline(recording: LollypopRecording, sightings: Sightings, index: int) -> tuple[FloatArray, FloatArray]:
    """Where mocap and calibration place the face's corners (C, 2) and the markers (M, 2); those with a pixel."""
    device = recording.device
    camera_T_body = sightings.camera_T_ref @ sightings.ref_T_body[index]
    face = device.faces[sightings.face_index[index]]
    corners_m = face.corners_in_face_m @ face.body_T_face[:3, :3].T + face.body_T_face[:3, 3]
    markers_m = device.markers_in_body_m
    return _projected(sightings, camera_T_body, corners_m), _projected(sightings, camera_T_body, markers_m)


def _projected(sightings: Sightings, camera_T_body: FloatArray, points_in_body_m: FloatArray) -> FloatArray:
    in_camera = points_in_body_m @ camera_T_body[:3, :3].T + camera_T_body[:3, 3]
    pixels_px, valid = sightings.camera.project(in_camera)
    return pixels_px[valid]


def _cut_out(
    figure: Figure, place: tuple[float, float, float, float], image: GreyImage, centre_px: FloatArray, half_px: float
) -> Axes:
    """The raw pixels around a pixel, in axes at ``place`` in the figure."""
    piece, (left, top) = _crop(image, centre_px, half_px)
    height, width = piece.shape
    axes = figure.add_axes(place)
    extent = (left - 0.5, left + width - 0.5, top + height - 0.5, top - 0.5)
    axes.imshow(piece, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="none")
    axes.set_xlim(centre_px[0] - half_px, centre_px[0] + half_px)
    axes.set_ylim(centre_px[1] + half_px, centre_px[1] - half_px)
    axes.set_axis_off()
    return axes


def _mark(axes: Axes, centre_px: FloatArray, mocap_px: FloatArray, size: float) -> None:
    axes.plot(*centre_px, "+", color=BLUE, markersize=26 * size, markeredgewidth=1.6)
    axes.plot(*mocap_px, "o", markerfacecolor="none", color=_RED, markersize=13 * size, markeredgewidth=1.6)


def _frame(axes: Axes) -> Rectangle:
    return Rectangle(
        (0, 0), 1, 1, transform=axes.transAxes, fill=False, edgecolor="white", linewidth=3.0, clip_on=False
    )


def _crop(image: GreyImage, centre_px: FloatArray, half_px: float) -> tuple[GreyImage, tuple[int, int]]:
    """The part of the image around a pixel, and the pixel (x, y) of its upper left."""
    height, width = image.shape
    left, top = np.maximum(np.floor(centre_px - half_px).astype(int), 0)
    right, bottom = np.minimum(np.ceil(centre_px + half_px).astype(int) + 1, (width, height))
    return image[top:bottom, left:right], (int(left), int(top))
