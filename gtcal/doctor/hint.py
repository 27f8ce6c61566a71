"""What a calibration that goes wrong says of the cause, from what is at hand: cheap, and less than the doctor finds."""

from __future__ import annotations

from gtcal.doctor.chain_search import ChainSearch
from gtcal.estimation.alignment import guides_of
from gtcal.estimation.observations import Observations
from gtcal.estimation.screening import GROSS_VIEW
from gtcal.estimation.solver_warnings import MANY_DROPPED, fit_warnings
from gtcal.results.calibration import Calibration

ALONE_PX = 2.0
"""Corners so far off, typically, with a board pose of their view's own, tell of a wrong lens or board."""


def likely_mistake(observations: Observations, *, seed: int, max_views: int) -> str:
    """What to change so that the data agree, with the evidence; empty where no single other reading of the trajectories
    helps."""
    search = ChainSearch(guides_of(observations.views, max_views), seed)
    stated = search.fit(observations.motion)
    found = search.one_reading(observations.motion, stated)
    if found is None:
        return ""
    (reading,) = found.readings
    fixes = " and ".join((*(f"set {line}" for line in reading.lines), *reading.advice))
    return (
        f"likely {reading.says}: they agree to {found.fit.misfit_mm:.1f} mm instead of {stated.misfit_mm:.1f} mm if "
        f"you {fixes}" + (" in the manifest" if reading.lines else "")
    )


def looks_wrong(calibration: Calibration) -> bool:
    """Whether a calibration that was just computed looks like one of a recording with a fault: the views fit no board
    pose of their own, or none in the chain, or many of them were left out."""
    names = [report.name for report in calibration.stages]
    stages = calibration.stages[names.index("PnP") :]
    if not stages[0].median_px < ALONE_PX or fit_warnings(stages, calibration.mocap_noise):
        return True
    kept = {name: camera.residuals.n_views for name, camera in calibration.cameras.items()}
    gross = {drop.camera: drop.n_views for drop in calibration.dropped if drop.reason == GROSS_VIEW}
    return any(n / (n + kept[name]) > MANY_DROPPED for name, n in gross.items())
