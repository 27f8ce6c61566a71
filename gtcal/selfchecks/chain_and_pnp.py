"""Chain against PnP: what the mocap adds to the error of the pixels, and what the calibration adds to that.

A pose of each view's own (PnP) leaves what lens model and detector err by. The chain of a calibration that has seen the
view adds the mocap's error of that moment. The chain of one that has not adds its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from factors.moments import chain
from factors.reprojection import residuals_px
from factors.rigid import inverse
from gtcal.estimation.estimate import Estimate
from gtcal.estimation.observations import Views
from gtcal.estimation.pnp import refine_poses
from gtcal.estimation.residuals import chain_residuals_px, corner_views
from gtcal.selfchecks.folds import rms_length


@dataclass(frozen=True)
class ChainAndPnp:
    """Of one camera; RMS lengths in px.

    pnp_px: with a pose of each view's own. chain_px: of the chain. hold_out_px: of chains that have not seen the view.
    scatter_mm, scatter_deg: how far the board's pose by the chain is from that by PnP, typically (median), at the
        middle of what is seen of it.
    """

    camera: str
    pnp_px: float
    chain_px: float
    hold_out_px: float
    scatter_mm: float
    scatter_deg: float

    @property
    def mocap_px(self) -> float:
        """What the mocap adds."""
        return float(np.sqrt(max(self.chain_px**2 - self.pnp_px**2, 0.0)))

    @property
    def calibration_px(self) -> float:
        """What the calibration adds."""
        return float(np.sqrt(max(self.hold_out_px**2 - self.chain_px**2, 0.0)))

    @property
    def statement(self) -> str:
        """Which part is the largest."""
        parts = {"lens model and detector": self.pnp_px, "mocap": self.mocap_px, "calibration": self.calibration_px}
        largest = max(parts, key=lambda name: parts[name])
        return f"camera {self.camera!r}: most of the error is of the {largest} ({parts[largest]:.2g} px)"


def chain_and_pnp(views: Views, estimate: Estimate, hold_out_px: float) -> ChainAndPnp:
    """The estimate's chain against PnP, on the views of one camera."""
    name, model = views.camera.name, views.camera.model
    camera = replace(views.camera, parameters=estimate.theta[name])
    corners = corner_views(views)
    by_chain = chain(estimate.camera_T_ref[name], views.ref_T_body, estimate.body_T_board)
    by_pnp = refine_poses(corners, camera, by_chain).camera_T_board
    middle_m = views.corners_m.mean(axis=0)
    offset_m = (by_pnp - by_chain)[:, :3, :3] @ middle_m + (by_pnp - by_chain)[:, :3, 3]
    turned = inverse(by_chain) @ by_pnp
    return ChainAndPnp(
        name,
        rms_length(residuals_px(corners, by_pnp, model, camera.theta)),
        rms_length(chain_residuals_px(views, estimate)),
        hold_out_px,
        1e3 * float(np.median(np.linalg.norm(offset_m, axis=1))),
        float(np.rad2deg(np.median(Rotation.from_matrix(turned[:, :3, :3]).magnitude()))),
    )
