"""The command line: one module per command, each imported whole only when it runs."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence

DESCRIPTION = """Camera-to-mocap calibration: where each camera sits relative to the mocap system, and how sure that is.

The usual way: 'gtcal board' draws a board to print; you record it with the cameras and the mocap running; 'gtcal
calibrate RECORDING' solves and writes calibration.json. 'gtcal demo' shows all of it on a rendered recording.
'gtcal COMMAND --help' explains a command."""

EXIT_FAILURE = 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Exit codes: 0 fine, 1 a known failure told in one line (or a bug, with its traceback), 2 usage."""
    import tyro

    from gtcal.cli.board import board
    from gtcal.cli.calibrate import calibrate
    from gtcal.cli.demo import demo
    from gtcal.cli.detect import detect
    from gtcal.cli.schema import schema
    from gtcal.cli.simulate import simulate
    from gtcal.errors import GtcalError

    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        return _print_version()
    commands = {
        "demo": demo,
        "board": board,
        "calibrate": calibrate,
        "detect": detect,
        "simulate": simulate,
        "schema": schema,
    }
    logging.basicConfig(format="%(name)s: %(message)s", level=logging.WARNING)
    try:
        tyro.extras.subcommand_cli_from_dict(
            commands, prog="gtcal", description=DESCRIPTION, args=given, sort_subcommands=False
        )
    except GtcalError as error:
        print(f"gtcal: {error}", file=sys.stderr)
        return EXIT_FAILURE
    except KeyboardInterrupt:
        print("gtcal: interrupted", file=sys.stderr)
        return 130
    except Exception:
        logging.getLogger("gtcal").exception("this is a bug in gtcal; please report it with what you ran")
        return EXIT_FAILURE
    return 0


def _print_version() -> int:
    from importlib.metadata import version

    print(f"gtcal {version('gtcal')}")
    return 0
