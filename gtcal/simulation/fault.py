"""What happened to a rig between two recordings of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import Camera, FloatArray
from gtcal.errors import GtcalError
from gtcal.simulation.rig import Rig
from gtcal.simulation.transforms import transform


@dataclass(frozen=True)
class RigFault:
    """What happened to a rig between two recordings.

    markers: (4, 4) with camera_T_ref * markers the true extrinsic of every camera: the platform's markers were
        bumped (or, with fixed cameras, the mocap's world was moved).
    cameras: by name (4, 4) with cameras[name] * camera_T_ref the camera's true extrinsic: the camera was moved.
    focal_shares: by name, by what share of itself the focal length grew: the lens warmed up.
    device_centre_m: how far the device's faces lie from where they belong in its body: a disc was lost.
    """

    markers: FloatArray = field(default_factory=lambda: np.eye(4))
    cameras: Mapping[str, FloatArray] = field(default_factory=dict)
    focal_shares: Mapping[str, float] = field(default_factory=dict)
    device_centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def check(self, rig: Rig) -> None:
        """Raises GtcalError for a camera that is not in the rig."""
        names = [camera.name for camera in rig.cameras]
        for name in (*self.cameras, *self.focal_shares):
            if name not in names:
                raise GtcalError(f"fault: camera {name!r} is not in the rig; cameras: {', '.join(names)}")

    def of(self, rig: Rig) -> Rig:
        """The rig with its cameras as they are after it; where its markers are is not the rig's to know."""
        cameras = tuple(_warmed(camera, self.focal_shares.get(camera.name, 0.0)) for camera in rig.cameras)
        moved = np.stack([self.cameras.get(camera.name, np.eye(4)) for camera in rig.cameras])
        return replace(rig, cameras=cameras, rig_T_camera=rig.rig_T_camera @ inverse(moved))

    def scaled(self, share: float) -> RigFault:
        """The same fault, ``share`` of it."""
        x, y, z = self.device_centre_m
        return RigFault(
            _scaled(self.markers, share),
            {name: _scaled(moved, share) for name, moved in self.cameras.items()},
            {name: share * grown for name, grown in self.focal_shares.items()},
            (share * x, share * y, share * z),
        )


def small_motion(shift_mm: FloatArray | tuple[float, ...], turn_deg: FloatArray | tuple[float, ...]) -> FloatArray:
    """(4, 4) of a shift (3,) and a rotation vector (3,)."""
    return transform(Rotation.from_rotvec(np.deg2rad(turn_deg)), 1e-3 * np.asarray(shift_mm, dtype=np.float64))


def _scaled(motion: FloatArray, share: float) -> FloatArray:
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return transform(Rotation.from_rotvec(share * turn), share * motion[:3, 3])


def _warmed(camera: Camera, share: float) -> Camera:
    theta = camera.theta.copy()
    theta[:2] *= 1.0 + share
    return replace(camera, parameters=theta)
