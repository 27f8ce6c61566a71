"""Jobs in a YAML or CSV file, or the recordings that are found in a folder; all of it checked before anything runs.

gtcal_jobs: 1
options:                                  # for all jobs of a kind; those of a job come on top
  calibrate: {effects: false}
  verify: {max_rmse_px: 0.4}
jobs:
  - {rig: rig07, kind: calibrate, recording: rig07/2026-05-04_board, accept: true}
  - {rig: rig07, kind: verify, recording: rig07/2026-05-05_lollypop, taken: 2026-05-05T08:10}
  - {rig: rig07, kind: drift, name: may, recordings: [rig07/2026-05-05_lollypop, rig07/2026-05-06_lollypop]}
"""

from __future__ import annotations

import csv
import datetime
import io
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_type_hints

import yaml
from pydantic import Field, create_model

from factors import RobustKernel
from gtcal.documents import PlainLoader, load_document, load_plain_yaml, read_text
from gtcal.errors import GtcalError
from gtcal.estimation.options import CalibrationOptions, MocapSigmas
from gtcal.estimation.priors_file import read_priors
from gtcal.files import is_there
from gtcal.fleet.jobs import Job, JobKind, JobsError, check_distinct, taken_ns_in, taken_ns_of
from gtcal.names import check_name
from gtcal.recordings.manifest import MANIFEST_NAMES, Entry, find_manifest, load_fields, validated
from gtcal.verification.verification import VerificationOptions

TakenFrom = Literal["stamps", "name"]
"""Where a recording's date comes from, if it isn't stated: its time stamps, or its name."""


class JobEntry(Entry):
    """One job, as it is stated."""

    rig: str = Field(description="The rig's name.")
    kind: Literal["calibrate", "verify", "drift"] | None = Field(
        None, description="What to do; by default what the manifest is for."
    )
    recording: str | None = Field(None, description="The recording's folder or manifest, from where the file is.")
    recordings: list[str] | None = Field(None, description="Of a drift: the recordings in the order they were taken.")
    name: str | None = Field(None, description="What the recording is called; by default as its folder.")
    calibration: str | None = Field(
        None, description="calibration.json to verify; by default the rig's last accepted one before the recording."
    )
    taken: str | datetime.datetime | datetime.date | None = Field(
        None, description="When it was taken, ISO 8601, UTC where no zone is stated; by default by its stamps."
    )
    accept: bool | None = Field(None, description="Of a calibration: the rig is used with it from then on.")
    report: bool | None = Field(None, description="Whether to write a report too.")
    options: dict[str, Any] = Field(default_factory=dict, description="As of the command, with _ in place of -.")


class KindOptions(Entry):
    """Options for all jobs of a kind."""

    calibrate: dict[str, Any] = Field(default_factory=dict, description="As of 'gtcal calibrate'.")
    verify: dict[str, Any] = Field(default_factory=dict, description="As of 'gtcal verify'.")
    drift: dict[str, Any] = Field(default_factory=dict, description="As of 'gtcal drift'.")


class JobsHead(Entry):
    """What a file of jobs holds beside the jobs."""

    gtcal_jobs: Literal[1] = Field(description="Version of this format: 1.")
    options: KindOptions = Field(default_factory=KindOptions, description="Options by kind, for all jobs.")


def read_jobs(path: Path, *, taken_from: TakenFrom = "stamps", report: bool = False) -> tuple[Job, ...]:
    """The jobs that a file states, or those of all recordings in a folder, whose first parts below it name the rigs.

    Raises JobsError with a line for each job that is wrong; GtcalError where the file can't be read."""
    if path.is_dir():
        stated, head = _found_in(path), KindOptions()
    elif path.suffix.lower() == ".csv":
        stated, head = _rows(path), KindOptions()
    else:
        stated, head = _entries(path)
    jobs, wrong = [], []
    for where, fields in stated:
        try:
            jobs.append(_job(where, fields, path if path.is_dir() else path.parent, head, taken_from, report))
        except GtcalError as error:
            text = str(error)
            wrong.append(text if text.startswith(where) else f"{where}: {text}")
    if wrong:
        raise JobsError(wrong)
    if not jobs:
        raise GtcalError(f"{path}: holds no jobs; expected a list of them, or a folder with recordings in it")
    check_distinct(jobs)
    return tuple(jobs)


Stated = list[tuple[str, dict[str, Any]]]
"""Where each job is stated, and its fields."""


def _entries(path: Path) -> tuple[Stated, KindOptions]:
    document = load_document(path)
    if not isinstance(document, dict) or not isinstance(document.get("jobs"), list):
        raise GtcalError(f"{path}: is no file of jobs; expected 'gtcal_jobs: 1' and a list 'jobs'")
    head = validated(path, {name: value for name, value in document.items() if name != "jobs"}, JobsHead)
    lines = _lines_of_jobs(path) if path.suffix.lower() in (".yaml", ".yml") else []
    places = [f"{path}:{line}" for line in lines] or [f"{path}: jobs.{i}" for i in range(len(document["jobs"]))]
    return list(zip(places, document["jobs"], strict=True)), head.options


def _lines_of_jobs(path: Path) -> list[int]:
    """Of each job, none where they are merged in from elsewhere (<<)."""
    root = yaml.compose(read_text(path), PlainLoader)
    assert isinstance(root, yaml.MappingNode)  # load_document has seen to that
    stated = [value for key, value in root.value if key.value == "jobs"]
    return [node.start_mark.line + 1 for jobs in stated for node in jobs.value]


_FIELDS = frozenset(JobEntry.model_fields) - {"options"}


def _rows(path: Path) -> Stated:
    """Of a CSV with the fields as its header; 'options.max_rmse_px' is an option; an empty cell is not given."""
    reader = csv.reader(io.StringIO(read_text(path)))
    try:
        names, rows = next(reader, []), [(reader.line_num, row) for row in reader if any(row)]
    except csv.Error as error:
        raise GtcalError(f"{path}:{reader.line_num}: is no CSV: {error}") from None
    for name in names:
        if name not in _FIELDS and not name.startswith("options."):
            raise GtcalError(
                f"{path}:1: {name!r} is no field of a job; fields: {', '.join(sorted(_FIELDS))}, options.NAME"
            )
    return [(f"{path}:{line}", _row(f"{path}:{line}", names, row)) for line, row in rows]


def _row(where: str, names: list[str], row: list[str]) -> dict[str, Any]:
    if len(row) != len(names):
        raise GtcalError(f"{where}: has {len(row)} cells, the header {len(names)}")
    fields: dict[str, Any] = {"options": {}}
    for name, cell in zip(names, row, strict=True):
        if not cell:
            continue
        if name.startswith("options."):
            fields["options"][name.removeprefix("options.")] = load_plain_yaml(Path(where), cell)
        elif name == "recordings":
            fields[name] = [part.strip() for part in cell.split(";")]
        else:
            fields[name] = load_plain_yaml(Path(where), cell) if name in ("accept", "report") else cell
    return fields


def recordings_in(folder: Path) -> Iterator[Path]:
    """The manifests of the recordings below a folder, in order; what lies within a recording, or is hidden, is none."""
    for name in MANIFEST_NAMES:
        if is_there(folder / name):
            yield folder / name
            return
    try:
        inner = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise GtcalError(f"{folder}: can't be read: {error.strerror}") from None
    for path in inner:
        yield from recordings_in(path)


def _found_in(folder: Path) -> Stated:
    return [(str(manifest), stated_by_place(folder, manifest)) for manifest in recordings_in(folder)]


def stated_by_place(folder: Path, manifest: Path) -> dict[str, Any]:
    """The rig and the name of a recording by where it is: FOLDER/RIG/NAME, or FOLDER/NAME of the rig FOLDER."""
    parts = manifest.parent.relative_to(folder).parts
    rig = parts[0] if len(parts) > 1 else folder.resolve().name
    name = "_".join(parts[1:] or parts or ("recording",))
    return {"rig": rig, "name": name, "recording": str(manifest.parent.relative_to(folder))}


def _job(where: str, fields: Any, folder: Path, head: KindOptions, taken_from: TakenFrom, report: bool) -> Job:
    if not isinstance(fields, dict):
        raise GtcalError(f"{where}: is no job; expected fields such as 'rig' and 'recording'")
    entry = validated(Path(where), fields, JobEntry)
    manifests = _manifests(entry, folder)
    kind = entry.kind or _kind_of(manifests[0])
    name = entry.name or manifests[0].parent.name
    for what, called in (("rig", entry.rig), ("name", name)):
        check_name(what, called)
    _check_fitting(entry, kind)
    calibration = None if entry.calibration is None else folder / entry.calibration
    if calibration is not None and not calibration.is_file():
        raise GtcalError(f"calibration: {calibration}: there is no such file")
    options = getattr(head, kind) | entry.options
    return Job(
        rig=entry.rig,
        name=name,
        kind=kind,
        recordings=manifests,
        options=calibration_options(options, folder) if kind == "calibrate" else verification_options(options),
        calibration=calibration,
        taken_ns=_taken_ns(entry, name, taken_from),
        accept=bool(entry.accept),
        report=(report if entry.report is None else entry.report) and kind != "drift",
        where=where,
    )


def _manifests(entry: JobEntry, folder: Path) -> tuple[Path, ...]:
    given = entry.recordings if entry.recordings is not None else [entry.recording] if entry.recording else []
    if not given or (entry.recording and entry.recordings is not None):
        raise GtcalError("expected 'recording', or of a drift 'recordings'")
    return tuple(find_manifest(folder / path) for path in given)


def _kind_of(manifest: Path) -> JobKind:
    return "verify" if "device" in load_fields(manifest) else "calibrate"


def _check_fitting(entry: JobEntry, kind: JobKind) -> None:
    if kind != "drift" and entry.recordings is not None:
        raise GtcalError(f"recordings: are of a drift; a job of kind {kind!r} has one 'recording'")
    if kind == "calibrate" and entry.calibration is not None:
        raise GtcalError("calibration: is what 'verify' and 'drift' need, not 'calibrate'")
    if kind != "calibrate" and entry.accept:
        raise GtcalError(f"accept: is of a calibration, not of kind {kind!r}")


def _taken_ns(entry: JobEntry, name: str, taken_from: TakenFrom) -> int | None:
    if entry.taken is None:
        return taken_ns_in(name) if taken_from == "name" else None
    given = entry.taken
    try:
        return taken_ns_of(given if isinstance(given, str) else given.isoformat())
    except GtcalError as error:
        raise GtcalError(f"taken: {error}") from None


_NOT_PLAIN = ("robust", "mocap", "priors")
"""Options of a calibration that people state in other words."""


@cache
def _plain_options(kind: type) -> type[Entry]:
    hints = get_type_hints(kind)
    fields: dict[str, Any] = {
        name: (hint, Field(None, description="an option")) for name, hint in hints.items() if name not in _NOT_PLAIN
    }
    if kind is CalibrationOptions:
        fields["stages"] = (list[int], Field(None, description="an option"))
        for name, hint in (
            ("kernel", str),
            ("kernel_parameter", float),
            ("mocap_noise", str),
            ("mocap_sigma_mm", float),
            ("mocap_sigma_deg", float),
            ("priors", str),
        ):
            fields[name] = (hint, Field(None, description="an option"))
    return create_model("Options", __base__=Entry, **fields)


def _given(kind: type, fields: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are given, each of the right type."""
    model = _plain_options(kind)
    try:
        checked = validated(Path("options"), dict(fields), model)
    except GtcalError as error:
        raise GtcalError(str(error).replace("options: ", "options.", 1)) from None
    return {name: getattr(checked, name) for name in fields}


def verification_options(fields: Mapping[str, Any]) -> VerificationOptions:
    """From options by name, as 'gtcal verify' has them with _ in place of -. Raises GtcalError for one that makes no
    sense."""
    return VerificationOptions(**_given(VerificationOptions, fields))


def calibration_options(fields: Mapping[str, Any], folder: Path) -> CalibrationOptions:
    """From options by name, as 'gtcal calibrate' has them with _ in place of -; a file of priors is looked for from
    ``folder``. Raises GtcalError for one that makes no sense."""
    given = _given(CalibrationOptions, fields)
    kernel, parameter = given.pop("kernel", None), given.pop("kernel_parameter", None)
    noise = given.pop("mocap_noise", None)
    mm, deg = given.pop("mocap_sigma_mm", None), given.pop("mocap_sigma_deg", None)
    priors = given.pop("priors", None)
    if "stages" in given:
        given["stages"] = tuple(given["stages"])
    if kernel is not None:
        given["robust"] = _kernel(kernel, parameter)
    elif parameter is not None:
        raise GtcalError("options.kernel_parameter: is of a 'kernel', which isn't given")
    if (mm is None) != (deg is None):
        raise GtcalError("options.mocap_sigma_mm and mocap_sigma_deg go together: give both, or neither")
    if mm is not None and deg is not None:
        given["mocap"] = MocapSigmas(mm, deg)
    elif noise is not None:
        given["mocap"] = noise
    if priors is not None:
        given["priors"] = read_priors(folder / priors)
    return CalibrationOptions(**given)


def _kernel(name: str, parameter: float | None) -> RobustKernel:
    try:
        return RobustKernel.named(name) if parameter is None else RobustKernel(name, parameter)
    except ValueError as error:
        raise GtcalError(f"options.kernel: {error}") from None
