"""Laws of the camera models, for every model of CAMERA_MODELS, and what independent implementations say."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from factors_support import CAMERAS, QUEST3_RIGHT, camera, numeric_derivative
from lens_formulas import double_sphere_m, extended_unified_m

from factors import (
    CAMERA_MODELS,
    FISHEYE62,
    FISHEYE624,
    KANNALA_BRANDT4,
    PINHOLE_RADTAN,
    PINHOLE_RATIONAL,
    CameraModel,
    register_camera_model,
)

FARTHEST_PINHOLE_RAD = np.radians(85.0)

every_camera = pytest.mark.parametrize("label", CAMERAS)
polynomials = (KANNALA_BRANDT4, FISHEYE62, FISHEYE624, PINHOLE_RADTAN)
every_fisheye = pytest.mark.parametrize("label", [c for c in CAMERAS if camera(c)[0] in polynomials[:3]])


def off_axis(angle_rad: np.ndarray, n_azimuths: int = 24) -> np.ndarray:
    """Unit bearings (N * n_azimuths, 3) so far off the axis, all round it."""
    angle, azimuth = np.meshgrid(angle_rad, np.linspace(-np.pi, np.pi, n_azimuths, endpoint=False))
    bearings = [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
    return np.stack(bearings, axis=-1).reshape(-1, 3)


def field(model: CameraModel, theta: np.ndarray, up_to: float = 0.999) -> np.ndarray:
    """Bearings from the optical axis up to that share of the field's radius; to 65 degrees where a pinhole's field
    goes on to 85, for its pixels run away there, and to four fifths where those of another do."""
    shares = np.concatenate([[0.0, 1e-12, 1e-8, 1e-4], np.linspace(0.01, up_to, 60), [up_to]])
    limit = model.max_angle_rad(theta)
    if not model.perspective:
        runs_away = model.radial_slopes(off_axis(np.array([0.999999 * limit]), 1), theta)[0] > 5.0
        return off_axis(shares * limit * (0.8 if runs_away else 1.0))
    return off_axis(np.arctan(shares * np.tan(limit)) if limit < np.radians(84.9) else shares * np.radians(65))


def test_every_model_has_a_camera_here() -> None:
    assert {name for name, _ in CAMERAS.values()} == set(CAMERA_MODELS)
    for name, theta in CAMERAS.values():
        assert CAMERA_MODELS[name].n_parameters == len(theta)


@every_camera
def test_jacobians_equal_numeric_differentiation(label: str) -> None:
    model, theta = camera(label)
    distance_m = np.random.default_rng(1).uniform(0.5, 2.0, (len(field(model, theta)), 1))
    points = distance_m * field(model, theta, 0.98)
    pixels, valid, J_point, J_theta = model.project_with_jacobians(points, theta)
    assert valid.all()
    np.testing.assert_array_equal(pixels, model.project(points, theta)[0])
    by_point = numeric_derivative(lambda p: model.project(p, theta)[0], points, 1e-5)
    by_theta = numeric_derivative(lambda t: model.project(points, t)[0], theta, 1e-6)
    np.testing.assert_allclose(J_point, by_point, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(J_theta, by_theta, rtol=1e-6, atol=1e-6)


@every_camera
def test_on_the_axis_every_model_is_a_pinhole(label: str) -> None:
    model, theta = camera(label)
    cx, cy = theta[2:4]
    fx, fy = theta[:2] * model.slope_on_axis(theta)
    xi = theta[model.parameter_names.index("xi")] if "xi" in model.parameter_names else 0.0
    assert model.slope_on_axis(theta) == pytest.approx(1.0 / (1.0 + xi), rel=1e-15)
    pixels, _, J_point, J_theta = model.project_with_jacobians([[0.0, 0.0, 2.0]], theta)
    np.testing.assert_array_equal(pixels, [[cx, cy]])
    np.testing.assert_allclose(J_point[0], [[fx / 2, 0, 0], [0, fy / 2, 0]], rtol=1e-15)
    np.testing.assert_array_equal(J_theta[0], np.eye(2, model.n_parameters, k=2))


@pytest.mark.long
@every_camera
def test_unproject_inverts_project_over_the_field(label: str) -> None:
    model, theta = camera(label)
    bearings = field(model, theta)
    pixels, valid = model.project(bearings, theta)
    back, found = model.unproject(pixels, theta)
    again, _ = model.project(back, theta)
    np.testing.assert_array_equal(found, valid)
    folds_before = ("strong_barrel", "rational_barrel", "mirror_barrel")  # by their tangential part, at 0.998 of it
    assert valid.all() or label in folds_before
    assert valid.mean() > 0.98
    np.testing.assert_allclose(again[valid], pixels[valid], rtol=0, atol=1e-10)
    np.testing.assert_allclose(back[valid], bearings[valid], rtol=0, atol=1e-11)


@every_camera
def test_every_pixel_has_its_point_or_none(label: str) -> None:
    model, theta = camera(label)
    pixels = np.stack(np.meshgrid(np.linspace(-600, 1900, 101), np.linspace(-600, 1900, 101)), axis=-1)
    bearings, found = model.unproject(pixels.reshape(-1, 2), theta)
    again, valid = model.project(bearings, theta)
    np.testing.assert_array_equal(valid, found)
    assert found.sum() > 300
    np.testing.assert_allclose(again[found], pixels.reshape(-1, 2)[found], rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(bearings[found], axis=1), 1.0, rtol=1e-14)
    assert np.isnan(again[~found]).all()
    assert np.isnan(bearings[~found]).all()


@every_camera
@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_the_distance_does_not_matter(label: str, scale: float) -> None:
    model, theta = camera(label)
    bearings = field(model, theta)
    pixels, valid = model.project(bearings, theta)
    rounding = 1e-11 if label == "near_a_pole" else 1e-12  # a quotient of two numbers near zero
    moved = model.project(scale * bearings[valid], theta)[0]
    np.testing.assert_allclose(moved, pixels[valid], rtol=1e-14, atol=rounding)


def assert_masked(model: CameraModel, theta: np.ndarray, points: np.ndarray) -> None:
    for arrays in (model.project(points, theta), model.project_with_jacobians(points, theta)):
        values, valid = [arrays[0], *arrays[2:]], arrays[1]
        assert not valid.any()
        assert all(np.isnan(value).all() for value in values)


@every_camera
def test_beyond_the_field_there_is_no_pixel(label: str) -> None:
    model, theta = camera(label)
    limit = model.max_angle_rad(theta)
    assert_masked(model, theta, np.array([[0.0, 0.0, -1.0]]))
    if limit < np.pi:
        assert_masked(model, theta, off_axis(np.linspace(1.000001 * limit, np.pi, 200)))
    assert model.project(off_axis(np.array([0.99 * limit])), theta)[1].all()


def continued(model: CameraModel, theta: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
    pixels, valid, J_point, J_theta = model.project_with_jacobians(points, theta, continued=True)
    return pixels, J_point, J_theta, valid


with_an_end = pytest.mark.parametrize("label", [c for c in CAMERAS if camera(c)[0].max_angle_rad(camera(c)[1]) < np.pi])


BENT_TO_THE_END = ("strong_barrel", "rational_barrel", "kinect", "near_a_pole", "mirror", "mirror_barrel")


@with_an_end
def test_beyond_the_field_an_optimiser_finds_its_way_back(label: str) -> None:
    model, theta = camera(label)
    limit = model.max_angle_rad(theta)
    angles = np.linspace(limit + 1e-4, 3.0, 50)
    points = 1.3 * off_axis(angles, 8)
    pixels, J_point, J_theta, valid = continued(model, theta, points)
    assert not valid.any()
    by_point = numeric_derivative(lambda p: continued(model, theta, p)[0], points, 1e-6)
    by_theta = numeric_derivative(lambda t: continued(model, t, points)[0], theta, 1e-7)
    np.testing.assert_allclose(J_point, by_point, rtol=1e-6, atol=1e-9 * np.abs(by_point).max())
    np.testing.assert_allclose(J_theta, by_theta, rtol=1e-5, atol=1e-6 * np.abs(by_theta).max())
    distance_px = np.hypot(*((pixels - theta[2:4]) / theta[:2]).T).reshape(8, 50)
    assert (np.diff(distance_px, axis=1) > 0.0).all()  # ever further out, and so pulled back


@with_an_end
def test_at_the_end_of_the_field_the_continued_pixel_has_no_step(label: str) -> None:
    model, theta = camera(label)
    limit = model.max_angle_rad(theta)
    step = 1e-9
    before, after = (continued(model, theta, off_axis(np.array([limit + s * step]), 8)) for s in (-1, 1))
    size = np.abs(before[1]).max()
    np.testing.assert_allclose(before[0], after[0], rtol=0, atol=3 * step * size)
    tangential = 0.06 if label in BENT_TO_THE_END else 0.0  # where it bends, it ends with the field, as documented
    for i in (1, 2):
        scale = np.abs(before[i]).max()
        np.testing.assert_allclose(before[i], after[i], rtol=0, atol=(2e-5 + tangential) * scale)


@every_camera
def test_inside_the_field_the_continued_pixel_is_the_pixel(label: str) -> None:
    model, theta = camera(label)
    points = field(model, theta, 0.98)
    pixels, valid, *jacobians = model.project_with_jacobians(points, theta)
    assert valid.all()
    for got, expected in zip(continued(model, theta, points), (pixels, *jacobians, valid), strict=True):
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize(("label", "index"), [("quest3", 10), ("thin_prism", 11), ("strong_barrel", 6)])
def test_where_the_tangential_part_folds_there_is_no_pixel(label: str, index: int) -> None:
    model, theta = camera(label)
    theta[index] = -0.2  # p0, p1, and OpenCV's p1
    bearings = field(model, theta)
    pixels, valid = model.project(bearings, theta)
    assert 0.1 < valid.mean() < 0.99
    assert np.isnan(pixels[~valid]).all()
    back, found = model.unproject(pixels[valid], theta)
    assert found.all()
    np.testing.assert_allclose(back, bearings[valid], rtol=0, atol=1e-9)


@every_camera
def test_what_is_no_direction_has_no_pixel(label: str) -> None:
    model, theta = camera(label)
    odd = [0.0, np.nan, np.inf, -np.inf]
    points = np.stack(np.meshgrid([*odd, 0.3], [*odd, -0.2], [*odd, 1.0]), axis=-1).reshape(-1, 3)
    finite = np.isfinite(points).all(axis=1)
    assert_masked(model, theta, points[~finite])
    assert_masked(model, theta, np.zeros((1, 3)))


@every_camera
def test_pixels_outside_the_field_have_no_point(label: str) -> None:
    model, theta = camera(label)
    outside = [[np.nan, 3.0], [3.0, np.nan], [np.inf, 3.0], [3.0, -np.inf]]
    if model.max_angle_rad(theta) < (FARTHEST_PINHOLE_RAD - 1e-9 if model.perspective else np.pi):
        rim = model.project(off_axis(np.array([0.9999 * model.max_angle_rad(theta)])), theta)[0]
        outside += list(theta[2:4] + 1.1 * (rim - theta[2:4]))
    bearings, found = model.unproject(outside, theta)
    assert not found.any()
    assert np.isnan(bearings).all()


def radius_limit(model: CameraModel, theta: np.ndarray) -> float:
    """The first root of the derivative of the radial polynomial, by numpy."""
    names = [n for n in model.parameter_names if n.startswith("k")]
    coefficients = [theta[model.parameter_names.index(n)] for n in names]
    slope = [1.0, *(k * (2 * i + 3) for i, k in enumerate(coefficients))]
    squares = np.roots(slope[::-1])
    real = squares.real[(np.abs(squares.imag) < 1e-9 * np.abs(squares)) & (squares.real > 0)]
    return float(np.sqrt(real.min())) if len(real) else np.inf


@pytest.mark.parametrize("model", polynomials, ids=lambda model: model.name)
def test_the_field_ends_at_the_first_root_of_the_slope(model: CameraModel) -> None:
    random = np.random.default_rng(5)
    radial = [name.startswith("k") for name in model.parameter_names]
    sizes = 0.3 * 0.5 ** np.arange(sum(radial))
    n_ends = 0
    for _ in range(200):
        theta = np.zeros(model.n_parameters)
        theta[:2], theta[radial] = 500.0, random.normal(size=sum(radial)) * sizes
        root = radius_limit(model, theta)
        limit = min(np.arctan(root), FARTHEST_PINHOLE_RAD) if model is PINHOLE_RADTAN else min(root, np.pi)
        assert model.max_angle_rad(theta) == pytest.approx(limit, rel=1e-9)
        n_ends += limit not in (np.pi, FARTHEST_PINHOLE_RAD)
    assert n_ends > 50


@pytest.mark.parametrize(
    "model", [model for model in CAMERA_MODELS.values() if model not in polynomials], ids=lambda model: model.name
)
def test_the_field_ends_where_the_formula_turns(model: CameraModel) -> None:
    """The radial function written out, on a fine grid: up to where it falls, or is eleven focal lengths."""
    random = np.random.default_rng(5)
    angles = np.linspace(0.0, FARTHEST_PINHOLE_RAD if model.perspective else np.pi, 40_001)
    limits = []
    for _ in range(100):
        theta = np.array([*[500.0] * 2, 0, 0, *model.undistorted])
        theta[4:] += random.normal(size=len(theta) - 4) * 0.3
        theta[[i for i, name in enumerate(model.parameter_names) if name[0] == "p"]] = 0.0
        points = off_axis(angles[:-1], 1)
        points = np.stack([np.hypot(points[:, 0], points[:, 1]), np.zeros(len(points)), points[:, 2]], axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            m, radius = FORMULAS[model.name](points, theta)
        inside = (np.diff(radius, prepend=-1.0) > 0.0) & (m >= 0.0)
        if not model.perspective:
            inside &= m * model.slope_on_axis(theta) ** -1 < np.tan(FARTHEST_PINHOLE_RAD)
        last = np.flatnonzero(~inside)[0] if (~inside).any() else len(angles) - 1
        if model.slope_on_axis(theta) > 0.0:
            limits.append(angles[last])
            assert model.max_angle_rad(theta) == pytest.approx(limits[-1], abs=3e-4)
    assert len(limits) > 80
    assert np.mean(np.array(limits) < angles[-1] - 1e-3) > 0.3


def unified_m(points: np.ndarray, theta: np.ndarray) -> np.ndarray:
    return points[:, 0] / (points[:, 2] + theta[8] * np.linalg.norm(points, axis=1))


def rational_radius(points: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, _, _, k3, k4, k5, k6 = theta[4:]
    m = points[:, 0] / points[:, 2]
    scale = (1 + k1 * m**2 + k2 * m**4 + k3 * m**6) / (1 + k4 * m**2 + k5 * m**4 + k6 * m**6)
    below = 1 + k4 * m**2 + k5 * m**4 + k6 * m**6
    return np.where(np.minimum.accumulate(below) > 0.0, m, np.nan), np.where(scale < 100.0, m * scale, np.nan)


def mei_radius(points: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    m = unified_m(points, theta)
    return m, m * (1 + theta[4] * m**2 + theta[5] * m**4)


def undistorted(of: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    return lambda points, theta: (points[:, 0] * of(points, theta),) * 2


FORMULAS = {
    "pinhole_rational": rational_radius,
    "mei_omni": mei_radius,
    "double_sphere": undistorted(double_sphere_m),
    "extended_unified": undistorted(extended_unified_m),
}
"""By model, m and R of points with y = 0."""


@pytest.mark.parametrize("label", ["tum_vi_ds", "narrow_ds", "tum_vi_eucm", "narrow_eucm"])
def test_sphere_models_are_their_papers(label: str) -> None:
    model, theta = camera(label)
    points = 1.7 * field(model, theta, 0.9)
    formula = double_sphere_m if model.name == "double_sphere" else extended_unified_m
    expected = theta[:2] * points[:, :2] * formula(points, theta)[:, None] + theta[2:4]
    pixels, valid = model.project(points, theta)
    assert valid.all()
    np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-9)


def test_a_double_spheres_field_ends_where_the_second_sphere_turns() -> None:
    """Where a ray grazes the second sphere, its cosine there being -(1 - alpha) / alpha. The paper's bound, equations
    43 to 45, takes a point on the second sphere for one on the first, and is near it."""
    model, theta = camera("tum_vi_ds")
    xi, alpha = theta[4:]
    w1, limit = (1 - alpha) / alpha, model.max_angle_rad(theta)
    second = np.array([np.sin(limit), xi + np.cos(limit)])
    assert second[1] / np.linalg.norm(second) == pytest.approx(-w1, abs=1e-9)
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi**2 + 1)
    assert limit == pytest.approx(np.arccos(-w2), abs=0.02)


def test_a_unified_field_is_its_papers() -> None:
    model, theta = camera("tum_vi_eucm")
    theta[5] = 1.0
    alpha = theta[4]
    assert model.max_angle_rad(theta) == pytest.approx(np.arccos(-(1 - alpha) / alpha), abs=1e-9)


@every_camera
def test_the_radial_slope_is_what_a_pixel_moves(label: str) -> None:
    model, theta = camera(label)
    pure = np.where([name[0] not in "ps" for name in model.parameter_names], theta, 0.0)  # no tangential part
    angles = np.linspace(0.01, 0.98, 40) * min(model.max_angle_rad(pure), 1.2)
    radii = np.tan(angles) if model.perspective else angles

    def distance(radius: np.ndarray) -> np.ndarray:
        points = off_axis(np.arctan(radius) if model.perspective else radius, 1)
        return np.hypot(*((model.project(points, pure)[0] - pure[2:4]) / pure[:2]).T)

    expected = (distance(radii + 1e-6) - distance(radii - 1e-6)) / 2e-6 / model.slope_on_axis(theta)
    np.testing.assert_allclose(model.radial_slopes(off_axis(angles, 1), theta), expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(model.radial_slopes([[0.0, 0.0, 3.0]], theta), [1.0])
    assert np.isnan(model.radial_slopes([[np.nan] * 3], theta)).all()


def test_the_field_of_the_quest_3() -> None:
    limit = FISHEYE62.max_angle_rad(QUEST3_RIGHT)
    assert np.degrees(limit) == pytest.approx(89.5635, abs=5e-5)
    assert FISHEYE62.project(off_axis(np.array([limit - 1e-9])), QUEST3_RIGHT)[1].all()


@pytest.mark.parametrize("index", [0, 1])
def test_fisheye62_agrees_with_two_implementations(shared: Callable[[str], Path], index: int) -> None:
    oracle = json.loads(shared("oracles/fisheye62_quest3.json").read_text())["cameras"][index]
    theta = [oracle["params"][name] for name in FISHEYE62.parameter_names]
    assert_agrees(FISHEYE62, theta, oracle)


@pytest.mark.parametrize("index", [0, 1])
def test_fisheye624_agrees_with_two_implementations(index: int) -> None:
    text = (Path(__file__).parent / "data" / "fisheye624_oracle.json").read_text()
    oracle = json.loads(text)["cameras"][index]
    assert_agrees(FISHEYE624, oracle["theta"], oracle)


def assert_agrees(model: CameraModel, theta: list[float], oracle: dict[str, list[list[float]]]) -> None:
    pixels, valid = model.project(oracle["points_m"], theta)
    assert valid.all()
    np.testing.assert_allclose(pixels, oracle["pixels_projectaria_px"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(pixels, oracle["pixels_pycolmap_px"], rtol=0, atol=1e-9)


def camera_matrix(theta: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = theta[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("label", [c for c in CAMERAS if camera(c)[0].perspective])
def test_the_pinholes_are_opencvs(label: str) -> None:
    model, theta = camera(label)
    points = field(model, theta, 0.9)
    given, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera_matrix(theta), theta[4:])
    np.testing.assert_allclose(model.project(points, theta)[0], given[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("label", ["mirror", "mirror_barrel"])
def test_mei_is_opencvs_omnidir(label: str) -> None:
    model, theta = camera(label)
    points = field(model, theta, 0.9)
    k_and_p, xi = theta[4:8], theta[8]
    given, _ = cv2.omnidir.projectPoints(points[None], np.zeros(3), np.zeros(3), camera_matrix(theta), xi, k_and_p)
    np.testing.assert_allclose(model.project(points, theta)[0], given[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("label", ["tum_vi", "strong_fisheye"])
def test_kannala_brandt_is_opencvs_fisheye(label: str) -> None:
    model, theta = camera(label)
    points = field(model, theta)
    points = points[points[:, 2] > 0.05]  # OpenCV divides by z
    given, _ = cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), camera_matrix(theta), theta[4:])
    np.testing.assert_allclose(model.project(points, theta)[0], given[0], rtol=0, atol=1e-9)


@every_fisheye
def test_the_fisheye_models_nest(label: str) -> None:
    model, theta = camera(label)
    same = {
        FISHEYE624: (FISHEYE62, [*theta[:12], 0, 0, 0, 0], theta[:12]),
        FISHEYE62: (FISHEYE624, theta, [*theta, 0, 0, 0, 0]),
        KANNALA_BRANDT4: (FISHEYE62, theta, [*theta, 0, 0, 0, 0]),
    }
    other, own, others = same[model]
    points = off_axis(np.linspace(0, 1.2, 30))
    pixels, valid, J_point, J_theta = model.project_with_jacobians(points, own)
    other_pixels, other_valid, other_J_point, other_J_theta = other.project_with_jacobians(points, others)
    shared = min(len(own), len(others))
    np.testing.assert_array_equal(valid, other_valid)
    np.testing.assert_allclose(pixels, other_pixels, rtol=1e-15)
    np.testing.assert_allclose(J_point, other_J_point, rtol=1e-13, atol=1e-11)
    np.testing.assert_allclose(J_theta[..., :shared], other_J_theta[..., :shared], rtol=1e-13, atol=1e-11)


def test_the_rational_model_without_its_denominator_is_the_pinhole() -> None:
    theta = camera("pincushion")[1]
    points = off_axis(np.linspace(0, 1.1, 30))
    own = PINHOLE_RADTAN.project_with_jacobians(points, theta)
    others = PINHOLE_RATIONAL.project_with_jacobians(points, [*theta, 0.0, 0.0, 0.0])
    for got, expected in zip(others[:3], own[:3], strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-13, atol=1e-11)
    np.testing.assert_allclose(others[3][..., :9], own[3], rtol=1e-13, atol=1e-11)


def test_every_model_knows_a_usual_lens_and_one_to_start_from() -> None:
    for model in CAMERA_MODELS.values():
        for lens in (model.usual[1:], model.undistorted):
            theta = np.array([model.usual[0]] * 2 + [639.5, 511.5, *lens])
            corner = model.unproject([[0.0, 0.0]], theta)
            assert corner[1].all(), model.name


def test_models_are_handed_to_other_processes_by_name() -> None:
    assert all(pickle.loads(pickle.dumps(model)) is model for model in CAMERA_MODELS.values())


def test_two_models_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="there is a camera model 'fisheye62' already"):
        register_camera_model(CameraModel("fisheye62", ("fx", "fy", "cx", "cy")))
    with pytest.raises(ValueError, match="expected fx fy cx cy first"):
        register_camera_model(CameraModel("one", ("f", "cx", "cy", "k")))


def test_shape_errors_quote_the_shape() -> None:
    theta = np.zeros(12)
    with pytest.raises(ValueError, match=r"points_in_camera.shape=\(4, 2\), expected \(N, 3\)"):
        FISHEYE62.project(np.zeros((4, 2)), theta)
    with pytest.raises(ValueError, match=r"points_in_camera.shape=\(3,\), expected \(N, 3\)"):
        FISHEYE62.project_with_jacobians(np.zeros(3), theta)
    with pytest.raises(ValueError, match=r"pixels_px.shape=\(4, 3\), expected \(N, 2\)"):
        FISHEYE62.unproject(np.zeros((4, 3)), theta)
    with pytest.raises(ValueError, match=r"theta.shape=\(11,\), expected \(12,\) for fisheye62: fx fy cx cy k0"):
        FISHEYE62.project(np.zeros((4, 3)), theta[:11])


def test_no_points_have_no_pixels() -> None:
    pixels, valid, J_point, J_theta = FISHEYE62.project_with_jacobians(np.empty((0, 3)), QUEST3_RIGHT)
    assert (pixels.shape, valid.shape, J_point.shape, J_theta.shape) == ((0, 2), (0,), (0, 2, 3), (0, 2, 12))
    assert FISHEYE62.unproject(np.empty((0, 2)), QUEST3_RIGHT)[0].shape == (0, 3)
