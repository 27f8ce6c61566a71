"""Other readings of a camera: the order of its coefficients, another image size, an image turned upside down."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtcal.camera import Camera, FloatArray
from gtcal.doctor.manifest_lines import line_of
from gtcal.recordings.detections import CameraDetections

Seen = tuple[Camera, CameraDetections]
"""A camera and what it detected."""

IMAGE_SCALES = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0, 4.0)
"""Of the images against those that the intrinsics were found for."""

_FISHEYE_ORDERS: tuple[tuple[str, str, tuple[int, ...]], ...] = (
    ("tangential order", "p0 and p1 stand in OpenCV's order: they are to be exchanged", (0, 1, 2, 3, 4, 5, 7, 6)),
    ("coefficient order", "the coefficients are in UmeTrack's order k1 k2 k3 k4 p1 p2 k5 k6", (0, 1, 2, 3, 6, 7, 4, 5)),
    (
        "coefficient order",
        "the coefficients are in UmeTrack's order k1 k2 k3 k4 p1 p2 k5 k6, and p1, p2 in OpenCV's",
        (0, 1, 2, 3, 6, 7, 5, 4),
    ),
    ("coefficient order", "the coefficients are in the order k1 k2 p1 p2 k3 k4 k5 k6", (0, 1, 4, 5, 6, 7, 2, 3)),
    (
        "coefficient order",
        "the coefficients are in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6, p1 and p2 its own too",
        (0, 1, 4, 5, 6, 7, 3, 2),
    ),
    ("coefficient order", "the coefficients are in the order p0 p1 k0 k1 k2 k3 k4 k5", (2, 3, 4, 5, 6, 7, 0, 1)),
)
"""Which of the eight numbers given as k0..k5 p0 p1 is each of k0..k5 p0 p1."""

_PINHOLE_ORDERS: tuple[tuple[str, str, tuple[int, ...]], ...] = (
    ("tangential order", "p1 and p2 are exchanged", (0, 1, 3, 2, 4)),
    ("coefficient order", "the coefficients are in the order k1 k2 k3 p1 p2", (0, 1, 3, 4, 2)),
    ("coefficient order", "the coefficients are in the order k1 k2 k3 p2 p1", (0, 1, 4, 3, 2)),
)
"""The same for k1 k2 p1 p2 k3."""

_RATIONAL_ORDERS: tuple[tuple[str, str, tuple[int, ...]], ...] = (
    ("tangential order", "p1 and p2 are exchanged", (0, 1, 3, 2, 4, 5, 6, 7)),
    ("coefficient order", "the coefficients are in the order k1 k2 k3 k4 k5 k6 p1 p2", (0, 1, 6, 7, 2, 3, 4, 5)),
    ("coefficient order", "the coefficients are in Azure Kinect's order k1 .. k6 p2 p1", (0, 1, 7, 6, 2, 3, 4, 5)),
)
"""The same for k1 k2 p1 p2 k3 k4 k5 k6."""

_CENTRED = 0.2
"""A principal point this near to the middle, as a share of half the image, is that of an image of the stated size."""

_ORDERS = {"fisheye62": _FISHEYE_ORDERS, "fisheye624": _FISHEYE_ORDERS[:1], "pinhole_radtan": _PINHOLE_ORDERS}
_ORDERS["pinhole_rational"] = _RATIONAL_ORDERS


@dataclass(frozen=True)
class LensReading:
    """Another reading of one camera. alternatives: what may be done in place of changing the manifest. of_file: whether
    it is how a file was written, so that all cameras are likely to need it."""

    fault: str
    says: str
    reread: Callable[[Seen], Camera]
    alternatives: tuple[str, ...] = ()
    of_file: bool = True


def lens_readings(camera: Camera) -> Iterator[LensReading]:
    """Other readings of a camera with intrinsics."""
    for fault, says, order in _ORDERS.get(camera.model.name, ()):
        yield _of_theta(fault, says, lambda theta, order=order: _reordered(theta, order))  # type: ignore[misc]
    yield _of_theta("lens axes", "fx and fy, and cx and cy, are exchanged", _exchanged_axes)
    for scale in IMAGE_SCALES:
        yield LensReading(
            "image size",
            f"the intrinsics were found for images of {1 / scale:.3g} times the size",
            lambda seen, scale=scale: _at_scale(seen, scale),  # type: ignore[misc]
        )
    yield _of_theta(
        "focal length unit",
        "the focal length is given in widths of the image",
        lambda theta: theta * np.array([camera.image_width_px] * 2 + [1.0] * (len(theta) - 2)),
    )
    yield LensReading(
        "image upside down",
        "the images are turned by 180 degrees against those that the intrinsics were found for",
        lambda seen: turned_camera(seen[0]),
        alternatives=(f"turn the images of {camera.name} by 180 degrees, and keep its parameters",),
        of_file=False,
    )


def _of_theta(fault: str, says: str, change: Callable[[FloatArray], FloatArray]) -> LensReading:
    return LensReading(fault, says, lambda seen: replace(seen[0], parameters=change(seen[0].theta)))


def _reordered(theta: FloatArray, order: tuple[int, ...]) -> FloatArray:
    return np.concatenate([theta[:4], theta[4 : 4 + len(order)][list(order)], theta[4 + len(order) :]])


def _exchanged_axes(theta: FloatArray) -> FloatArray:
    return theta[[1, 0, 3, 2, *range(4, len(theta))]]


def _at_scale(seen: Seen, scale: float) -> Camera:
    """The camera for images of this scale; of another image size too, where the one stated went with the intrinsics and
    the corners fit into the smaller (or go into the larger) image."""
    camera, detections = seen
    scaled = replace(camera, parameters=scaled_intrinsics(camera.theta, scale))
    size_px = np.array([camera.image_width_px, camera.image_height_px])
    whole = np.abs((camera.theta[2:4] + 0.5) / (size_px / 2) - 1.0).max() < _CENTRED
    width_px, height_px = np.rint(size_px * scale).astype(int).tolist()
    resized = replace(scaled, image_width_px=width_px, image_height_px=height_px)
    return resized if whole and resized.in_image(detections.corners_px).all() else scaled


def scaled_intrinsics(theta: FloatArray, scale: float) -> FloatArray:
    """Intrinsics of images that are scaled; integer pixels are centres, so the image's corner is at -0.5."""
    scaled = theta.copy()
    scaled[:2] *= scale
    scaled[2:4] = (theta[2:4] + 0.5) * scale - 0.5
    return scaled


def turned_camera(camera: Camera) -> Camera:
    """The intrinsics of images that are turned upside down: the tangential terms change sign, and the thin prism's."""
    theta = camera.theta.copy()
    theta[2] = camera.image_width_px - 1.0 - theta[2]
    theta[3] = camera.image_height_px - 1.0 - theta[3]
    odd = [i for i, name in enumerate(camera.model.parameter_names) if name[0] in "ps"]
    theta[odd] *= -1.0
    return replace(camera, parameters=theta)


def mirrored(seen: Seen, *, axis: int) -> Seen:
    """With the corners mirrored within the image: left for right (axis 0), or top for bottom (1)."""
    camera, detections = seen
    pixels = detections.corners_px.copy()
    pixels[:, axis] = (camera.image_width_px, camera.image_height_px)[axis] - 1.0 - pixels[:, axis]
    return camera, replace(detections, corners_px=pixels)


def camera_lines(stated: Camera, camera: Camera) -> tuple[str, ...]:
    """The manifest's lines for what this camera has otherwise than stated."""
    where, lines = f"cameras.{camera.name}", []
    size_px = [camera.image_width_px, camera.image_height_px]
    if size_px != [stated.image_width_px, stated.image_height_px]:
        lines.append(line_of(f"{where}.image_size_px", size_px))
    theta = dict(zip(camera.model.parameter_names, camera.theta.tolist(), strict=True))
    return (*lines, line_of(f"{where}.parameters", theta))
