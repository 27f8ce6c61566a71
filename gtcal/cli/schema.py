"""gtcal schema: the JSON schemas of what is read and printed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro


def schema(
    of: Annotated[
        tyro.conf.Positional[Literal["recording", "jobs", "batch", "batch-plan", "history", "watch"]],
        tyro.conf.arg(metavar="[OF]"),
    ] = "recording",
    *,
    lollypop: bool = False,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
) -> None:
    """Print the JSON schema of a recording's manifest, for editors that complete and check as you type; or of a file of
    jobs, or of what a command prints with --json.

    Args:
        of: recording: a recording's manifest. jobs: a file of jobs for 'gtcal batch'. batch, batch-plan, history,
            watch: what 'gtcal batch --json' (with --dry-run: batch-plan), 'gtcal history --json' and 'gtcal watch'
            print.
        lollypop: That of a recording of the Lollypop, with 'device' and 'device_body'.
        output: File to write in place of printing.
    """
    import json

    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, write_text
    from gtcal.recordings.manifest import manifest_schema
    from gtcal.verification.lollypop_recording import lollypop_manifest_schema

    if lollypop and of != "recording":
        raise GtcalError(f"--lollypop is of a recording's manifest, not of {of}")
    check_outputs([output])
    if of == "recording":
        found = lollypop_manifest_schema() if lollypop else manifest_schema()
    else:
        from gtcal.cli.json_schemas import schema_of

        found = schema_of(of)
    text = json.dumps(found, indent=2)
    if output is None:
        print(text)
    else:
        write_text(output, text + "\n")
