"""Cameras, scenes and derivatives that the tests of ``factors`` share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from factors import (
    CAMERA_MODELS,
    GAUSSIAN,
    CameraModel,
    CornerReprojectionFactor,
    CornerViews,
    FusedReprojectionFactor,
    RobustKernel,
)
from factors.board_shape import FLAT, outline_of
from factors.rigid import inverse

QUEST3_RIGHT = [503.17462158203125, 503.17462158203125, 636.9581909179688, 511.8325500488281]
QUEST3_RIGHT += [0.043429020792245865, -0.046074334532022476, 0.02290933020412922, -0.01852448284626007]
QUEST3_RIGHT += [0.007009806111454964, -0.001104349852539599, -2.9515178539440967e-05, 0.000159201052156277]

# label: model and theta
CAMERAS: dict[str, tuple[str, list[float]]] = {
    # the right front camera of a real Quest 3 (shared/oracles)
    "quest3": ("fisheye62", QUEST3_RIGHT),
    # cam0 of TUM-VI, 512 x 512
    "tum_vi": (
        "kannala_brandt4",
        [190.978, 190.973, 254.932, 256.897, 0.0034824, 0.00071503, -0.0020532, 0.00020294],
    ),
    # made up: monotonic up to 66 degrees only
    "strong_fisheye": ("kannala_brandt4", [420.0, 430.0, 640.0, 400.0, -0.25, 0.12, -0.09, 0.015]),
    # cam0 of EuRoC MAV: barrel, monotonic up to 90 degrees
    "euroc": (
        "pinhole_radtan",
        [458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907, 1.9359e-4, 1.7619e-5, 0.0],
    ),
    # made up: barrel, monotonic up to 53.6 degrees, and the tangential part folds just before
    "strong_barrel": ("pinhole_radtan", [610.0, 600.0, 640.0, 480.0, -0.4, 0.2, 0.002, -0.003, -0.05]),
    # made up
    "pincushion": ("pinhole_radtan", [610.0, 600.0, 640.0, 480.0, 0.18, 0.06, 0.001, -0.0007, 0.02]),
    # the Quest 3 with a made-up thin prism and two focal lengths
    "thin_prism": (
        "fisheye624",
        [503.2, 507.9, *QUEST3_RIGHT[2:], 0.004, -0.001, -0.003, 0.0008],
    ),
    # made up after the colour camera of an Azure Kinect
    "kinect": (
        "pinhole_rational",
        [605.1, 604.9, 638.2, 366.4, 0.4617, -2.4713, 7e-4, -3e-4, 1.4119, 0.3413, -2.3014, 1.3436],
    ),
    # made up after a Luxonis camera: numerator and denominator nearly cancel, and both nearly vanish
    "near_a_pole": (
        "pinhole_rational",
        [903.9, 905.3, 645.6, 386.9, -7.64, 19.10, 6.8e-4, 1.12e-3, -12.51, -7.64, 19.06, -12.45],
    ),
    # made up: ends at 47 degrees
    "rational_barrel": (
        "pinhole_rational",
        [610.0, 600.0, 640.0, 480.0, -0.3, 0.0, 1e-3, 5e-4, 0.0, 0.2, 0.1, 0.0],
    ),
    # cam0 of TUM-VI, 512 x 512, as basalt publishes it
    "tum_vi_ds": (
        "double_sphere",
        [158.28600034966977, 158.2743455478755, 254.96116578191653, 256.8894394501779, -0.17213, 0.59311776],
    ),
    "tum_vi_eucm": (
        "extended_unified",
        [191.14799836282189, 191.13150963902818, 254.9585771534443, 256.88154645599448, 0.62910609, 1.04180674],
    ),
    # made up: fields that end because the pixels run away
    "narrow_ds": ("double_sphere", [700.0, 705.0, 640.0, 512.0, 0.1, 0.3]),
    "narrow_eucm": ("extended_unified", [700.0, 705.0, 640.0, 512.0, 0.35, 0.9]),
    # made up: a catadioptric camera
    "mirror": ("mei_omni", [820.0, 815.0, 640.0, 512.0, -0.2, 0.05, 1e-3, -8e-4, 0.95]),
    "mirror_barrel": ("mei_omni", [1400.0, 1410.0, 640.0, 512.0, -0.9, 0.1, 5e-4, -8e-4, 1.4]),
}


def camera(label: str) -> tuple[CameraModel, np.ndarray]:
    """Model and theta of one of ``CAMERAS``."""
    name, theta = CAMERAS[label]
    return CAMERA_MODELS[name], np.array(theta)


def numeric_derivative(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float) -> np.ndarray:
    """Central differences of ``function`` in the last place of ``at``; the derivative's columns come last."""
    columns = []
    for i in range(at.shape[-1]):
        shift = np.zeros(at.shape[-1])
        shift[i] = step
        columns.append((function(at + shift) - function(at - shift)) / (2 * step))
    return np.stack(columns, axis=-1)


def poses(random: np.random.Generator, n: int, angle_rad: float, distance_m: float) -> np.ndarray:
    """Random transforms (n, 4, 4), rotated and shifted by about so much."""
    tangents = random.normal(size=(n, 6)) * np.repeat([angle_rad, distance_m], 3) / np.sqrt(3)
    return np.array([gtsam.Pose3.Expmap(xi).matrix() for xi in tangents]).reshape(n, 4, 4)


Y, X, THETA, SHAPE = (gtsam.symbol(letter, 0) for letter in "yxts")
BENT = np.array([1e-3, -2e-3, 1.5e-3, -1e-3, 7e-4])


def A(view: int) -> int:
    """Key of the body's pose in that view."""
    return gtsam.symbol("a", view)


@dataclass(frozen=True)
class Scene:
    """A board seen by a camera in several views: what was measured, and a first guess at the variables."""

    model: CameraModel
    theta: np.ndarray
    views: CornerViews
    ref_T_body: np.ndarray
    values: gtsam.Values

    def initial(self, *, free_body: bool = False, free_theta: bool = False, free_shape: bool = False) -> gtsam.Values:
        """Those of the values that are variables."""
        values = gtsam.Values(self.values)
        for key in [] if free_body else [A(v) for v in range(self.views.n_views)]:
            values.erase(key)
        if not free_theta:
            values.erase(THETA)
        if not free_shape:
            values.erase(SHAPE)
        return values

    def graph(
        self,
        *,
        fused: bool,
        robust: RobustKernel = GAUSSIAN,
        free_body: bool = False,
        free_theta: bool = False,
        free_shape: bool = False,
    ) -> gtsam.NonlinearFactorGraph:
        """The measurement in one of its two grains, without priors."""
        graph = gtsam.NonlinearFactorGraph()
        theta, shape = THETA if free_theta else self.theta, SHAPE if free_shape else FLAT
        if fused and not free_body:
            graph.add(self.fused(self.views, self.ref_T_body, theta, robust, shape))
            return graph
        for v in range(self.views.n_views):
            body = A(v) if free_body else self.ref_T_body[v]
            if fused:
                graph.add(self.fused(self.one_view(v), body, theta, robust, shape))
                continue
            for n in range(*self.views.view_start[v : v + 2]):
                graph.add(self.corner(n, body, theta, robust.noise_model(self.views.sigma_px, 2), shape))
        return graph

    def one_view(self, v: int) -> CornerViews:
        start, end = self.views.view_start[v : v + 2]
        corners = self.views.corners_m[start:end], self.views.corners_px[start:end]
        return CornerViews(np.array([0, end - start]), *corners, self.views.sigma_px, self.views.outline_m)

    def fused(
        self,
        views: CornerViews,
        body: int | np.ndarray,
        theta: int | np.ndarray,
        robust: RobustKernel = GAUSSIAN,
        shape: int | np.ndarray = FLAT,
    ) -> FusedReprojectionFactor:
        return FusedReprojectionFactor(
            Y, X, views=views, model=self.model, ref_T_body=body, theta=theta, shape=shape, robust=robust
        )

    def corner(
        self,
        n: int,
        body: int | np.ndarray,
        theta: int | np.ndarray,
        noise_model: gtsam.noiseModel.Base,
        shape: int | np.ndarray = FLAT,
    ) -> CornerReprojectionFactor:
        return CornerReprojectionFactor(
            Y,
            X,
            corner_m=self.views.corners_m[n],
            corner_px=self.views.corners_px[n],
            model=self.model,
            ref_T_body=body,
            theta=theta,
            noise_model=noise_model,
            shape=shape,
            outline_m=self.views.outline_m,
        )


def scene(
    label: str = "quest3", *, n_views: int = 5, noise_px: float = 0.3, outlier_px: float = 0.0, seed: int = 0
) -> Scene:
    """Views of a 5 x 4 board, half a metre wide, about 0.8 m before the camera and up to 40 degrees off its axis.
    A fifth of the corners is off by about ``outlier_px``."""
    random = np.random.default_rng(seed)
    model, theta = camera(label)
    grid = np.stack(np.meshgrid(np.arange(5) * 0.12, np.arange(4) * 0.12, [0.0]), axis=-1).reshape(-1, 3)
    camera_T_ref, body_T_board = poses(random, 2, 2.0, 0.3)
    middle = np.eye(4)
    middle[:3, 3] = -0.24, -0.18, 0.8
    camera_T_board = poses(random, n_views, 0.4, 0.3) @ middle @ poses(random, n_views, 0.5, 0.0)
    ref_T_body = inverse(camera_T_ref) @ camera_T_board @ inverse(body_T_board)
    corners_m = np.tile(grid, (n_views, 1))
    points = (camera_T_board[:, :3, :3] @ grid.T + camera_T_board[:, :3, 3:]).swapaxes(1, 2).reshape(-1, 3)
    pixels, valid = model.project(points, theta)
    assert valid.all(), "the scene should lie in the field of view"
    pixels += random.normal(scale=noise_px, size=pixels.shape)
    pixels += outlier_px * random.normal(size=pixels.shape) * (random.random((len(pixels), 1)) < 0.2)
    views = CornerViews(len(grid) * np.arange(n_views + 1), corners_m, pixels, 0.4, outline_of(corners_m))

    values = gtsam.Values()
    values.insert(Y, gtsam.Pose3(camera_T_ref @ poses(random, 1, 0.0007, 0.0005)[0]))
    values.insert(X, gtsam.Pose3(body_T_board @ poses(random, 1, 0.0007, 0.0005)[0]))
    values.insert(THETA, theta * (1 + 0.0003 * random.normal(size=len(theta))))
    values.insert(SHAPE, BENT)
    for v in range(n_views):
        values.insert(A(v), gtsam.Pose3(ref_T_body[v] @ poses(random, 1, 0.0003, 0.0002)[0]))
    return Scene(model, theta, views, ref_T_body, values)


def moved(values: gtsam.Values, key: int, shift: np.ndarray) -> gtsam.Values:
    """The values with one variable retracted by ``shift``."""
    delta, single = values.zeroVectors(), gtsam.VectorValues()
    single.insert(key, shift)
    delta.update(single)
    return values.retract(delta)


def derivative_to(
    function: Callable[[gtsam.Values], np.ndarray | float], values: gtsam.Values, key: int, step: float = 1e-6
) -> np.ndarray:
    """Central differences of a function of the values in the tangent of one of them."""
    size = values.zeroVectors().at(key).size
    return numeric_derivative(lambda shift: np.array(function(moved(values, key, shift))), np.zeros(size), step)
