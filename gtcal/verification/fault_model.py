"""How a correction moves the errors of a verification: sightings, the state that corrections change, derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from factors.rigid import inverse
from gtcal.camera import BoolArray, Camera, FloatArray
from gtcal.recordings.detections import IntArray
from gtcal.verification.verification import FaultKind, Sightings

SETTLED_PX = 1e-3
HUBER = 1.5  # in noise sigmas of one coordinate
_LEAST_SIGMA_PX = 0.02
# What the data leave open stays as it is: these are no information beside any real recording.
_FREE_RAD, _FREE_M, _FREE_LOG_FOCAL, _FREE_S = np.deg2rad(20.0), 0.5, 0.5, 1.0


@dataclass(frozen=True)
class Sighted:
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
class State:
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
class Candidate:
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


def sighted(sightings: Mapping[str, Sightings]) -> Sighted | None:
    """None where there are none."""
    if not sightings:
        return None
    seen = list(sightings.values())
    frame_index = np.concatenate([s.frame_index for s in seen])
    order = np.argsort(frame_index, kind="stable")
    in_ref, velocities = zip(*(_to_ref(s) for s in seen), strict=True)
    return Sighted(
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


def rows_of(data: Sighted, rows: BoolArray) -> Sighted:
    """Some of them; rows: (S,)."""
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


def noise_px(data: Sighted, state: State) -> FloatArray:
    """(C,) 1-sigma of a coordinate of each camera's errors about its own best rigid correction."""
    noise = np.empty(len(data.cameras))
    for index in range(len(data.cameras)):
        own = rows_of(data, data.camera == index)
        candidate, corrected = Candidate("camera_moved", index), state
        sigma = np.inf
        for _ in range(6):
            residuals, J, valid = linearised(own, corrected, candidate)
            sigma = max(1.4826 * float(np.median(np.abs(residuals[valid]))) if valid.any() else np.inf, _LEAST_SIGMA_PX)
            weights = huber_weights(residuals, np.full(len(residuals), sigma)) * valid
            H = np.einsum("sik,s,sil->kl", J, weights, J) + candidate.prior
            step = -np.linalg.solve(H, np.einsum("sik,s,si->k", J, weights, residuals))
            corrected = moved(corrected, candidate, step)
            if np.sqrt(np.mean((J @ step) ** 2)) < SETTLED_PX:
                break
        noise[index] = sigma
    return noise


def _points(data: Sighted, state: State) -> tuple[FloatArray, FloatArray]:
    """(S, 3) the device's centres in ref and in the cameras."""
    in_ref = data.in_ref_m + np.einsum("sij,j->si", data.ref_R_body, state.shift_m) + state.offset_s * data.in_ref_m_s
    T = state.camera_T_ref[data.camera]
    return in_ref, np.einsum("sij,sj->si", T[:, :3, :3], in_ref) + T[:, :3, 3]


def project(data: Sighted, state: State) -> tuple[FloatArray, BoolArray]:
    """(S, 2) and (S,) whether there is a pixel; 0 where not."""
    _, in_camera = _points(data, state)
    pixels, valid = np.zeros((len(in_camera), 2)), np.zeros(len(in_camera), dtype=bool)
    for index, camera in enumerate(data.cameras):
        rows = data.camera == index
        pixels[rows], valid[rows] = camera.model.project(in_camera[rows], state.theta(index, camera))
    return np.where(valid[:, None], pixels, 0.0), valid


def linearised(data: Sighted, state: State, candidate: Candidate) -> tuple[FloatArray, FloatArray, BoolArray]:
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


def moved(state: State, candidate: Candidate, step: FloatArray) -> State:
    """By a step (K,) of the candidate's correction."""
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
        T = T @ exp_of(step)
    else:
        T[candidate.camera] = exp_of(step) @ T[candidate.camera]
    return replace(state, camera_T_ref=T)


def correction_between(candidate: Candidate, start: State, end: State) -> FloatArray:
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


def exp_of(xi: FloatArray) -> FloatArray:
    """(4, 4) of a rotation vector and a translation, the pair (not the screw motion): what is small is the same."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(xi[:3]).as_matrix(), xi[3:]
    return T


def _log(T: FloatArray) -> FloatArray:
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def huber_weights(residuals: FloatArray, sigma: FloatArray) -> FloatArray:
    """(S,) weights of residuals (S, 2), in 1/px^2."""
    whitened = np.linalg.norm(residuals, axis=1) / sigma
    return np.minimum(1.0, HUBER / np.maximum(whitened, 1e-12)) / sigma**2


def rms(differences_px: FloatArray) -> float:
    """Of the lengths of differences (S, 2)."""
    return float(np.sqrt(np.mean((differences_px**2).sum(axis=1))))
