"""Pass, fail or inconclusive: on bounds, not on luck."""

from __future__ import annotations

from collections.abc import Iterable

from gtcal.verification.verification import ErrorStatistics, Verdict, VerificationOptions


def camera_verdict(
    px: ErrorStatistics, mm: ErrorStatistics, n_independent: float, coverage: float, options: VerificationOptions
) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict on one camera, and why it is not a pass.

    A tolerance is exceeded where the RMSE's lower bound lies above it, and kept where the upper one lies below. What
    is exceeded with confidence stays exceeded, however little of the image was covered; to pass takes both."""
    failures = [*_exceeded(px, options.max_rmse_px, options), *_exceeded(mm, options.max_rmse_mm, options)]
    if failures:
        return Verdict.FAIL, tuple(failures)
    open_points = [
        *_too_little(px.count, n_independent, coverage, options),
        *_undecided(px, options.max_rmse_px, options),
        *_undecided(mm, options.max_rmse_mm, options),
    ]
    return (Verdict.INCONCLUSIVE, tuple(open_points)) if open_points else (Verdict.PASS, ())


def overall_verdict(verdicts: Iterable[Verdict]) -> Verdict:
    """Fail where one fails, else inconclusive where one is."""
    given = set(verdicts)
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE):
        if verdict in given:
            return verdict
    return Verdict.PASS


def _exceeded(errors: ErrorStatistics, limit: float, options: VerificationOptions) -> list[str]:
    if not errors.rmse_low > limit:
        return []
    return [
        f"RMSE {errors.rmse:.3f} {errors.unit} exceeds {limit:g} {errors.unit} (above {errors.rmse_low:.3f} with "
        f"{100 * options.confidence:g} % confidence)"
    ]


def _undecided(errors: ErrorStatistics, limit: float, options: VerificationOptions) -> list[str]:
    if not errors.rmse_high > limit:
        return []
    return [
        f"RMSE {errors.rmse:.3f} {errors.unit} is too near to the limit of {limit:g} {errors.unit} to decide (between "
        f"{errors.rmse_low:.3f} and {errors.rmse_high:.3f}, each with {100 * options.confidence:g} % confidence)"
    ]


def _too_little(count: int, n_independent: float, coverage: float, options: VerificationOptions) -> list[str]:
    reasons = []
    if count < options.min_sightings:
        reasons.append(f"{count} sightings are too few; {options.min_sightings} are needed")
    elif n_independent < options.min_blocks:
        reasons.append(
            f"the errors are so correlated in time that the recording has {n_independent:.1f} independent stretches; "
            f"{options.min_blocks} are needed"
        )
    if coverage < options.min_coverage:
        reasons.append(
            f"the device was shown in {100 * coverage:.0f} % of the image; {100 * options.min_coverage:.0f} % are "
            "needed"
        )
    return reasons
