"""Stage 3 or stage 4: which estimate a calibration takes, and why."""

from __future__ import annotations

from gtcal.estimation.errors_in_variables import MocapNoiseFit
from gtcal.estimation.mocap_noise import Whiteness
from gtcal.results.calibration import MocapNoise

WORSE, WORSE_SIGMAS, MUCH_WORSE = 1.01, 1.0, 1.05
"""Stage 4 has not earned its place where its hold-out error is over 1 % larger than stage 3's, and that by over one
standard error, or over 5 % larger, whatever that may be by chance: it then takes for noise what is systematic."""

MOST_DROPPED = 0.1
"""Nor where it would have to leave out more than this share of the views, as off by more than its noise."""

NOT_WHITE, NOT_CHANCE = 0.4, 4.0
"""Innovations are not white where their correlation from frame to frame is over 0.4 and over 4 sigma of chance."""


def choose(fit: MocapNoiseFit, whiteness: Whiteness) -> MocapNoise:
    """The stage to take, with what it rests on."""
    hold_out_px = {3: fit.hold_out.exact_rmse_px, 4: fit.hold_out.noisy_rmse_px}
    stage, reason = _choice(hold_out_px, fit, whiteness)
    noise = fit.noise
    return MocapNoise(
        translation_sigma_mm={name: sigmas.translation_mm for name, sigmas in noise.bodies.items()},
        rotation_sigma_deg={name: sigmas.rotation_deg for name, sigmas in noise.bodies.items()},
        correlation_s=noise.correlation_s,
        jitter_s=noise.jitter_s,
        estimated=noise.estimated,
        innovation_variance=whiteness.variance,
        lag_1=whiteness.lag_1,
        lag_1_sigma=whiteness.lag_1_sigma,
        hold_out_px=hold_out_px,
        stage=stage,
        reason=reason,
    )


def _choice(hold_out_px: dict[int, float], fit: MocapNoiseFit, whiteness: Whiteness) -> tuple[int, str]:
    if fit.gross_share > MOST_DROPPED:
        return 3, f"{fit.gross_share:.0%} of the views lie off by more than noise explains, so it is not noise"
    compared = f"hold-out {hold_out_px[4]:.3g} px with the mocap's noise modelled, {hold_out_px[3]:.3g} px without"
    surely = fit.hold_out.noisy_worse_by_sigmas > WORSE_SIGMAS
    if hold_out_px[4] > (WORSE if surely else MUCH_WORSE) * hold_out_px[3]:
        return 3, f"{compared}: what the mocap errs by is systematic, not noise"
    lag_1 = whiteness.lag_1
    if lag_1 > max(NOT_WHITE, NOT_CHANCE * whiteness.lag_1_sigma):
        return 3, f"the mocap's errors are not white (correlation {lag_1:.2f} from frame to frame), so not noise"
    return 4, compared
