"""The manifest of a recording: recording.yaml (or .json), its schema, and what is said about a wrong one."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from factors import CAMERA_MODELS
from gtcal.board import board_manifest_schema
from gtcal.board_tolerance import with_tolerance_schema
from gtcal.bounds import LARGEST_LENS, LARGEST_SIDE_PX, LARGEST_STAMP_NS
from gtcal.camera import StampedRow
from gtcal.camera_files.formats import CAMERA_FILE_READERS
from gtcal.documents import load_document
from gtcal.errors import GtcalError
from gtcal.files import check_regular, is_there, write_text
from gtcal.names import fault_of_name, shown
from gtcal.readers import TRAJECTORY_READERS, BodySelection, pose_list
from gtcal.readers.mocap_take import RotationKind
from gtcal.readers.pose_list import AngleUnit
from gtcal.readers.poses import LengthUnit, PoseConventions, PoseDirection, TimeUnit
from gtcal.recordings.capture import Capture, check_bodies
from gtcal.recordings.layouts import LAYOUTS, expanded, find_layout
from gtcal.recordings.open_questions import check_answered
from gtcal.recordings.trajectory import QuaternionOrder

MANIFEST_NAMES = ("recording.yaml", "recording.yml", "recording.json")


def _choice(what: str, choices: Collection[str]) -> tuple[AfterValidator, WithJsonSchema]:
    """A text that must be one of these choices, as they are when it is read: the check, and its part of the schema."""

    def check(value: str) -> str:
        if value not in choices:
            message = f"{value!r} is not {what}{did_you_mean(value, list(choices))}; choose from {', '.join(choices)}"
            raise PydanticCustomError("choice", "{message}", {"message": message})
        return value

    return AfterValidator(check), WithJsonSchema({"type": "string", "enum": list(choices)})


CameraModelName = Annotated[str, *_choice("a camera model", CAMERA_MODELS)]
TrajectoryFormat = Annotated[str, *_choice("a trajectory format", (*TRAJECTORY_READERS, pose_list.FORMAT))]
LayoutName = Annotated[str, *_choice("a layout", LAYOUTS)]
LAYOUT_DESCRIPTION = (
    "euroc: the folder is laid out as EuRoC's, ASL's or TUM-VI's; cameras and tracked bodies, as far as they are not "
    "given here, are taken from there."
)
CaptureName = Annotated[str, *_choice("a capture kind", [kind.value for kind in Capture])]
CameraFileFormat = Annotated[str, *_choice("a format of camera files", CAMERA_FILE_READERS)]


def _named(value: str) -> str:
    if fault := fault_of_name(value):
        raise PydanticCustomError("choice", "{message}", {"message": f"the name {fault}; give it another"})
    return value


_Side = Annotated[PositiveInt, Field(le=LARGEST_SIDE_PX)]
_Parameter = Annotated[float, Field(ge=-LARGEST_LENS, le=LARGEST_LENS)]
CameraName = Annotated[str, AfterValidator(_named)]
"""A key of ``cameras``."""


# Left out, not null: None is how Python says it, and no value of the manifest.
_CAMERA_MODEL_SCHEMA = _choice("a camera model", CAMERA_MODELS)[1]
_CAMERA_FILE_SCHEMA = _choice("a format of camera files", CAMERA_FILE_READERS)[1]


class Entry(BaseModel):
    """A part of a manifest: no field that isn't known, no value converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class ShutterEntry(Entry):
    """A rolling shutter, which exposes the rows one after the other."""

    readout_ms: float | None = Field(
        default=None,
        gt=0,
        lt=1000,
        description="Time from the first row's exposure to the last one's. Leave it out where it is to be found with "
        "the clock offset.",
    )
    stamped_row: StampedRow = Field(description="The row at whose exposure the image is stamped.")


class IntrinsicsEntry(Entry):
    """A camera's lens in a file of another tool, and what that leaves unsaid."""

    file: str = Field(description="The file (of ros, ros_bag and colmap also the folder), relative to the manifest.")
    format: Annotated[CameraFileFormat | None, _CAMERA_FILE_SCHEMA] = Field(
        default=None, description="The format of the file. Needed where the file doesn't tell."
    )
    camera: str | None = Field(
        default=None,
        description="The camera's name in the file. Needed where it holds more than one, and none of this name.",
    )


def _unless_in_a_file(value: Any, info: ValidationInfo) -> Any:
    """The value; missing, if neither it nor a file of intrinsics is given."""
    if value is None and info.data.get("intrinsics") is None:
        described = CameraEntry.model_fields[str(info.field_name)].description
        raise PydanticCustomError("choice", "{message}", {"message": f"is missing; it says: {described}"})
    return value


class CameraEntry(Entry):
    """One camera, and where its images or detections are."""

    model_config = ConfigDict(
        json_schema_extra={"anyOf": [{"required": ["model", "image_size_px"]}, {"required": ["intrinsics"]}]}
    )

    intrinsics: IntrinsicsEntry | None = Field(
        default=None, description="The lens in a file of another tool, in place of model, image_size_px and parameters."
    )
    model: Annotated[CameraModelName | None, _CAMERA_MODEL_SCHEMA, AfterValidator(_unless_in_a_file)] = Field(
        default=None,
        validate_default=True,
        description="The camera model. Left out where a file of intrinsics says it.",
    )
    image_size_px: Annotated[
        Annotated[list[_Side], Field(min_length=2, max_length=2)] | None, AfterValidator(_unless_in_a_file)
    ] = Field(
        default=None,
        validate_default=True,
        description="Width and height of the images in pixels. Left out where a file of intrinsics says it.",
    )
    parameters: dict[str, _Parameter] | None = Field(
        default=None,
        description="The intrinsic parameters by name (pixels, integer coordinates at pixel centres). "
        "Leave them out where they are to be found from the recording.",
    )
    parameter_sigmas: dict[str, Annotated[PositiveFloat, Field(le=LARGEST_LENS)]] | None = Field(
        default=None,
        description="1-sigma of the intrinsic parameters by name, in their units, as far as they are known; for the "
        "others those of a factory's calibration are taken (0.3 % of the focal length, 3 px).",
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
        description="CSV or Parquet of detected corners, or a folder of such. Taken in place of detecting in 'images'.",
    )
    rolling_shutter: ShutterEntry | None = Field(
        default=None, description="Given where the camera exposes its rows one after the other."
    )
    video: str | None = Field(default=None, description="Video file; its frames' own time stamps are taken.")
    bag: str | None = Field(default=None, description="ROS 1 bag, or ROS 2 bag (folder, .mcap or .db3); see 'topic'.")
    topic: str | None = Field(default=None, description="The topic of 'bag' with the images; header.stamp is taken.")
    vrs: str | None = Field(default=None, description="VRS file; see 'stream'.")
    stream: str | None = Field(
        default=None, description="The stream with the images: of 'vrs', as 1201-1; of 'video', where it has several."
    )
    stamp_offset_ns: int | None = Field(
        default=None,
        ge=-LARGEST_STAMP_NS,
        le=LARGEST_STAMP_NS,
        description="Added to the time stamps of the images. Needed for a video, whose stamps count from its first "
        "frame: that frame's time.",
    )

    @property
    def has_images(self) -> bool:
        """Whether it names images, of whatever source."""
        return bool(self.image_sources)

    @property
    def image_sources(self) -> tuple[str, ...]:
        """The kinds of image sources that it names, by the names of their fields."""
        folder = () if self.images is None and self.image_list is None else ("images",)
        others = tuple(name for name in ("video", "bag", "vrs") if getattr(self, name) is not None)
        return (*folder, *others)


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
    name: str | None = Field(
        default=None,
        description="The body, segment, prefix of labels, topic or frame in the file. Needed where it holds several.",
    )
    markers: list[str] | None = Field(
        default=None,
        min_length=3,
        description="Labels of the body's markers, to solve it from: the origin is their centroid, x points to the "
        "first one.",
    )
    rotation: RotationKind | None = Field(
        default=None,
        description="How rotations are written. Needed for Vicon's segments, and for three angles in a pose_list.",
    )
    angle_unit: AngleUnit | None = Field(
        default=None, description="Unit of the angles of a pose_list. Needed where the file's header doesn't say."
    )
    stamp_offset_ns: int = Field(
        default=0,
        ge=-LARGEST_STAMP_NS,
        le=LARGEST_STAMP_NS,
        description="Added to the file's time stamps, which in most exports count from the take's start.",
    )
    rate_hz: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="Frames a second. Needed where the file numbers frames and states no rate.",
    )

    @property
    def conventions(self) -> PoseConventions:
        return PoseConventions(self.quaternion, self.length_unit, self.time_unit, self.pose)

    @property
    def selection(self) -> BodySelection:
        """Which body of the file, and when."""
        markers = None if self.markers is None else tuple(self.markers)
        return BodySelection(self.name, markers, self.rotation, self.stamp_offset_ns, self.rate_hz)


class Manifest(Entry):
    """A recording of a board that cameras see and a mocap system tracks."""

    gtcal_recording: Literal[1] = Field(description="Version of this format: 1.")
    capture: CaptureName = Field(
        description="fixed_cameras: fixed cameras, tracked board. tracked_platform: cameras on a tracked platform "
        "(headset, rig), tracked board. standing_board: tracked platform, untracked board that stands still."
    )
    board: Annotated[dict[str, Any], WithJsonSchema(with_tolerance_schema(board_manifest_schema()))] = Field(
        description="The board: a preset, or a type and its fields; scale_sigma (1-sigma of its size, a share) and "
        "flatness_mm (1-sigma of bow and twist) say how near to that it is, else it counts as printed and glued."
    )
    layout: LayoutName | None = Field(default=None, description=LAYOUT_DESCRIPTION)
    numbered: bool = Field(
        default=False,
        description="Images, corners and poses go together by number, one pose for each image (format pose_list): "
        "there are no time stamps, so nothing is interpolated, and there is no clock.",
    )
    cameras: dict[CameraName, CameraEntry] = Field(min_length=1, description="The cameras by name.")
    platform: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the cameras.")
    board_body: TrajectoryEntry | None = Field(default=None, description="The tracked body that carries the board.")
    max_gap_ms: float | None = Field(
        default=None,
        gt=0,
        le=1e9,
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
        **unless_layout(Manifest.model_json_schema(), "cameras"),
        "allOf": [_bodies_schema(capture) for capture in Capture],
    }


def unless_layout(schema: dict[str, Any], *names: str) -> dict[str, Any]:
    """The schema of a manifest in which a layout may stand for these fields."""
    required = [name for name in schema["required"] if name not in names]
    return {**schema, "required": required, "anyOf": [{"required": list(names)}, {"required": ["layout"]}]}


def find_manifest(path: Path) -> Path:
    """The manifest at ``path``: the file itself, or the one in this folder.

    Raises GtcalError where there is none, or more than one."""
    check_regular(path)
    if path.is_file():
        return path
    if not path.is_dir():
        raise GtcalError(f"{path}: there is no such recording; expected a folder with {MANIFEST_NAMES[0]} in it")
    found = [path / name for name in MANIFEST_NAMES if (path / name).is_file()]
    if not found:
        laid_out = "; it is laid out as EuRoC's, but which board was shown stands nowhere" if find_layout(path) else ""
        raise GtcalError(
            f"{path}: there is no manifest in this folder; expected {' or '.join(MANIFEST_NAMES)}{laid_out}; "
            f"'gtcal init {path}' drafts one"
        )
    if len(found) > 1:
        raise GtcalError(f"{path}: there are {' and '.join(f.name for f in found)}; keep one")
    return found[0]


def read_manifest(path: Path) -> Manifest:
    """Read and check the manifest file at ``path``.

    Raises GtcalError naming the file and the field for the first thing that is wrong."""
    return manifest_of(path, load_fields(path))


def named_files(path: Path) -> tuple[Path, ...]:
    """The manifest at ``path`` and every file and folder that a text in it names, as far as they are there: what a
    recording is read from, also where something is wrong with it."""
    manifest = find_manifest(path)
    try:
        fields = load_document(manifest)
        fields = expanded(manifest, fields) if isinstance(fields, dict) else fields
    except GtcalError:
        return (manifest,)
    named = (manifest.parent / text for text in dict.fromkeys(_texts(fields, 0)))
    return (manifest, *(file for file in named if is_there(file)))


_DEEPEST = 10
"""No field of a manifest lies deeper."""


def _texts(value: Any, depth: int) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list) and depth < _DEEPEST:
        for part in value.values() if isinstance(value, dict) else value:
            yield from _texts(part, depth + 1)


def manifest_of(path: Path, data: dict[str, Any]) -> Manifest:
    """The fields of the manifest at ``path``, checked. Raises GtcalError as ``read_manifest``."""
    if "device" in data:
        raise GtcalError(
            f"{path}: device: this is a recording of a Lollypop, which verifies a calibration ('gtcal verify', and "
            "'gtcal doctor --calibration'), not of a board to calibrate from"
        )
    if "boards" in data:
        raise GtcalError(
            f"{path}: boards: this is a recording of several, which 'gtcal calibrate' and 'report' take; for all else "
            "write a manifest with one of them ('board', 'capture', 'board_body') beside it"
        )
    _refuse_poses(path, data.get("cameras"))
    manifest = validated(path, data, Manifest)
    try:
        check_bodies(Capture(manifest.capture), set(manifest.bodies))
        check_sources(manifest.cameras)
        check_numbered_bodies(manifest.bodies, numbered=manifest.numbered)
        _check_without_time(manifest)
    except GtcalError as error:
        raise GtcalError(f"{path}: {error}") from None
    return manifest


def _refuse_poses(path: Path, cameras: Any) -> None:
    for name, camera in cameras.items() if isinstance(cameras, dict) else ():
        if isinstance(camera, dict) and "views" in camera:
            raise GtcalError(
                f"{path}: cameras.{name}.views: these are poses in place of corners, which 'gtcal calibrate', "
                "'compare', 'doctor' and 'report' take; all else needs images or corners"
            )


def check_numbered_bodies(bodies: Mapping[str, TrajectoryEntry], *, numbered: bool) -> None:
    """Raises GtcalError where poses have no time, but the recording does, or the other way round."""
    for name, body in bodies.items():
        if not numbered and body.format == pose_list.FORMAT:
            raise GtcalError(
                f"{name}.format: a {pose_list.FORMAT} has no time stamps; where its poses go with the images by "
                "number, set numbered: true"
            )
        if numbered and body.format != pose_list.FORMAT:
            raise GtcalError(
                f"{name}.format: numbered: true takes a {pose_list.FORMAT}, one pose for each image; leave numbered "
                f"out where the poses of {body.format} have the images' clock"
            )
        if body.angle_unit is not None and body.format != pose_list.FORMAT:
            raise GtcalError(f"{name}.angle_unit: belongs to format {pose_list.FORMAT}")


def _check_without_time(manifest: Manifest) -> None:
    """Raises GtcalError where a numbered recording states what only time has."""
    if not manifest.numbered:
        return
    of_time = {"layout": manifest.layout, "max_gap_ms": manifest.max_gap_ms}
    for name, camera in manifest.cameras.items():
        fields = ("image_list", "video", "bag", "vrs", "rolling_shutter", "stamp_offset_ns")
        of_time |= {f"cameras.{name}.{field}": getattr(camera, field) for field in fields}
    for name, body in manifest.bodies.items():
        of_time |= {f"{name}.stamp_offset_ns": body.stamp_offset_ns or None}
    for where, value in of_time.items():
        if value is not None:
            raise GtcalError(f"{where}: has to do with time, which a numbered recording has not; leave it out")


def load_fields(path: Path) -> dict[str, Any]:
    """The fields of a manifest file, unchecked, with those that its layout stands for.

    Raises GtcalError where it can't be read, is no YAML or JSON, or holds no fields."""
    data = load_document(path)
    if not isinstance(data, dict):
        raise GtcalError(f"{path}: is no manifest; expected fields such as 'gtcal_recording: 1'")
    check_answered(path, data)
    return expanded(path, data)


def validated(path: Path, data: dict[str, Any], kind: type[M]) -> M:
    """The fields as a manifest of this kind. Raises GtcalError naming the file and the first field that is wrong."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        of_gtcal = [name.removeprefix("gtcal_") for name in data if name.startswith("gtcal_")]
        if "gtcal_recording" in kind.model_fields and of_gtcal and "recording" not in of_gtcal:
            what = of_gtcal[0].replace("_", " ")
            raise GtcalError(f"{path}: is a {what} of gtcal, not the manifest of a recording") from None
        raise GtcalError(f"{path}: {_explain(error, kind)}") from None


def write_manifest(path: Path, manifest: Entry) -> None:
    """Write a manifest as YAML, without the fields at None. Raises GtcalError where its folder takes no files."""
    data = manifest.model_dump(exclude_none=True)
    if not data.get("numbered", True):
        del data["numbered"]
    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120))


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """'; did you mean ...?' where one of the choices is near, else nothing."""
    near = get_close_matches(name, list(choices), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def check_sources(cameras: dict[str, CameraEntry]) -> None:
    """Raises GtcalError where a camera has neither images nor detections, images of more than one source, or a field
    that belongs to another source."""
    for name, camera in cameras.items():
        where = f"cameras.{name}"
        sources = camera.image_sources
        if not sources and camera.detections is None:
            raise GtcalError(
                f"{where}: has neither 'images' nor 'image_list' nor 'video' nor 'bag' nor 'vrs' nor 'detections'; "
                "give one"
            )
        if len(sources) > 1:
            raise GtcalError(f"{where}: has {' and '.join(map(repr, sources))}; its images come from one of them")
        _check_source_fields(where, camera, sources)
        if camera.intrinsics is not None and camera.parameters is not None:
            raise GtcalError(f"{where}: has both 'intrinsics' and 'parameters'; give one")
        if camera.parameter_sigmas and camera.intrinsics is None and camera.parameters is None:
            raise GtcalError(f"{where}: has 'parameter_sigmas', but no 'parameters' or 'intrinsics'")


def _check_source_fields(where: str, camera: CameraEntry, sources: tuple[str, ...]) -> None:
    for field, owners in _FIELDS_OF_SOURCES.items():
        if getattr(camera, field) is not None and not set(owners) & set(sources):
            raise GtcalError(f"{where}.{field}: belongs to {' or '.join(map(repr, owners))}, which isn't given")
    if camera.stamp_offset_ns is not None and camera.detections is not None:
        raise GtcalError(
            f"{where}.stamp_offset_ns: shifts the stamps of images, not those of 'detections'; leave out one of the two"
        )
    if camera.video is not None and camera.stamp_offset_ns is None:
        raise GtcalError(
            f"{where}.stamp_offset_ns: is missing; a video's stamps count from its first frame: give that frame's time "
            "on the mocap's clock in ns (0 where the mocap counts from there too)"
        )


_FIELDS_OF_SOURCES = {
    "topic": ("bag",),
    "stream": ("vrs", "video"),
    "stamp_offset_ns": ("images", "video", "bag", "vrs"),
}


def _bodies_schema(capture: Capture) -> dict[str, Any]:
    forbidden = [name for name in ("platform", "board_body") if name not in capture.bodies]
    return {
        "if": {"properties": {"capture": {"const": capture.value}}},
        "then": {
            "anyOf": [{"required": list(capture.bodies)}, {"required": ["layout"]}],
            "properties": dict.fromkeys(forbidden, False),
        },
    }


def _explain(error: ValidationError, kind: type[Entry]) -> str:
    """The first error in one line: an unknown field before a missing one, since a misspelt field is both."""
    errors = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = errors[0]
    parts = [str(part) for part in first["loc"] if part != "[key]"]
    field = ".".join(shown(part) if fault_of_name(part) else part for part in parts)
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    return f"{field}: {_message(first, kind)}{more}"


def _message(error: ErrorDetails, manifest: type[Entry]) -> str:
    kind, given = error["type"], error["input"]
    if kind == "extra_forbidden":
        names = list(_entry_at(error["loc"], manifest).model_fields)
        within, dot, field = str(error["loc"][-1]).rpartition(".")
        if dot and within.split(".")[0] in names:  # as messages name them
            return f"is not a field: write '{field}' as a field within '{within}'"
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
    if loc[0] != "cameras":
        return TrajectoryEntry
    inner: dict[str, type[Entry]] = {"rolling_shutter": ShutterEntry, "intrinsics": IntrinsicsEntry}
    return inner.get(str(loc[2]), CameraEntry) if len(loc) > 3 else CameraEntry
