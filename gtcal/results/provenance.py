"""How a result was made."""

from __future__ import annotations

import datetime
import platform
import sys
from dataclasses import asdict, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from gtcal.files import InputFile
from gtcal.results.calibration import Provenance


@runtime_checkable
class Documented(Protocol):
    """What says itself how it stands in a file."""

    def document(self) -> dict[str, Any]: ...


_LIBRARIES = ("gtcal", "gtsam", "numpy", "numba", "opencv-contrib-python-headless", "scipy")


def provenance(options: object, inputs: tuple[InputFile, ...], duration_s: float) -> Provenance:
    """The circumstances of a result computed just now. options: the dataclass of its options."""
    return Provenance(
        created_utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command_line=(Path(sys.argv[0]).name, *sys.argv[1:]),
        versions={"python": platform.python_version()} | {name: _version(name) for name in _LIBRARIES},
        options=plain_options(options),
        inputs=inputs,
        duration_s=duration_s,
    )


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "not installed as a package"


def plain_options(options: object) -> dict[str, Any]:
    """As JSON knows it: tuples as lists."""
    return {
        name: list(value) if isinstance(value, tuple) else _as_fields(value) for name, value in vars(options).items()
    }


def _as_fields(value: Any) -> Any:
    if isinstance(value, Documented):
        return value.document()
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
