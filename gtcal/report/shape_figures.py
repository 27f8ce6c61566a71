"""Figures of what a calibration found beside poses: the board's shape, and what else the data want."""

from __future__ import annotations

import numpy as np

from factors.board_shape import outline_of, shaped
from gtcal.board import board_from_manifest
from gtcal.report.pictures import BLUE, MUTED, Picture, picture, styled_figure
from gtcal.results.board_shape import BoardShape
from gtcal.results.calibration import Calibration
from gtcal.results.effect_finding import EffectFinding

_CELLS, _ARROWS = 60, 7
_HEIGHTS = "RdBu_r"
"""Blue below, red above, white where it is flat."""

_LEAST_HEIGHT_MM = 0.1
"""The deepest colour stands for at least this, so that a flat board looks flat."""


def shape_picture(calibration: Calibration) -> Picture | None:
    """How high the board stands out of its plane, and how its corners lie beside where they are stated; None where its
    shape was not solved for."""
    found = calibration.board_shape
    if found is None:
        return None
    outline_m = outline_of(board_from_manifest(calibration.board).corners_m)
    middle_m, half_m = outline_m[:2], outline_m[2:]
    axes_m = [middle + half * np.linspace(-1.0, 1.0, _CELLS) for middle, half in zip(middle_m, half_m, strict=True)]
    flat_m = np.stack([*np.meshgrid(*axes_m), np.zeros((_CELLS, _CELLS))], axis=-1)
    heights_mm = 1e3 * shaped(flat_m.reshape(-1, 3), outline_m, found.shape)[:, 2].reshape(_CELLS, _CELLS)
    highest_mm = max(float(np.abs(heights_mm).max()), _LEAST_HEIGHT_MM)
    with styled_figure() as figure:
        axes = figure.add_subplot(aspect="equal")
        extent = 1e3 * np.array([axes_m[0][0], axes_m[0][-1], axes_m[1][-1], axes_m[1][0]])
        shown = axes.imshow(heights_mm, extent=tuple(extent), cmap=_HEIGHTS, vmin=-highest_mm, vmax=highest_mm)
        figure.colorbar(shown, ax=axes, label="out of the plane, mm", shrink=0.8, aspect=24)
        every = np.s_[:: _CELLS // _ARROWS, :: _CELLS // _ARROWS]
        at_m = flat_m[every].reshape(-1, 3)
        aside_mm = 1e3 * (shaped(at_m, outline_m, found.shape) - at_m)[:, :2]
        x_mm, y_mm = 1e3 * at_m[:, :2].T
        axes.quiver(x_mm, y_mm, *aside_mm.T, angles="xy", color=MUTED, width=0.005)
        axes.set(xlabel="x, mm", ylabel="y, mm")
        axes.grid(False)
        longest_mm = float(np.linalg.norm(aside_mm, axis=1).max())
        return picture(
            figure,
            "The board's shape",
            f"{'; '.join(shape_lines(found))}. Arrows: how corners lie beside where they are stated, the longest "
            f"{longest_mm:.2g} mm.",
        )


def shape_lines(found: BoardShape) -> tuple[str, ...]:
    """A number each, with its 1-sigma."""
    return tuple(f"{part.what} {part.value:+.3f} ± {part.sigma:.3f} {part.unit}" for part in found.parts)


def effect_picture(finding: EffectFinding) -> Picture:
    """How far an effect would move each camera if it were let in."""
    names = list(finding.moves_mm)
    places = np.arange(len(names))
    with styled_figure(3.9, 0.9 + 0.28 * len(names)) as figure:
        for index, (moves, unit) in enumerate(((finding.moves_mm, "mm"), (finding.moves_deg, "deg"))):
            axes = figure.add_subplot(1, 2, index + 1)
            axes.barh(places, [moves[name] for name in names], color=BLUE, height=0.6)
            axes.set_yticks(places, names if index == 0 else [""] * len(names))
            axes.invert_yaxis()
            axes.grid(False, axis="y")
            axes.set_xlabel(f"would move, {unit}")
        when = f" at {finding.moment.text}" if finding.moment else ""
        return picture(
            figure, f"{finding.name}: {finding.size}{when}", "How far each camera would move if it were let in."
        )
