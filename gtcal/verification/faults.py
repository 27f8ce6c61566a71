"""What the errors look like: the smallest correction that explains them, and whose it is.

Candidates: a rigid correction that all cameras share (the markers of the headset moved), one of a single camera,
another focal length of a single camera (its lens warmed up), a shift of the device's own centre, and an offset of the
cameras' clock. Each is fitted to
the errors in px, robustly, and tested against chance with a covariance that accounts for what the sightings of a frame
share and for the correlation in time (``gtcal.verification.blocks``), plus what the calibration itself leaves open. Of
those that pass, the one that leaves the smallest errors for the fewest parameters is the finding; with it applied the
search goes on, so that two moved cameras are two findings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from factors.rigid import adjoint
from gtcal.camera import BoolArray, FloatArray
from gtcal.recordings.capture import Capture
from gtcal.results.calibration import Calibration
from gtcal.verification.blocks import fit_covariance
from gtcal.verification.fault_model import (
    HUBER,
    SETTLED_PX,
    Candidate,
    Sighted,
    State,
    correction_between,
    exp_of,
    huber_weights,
    linearised,
    moved,
    noise_px,
    project,
    rms,
    rows_of,
    sighted,
)
from gtcal.verification.verification import Fault, Sightings, VerificationOptions

_STEPS = 12
_FEWEST_FRAMES = 16


@dataclass(frozen=True)
class _Fit:
    """A fitted candidate.

    correction: (K,) rotation vector and translation, shift, logarithm of the focal length's growth, or time.
    covariance: of the same. p_value: that it is chance. effect_px: RMS shift of the image centres it concerns.
    loss: (F,) robust loss of every frame. inflation: for the correlation in time."""

    candidate: Candidate
    state: State
    correction: FloatArray
    covariance: FloatArray
    p_value: float
    effect_px: float
    loss: FloatArray
    inflation: float
    rmse_before_px: float
    rmse_after_px: float


def find_faults(
    sightings: Mapping[str, Sightings], calibration: Calibration, options: VerificationOptions
) -> tuple[Fault, ...]:
    """The corrections that explain the errors significantly better than chance, the first one first; empty where there
    are none or too little data."""
    sightings = {name: seen for name, seen in sightings.items() if len(seen)}
    data = sighted(sightings)
    if data is None:
        return ()
    state = State(np.stack([seen.camera_T_ref for seen in sightings.values()]), np.zeros(len(sightings)), np.zeros(3))
    search = _Search(data, calibration, tuple(sightings), options, noise_px(data, state))
    candidates = search.candidates()
    level = options.false_alarm_rate / len(candidates)
    faults: list[Fault] = []
    real = search.real(candidates, state, level)
    while real:
        best = min(real, key=search.score)
        candidates = [candidate for candidate in candidates if candidate != best.candidate]
        still_real = search.real(candidates, best.state, level)
        # Another explanation is as good where either correction leaves the other one nothing to explain.
        explained = [fit for fit in real if fit is not best and not _is_among(fit, still_real)]
        as_good = [fit for fit in explained if not search.real([best.candidate], fit.state, level)]
        faults.append(search.fault(best, as_good))
        real = still_real
    return tuple(faults)


def find_clock_offset(
    sightings: Mapping[str, Sightings], calibration: Calibration, options: VerificationOptions
) -> tuple[float, float] | None:
    """What is to be added to the cameras' stamps, with its 1-sigma, in s; None where there is too little data."""
    sightings = {name: seen for name, seen in sightings.items() if len(seen)}
    data = sighted(sightings)
    if data is None:
        return None
    state = State(np.stack([seen.camera_T_ref for seen in sightings.values()]), np.zeros(len(sightings)), np.zeros(3))
    search = _Search(data, calibration, tuple(sightings), options, noise_px(data, state))
    fit = search.fit(Candidate("clock_offset"), state)
    return None if fit is None else (float(fit.correction[0]), float(np.sqrt(fit.covariance[0, 0])))


def _is_among(fit: _Fit, fits: list[_Fit]) -> bool:
    return any(other.candidate == fit.candidate for other in fits)


@dataclass(frozen=True)
class _Search:
    """What all fits share. noise_px: (C,) 1-sigma of one coordinate of each camera's errors about its own best fit."""

    data: Sighted
    calibration: Calibration
    names: tuple[str, ...]
    options: VerificationOptions
    noise_px: FloatArray

    def candidates(self) -> list[Candidate]:
        moved = [Candidate("camera_moved", index) for index in range(len(self.names))]
        warmed = [Candidate("lens_changed", index) for index in range(len(self.names))]
        # With a single camera its own correction and the one that all share are the same.
        shared = [Candidate("markers_moved")] if len(self.names) > 1 else []
        return [*moved, *shared, *warmed, Candidate("device_centre"), Candidate("clock_offset")]

    def real(self, candidates: list[Candidate], state: State, level: float) -> list[_Fit]:
        """The fits from ``state`` that chance doesn't explain and that matter."""
        fits = [fit for candidate in candidates if (fit := self.fit(candidate, state)) is not None]
        return [fit for fit in fits if fit.p_value < level and fit.effect_px > self.options.least_fault_px]

    def fit(self, candidate: Candidate, start: State) -> _Fit | None:
        """None where there is too little data, or the fit leaves the lenses' fields."""
        rows = self._rows(candidate)
        data = rows_of(self.data, rows)
        if len(np.unique(data.frame_index)) < _FEWEST_FRAMES:
            return None
        state = start
        for _ in range(_STEPS):
            residuals, J, valid = linearised(data, state, candidate)
            weights = huber_weights(residuals, self.noise_px[data.camera]) * valid
            H = np.einsum("sik,s,sil->kl", J, weights, J) + candidate.prior
            step = -np.linalg.solve(H, np.einsum("sik,s,si->k", J, weights, residuals))
            state = moved(state, candidate, step)
            if np.sqrt(np.mean((J @ step) ** 2)) < SETTLED_PX:
                break
        residuals, J, valid = linearised(data, state, candidate)
        weights = huber_weights(residuals, self.noise_px[data.camera]) * valid
        if valid.mean() < 0.5:
            return None
        information = np.einsum("sik,s,sil->skl", J, weights, J)
        scores = np.einsum("sik,s,si->sk", J, weights, residuals)
        of_fit = fit_covariance(scores, information, candidate.prior, data.frame_index)
        if of_fit is None:
            return None
        found = correction_between(candidate, start, state)
        covariance = of_fit.covariance + self._left_open(candidate, start)
        before, _ = project(data, start)
        after, _ = project(data, state)
        return _Fit(
            candidate=candidate,
            state=state,
            correction=found,
            covariance=covariance,
            p_value=_p_value(found, covariance, of_fit.degrees_of_freedom),
            effect_px=rms(after - before),
            loss=self._loss(state),
            inflation=of_fit.inflation,
            rmse_before_px=rms(before - data.image_px),
            rmse_after_px=rms(after - data.image_px),
        )

    def score(self, fit: _Fit) -> float:
        """Bayes' information criterion, with as many frames as are independent (times what a frame weighs)."""
        n = max(len(fit.loss) / fit.inflation, 2.0)
        return float(fit.loss.sum() + fit.inflation * 0.5 * fit.candidate.n_parameters * np.log(n))

    def fault(self, best: _Fit, as_good: list[_Fit]) -> Fault:
        shift, turn, shift_sigma, turn_sigma = _sizes(best)
        return Fault(
            kind=best.candidate.kind,
            camera=None if best.candidate.camera is None else self.names[best.candidate.camera],
            correction=_matrix(best),
            focal_share=float(np.expm1(best.correction[0])) if best.candidate.kind == "lens_changed" else 0.0,
            offset_s=float(best.correction[0]) if best.candidate.kind == "clock_offset" else 0.0,
            shift_mm=shift,
            turn_deg=turn,
            shift_sigma_mm=shift_sigma,
            turn_sigma_deg=turn_sigma,
            p_value=best.p_value,
            rmse_before_px=best.rmse_before_px,
            rmse_after_px=best.rmse_after_px,
            also_possible=tuple(self._sentence(fit) for fit in as_good),
            sentence=self._sentence(best),
        )

    def _sentence(self, fit: _Fit) -> str:
        shift, turn, shift_sigma, turn_sigma = _sizes(fit)
        if fit.candidate.kind == "device_centre":
            return f"the Lollypop's centre is {shift:.2f} mm off (1-sigma {shift_sigma:.2f} mm)"
        if fit.candidate.kind == "lens_changed" and fit.candidate.camera is not None:
            share, sigma = 100.0 * np.expm1(fit.correction[0]), 100.0 * np.sqrt(fit.covariance[0, 0])
            name = self.names[fit.candidate.camera]
            return f"the focal length of camera {name!r} changed by {share:+.3f} % (1-sigma {sigma:.3f} %)"
        if fit.candidate.kind == "clock_offset":
            offset_ms, sigma_ms = 1e3 * fit.correction[0], 1e3 * np.sqrt(fit.covariance[0, 0])
            return f"the cameras' clock is off: {offset_ms:+.2f} ms (1-sigma {sigma_ms:.2f} ms) is to be added"
        moved = f"moved by {shift:.2f} mm and {turn:.3f} deg (1-sigma {shift_sigma:.2f} mm, {turn_sigma:.3f} deg)"
        if fit.candidate.camera is not None:
            alone = " (or the markers; a single camera can't tell)" if len(self.names) == 1 else ""
            return f"camera {self.names[fit.candidate.camera]!r} {moved}{alone}"
        if self.calibration.capture is Capture.FIXED_CAMERAS:
            return f"the mocap's world {moved} against all cameras"
        return f"the headset's markers {moved} against all cameras"

    def _rows(self, candidate: Candidate) -> BoolArray:
        if candidate.camera is None:
            return np.ones(len(self.data.camera), dtype=bool)
        return np.asarray(self.data.camera == candidate.camera)

    def _loss(self, state: State) -> FloatArray:
        """(F,) Huber loss of every frame, over all cameras."""
        projected, valid = project(self.data, state)
        whitened = np.linalg.norm(projected - self.data.image_px, axis=1) / self.noise_px[self.data.camera]
        whitened = np.where(valid, whitened, 1e3)
        loss = np.where(whitened < HUBER, 0.5 * whitened**2, HUBER * (whitened - 0.5 * HUBER))
        starts = np.flatnonzero(np.concatenate([[True], np.diff(self.data.frame_index) > 0]))
        return np.asarray(np.add.reduceat(loss, starts))

    def _left_open(self, candidate: Candidate, state: State) -> FloatArray:
        """(K, K) the calibration's own covariance in the tangent of the correction."""
        if candidate.kind in ("device_centre", "lens_changed", "clock_offset"):
            return np.zeros((candidate.n_parameters, candidate.n_parameters))
        known = [self.calibration.cameras[name].camera_T_ref.covariance for name in self.names]
        covariances = np.stack([np.zeros((6, 6)) if matrix is None else matrix for matrix in known])
        if candidate.camera is None:  # of what the cameras share at most this is wrong
            return np.asarray(covariances.mean(axis=0))
        into = adjoint(state.camera_T_ref[candidate.camera][None])[0]
        return np.asarray(into @ covariances[candidate.camera] @ into.T)


def _matrix(fit: _Fit) -> FloatArray:
    """(4, 4) of the correction."""
    if fit.candidate.kind in ("lens_changed", "clock_offset"):
        return np.eye(4)
    found = fit.correction
    return exp_of(found if len(found) == 6 else np.concatenate([np.zeros(3), found]))


def _p_value(found: FloatArray, covariance: FloatArray, degrees_of_freedom: float) -> float:
    wald = float(found @ np.linalg.solve(covariance, found))
    return float(special.fdtrc(len(found), degrees_of_freedom, wald / len(found)))


def _sizes(fit: _Fit) -> tuple[float, float, float, float]:
    """shift_mm, turn_deg and their sigmas."""
    if fit.candidate.kind in ("lens_changed", "clock_offset"):
        return 0.0, 0.0, 0.0, 0.0
    found, covariance = fit.correction, fit.covariance
    shift_mm = 1e3 * float(np.linalg.norm(found[-3:]))
    shift_sigma = 1e3 * float(np.sqrt(np.linalg.eigvalsh(covariance[-3:, -3:])[-1]))
    if fit.candidate.kind == "device_centre":
        return shift_mm, 0.0, shift_sigma, 0.0
    turn_deg = float(np.rad2deg(np.linalg.norm(found[:3])))
    turn_sigma = float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])))
    return shift_mm, turn_deg, shift_sigma, turn_sigma
