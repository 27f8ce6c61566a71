"""The manifest of a recording: recording.yaml (or .json), its schema, and what is said about a wrong one."""

from __future__ import annotations

import json
import re
from collections.abc import Hashable, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveInt, ValidationError, WithJsonSchema
from pydantic_core import ErrorDetails, PydanticCustomError

from factors import CAMERA_MODELS
from gtcal.board import board_manifest_schema
from gtcal.errors import GtcalError
from gtcal.files import write_text
from gtcal.readers import TRAJECTORY_READERS
from gtcal.readers.poses import LengthUnit, PoseConventions, PoseDirection, TimeUnit
from gtcal.recordings.capture import Capture, check_bodies
from gtcal.recordings.trajectory import QuaternionOrder

MANIFEST_NAMES = ("recording.yaml", "recording.yml", "recording.json")


def _choice(what: str, choices: Iterable[str]) -> tuple[AfterValidator, WithJsonSchema]:
    """A text that must be one of these choices: the check, and its part of the schema."""
    listed = list(choices)

    def check(value: str) -> str:
        if value not in listed:
            message = f"{value!r} is not {what}{did_you_mean(value, listed)}; choose from {', '.join(listed)}"
            raise PydanticCustomError("choice", "{message}", {"message": message})
        return value

    return AfterValidator(check), WithJsonSchema({"type": "string", "enum": listed})


CameraModelName = Annotated[str, *_choice("a camera model", CAMERA_MODELS)]
TrajectoryFormat = Annotated[str, *_choice("a trajectory format", TRAJECTORY_READERS)]
CaptureName = Annotated[str, *_choice("a capture kind", [kind.value for kind in Capture])]


class Entry(BaseModel):
    """A part of a manifest: no field that isn't known, no value converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class CameraEntry(Entry):
    """One camera, and where its images or detections are."""

    model: CameraModelName = Field(description="The camera model.")
    image_size_px: list[PositiveInt] = Field(
        min_length=2, max_length=2, description="Width and height of the images in pixels."
    )
    parameters: dict[str, float] | None = Field(
        default=None,
        description="The intrinsic parameters by name (pixels, integer coordinates at pixel centres). "
        "Leave them out where they are to be found from the recording.",
    )
    images: str | None = Field(
        default=None,
        description="Folder of the images, relative to the manifest; named by time stamp in ns unless listed.",
    )
    image_list: str | None = Field(
        default=None,
        description="CSV 'timestamp [ns],filename' of the images in 'images', or in the folder 'data' beside it.",
    )
    detections: str | None = Field(
        default=None,
        description="CSV of detected corners, or a folder of CSVs. Taken in place of detecting in 'images'.",
    )


class TrajectoryEntry(Entry):
    """The trajectory of one tracked body, and what its file leaves unsaid."""

    trajectory: str = Field(description="The file, relative to the manifest.")
    format: TrajectoryFormat = Field(description="The format of the file.")
    quaternion: QuaternionOrder | None = Field(
        default=None, description="Order of the quaternion's numbers. Needed where the file's header doesn't say."
    )
    length_unit: LengthUnit | None = Field(
        default=None, description="Unit of positions. Needed where the file's header doesn't say."
    )
    time_unit: TimeUnit | None = Field(
        default=None, description="Unit of time stamps. Needed where the file's header doesn't say."
    )
    pose: PoseDirection | None = Field(
        default=None, description="Whether a row holds the body's pose in the world (the default), or its inverse."
    )

    @property
    def conventions(self) -> PoseConventions:
        return PoseConventions(self.quaternion, self.length_unit, self.time_unit, self.pose)


class Manifest(Entry):
    """A recording of a board that cameras see and a mocap system tracks."""

    gtcal_recording: Literal[1] = Field(description="Version of this format: 1.")
    capture: CaptureName = Field(
        description="fixed_cameras: fixed cameras, tracked board. tracked_platform: cameras on a tracked platform "
        "(headset, rig), tracked board. standing_board: tracked platform, untracked board that stands still."
    )
    board: Annotated[dict[str, Any], WithJsonSchema(board_manifest_schema())] = Field(
        description="The board: a preset, or a type and its fields."
    )
    cameras: dict[str, CameraEntry] = Field(min_length=1, description="The cameras by name.")
    platform: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the cameras.")
    board_body: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the board.")
    max_gap_ms: float | None = Field(
        default=None,
        gt=0,
        description="Longest gap in a trajectory to interpolate across. Default: 2.5 median sampling intervals of "
        "that trajectory, which bridges one lost sample but not two, and at most 200 ms.",
    )

    @property
    def bodies(self) -> dict[str, TrajectoryEntry]:
        """The tracked bodies that are given, by name."""
        given = {"platform": self.platform, "board_body": self.board_body}
        return {name: entry for name, entry in given.items() if entry is not None}


M = TypeVar("M", bound=Entry)


def manifest_schema() -> dict[str, Any]:
    """The JSON schema of a manifest, which bodies each capture needs included."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Manifest.model_json_schema(),
        "allOf": [_bodies_schema(capture) for capture in Capture],
    }


def find_manifest(path: Path) -> Path:
    """The manifest at ``path``: the file itself, or the one in this folder.

    Raises GtcalError where there is none, or more than one."""
    if path.is_file():
        return path
    if not path.is_dir():
        raise GtcalError(f"{path}: there is no such recording; expected a folder with {MANIFEST_NAMES[0]} in it")
    found = [path / name for name in MANIFEST_NAMES if (path / name).is_file()]
    if not found:
        raise GtcalError(f"{path}: there is no manifest in this folder; expected {' or '.join(MANIFEST_NAMES)}")
    if len(found) > 1:
        raise GtcalError(f"{path}: there are {' and '.join(f.name for f in found)}; keep one")
    return found[0]


def read_manifest(path: Path) -> Manifest:
    """Read and check the manifest file at ``path``.

    Raises GtcalError naming the file and the field for the first thing that is wrong."""
    return manifest_of(path, load_fields(path))


def manifest_of(path: Path, data: dict[str, Any]) -> Manifest:
    """The fields of the manifest at ``path``, checked. Raises GtcalError as ``read_manifest``."""
    if "device" in data:
        raise GtcalError(
            f"{path}: device: this is a recording of a Lollypop, which verifies a calibration ('gtcal verify'), "
            "not of a board to calibrate from"
        )
    manifest = validated(path, data, Manifest)
    try:
        check_bodies(Capture(manifest.capture), set(manifest.bodies))
        check_sources(manifest.cameras)
    except GtcalError as error:
        raise GtcalError(f"{path}: {error}") from None
    return manifest


def load_fields(path: Path) -> dict[str, Any]:
    """The fields of a manifest file, unchecked.

    Raises GtcalError where it can't be read, is no YAML or JSON, or holds no fields."""
    data = _load(path)
    if not isinstance(data, dict):
        raise GtcalError(f"{path}: is no manifest; expected fields such as 'gtcal_recording: 1'")
    return data


def validated(path: Path, data: dict[str, Any], kind: type[M]) -> M:
    """The fields as a manifest of this kind. Raises GtcalError naming the file and the first field that is wrong."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise GtcalError(f"{path}: {_explain(error, kind)}") from None


def write_manifest(path: Path, manifest: Entry) -> None:
    """Write a manifest as YAML, without the fields at None. Raises GtcalError where its folder takes no files."""
    data = manifest.model_dump(exclude_none=True)
    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120))


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """'; did you mean ...?' where one of the choices is near, else nothing."""
    near = get_close_matches(name, list(choices), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def check_sources(cameras: dict[str, CameraEntry]) -> None:
    """Raises GtcalError where a camera has neither images nor detections."""
    for name, camera in cameras.items():
        if camera.images is None and camera.image_list is None and camera.detections is None:
            raise GtcalError(f"cameras.{name}: has neither 'images' nor 'image_list' nor 'detections'; give one")


def _bodies_schema(capture: Capture) -> dict[str, Any]:
    forbidden = [name for name in ("platform", "board_body") if name not in capture.bodies]
    return {
        "if": {"properties": {"capture": {"const": capture.value}}},
        "then": {"required": list(capture.bodies), "properties": dict.fromkeys(forbidden, False)},
    }


def _load(path: Path) -> Any:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error
    except UnicodeDecodeError:
        raise GtcalError(f"{path}: is not UTF-8 text") from None
    return _load_json(path, text) if path.suffix.lower() == ".json" else _load_yaml(path, text)


def _load_json(path: Path, text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_without_duplicates)
    except json.JSONDecodeError as error:
        raise GtcalError(f"{path}:{error.lineno}: is not valid JSON: {error.msg}") from None
    except ValueError as error:
        raise GtcalError(f"{path}: {error}") from None


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"the field {name!r} stands twice in the same place; keep one")
    return dict(pairs)


def _load_yaml(path: Path, text: str) -> Any:
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise GtcalError(f"{path}:{line}: is not valid YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise GtcalError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from None


class _Loader(yaml.SafeLoader):
    """YAML as people mean it: a field that stands twice is an error, keys are text, 1e-3 is a number."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                problem = f"the name {key_node.value!r} is no text; put it in quotes"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            if key in seen:
                problem = f"the field {key!r} stands twice in the same place; keep one"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


def _explain(error: ValidationError, kind: type[Entry]) -> str:
    """The first error in one line: an unknown field before a missing one, since a misspelt field is both."""
    errors = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = errors[0]
    field = ".".join(str(part) for part in first["loc"])
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    return f"{field}: {_message(first, kind)}{more}"


def _message(error: ErrorDetails, manifest: type[Entry]) -> str:
    kind, given = error["type"], error["input"]
    if kind == "extra_forbidden":
        names = list(_entry_at(error["loc"], manifest).model_fields)
        return f"is not a field{did_you_mean(str(error['loc'][-1]), names)}; fields: {', '.join(names)}"
    if kind == "missing":
        described = _entry_at(error["loc"], manifest).model_fields[str(error["loc"][-1])].description
        return f"is missing; it says: {described}"
    if kind == "choice":
        return error["msg"]
    expected = error["msg"].replace("Input should be", "expected", 1)
    return f"is {given!r}; {expected[0].lower()}{expected[1:]}"


def _entry_at(loc: tuple[int | str, ...], manifest: type[Entry]) -> type[Entry]:
    """The entry whose field stands at this place."""
    if len(loc) == 1:
        return manifest
    return CameraEntry if loc[0] == "cameras" else TrajectoryEntry
