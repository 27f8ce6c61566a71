"""Files of nested fields, YAML, JSON and TOML, read as people mean them; where damaged, told in one line."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Hashable, Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml

from gtcal.bounds import within
from gtcal.errors import GtcalError
from gtcal.files import DOCUMENT_BYTES, read_bytes


def load_document(path: Path) -> Any:
    """What a file says: JSON (also the single line of a .jsonl) or TOML by its suffix, else YAML.

    Raises GtcalError naming the file, and the line where there is one, for a file that can't be read, is not valid, or
    holds a field twice."""
    return parse_document(path, read_text(path))


def parse_document(path: Path, text: str) -> Any:
    """``load_document`` of a file whose text is at hand."""
    document = _parsed(path, text)
    check_extent(path, document)
    return document


def _parsed(path: Path, text: str) -> Any:
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return load_toml(path, text)
    if suffix == ".jsonl" and (n_lines := len(text.split("\n{"))) > 1:
        raise GtcalError(f"{path}: holds {n_lines} documents, a line each; keep the one that is meant")
    return _load_json(path, text) if suffix in (".json", ".jsonl") else _load_yaml(path, text)


def read_text(path: Path) -> str:
    """A text file in UTF-8, with or without a byte order mark, its lines ended by \\n. Raises GtcalError where it is
    none."""
    try:
        text = read_bytes(path, DOCUMENT_BYTES).decode("utf-8-sig")
        return text.replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise GtcalError(f"{path}: can't be read: {error.strerror}") from error
    except UnicodeDecodeError:
        raise GtcalError(f"{path}: is not UTF-8 text") from None


def load_toml(path: Path, text: str) -> Any:
    """The fields of a text in TOML. Raises GtcalError naming the file where it is not valid."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise GtcalError(f"{path}: is not valid TOML: {error}") from None


def load_plain_yaml(path: Path, text: str) -> Any:
    """A text in YAML as PyYAML takes it, OpenCV's first line, which is no YAML to others, left out. Raises GtcalError
    naming the file where it is not valid."""
    try:
        document = yaml.load(re.sub(r"\A%YAML:[^\n]*\n(---)?", "", text), PlainLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise GtcalError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from None
    check_extent(path, document)
    return document


_DEEPEST = 64
_MOST_VALUES = 5_000_000


def check_extent(path: Path, document: Any) -> None:
    """Raises GtcalError where fields lie within fields without end, by names that stand for others there are more than
    any file holds, or a number is beyond all bounds."""
    count, level = 0, [document]
    for _ in range(_DEEPEST):
        level = [part for value in level for part in _parts(value)]
        count += len(level)
        if not level:
            return
        if count > _MOST_VALUES:
            raise GtcalError(f"{path}: holds more than {_MOST_VALUES} values, by aliases (*) that stand for others")
        if not all(map(_is_bounded, level)):
            where, value = next(_unbounded(document))
            raise GtcalError(f"{path}: {where}: is {short(value)}, beyond any number that has a meaning here")
    raise GtcalError(f"{path}: its fields lie within each other, more than {_DEEPEST} deep, or without end")


def _is_bounded(value: Any) -> bool:
    return within(value) or value != value or abs(value) == math.inf  # infinity and NaN have checks of their own


def _unbounded(value: Any, where: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The dotted names and values of the numbers beyond bounds."""
    if not _is_bounded(value):
        yield where, value
    parts = value.items() if isinstance(value, dict) else enumerate(_parts(value))
    for name, part in parts if depth < _DEEPEST else ():
        yield from _unbounded(part, f"{where}.{name}" if where else str(name), depth + 1)


def short(value: Any) -> str:
    """A value in a message, not all of a long one."""
    if isinstance(value, int) and abs(value) >= 10**40:
        return f"a number of {value.bit_length() * 3 // 10} digits"
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _parts(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list | tuple | set) else ()


def _load_json(path: Path, text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_without_duplicates)
    except json.JSONDecodeError as error:
        raise GtcalError(f"{path}:{error.lineno}: is not valid JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
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
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise GtcalError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from None


# libyaml's, where PyYAML has it: it bounds the depth, where Python's takes seconds over brackets within brackets
PlainLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""YAML as PyYAML takes it."""


class _Loader(PlainLoader):
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
