"""Sub-pixel centres of dots.

The light that a dot takes from its surroundings has a centroid, which is that of the dot's image. Neither perspective
nor the lens takes the middle of a disc to the middle of its image: a dot's outline, carried into the image by the
homography of the dots around it, tells how far the two are apart, and that is taken off (Heikkila 2000)."""

from __future__ import annotations

import math

import numpy as np

from factors.kernel import kernel
from gtcal.camera import Camera, FloatArray
from gtcal.detection.local_warp import fit_local_warps
from gtcal.detection.sight import board_image, sight_of
from gtcal.plain_boards import DotGrid
from gtcal.recordings.detections import IntArray
from gtcal.recordings.images import GreyImage

_ROUNDS = 3
_OUTLINE = 48
# A window ends, and the ring of background around it, in radii of the dot; no further than half-way to the next dot.
_WINDOW, _RING = 1.25, 1.6
# A dot is refused where it ends so far from where its neighbours say, or takes less light than this.
_ASTRAY_PX, _ASTRAY_PART, _FAINTEST_GREY = 1.0, 0.25, 8.0


def refined_dots(
    image: GreyImage, board: DotGrid, camera: Camera | None, found_px: FloatArray
) -> tuple[FloatArray, IntArray]:
    """(C, 2) the images of the dots' centres, from where they were found roughly, and the ids of those that look like
    dots."""
    centres_m = board.corners_m[:, :2]
    reach = 0.5 * _closest_m(centres_m) / board.radius_m
    window, ring = min(_WINDOW, 0.5 * (1.0 + reach)), min(_RING, reach)
    turn = np.linspace(0.0, 2.0 * np.pi, _OUTLINE, endpoint=False)
    outline_m = centres_m[:, None] + board.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pixels_px, good = found_px.copy(), np.ones(len(found_px), dtype=np.bool_)
    for _ in range(_ROUNDS):
        sight = sight_of(camera, image.shape[:2], centres_m, pixels_px)
        warps = fit_local_warps(
            centres_m,
            sight.to_plane(pixels_px),
            centres_m,
            spread_m=board.pitch_m,
            leave_out=np.arange(len(centres_m)),
        )
        shown = board_image(sight, *warps.at_centres(), step_m=0.05 * board.pitch_m)
        outlines_px = sight.to_pixels(warps.apply(outline_m).reshape(-1, 2)).reshape(outline_m.shape)
        offsets_px = _polygon_centroids(outlines_px) - shown.pixels_px
        measured = np.full((len(pixels_px), 3), np.nan)
        _centroids(image, pixels_px + offsets_px, shown.px_per_m * board.radius_m, window, ring, measured)
        centres_px = measured[:, :2] - offsets_px
        astray_px = np.linalg.norm(centres_px - shown.pixels_px, axis=1)
        size_px = np.sqrt(np.abs(np.linalg.det(shown.px_per_m))) * board.radius_m
        with np.errstate(invalid="ignore"):
            good = (astray_px < np.maximum(_ASTRAY_PX, _ASTRAY_PART * size_px)) & (measured[:, 2] > _FAINTEST_GREY)
        pixels_px = np.where(good[:, None], centres_px, pixels_px)
    return pixels_px, np.flatnonzero(good)


def _closest_m(centres_m: FloatArray) -> float:
    apart = np.linalg.norm(centres_m[1:] - centres_m[0], axis=1)
    return float(apart.min())


def _polygon_centroids(outlines_px: FloatArray) -> FloatArray:
    """(N, 2) of the areas of polygons (N, K, 2)."""
    origin = outlines_px[:, :1]
    x, y = np.moveaxis(outlines_px - origin, 2, 0)
    next_x, next_y = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    cross = x * next_y - next_x * y
    area = cross.sum(axis=1)
    about = np.stack([((x + next_x) * cross).sum(axis=1), ((y + next_y) * cross).sum(axis=1)], axis=1)
    return np.asarray(origin[:, 0] + about / (3.0 * area[:, None]))


@kernel
def _centroids(image, middles_px, px_per_radius, window, ring, found):  # type: ignore[no-untyped-def]
    """Of the darkness against the mean light of the ring, within the window, both ellipses; and how dark it is."""
    height, width = image.shape
    for i in range(len(middles_px)):
        a, b = px_per_radius[i, 0, 0], px_per_radius[i, 0, 1]
        c, d = px_per_radius[i, 1, 0], px_per_radius[i, 1, 1]
        area = a * d - b * c
        x0, y0 = middles_px[i, 0], middles_px[i, 1]
        if not abs(area) > 1e-9 or not math.isfinite(x0 + y0):
            continue
        reach_x, reach_y = ring * math.hypot(a, b) + 1.0, ring * math.hypot(c, d) + 1.0
        left, right = math.floor(x0 - reach_x), math.ceil(x0 + reach_x)
        top, bottom = math.floor(y0 - reach_y), math.ceil(y0 + reach_y)
        if left < 0 or top < 0 or right >= width or bottom >= height:
            continue
        # half a pixel and the lens's blur wider, so that no light of the dot is cut off
        soft = 1.0 / math.sqrt(abs(area))
        light, n = 0.0, 0
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                u = (d * (x - x0) - b * (y - y0)) / area
                v = (-c * (x - x0) + a * (y - y0)) / area
                r = math.hypot(u, v)
                if window + soft < r <= ring + soft:
                    light += image[y, x]
                    n += 1
        if n < 8:
            continue
        light /= n
        dark, at_x, at_y, peak = 0.0, 0.0, 0.0, 0.0
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                u = (d * (x - x0) - b * (y - y0)) / area
                v = (-c * (x - x0) + a * (y - y0)) / area
                if math.hypot(u, v) <= window + soft:
                    weight = light - image[y, x]
                    dark += weight
                    at_x += weight * (x - x0)
                    at_y += weight * (y - y0)
                    peak = max(peak, weight)
        if dark > 0.0:
            found[i, 0], found[i, 1], found[i, 2] = x0 + at_x / dark, y0 + at_y / dark, peak
