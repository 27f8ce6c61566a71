"""Lenses that a format, or gtcal, can't hold: refused with the loss of the nearest, which is the nearest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from camera_files_support import (
    ARIA,
    CAMERA_INFO_MESSAGE,
    LENSES,
    points_in,
    read_text_as,
    rig_of,
    said,
    written,
)

from gtcal.camera_files.lenses import F62, KB4, PINHOLE, RADTAN4, Form, express
from gtcal.errors import GtcalError

# Lenses that gtcal has no model of


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_PINHOLE", [500, 320.5, 240.5]),
        ("SIMPLE_RADIAL", [500, 320.5, 240.5, -0.05]),
        ("RADIAL", [500, 320.5, 240.5, -0.05, 0.01]),
        ("OPENCV", [500, 510, 320.5, 240.5, -0.05, 0.01, 0.001, -0.002]),
        ("FULL_OPENCV", [500, 510, 320.5, 240.5, -0.05, 0.01, 0.001, -0.002, 0.003, 0, 0, 0]),
        ("FULL_OPENCV", [500, 510, 320.5, 240.5, -0.05, 0.01, 0.001, -0.002, 0.003, 0.01, 0.002, 0.001]),
        ("SIMPLE_FISHEYE", [300, 320.5, 240.5]),
        ("FISHEYE", [300, 310, 320.5, 240.5]),
        ("SIMPLE_RADIAL_FISHEYE", [300, 320.5, 240.5, 0.02]),
        ("RADIAL_FISHEYE", [300, 320.5, 240.5, 0.02, -0.003]),
        ("OPENCV_FISHEYE", [300, 310, 320.5, 240.5, 0.02, -0.003, 0.001, -0.0002]),
        ("THIN_PRISM_FISHEYE", [300, 310, 320.5, 240.5, 0.02, -0.003, 0, 0, 0.001, -0.0002, 0, 0]),
        ("THIN_PRISM_FISHEYE", [300, 310, 320.5, 240.5, 0.02, -0.003, 0.001, 0.002, 0.001, -0.0002, 0.001, 0.002]),
        ("RAD_TAN_THIN_PRISM_FISHEYE", [300, 310, 320.5, 240.5, *ARIA[4:]]),
        ("EUCM", [300, 310, 320.5, 240.5, 0.62, 1.04]),
        ("FOV", [400, 410, 320.5, 240.5, 0.8]),
    ],
)
def test_every_lens_of_colmaps_is_read_as_pycolmap_has_it_or_within_its_stated_loss(
    model: str, params: list[float], tmp_path: Path
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    text = f"1 {model} 640 480 {' '.join(map(str, params))}\n"
    (tmp_path / "cameras.txt").write_text(text)
    refused = said(tmp_path / "cameras.txt", None)
    (camera,) = read_text_as(tmp_path, "cameras.txt", text, nearest=True).cameras
    if refused is None:
        assert camera.lens_off_px == 0
    else:
        assert "gtcal has no model of; the nearest" in refused
        assert camera.lens_off_px == pytest.approx(float(refused.split(" px rms and ")[1].split()[0]), rel=0.01)
    theirs = pycolmap.Camera(model=model, width=640, height=480, params=params)
    points = points_in(camera.camera, share=0.98)
    points = points[points[:, 2] > 0]
    off_px = np.linalg.norm(np.array(theirs.img_from_cam(points)) - 0.5 - camera.camera.project(points)[0], axis=1)
    assert off_px.max() <= 1.05 * camera.lens_off_px + 1e-9


def test_a_rational_polynomial_is_read_as_it_is(tmp_path: Path) -> None:
    text = CAMERA_INFO_MESSAGE.replace("0.0, 0.0, 0.0, 0.0]\nk:", "0.01, 0.02, 0.03, 0.01]\nk:")
    (camera,) = read_text_as(tmp_path, "info.yaml", text).cameras
    assert camera.camera.model.name == "pinhole_rational"
    np.testing.assert_array_equal(camera.camera.theta[4:], [-0.36, 0.11, 0.001, 0.0005, 0.01, 0.02, 0.03, 0.01])


def test_opencvs_thin_prism_is_refused_with_its_loss_unless_the_nearest_will_do(tmp_path: Path) -> None:
    thin_prism = "0.01, 0.02, 0.03, 0.01, 0.002, 0.0005, -0.002, 0.0002]\nk:"
    text = CAMERA_INFO_MESSAGE.replace("0.0, 0.0, 0.0, 0.0]\nk:", thin_prism)
    with pytest.raises(
        GtcalError, match=r"12 coefficients, which gtcal has no model of; .* off by .* 'gtcal convert --near"
    ):
        read_text_as(tmp_path, "info.yaml", text)
    (camera,) = read_text_as(tmp_path, "info.yaml", text, nearest=True).cameras
    assert 0.1 < camera.lens_off_px < 2


# The nearest lens


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("form", [PINHOLE, RADTAN4, KB4, F62])
def test_the_nearest_lens_is_nearest(lens: str, form: Form) -> None:
    """No small step of any parameter is better: a minimum, for every lens in every form."""
    camera = LENSES[lens]
    grid = np.stack(
        np.meshgrid(np.linspace(0, camera.image_width_px - 1, 25), np.linspace(0, camera.image_height_px - 1, 25))
    )
    bearings, valid = camera.unproject(grid.reshape(2, -1).T)
    if form in (PINHOLE, RADTAN4) and bearings[valid, 2].min() < np.cos(np.deg2rad(85.0)):
        with pytest.raises(GtcalError, match="has a bearing for every pixel of the image, which reaches"):
            express(camera, format_name="it", forms=(form,), nearest=True)
        return
    found = express(camera, format_name="it", forms=(form,), nearest=True)
    if found.max_px == 0:
        return

    def rms_px(theta: np.ndarray) -> float:
        off = form.model.project(bearings[valid], theta)[0] - grid.reshape(2, -1).T[valid]
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))

    assert rms_px(found.theta) == pytest.approx(found.rms_px, rel=1e-6)
    for i in range(form.n_free):
        for sign in (-1, 1):
            step = np.zeros(len(found.theta))
            step[i] = sign * max(1e-4 * abs(found.theta[i]), 1e-6)
            assert rms_px(found.theta + step) > found.rms_px * (1 - 1e-6)


def test_a_pinhole_that_is_to_hold_more_than_90_degrees_is_refused_even_as_the_nearest() -> None:
    with pytest.raises(GtcalError, match=r"camera 'fisheye': it can't express .* no lens that it can .* 1\d\d deg off"):
        express(LENSES["fisheye"], format_name="it", forms=(PINHOLE, RADTAN4), nearest=True)


def test_a_fisheye_past_90_degrees_says_so_where_opencv_stops(tmp_path: Path) -> None:
    for format_name in ("kalibr", "opencv", "pose2sim"):
        text = written(tmp_path, format_name, rig_of("fisheye", "radtan")).read_text()
        assert len([line for line in text.splitlines() if "OpenCV and COLMAP project up to 90" in line]) == 1
