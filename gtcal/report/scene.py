"""The 3-D view's content: cameras, board poses and bodies as lines in ref. The page's script only turns and draws."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from factors.rigid import inverse
from gtcal.board import board_from_manifest
from gtcal.camera import Camera, FloatArray
from gtcal.recordings.capture import Capture
from gtcal.report.evidence import Evidence
from gtcal.results.calibration import Calibration
from gtcal.verification.verification import Verification

_MOST_BOARDS = 24
_MOST_PATH_POINTS = 400
_MOST_DOTS = 250
_EDGE_SAMPLES = 8
_AXIS_COLOURS = ("#d55e00", "#009e73", "#0072b2")
_AXIS_NAMES = ("x", "y", "z")
_BOARD_COLOUR, _BODY_COLOUR, _REF_COLOUR = "#8a6d1f", "#5c6875", "#1c2733"
_LOLLYPOP_COLOUR = "#e69f00"
# What is farther off axis than this is drawn at this angle: a frustum of bearings to the side and behind confuses.
_WIDEST_DRAWN_RAD = np.deg2rad(80.0)

REF_NAMES = {
    Capture.FIXED_CAMERAS: "mocap world",
    Capture.TRACKED_PLATFORM: "platform body",
    Capture.STANDING_BOARD: "platform body",
}
BODY_NAMES = {
    Capture.FIXED_CAMERAS: "board's body",
    Capture.TRACKED_PLATFORM: "board's body",
    Capture.STANDING_BOARD: "mocap world",
}


@dataclass(frozen=True)
class Line:
    """A line through points in ref, in m. A ``fill`` in 0..1 closes it and tints its inside. ``label`` stands at the
    first point."""

    layer: str
    points: list[list[float]]
    colour: str
    width: float = 1.2
    opacity: float = 1.0
    fill: float = 0.0
    label: str = ""


@dataclass(frozen=True)
class Scene:
    """What the page draws. ``layers``: what can be switched on and off, by id. ``up``, ``back``: unit vectors in ref,
    upwards and from the scene towards where one first looks from."""

    lines: list[Line]
    layers: dict[str, str]
    up: list[float]
    back: list[float]

    def to_json(self) -> dict[str, Any]:
        """As the page's script reads it."""
        return asdict(self)


def build_scene(
    calibration: Calibration,
    evidence: Evidence | None,
    colours: dict[str, str],
    verification: Verification | None = None,
) -> Scene:
    """The scene in ref; board poses and the body's path need the evidence of a recording, the Lollypop's places the
    sightings of a verification. ``colours``: by camera."""
    length_m = _frustum_length_m(calibration, evidence)
    lines = [line for name in calibration.cameras for line in _camera(calibration, name, length_m, colours[name])]
    lines += _axes("ref", np.eye(4), 0.6 * length_m, "ref", 2.2)
    layers = {"cameras": "cameras", "ref": f"ref ({REF_NAMES[calibration.capture]})"}
    if evidence is not None:
        lines += _boards(calibration, evidence) + _body(evidence, 0.4 * length_m)
        layers |= {"boards": "board poses", "body": f"{BODY_NAMES[calibration.capture]} and its path"}
    if verification is not None and verification.sightings:
        lines += _lollypop(verification)
        layers["lollypop"] = "the Lollypop"
    up = _up(calibration)
    return Scene(lines, layers, _rounded(up), _rounded(_back(calibration, up)))


def _camera(calibration: Calibration, name: str, length_m: float, colour: str) -> list[Line]:
    calibrated = calibration.cameras[name]
    ref_T_camera = inverse(calibrated.camera_T_ref.a_T_b)
    centre = ref_T_camera[:3, 3]
    rim = _rim(calibrated.camera) * length_m @ ref_T_camera[:3, :3].T + centre
    spokes = [Line("cameras", _points([centre, corner]), colour) for corner in rim[::_EDGE_SAMPLES]]
    outline = Line("cameras", _points(rim), colour, width=1.8, fill=0.10)
    tip = centre + 0.85 * length_m * ref_T_camera[:3, 2]
    axis = Line("cameras", _points([tip, centre]), colour, width=1.2, label=name)
    dot = Line("cameras", _points([centre]), colour, width=6.0)
    # The image's upper edge, thick, tells which way up the camera is.
    upper = Line("cameras", _points(rim[: _EDGE_SAMPLES + 1]), colour, width=3.6)
    return [*spokes, outline, upper, axis, dot]


def _rim(camera: Camera) -> FloatArray:
    """(4 _EDGE_SAMPLES, 3) unit bearings along the image's border from its upper-left corner, clockwise; where the
    model has none, of the last pixel on the way there from the principal point that has."""
    right, bottom = camera.image_width_px - 0.5, camera.image_height_px - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom], [-0.5, -0.5]])
    share = np.arange(_EDGE_SAMPLES)[:, None] / _EDGE_SAMPLES
    border = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
    centre = camera.theta[2:4]
    shares = np.linspace(0.05, 1.0, 96)
    ways = centre + shares[None, :, None] * (border - centre)[:, None, :]
    bearings, valid = camera.unproject(ways.reshape(-1, 2))
    angle = np.arctan2(np.hypot(bearings[:, 0], bearings[:, 1]), bearings[:, 2])
    drawn = (valid & (angle <= _WIDEST_DRAWN_RAD)).reshape(len(border), -1)
    last = len(shares) - 1 - np.argmax(drawn[:, ::-1], axis=1)
    return bearings.reshape(len(border), -1, 3)[np.arange(len(border)), last]


def _boards(calibration: Calibration, evidence: Evidence) -> list[Line]:
    x_min, y_min, x_max, y_max = board_from_manifest(calibration.board).bounds_m
    outline = np.array([[x_min, y_min, 0, 1], [x_max, y_min, 0, 1], [x_max, y_max, 0, 1], [x_min, y_max, 0, 1]])
    ref_T_body = _poses(evidence)
    pick = np.unique(np.linspace(0, len(ref_T_body) - 1, _MOST_BOARDS).astype(int))
    ref_T_board = ref_T_body[pick] @ calibration.body_T_board.a_T_b
    corners = np.einsum("nij,cj->nci", ref_T_board, outline)[..., :3]
    return [Line("boards", _points(corner), _BOARD_COLOUR, 0.9, 0.5, fill=0.04) for corner in corners]


def _body(evidence: Evidence, length_m: float) -> list[Line]:
    ref_T_body = _poses(evidence)
    pick = np.unique(np.linspace(0, len(ref_T_body) - 1, _MOST_PATH_POINTS).astype(int))
    path = Line("body", _points(ref_T_body[pick, :3, 3]), _BODY_COLOUR, 0.8, 0.6)
    return [path, *_axes("body", ref_T_body[0], length_m, "body", 1.6)]


def _lollypop(verification: Verification) -> list[Line]:
    """Where it was seen: a dot a sighting, without a line, since it was not seen all the time."""
    seen = verification.sightings.values()
    places_m = np.concatenate([found.ref_T_body[:, :3, 3] for found in seen])
    pick = np.unique(np.linspace(0, len(places_m) - 1, min(_MOST_DOTS, len(places_m))).astype(int))
    return [Line("lollypop", _points([place]), _LOLLYPOP_COLOUR, 3.4) for place in places_m[pick]]


def _axes(layer: str, ref_T_frame: FloatArray, length_m: float, label: str, width: float) -> list[Line]:
    origin = ref_T_frame[:3, 3]
    tips = origin + length_m * ref_T_frame[:3, :3].T
    lines = [
        Line(layer, _points([tip, origin]), colour, width, label=name)
        for tip, colour, name in zip(tips, _AXIS_COLOURS, _AXIS_NAMES, strict=True)
    ]
    return [*lines, Line(layer, _points([origin]), _REF_COLOUR, 5.0, label=label)]


def _poses(evidence: Evidence) -> FloatArray:
    """(F, 4, 4) ref_T_body of the views that stay, of all cameras, in order of time, each frame once."""
    cameras = evidence.cameras.values()
    stamps_ns = np.concatenate([camera.views.stamps_ns[camera.keep_view] for camera in cameras])
    poses = np.concatenate([camera.views.ref_T_body[camera.keep_view] for camera in cameras])
    return poses[np.unique(stamps_ns, return_index=True)[1]]


def _frustum_length_m(calibration: Calibration, evidence: Evidence | None) -> float:
    """A third of the usual distance between camera and board; without a recording, of that between the cameras."""
    positions = [camera.camera_T_ref.position_of_a_in_b_m for camera in calibration.cameras.values()]
    if evidence is None:
        spread = float(np.linalg.norm(np.ptp(positions, axis=0)))
        return spread / 3.0 if spread > 0.0 else 0.1
    ref_T_board = _poses(evidence) @ calibration.body_T_board.a_T_b
    return float(np.median(np.linalg.norm(ref_T_board[:, None, :3, 3] - np.array(positions), axis=2))) / 3.0


def _up(calibration: Calibration) -> FloatArray:
    """Cameras mostly stand upright: against the mean of their y axes, which point down the image."""
    return _unit(-_mean_axis(calibration, 1), np.array([0.0, 0.0, 1.0]))


def _back(calibration: Calibration, up: FloatArray) -> FloatArray:
    """Against the cameras' mean viewing direction, and level."""
    backwards = -_mean_axis(calibration, 2)
    level = backwards - (backwards @ up) * up
    return _unit(level, _unit(np.cross(up, [1.0, 0.0, 0.0]), np.cross(up, [0.0, 1.0, 0.0])))


def _mean_axis(calibration: Calibration, axis: int) -> FloatArray:
    rows = [camera.camera_T_ref.a_T_b[axis, :3] for camera in calibration.cameras.values()]
    return np.mean(rows, axis=0)


def _unit(vector: FloatArray, otherwise: FloatArray) -> FloatArray:
    """The vector's direction; that of another where it has hardly any."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.05 else otherwise / np.linalg.norm(otherwise)


def _points(points: Any) -> list[list[float]]:
    """Rounded to 0.1 mm: the page is small and no eye sees more."""
    return np.round(np.asarray(points), 4).tolist()


def _rounded(vector: FloatArray) -> list[float]:
    return np.round(vector, 6).tolist()
