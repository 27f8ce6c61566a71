"""How many cores a command may use: ``--jobs N`` of every command, or the environment variable GTCAL_JOBS.

Told to every library by the environment, before the first of them is imported."""

from __future__ import annotations

import os
from collections.abc import Sequence

JOBS_HELP = (
    "--jobs N (or the environment variable GTCAL_JOBS): use N cores at most, where a machine is shared; by default all "
    "that there are."
)

_VARIABLE = "GTCAL_JOBS"
_OPTION = "--jobs"
# One each: our matrices are small, and our own threads and processes use the cores.
_LINEAR_ALGEBRA = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_OPENCV = "OPENCV_FOR_THREADS_NUM"


def limit_jobs(arguments: Sequence[str]) -> list[str]:
    """Sets the environment by the option or the variable; returns the arguments without the option.

    Raises ValueError, in words for the user, where either is no whole number from 1 on."""
    rest, stated = _taken(arguments)
    name = _OPTION if stated is not None else _VARIABLE
    stated = os.environ.get(_VARIABLE, "") if stated is None else stated
    if stated or name == _OPTION:
        if not stated.isdecimal() or int(stated) < 1:
            raise ValueError(f"{name} is {stated!r}; expected a whole number of cores, 1 or more")
        os.environ[_VARIABLE] = os.environ[_OPENCV] = stated
    for variable in _LINEAR_ALGEBRA:
        os.environ.setdefault(variable, "1")
    return rest


def _taken(arguments: Sequence[str]) -> tuple[list[str], str | None]:
    """The arguments without the option, and its value."""
    rest, stated, given = list[str](), None, iter(arguments)
    for argument in given:
        if argument == _OPTION:
            stated = next(given, "")
        elif argument.startswith(f"{_OPTION}="):
            stated = argument.partition("=")[2]
        else:
            rest.append(argument)
    return rest, stated
