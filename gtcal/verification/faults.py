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
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.recordings.capture import Capture
from gtcal.recordings.detections import IntArray
from gtcal.results.calibration import Calibration
from gtcal.verification.blocks import fit_covariance
from gtcal.verification.verification import Fault, FaultKind, Sightings, VerificationOptions

_STEPS, _SETTLED_PX = 12, 1e-3
_HUBER = 1.5  # in noise sigmas of one coordinate
_LEAST_SIGMA_PX = 0.02
# What the data leave open stays as it is: these are no information beside any real recording.
_FREE_RAD, _FREE_M, _FREE_LOG_FOCAL, _FREE_S = np.deg2rad(20.0), 0.5, 0.5, 1.0
_FEWEST_FRAMES = 16


@dataclass(frozen=True)
class _Data:
    """The sightings of all cameras in order of time. S rows.

    camera: (S,) index into ``cameras``. in_ref_m: (S, 3) mocap centres in ref, in_ref_m_s: (S, 3) their velocity.
    ref_R_body: (S, 3, 3)."""

    cameras: tuple[Camera, ...]
    camera: IntArray
    frame_index: IntArray
    image_px: FloatArray
    in_ref_m: FloatArray
    in_ref_m_s: FloatArray
    ref_R_body: FloatArray


@dataclass(frozen=True)
class _State:
    """Extrinsics (C, 4, 4), the growth of the focal lengths (C,) as its logarithm, the device's shift in its body (3,)
    and the time to add to the stamps, with the corrections found so far."""

    camera_T_ref: FloatArray
    log_focal: FloatArray
    shift_m: FloatArray
    offset_s: float = 0.0

    def theta(self, index: int, camera: Camera) -> FloatArray:
        """(K,) the intrinsics of a camera."""
        theta = camera.theta.copy()
        theta[:2] *= np.exp(self.log_focal[index])
        return theta


@dataclass(frozen=True)
class _Candidate:
    """kind and, for camera_moved and lens_changed, which camera."""

    kind: FaultKind
    camera: int | None = None

    @property
    def n_parameters(self) -> int:
        return {"device_centre": 3, "lens_changed": 1, "clock_offset": 1}.get(self.kind, 6)

    @property
    def prior(self) -> FloatArray:
        """(K, K) in whitened units: what the data say nothing of is left at zero, so that the correction is the
        smallest."""
        rigid = [_FREE_RAD] * 3 + [_FREE_M] * 3
        free = {"device_centre": [_FREE_M] * 3, "lens_changed": [_FREE_LOG_FOCAL], "clock_offset": [_FREE_S]}
        return np.diag(1.0 / np.square(free.get(self.kind, rigid)))


@dataclass(frozen=True)
class _Fit:
    """A fitted candidate.

    correction: (K,) rotation vector and translation, shift, logarithm of the focal length's growth, or time.
    covariance: of the same. p_value: that it is chance. effect_px: RMS shift of the image centres it concerns.
    loss: (F,) robust loss of every frame. inflation: for the correlation in time."""

    candidate: _Candidate
    state: _State
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
    data = _data(sightings)
    if data is None:
        return ()
    state = _State(np.stack([seen.camera_T_ref for seen in sightings.values()]), np.zeros(len(sightings)), np.zeros(3))
    search = _Search(data, calibration, tuple(sightings), options, _noise_px(data, state))
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
    data = _data(sightings)
    if data is None:
        return None
    state = _State(np.stack([seen.camera_T_ref for seen in sightings.values()]), np.zeros(len(sightings)), np.zeros(3))
    search = _Search(data, calibration, tuple(sightings), options, _noise_px(data, state))
    fit = search.fit(_Candidate("clock_offset"), state)
    return None if fit is None else (float(fit.correction[0]), float(np.sqrt(fit.covariance[0, 0])))


def _is_among(fit: _Fit, fits: list[_Fit]) -> bool:
    return any(other.candidate == fit.candidate for other in fits)


@dataclass(frozen=True)
class _Search:
    """What all fits share. noise_px: (C,) 1-sigma of one coordinate of each camera's errors about its own best fit."""

    data: _Data
    calibration: Calibration
    names: tuple[str, ...]
    options: VerificationOptions
    noise_px: FloatArray

    def candidates(self) -> list[_Candidate]:
        moved = [_Candidate("camera_moved", index) for index in range(len(self.names))]
        warmed = [_Candidate("lens_changed", index) for index in range(len(self.names))]
        # With a single camera its own correction and the one that all share are the same.
        shared = [_Candidate("markers_moved")] if len(self.names) > 1 else []
        return [*moved, *shared, *warmed, _Candidate("device_centre"), _Candidate("clock_offset")]

    def real(self, candidates: list[_Candidate], state: _State, level: float) -> list[_Fit]:
        """The fits from ``state`` that chance doesn't explain and that matter."""
        fits = [fit for candidate in candidates if (fit := self.fit(candidate, state)) is not None]
        return [fit for fit in fits if fit.p_value < level and fit.effect_px > self.options.least_fault_px]

    def fit(self, candidate: _Candidate, start: _State) -> _Fit | None:
        """None where there is too little data, or the fit leaves the lenses' fields."""
        rows = self._rows(candidate)
        data = _rows_of(self.data, rows)
        if len(np.unique(data.frame_index)) < _FEWEST_FRAMES:
            return None
        state = start
        for _ in range(_STEPS):
            residuals, J, valid = _linearised(data, state, candidate)
            weights = _huber_weights(residuals, self.noise_px[data.camera]) * valid
            H = np.einsum("sik,s,sil->kl", J, weights, J) + candidate.prior
            step = -np.linalg.solve(H, np.einsum("sik,s,si->k", J, weights, residuals))
            state = _moved(state, candidate, step)
            if np.sqrt(np.mean((J @ step) ** 2)) < _SETTLED_PX:
                break
        residuals, J, valid = _linearised(data, state, candidate)
        weights = _huber_weights(residuals, self.noise_px[data.camera]) * valid
        if valid.mean() < 0.5:
            return None
        information = np.einsum("sik,s,sil->skl", J, weights, J)
        scores = np.einsum("sik,s,si->sk", J, weights, residuals)
        of_fit = fit_covariance(scores, information, candidate.prior, data.frame_index)
        if of_fit is None:
            return None
        found = _correction(candidate, start, state)
        covariance = of_fit.covariance + self._left_open(candidate, start)
        before, _ = _project(data, start)
        after, _ = _project(data, state)
        return _Fit(
            candidate=candidate,
            state=state,
            correction=found,
            covariance=covariance,
            p_value=_p_value(found, covariance, of_fit.degrees_of_freedom),
            effect_px=_rms(after - before),
            loss=self._loss(state),
            inflation=of_fit.inflation,
            rmse_before_px=_rms(before - data.image_px),
            rmse_after_px=_rms(after - data.image_px),
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

    def _rows(self, candidate: _Candidate) -> BoolArray:
        if candidate.camera is None:
            return np.ones(len(self.data.camera), dtype=bool)
        return np.asarray(self.data.camera == candidate.camera)

    def _loss(self, state: _State) -> FloatArray:
        """(F,) Huber loss of every frame, over all cameras."""
        projected, valid = _project(self.data, state)
        whitened = np.linalg.norm(projected - self.data.image_px, axis=1) / self.noise_px[self.data.camera]
        whitened = np.where(valid, whitened, 1e3)
        loss = np.where(whitened < _HUBER, 0.5 * whitened**2, _HUBER * (whitened - 0.5 * _HUBER))
        starts = np.flatnonzero(np.concatenate([[True], np.diff(self.data.frame_index) > 0]))
        return np.asarray(np.add.reduceat(loss, starts))

    def _left_open(self, candidate: _Candidate, state: _State) -> FloatArray:
        """(K, K) the calibration's own covariance in the tangent of the correction."""
        if candidate.kind in ("device_centre", "lens_changed", "clock_offset"):
            return np.zeros((candidate.n_parameters, candidate.n_parameters))
        known = [self.calibration.cameras[name].camera_T_ref.covariance for name in self.names]
        covariances = np.stack([np.zeros((6, 6)) if matrix is None else matrix for matrix in known])
        if candidate.camera is None:  # of what the cameras share at most this is wrong
            return np.asarray(covariances.mean(axis=0))
        adjoint = _adjoint(state.camera_T_ref[candidate.camera])
        return np.asarray(adjoint @ covariances[candidate.camera] @ adjoint.T)


def _data(sightings: Mapping[str, Sightings]) -> _Data | None:
    if not sightings:
        return None
    seen = list(sightings.values())
    frame_index = np.concatenate([s.frame_index for s in seen])
    order = np.argsort(frame_index, kind="stable")
    in_ref, velocities = zip(*(_to_ref(s) for s in seen), strict=True)
    return _Data(
        cameras=tuple(s.camera for s in seen),
        camera=np.repeat(np.arange(len(seen)), [len(s) for s in seen])[order],
        frame_index=frame_index[order],
        image_px=np.concatenate([s.image_centre_px for s in seen])[order],
        in_ref_m=np.concatenate(in_ref)[order],
        in_ref_m_s=np.concatenate(velocities)[order],
        ref_R_body=np.concatenate([s.ref_T_body[:, :3, :3] for s in seen])[order],
    )


def _to_ref(seen: Sightings) -> tuple[FloatArray, FloatArray]:
    """(S, 3) the mocap's centres and their velocity."""
    ref_T_camera = inverse(seen.camera_T_ref)
    ref_R_camera = ref_T_camera[:3, :3]
    in_ref_m = seen.mocap_centre_in_camera_m @ ref_R_camera.T + ref_T_camera[:3, 3]
    return in_ref_m, seen.mocap_velocity_in_camera_m_s @ ref_R_camera.T


def _rows_of(data: _Data, rows: BoolArray) -> _Data:
    if rows.all():
        return data
    return replace(
        data,
        camera=data.camera[rows],
        frame_index=data.frame_index[rows],
        image_px=data.image_px[rows],
        in_ref_m=data.in_ref_m[rows],
        in_ref_m_s=data.in_ref_m_s[rows],
        ref_R_body=data.ref_R_body[rows],
    )


def _noise_px(data: _Data, state: _State) -> FloatArray:
    """(C,) 1-sigma of a coordinate of each camera's errors about its own best rigid correction."""
    noise = np.empty(len(data.cameras))
    for index in range(len(data.cameras)):
        own = _rows_of(data, data.camera == index)
        candidate, corrected = _Candidate("camera_moved", index), state
        sigma = np.inf
        for _ in range(6):
            residuals, J, valid = _linearised(own, corrected, candidate)
            sigma = max(1.4826 * float(np.median(np.abs(residuals[valid]))) if valid.any() else np.inf, _LEAST_SIGMA_PX)
            weights = _huber_weights(residuals, np.full(len(residuals), sigma)) * valid
            H = np.einsum("sik,s,sil->kl", J, weights, J) + candidate.prior
            step = -np.linalg.solve(H, np.einsum("sik,s,si->k", J, weights, residuals))
            corrected = _moved(corrected, candidate, step)
            if np.sqrt(np.mean((J @ step) ** 2)) < _SETTLED_PX:
                break
        noise[index] = sigma
    return noise


def _points(data: _Data, state: _State) -> tuple[FloatArray, FloatArray]:
    """(S, 3) the device's centres in ref and in the cameras."""
    in_ref = data.in_ref_m + np.einsum("sij,j->si", data.ref_R_body, state.shift_m) + state.offset_s * data.in_ref_m_s
    T = state.camera_T_ref[data.camera]
    return in_ref, np.einsum("sij,sj->si", T[:, :3, :3], in_ref) + T[:, :3, 3]


def _project(data: _Data, state: _State) -> tuple[FloatArray, BoolArray]:
    """(S, 2) and (S,) whether there is a pixel; 0 where not."""
    _, in_camera = _points(data, state)
    pixels, valid = np.zeros((len(in_camera), 2)), np.zeros(len(in_camera), dtype=bool)
    for index, camera in enumerate(data.cameras):
        rows = data.camera == index
        pixels[rows], valid[rows] = camera.model.project(in_camera[rows], state.theta(index, camera))
    return np.where(valid[:, None], pixels, 0.0), valid


def _linearised(data: _Data, state: _State, candidate: _Candidate) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Residuals (S, 2), projected less measured, their derivatives (S, 2, K) to the correction, and (S,) whether there
    is a pixel; both 0 where not."""
    in_ref, in_camera = _points(data, state)
    residuals, J_point = np.zeros((len(in_camera), 2)), np.zeros((len(in_camera), 2, 3))
    valid, by_focal = np.zeros(len(in_camera), dtype=bool), np.zeros((len(in_camera), 2))
    for index, camera in enumerate(data.cameras):
        rows = data.camera == index
        if rows.any():
            theta = state.theta(index, camera)
            pixels, valid[rows], J, _ = camera.model.project_with_jacobians(in_camera[rows], theta)
            residuals[rows], J_point[rows] = pixels - data.image_px[rows], J
            by_focal[rows] = pixels - theta[2:4]
    residuals[~valid], J_point[~valid], by_focal[~valid] = 0.0, 0.0, 0.0
    if candidate.kind == "lens_changed":
        return residuals, by_focal[:, :, None], valid
    if candidate.kind == "camera_moved":
        return residuals, _by_motion(J_point, in_camera), valid
    J_ref = J_point @ state.camera_T_ref[data.camera, :3, :3]
    if candidate.kind == "markers_moved":
        return residuals, _by_motion(J_ref, in_ref), valid
    if candidate.kind == "clock_offset":
        return residuals, J_ref @ data.in_ref_m_s[:, :, None], valid
    return residuals, J_ref @ data.ref_R_body, valid


def _by_motion(J_point: FloatArray, points: FloatArray) -> FloatArray:
    """(S, 2, 6) derivative to xi, rotation first, of Exp(xi) acting on points (S, 3)."""
    return np.concatenate([np.cross(points[:, None, :], J_point), J_point], axis=2)


def _moved(state: _State, candidate: _Candidate, step: FloatArray) -> _State:
    if candidate.kind == "device_centre":
        return replace(state, shift_m=state.shift_m + step)
    if candidate.kind == "clock_offset":
        return replace(state, offset_s=state.offset_s + float(step[0]))
    if candidate.kind == "lens_changed":
        log_focal = state.log_focal.copy()
        log_focal[candidate.camera] += step[0]
        return replace(state, log_focal=log_focal)
    T = state.camera_T_ref.copy()
    if candidate.camera is None:
        T = T @ _exp(step)
    else:
        T[candidate.camera] = _exp(step) @ T[candidate.camera]
    return replace(state, camera_T_ref=T)


def _correction(candidate: _Candidate, start: _State, end: _State) -> FloatArray:
    """(K,) from the start of a fit to its end."""
    if candidate.kind == "device_centre":
        return end.shift_m - start.shift_m
    if candidate.kind == "lens_changed":
        return np.asarray([(end.log_focal - start.log_focal)[candidate.camera]])
    if candidate.kind == "clock_offset":
        return np.array([end.offset_s - start.offset_s])
    if candidate.camera is None:
        return _log(inverse(start.camera_T_ref[0]) @ end.camera_T_ref[0])
    return _log(end.camera_T_ref[candidate.camera] @ inverse(start.camera_T_ref[candidate.camera]))


def _exp(xi: FloatArray) -> FloatArray:
    """(4, 4) of a rotation vector and a translation, the pair (not the screw motion): what is small is the same."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(xi[:3]).as_matrix(), xi[3:]
    return T


def _log(T: FloatArray) -> FloatArray:
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def _matrix(fit: _Fit) -> FloatArray:
    """(4, 4) of the correction."""
    if fit.candidate.kind in ("lens_changed", "clock_offset"):
        return np.eye(4)
    found = fit.correction
    return _exp(found if len(found) == 6 else np.concatenate([np.zeros(3), found]))


def _adjoint(a_T_b: FloatArray) -> FloatArray:
    """(6, 6) with a_T_b Exp(xi) = Exp(Ad xi) a_T_b."""
    R, (x, y, z) = a_T_b[:3, :3], a_T_b[:3, 3]
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[3:, :3] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
    return adjoint


def _huber_weights(residuals: FloatArray, sigma: FloatArray) -> FloatArray:
    """(S,) weights of residuals (S, 2), in 1/px^2."""
    whitened = np.linalg.norm(residuals, axis=1) / sigma
    return np.minimum(1.0, _HUBER / np.maximum(whitened, 1e-12)) / sigma**2


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


def _rms(differences_px: FloatArray) -> float:
    return float(np.sqrt(np.mean((differences_px**2).sum(axis=1))))
