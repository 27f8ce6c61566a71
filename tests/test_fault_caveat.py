"""A finding says how much of the error it explains."""

from __future__ import annotations

import numpy as np
import pytest

from gtcal.verification.verification import Fault


def fault(before_px: float, after_px: float) -> Fault:
    return Fault(
        kind="camera_moved",
        camera="cam0",
        correction=np.eye(4),
        focal_share=0.0,
        offset_s=0.0,
        shift_mm=1.0,
        turn_deg=0.0,
        shift_sigma_mm=0.1,
        turn_sigma_deg=0.01,
        p_value=1e-9,
        rmse_before_px=before_px,
        rmse_after_px=after_px,
        also_possible=(),
        sentence="camera 'cam0' moved by 1.00 mm",
    )


def test_the_main_cause_needs_no_caveat() -> None:
    assert fault(1.0, 0.2).explained_share == pytest.approx(0.96)
    assert fault(1.0, 0.2).caveat == ""


def test_a_finding_that_hardly_helps_says_so() -> None:
    assert "only 15% of the squared error" in fault(1.21, 1.115).caveat
