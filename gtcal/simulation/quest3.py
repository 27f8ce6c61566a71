"""The four tracking cameras of the simulated headset.

The front pair: the factory calibration of one real Quest 3, cameras "camera-slam-left" and "camera-slam-right", as
its projectaria-style camera JSON gives it (Fisheye62, integer pixel centres, device_T_camera). The side pair is
made up: small variations of these intrinsics, looking outwards and down at the places where the device has its
side cameras.

Device frame: x forward, y up, z to the wearer's right; the images are turned by a quarter.
"""

from __future__ import annotations

from dataclasses import dataclass

IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX = 1280, 1024


@dataclass(frozen=True)
class HeadsetCamera:
    """theta: Fisheye62 parameters fx fy cx cy k0..k5 p0 p1. The rotation and translation of device_T_camera."""

    name: str
    theta: tuple[float, ...]
    device_q_camera_wxyz: tuple[float, float, float, float]
    device_t_camera_m: tuple[float, float, float]


FRONT_LEFT = HeadsetCamera(
    "front_left",
    (
        504.5934753417969,
        504.5934753417969,
        638.3945922851562,
        509.4228515625,
        0.043982941657304764,
        -0.0448598638176918,
        0.01613209955394268,
        -0.010928832925856113,
        0.003512823488563299,
        -0.0005242147017270327,
        0.00047754947445355356,
        -4.744782927446067e-05,
    ),
    (-0.44995020258640295, 0.4002398518639525, -0.5571697905977196, 0.5717645499833561),
    (0.02676488494873047, -0.1293854675292969, -0.03089171028137207),
)
FRONT_RIGHT = HeadsetCamera(
    "front_right",
    (
        503.17462158203125,
        503.17462158203125,
        636.9581909179688,
        511.8325500488281,
        0.043429020792245865,
        -0.046074334532022476,
        0.02290933020412922,
        -0.01852448284626007,
        0.007009806111454964,
        -0.001104349852539599,
        -2.9515178539440967e-05,
        0.000159201052156277,
    ),
    (-0.43742901420997415, 0.40850468341688273, -0.5546791775025043, 0.578023175312987),
    (0.023434097290039063, -0.13131076049804688, 0.03267765808105469),
)
# The front pair turned by 72 and -74 degrees about the device's y, by 12 further down, and rolled by 4 and -3.
SIDE_LEFT = HeadsetCamera(
    "side_left",
    (
        505.8123,
        505.8123,
        642.1127,
        507.6231,
        0.044305,
        -0.045412,
        0.018274,
        -0.013105,
        0.004511,
        -0.000691,
        0.000213,
        -0.000148,
    ),
    (0.02619, 0.61162, -0.73182, 0.29945),
    (0.0042, -0.1123, -0.0781),
)
SIDE_RIGHT = HeadsetCamera(
    "side_right",
    (
        502.3417,
        502.3417,
        635.4718,
        514.2046,
        0.043112,
        -0.045127,
        0.020541,
        -0.015873,
        0.005702,
        -0.000884,
        -0.000164,
        0.000095,
    ),
    (0.63818, 0.08876, 0.25162, -0.72218),
    (0.0038, -0.1131, 0.0774),
)
HEADSET_CAMERAS = (FRONT_LEFT, FRONT_RIGHT, SIDE_LEFT, SIDE_RIGHT)
