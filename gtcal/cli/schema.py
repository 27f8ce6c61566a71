"""gtcal schema: the manifest's JSON schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def schema(*, lollypop: bool = False, output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None) -> None:
    """Print the JSON schema of a recording's manifest, for editors that complete and check as you type.

    Args:
        lollypop: That of a recording of the Lollypop, with 'device' and 'device_body'.
        output: File to write in place of printing.
    """
    import json

    from gtcal.files import check_outputs, write_text
    from gtcal.recordings.manifest import manifest_schema
    from gtcal.verification.lollypop_recording import lollypop_manifest_schema

    check_outputs([output])
    text = json.dumps(lollypop_manifest_schema() if lollypop else manifest_schema(), indent=2)
    if output is None:
        print(text)
    else:
        write_text(output, text + "\n")
