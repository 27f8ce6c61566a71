"""How a result file is read: JSON of a known schema, or one line on what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from gtcal.documents import check_extent, read_text
from gtcal.errors import GtcalError
from gtcal.files import is_there

T = TypeVar("T")


def read_result(path: Path, kind: str, schema_version: int, parse: Callable[[dict[str, Any]], T]) -> T:
    """What ``parse`` makes of the document in a file whose field ``gtcal_<kind>`` holds its schema's version.

    Raises GtcalError for a file that is missing, no JSON, of a newer schema, or where ``parse`` misses a field or finds
    one of the wrong form."""
    if is_there(path) and path.is_dir():
        raise GtcalError(f"{path}: is a folder; expected a {kind} of gtcal, a JSON file")
    document = _read_json(path, kind)
    check_extent(path, document)
    version = document.get(f"gtcal_{kind}") if isinstance(document, dict) else None
    if not isinstance(version, int):
        raise GtcalError(f"{path}: is no {kind} of gtcal: the field 'gtcal_{kind}' is missing")
    if version > schema_version:
        raise GtcalError(f"{path}: has {kind} schema {version}, this gtcal reads up to {schema_version}; update gtcal")
    try:
        return parse(document)
    except GtcalError as error:
        raise GtcalError(f"{path}: {error}") from None
    except KeyError as error:
        raise GtcalError(f"{path}: the field {error.args[0]!r} is missing") from error
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, RecursionError) as error:
        raise GtcalError(f"{path}: a field has the wrong form: {error}") from error


def _read_json(path: Path, kind: str) -> Any:
    try:
        return json.loads(read_text(path), parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise GtcalError(f"{path}: is no {kind} of gtcal, it is not valid JSON: {error}") from error


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")
