"""What a user can choose about a calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from factors import GAUSSIAN, AnyKernel, kernel_of
from gtcal.errors import GtcalError
from gtcal.estimation.priors import Priors

REDESCENDING = ("GemanMcClure", "TruncatedLeastSquares", "Tukey", "Welsch", "Cauchy")
"""Kernels under which what lies far off hardly counts."""

IntrinsicsMode = Literal["exact", "fixed", "auto", "refine", "calibrate", "calibrate+refine"]
"""auto: solved for jointly with the extrinsics, near what the recording states, by its sigmas; found first where it
states nothing. fixed: held at what the recording states, whose sigmas count in the covariance. exact: held, and taken
for known exactly, as in the paper. refine: solved for jointly, under ``intrinsics_prior``. calibrate: found first, by a
plain calibration from the views, then as auto, near what was found; calibrate+refine: found first, then as refine.
What the recording states is not used by these two."""

IntrinsicsPrior = Literal["weak", "stated"]

BoardMode = Literal["auto", "exact"]
"""auto: where intrinsics are solved for, so is the board's shape (its scale, stretch, bow and twist), near a flat board
as stated, by the tolerance that the recording states or that of a printed board. exact: flat and as stated."""

MocapMode = Literal["estimate", "exact"]

SegmentsMode = Literal["none", "auto"]
"""none: one set of poses for the whole recording. auto: where markers or a camera moved during it, one for each stretch
between the changes, all that did not move shared."""

SweepMode = Literal["converged", "paper"]
"""Of stage 1. converged: from each start the paper's sweep of closed-form updates, then on to the minimum of E_3D; and
where no chain comes close to most views, consensus. paper: the sweep alone."""

ClockMode = Literal["test", "estimate", "per_camera", "trust"]
"""test: the stamps are taken as they are, and a warning says what offset the data want. estimate: one offset between
all cameras and the mocap is found and corrected. per_camera: one for each. trust: the stamps are taken as they are."""


@dataclass(frozen=True)
class MocapSigmas:
    """How precisely the mocap measures a tracked body: 1-sigma of each component of world_T_body * Exp(noise), along
    and about the body's axes.

    Raises GtcalError where a sigma is not positive."""

    translation_mm: float
    rotation_deg: float

    def __post_init__(self) -> None:
        for name in ("translation_mm", "rotation_deg"):
            if not getattr(self, name) > 0.0:
                raise GtcalError(f"the mocap's sigma {name}: {getattr(self, name)} is not a positive number")


@dataclass(frozen=True)
class CalibrationOptions:
    """Options of ``gtcal.calibrate``.

    intrinsics: see ``IntrinsicsMode``.
    intrinsics_prior: where they are refined: 'weak', the paper's, or 'stated', the recording's values with its sigmas,
        as for 'auto'.
    focal_sigma_px, centre_sigma_px, distortion_sigma: of all cameras' stated intrinsics; None for those that the
        recording states with them, and where it states none, those of a factory's calibration
        (``gtcal.estimation.lens_sigmas``).
    board: see ``BoardMode``.
    robust: kernel of stage 3, on the whitened norm of each corner: a ``factors.RobustKernel``, the name of one
        ('Huber', with its usual parameter), or any estimator of ``gtsam.noiseModel.mEstimator``. One's own,
        ``mEstimator.Custom``, is called back from Python for every corner, which is slower.
    sigma_px: standard deviation of a pixel coordinate; None to estimate it from the residuals.
    mocap: what stage 4 takes for the mocap's noise: 'estimate' it from the recording, or the sigmas that are given;
        'exact': no stage 4, the mocap's poses are taken as exact.
    stages: those to run, of 1 (Procrustes sweep), 2 (3-D alignment), 3 (pixels).
    eps: a minimisation stops where an iteration improves the error E by less than eps (1 + E).
    screen: leave gross views and corners out.
    sweep: of stage 1, see ``SweepMode``.
    pnp_views: at most this many views per camera guide stages 1 and 2.
    seed: of the random starting rotations.
    allow_degenerate: solve even where the motion cannot determine the result.
    priors: what is known beforehand of poses and intrinsics.
    graduated: stage 3 begins with a kernel so wide that nothing is an outlier to it, and narrows it step by step to
        ``robust`` (graduated non-convexity: Yang et al. 2020; with GemanMcClure it is theirs). For data with so many
        outliers that screening by medians fails; a redescending kernel is needed, and ``screen`` may be off.

    effects: look for what the model leaves out (a slip of markers, a bumped camera, a clock, a lens, a scale).
    segments: see ``SegmentsMode``; 'auto' needs ``effects``, which find the changes.
    clock: see ``ClockMode``. clock_drift: where the offset is estimated, let it grow linearly in time.

    Raises GtcalError for a choice that makes no sense."""

    intrinsics: IntrinsicsMode = "auto"
    intrinsics_prior: IntrinsicsPrior = "weak"
    focal_sigma_px: float | None = None
    centre_sigma_px: float | None = None
    distortion_sigma: float | None = None
    board: BoardMode = "auto"
    robust: AnyKernel = field(default=GAUSSIAN)
    sigma_px: float | None = None
    mocap: MocapSigmas | MocapMode = "estimate"
    stages: tuple[int, ...] = (1, 2, 3)
    eps: float = 1e-4
    max_iterations: int = 100
    screen: bool = True
    sweep: SweepMode = "converged"
    pnp_views: int = 100
    seed: int = 0
    allow_degenerate: bool = False
    priors: Priors = field(default_factory=Priors)
    graduated: bool = False
    clock: ClockMode = "test"
    clock_drift: bool = False
    effects: bool = True
    segments: SegmentsMode = "none"

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "robust", kernel_of(self.robust))
        except ValueError as error:
            raise GtcalError(str(error)) from None
        if not self.stages or not set(self.stages) <= {1, 2, 3} or list(self.stages) != sorted(set(self.stages)):
            raise GtcalError(f"stages: {self.stages} is not a choice of 1, 2 and 3 in their order")
        modes = {
            "intrinsics": IntrinsicsMode,
            "intrinsics_prior": IntrinsicsPrior,
            "board": BoardMode,
            "clock": ClockMode,
            "segments": SegmentsMode,
            "sweep": SweepMode,
        }
        if not isinstance(self.mocap, MocapSigmas):
            modes["mocap"] = MocapMode
        for name, mode in modes.items():
            if getattr(self, name) not in get_args(mode):
                raise GtcalError(f"{name}: {getattr(self, name)!r} is none of {', '.join(get_args(mode))}")
        if self.segments == "auto" and not (self.effects and 3 in self.stages and self.mocap != "exact"):
            raise GtcalError(
                "segments are found among the effects, in what the mocap's noise does not explain: they need stage 3, "
                "effects, and a mocap that is not exact"
            )
        if self.intrinsics in ("refine", "calibrate+refine") and 3 not in self.stages:
            raise GtcalError("intrinsics are refined in stage 3, but stages leave it out")
        if isinstance(self.mocap, MocapSigmas) and 3 not in self.stages:
            raise GtcalError("mocap noise is modelled from where stage 3 ends, but stages leave it out")
        for name in ("eps", "focal_sigma_px", "centre_sigma_px", "distortion_sigma", "sigma_px"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise GtcalError(f"{name}: {value} is not a positive number")
        if self.clock_drift and self.clock not in ("estimate", "per_camera"):
            raise GtcalError(f"clock_drift asks for a clock that is estimated, but clock is {self.clock!r}")
        if self.clock_drift and self.clock == "per_camera":
            raise GtcalError("clock_drift is of a clock that all cameras share: set clock to 'estimate'")
        if self.graduated and self.robust.name not in REDESCENDING:
            raise GtcalError(
                f"graduated non-convexity needs a redescending kernel ({', '.join(REDESCENDING)}), not "
                f"{self.robust.name!r}"
            )
        for name, least in (("max_iterations", 1), ("pnp_views", 3), ("seed", 0)):
            if getattr(self, name) < least:
                raise GtcalError(f"{name}: {getattr(self, name)} is less than {least}")

    @property
    def refine_intrinsics(self) -> bool:
        """Whether the intrinsics are solved for jointly with the extrinsics."""
        return self.intrinsics not in ("exact", "fixed") and 3 in self.stages

    @property
    def solves_board_shape(self) -> bool:
        """Whether the board's shape is solved for jointly with the extrinsics and intrinsics."""
        return self.board == "auto" and self.trusts_stated_intrinsics

    @property
    def trusts_stated_intrinsics(self) -> bool:
        """Whether intrinsics that are solved for stay near what the recording states, by its sigmas."""
        return self.refine_intrinsics and (
            self.intrinsics in ("auto", "calibrate") or self.intrinsics_prior == "stated"
        )
