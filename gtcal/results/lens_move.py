"""How far intrinsics that were solved for moved from where they started."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LensMove:
    """Of one camera and one group of its intrinsics: 'focal length', 'principal point' or 'distortion'.

    sigmas: the root mean square over the group, in sigmas of what was known beforehand.
    largest_px: by how much it moves the pixel of the image that it moves most.
    camera_mm, camera_deg: how far it moved the camera, to first order."""

    group: str
    sigmas: float
    largest_px: float
    camera_mm: float
    camera_deg: float
