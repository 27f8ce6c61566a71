"""The command line: one module per command, imported only when the command runs."""

from __future__ import annotations

import errno
import gc
import inspect
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout
from functools import wraps
from importlib import import_module
from pathlib import Path
from textwrap import fill

from gtcal.cli.jobs import JOBS_HELP, limit_jobs

COMMANDS = {
    "demo": "render small recordings, calibrate, verify, and compare with the truth",
    "board": "draw a calibration board to scale",
    "init": "look at a folder and draft the manifest of a recording",
    "info": "show what is in a recording or a result: rates, gaps, overlap, coverage, as a picture too",
    "calibrate": "find every camera's extrinsic and the board-to-body transform from a recording",
    "doctor": "find out what is wrong with a recording, and which lines of its manifest to change",
    "uncertainty": "say how sure a calibration is: in mm, deg and px, by kind, and where it is weak",
    "compare": "calibrate a recording by other methods too, and compare",
    "selfcheck": "check a calibration against its own recording: halves, frames held out, chain and PnP",
    "verify": "test a calibration with an independent recording of the Lollypop",
    "drift": "verify a calibration over successive recordings of the Lollypop",
    "batch": "calibrate, verify and follow many recordings of many rigs, on all cores or a cluster, into one store",
    "history": "show a rig over months: what its recordings found, what is no chance, when it leaves the tolerance",
    "site": "write a static web site of a store: the fleet, each rig, the reports",
    "watch": "verify each recording of the Lollypop in a folder as soon as it is complete, and show the verdict large",
    "diff": "compare two calibrations of one rig: what moved, what is the same, what they can't tell apart",
    "report": "show a calibration, what it rests on and its verification on one HTML page",
    "export": "write a calibration as a file of another tool: Kalibr, OpenCV, ROS, COLMAP, Aria, Pose2Sim, ...",
    "convert": "read camera files or trajectories of one tool and write them for another",
    "detect": "find the board in a recording's images, and keep the corners",
    "simulate": "simulate a recording with known ground truth",
    "guide": "show a chapter of the guide: manifests, formats, boards, trust, verification, fleets, Python",
    "schema": "print the JSON schema of a recording's manifest, or of what commands for fleets read and print",
    "completion": "print the script that makes bash, zsh or fish complete gtcal's commands and options",
}
"""Every command, a function of this name in the module of this name, and what it does."""

OVERVIEW = """usage: gtcal COMMAND ...

Camera-to-mocap calibration: where each camera sits relative to the mocap system, and how sure that is.

The usual way: 'gtcal board' draws a board to print; you record it with the cameras and the mocap running;
'gtcal init FOLDER' drafts the manifest and 'gtcal info FOLDER' shows what you have; 'gtcal calibrate FOLDER' writes
calibration.json; 'gtcal verify calibration.json LOLLYPOP_RECORDING' tells whether it is true. 'gtcal demo' shows all
of it.

commands:
{commands}

'gtcal COMMAND --help' explains a command, 'gtcal guide' all else; 'gtcal --version' prints the version.
Every command takes {jobs}

exit codes: 0 fine, 1 a failure told in one line, 2 usage, 3 failed or moved, 4 it can't be told"""

_GC_THRESHOLD = 100_000
"""Python looks for garbage after so many new objects. At its own 700 that takes a tenth of a short command's time: its
imports make many objects and no garbage."""

_OF_THE_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENOMEM)
"""What the system says that no program can help, nor say it of a file."""

EXIT_FAILURE, EXIT_USAGE, EXIT_INTERRUPTED, EXIT_ENDED = 1, 2, 130, 143


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help"):
        print(_overview())
        return 0 if given else EXIT_USAGE
    if given[0] == "--version":
        from importlib.metadata import version

        print(f"gtcal {version('gtcal')}")
        return 0
    if given[0] not in COMMANDS:
        from difflib import get_close_matches

        near = "".join(f"; did you mean {name!r}?" for name in get_close_matches(given[0], COMMANDS, n=1))
        print(f"gtcal: {given[0]!r} is no command{near}; commands: {', '.join(COMMANDS)}", file=sys.stderr)
        return EXIT_USAGE
    return _run(given[0], given[1:])


def _overview() -> str:
    width = max(len(name) for name in COMMANDS)
    commands = "\n".join(f"  {name:{width}}  {what}" for name, what in COMMANDS.items())
    return OVERVIEW.format(commands=commands, jobs=fill(JOBS_HELP, 120, initial_indent=20 * " ").lstrip())


def _taking_jobs(function: Callable[..., object]) -> Callable[..., object]:
    """The command, its help with what every command takes."""
    said, arguments, each = (inspect.getdoc(function) or "").partition("\n\nArgs:")
    if JOBS_HELP not in said:  # else it ran before
        function.__doc__ = f"{said}\n\n{JOBS_HELP}{arguments}{each}"
    return function


def _said_to_start(command: str, function: Callable[..., object]) -> Callable[..., object]:
    """The command, saying in a terminal that it is there, for it takes a second to load what it computes with. What it
    says next takes the line's place."""

    @wraps(function)
    def started(*arguments: object, **options: object) -> object:
        if sys.stderr.isatty() and not options.get("quiet"):
            print(f"gtcal {command}: starting", end="\r", file=sys.stderr, flush=True)
        return function(*arguments, **options)

    return started


class _EndedError(BaseException):
    """A scheduler wants this program to end. As KeyboardInterrupt, nothing that catches errors catches it."""


@contextmanager
def _ending_in_words() -> Iterator[None]:
    """SIGTERM ends what runs inside as Ctrl-C does: what is being written is cleared away, and a line says it."""

    def end(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # while clearing away
        raise _EndedError

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _words_beside_data(arguments: Sequence[str]) -> AbstractContextManager[object]:
    """Where an output goes to /dev/stdout, or JSON to standard output, what is shown goes to stderr: who reads the
    output wants nothing else. Raises GtcalError where both are asked for."""
    from gtcal.cli.json_output import OPTION, alone_on_standard_output
    from gtcal.errors import GtcalError
    from gtcal.files import is_standard_output

    values = [argument.partition("=")[2] if argument.startswith("--") else argument for argument in arguments]
    to_stdout = any(value not in ("", os.devnull) and is_standard_output(Path(value)) for value in values)
    if OPTION in arguments:
        if to_stdout:
            raise GtcalError(f"{OPTION} prints the result on standard output: leave out the output that goes there too")
        return alone_on_standard_output()
    return redirect_stdout(sys.stderr) if to_stdout else nullcontext()


def _warn_on_stderr() -> None:
    """What is logged, in single lines."""
    from gtcal.plain import OneLine

    handler = logging.StreamHandler()
    handler.setFormatter(OneLine("%(name)s: %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)


def _run(command: str, arguments: list[str]) -> int:
    try:
        arguments = limit_jobs(arguments)  # before the imports: libraries read the environment once
    except ValueError as error:
        print(f"gtcal: {error}", file=sys.stderr)
        return EXIT_USAGE
    gc.set_threshold(_GC_THRESHOLD)  # before the imports: they are half of a short command's time
    import tyro

    from gtcal.cli.light_types import lightly_typed
    from gtcal.errors import GtcalError
    from gtcal.plain import one_line

    _warn_on_stderr()
    stated = _taking_jobs(getattr(import_module(f"gtcal.cli.{command}"), command))
    function = _said_to_start(command, lightly_typed(stated))
    try:
        with _ending_in_words(), _words_beside_data(arguments):
            code = tyro.cli(function, prog=f"gtcal {command}", args=arguments)
            sys.stdout.flush()
    except GtcalError as error:
        print(f"gtcal: {one_line(str(error))}", file=sys.stderr)
        return EXIT_FAILURE
    except (_EndedError, KeyboardInterrupt) as error:
        return _ended(error)
    except BrokenPipeError:  # the reader of our output, 'head' say, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILURE
    except OSError as error:  # of the machine, wherever it came up: a folder that is locked, say
        if error.filename is None and error.errno not in _OF_THE_MACHINE:
            return _bug()
        where = "" if error.filename is None else f"{error.filename}: "
        print(f"gtcal: {one_line(f'{where}{error.strerror or error}')}", file=sys.stderr)
        return EXIT_FAILURE
    except Exception as error:
        # Python wraps what comes up while a class is made, in an import say
        return _ended(error.__cause__) if isinstance(error.__cause__, _EndedError | KeyboardInterrupt) else _bug()
    return code if isinstance(code, int) else 0


def _ended(by: _EndedError | KeyboardInterrupt) -> int:
    if isinstance(by, KeyboardInterrupt):
        print("gtcal: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    print("gtcal: ended by a signal (SIGTERM)", file=sys.stderr)
    return EXIT_ENDED


def _bug() -> int:
    """Of what nobody thought of, the traceback."""
    logging.getLogger("gtcal").exception("this is a bug in gtcal; please report it with what you ran")
    return EXIT_FAILURE
