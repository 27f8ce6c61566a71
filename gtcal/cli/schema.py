"""gtcal schema: the JSON schemas of what is read and printed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def schema(
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[NAME]")] = "recording",
    *,
    list_: Annotated[bool, tyro.conf.arg(name="list")] = False,
    lollypop: bool = False,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
) -> None:
    """Print the JSON schema of a recording's manifest, for editors that complete and check as you type; or of anything
    else that gtcal reads or prints as JSON: every command that shows a table prints JSON in its place with --json.

        gtcal schema --list
        gtcal schema calibration -o calibration.schema.json

    Each document says its own kind and version in its first field, as "gtcal_calibration": 1. Fields may come with a
    version; what one means changes with the version only.

    Args:
        name: Which; by default that of a recording's manifest.
        list_: List the names, what each is, and which commands print it.
        lollypop: Short for lollypop-recording: the manifest of a recording of the Lollypop, with 'device' and
            'device_body'.
        output: File to write in place of printing.
    """
    import json

    from gtcal.cli.json_schemas import NAMES, schema_of
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, write_text

    if lollypop and name != "recording":
        raise GtcalError(f"--lollypop is of a recording's manifest, not of {name}")
    if name not in NAMES:
        raise GtcalError(f"there is no schema {name!r}; schemas: {', '.join(NAMES)}")
    check_outputs([output])
    if list_:
        _list()
        return
    text = json.dumps(schema_of("lollypop-recording" if lollypop else name), indent=2)
    if output is None:
        print(text)
    else:
        write_text(output, text + "\n")


def _list() -> None:
    from gtcal.cli.json_schemas import NAMES, PRINTED_BY, schema_of

    width = max(map(len, NAMES))
    for name in NAMES:
        by = ", ".join(f"gtcal {command}" for command, names in PRINTED_BY.items() if name in names)
        what = str(schema_of(name)["description"]).split("\n")[0]
        print(f"{name:{width}}  {what}" + (f"  [{by}]" if by else ""))
