"""gtcal init: the draft of a manifest."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from gtcal.overview.draft import Draft


def init(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")],
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    force: bool = False,
    json: bool = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Look at a folder and draft the manifest of a recording: what was found and why it was taken, and a question where
    the files don't tell.

    Images (folders, videos, bags, VRS), files of a mocap, lenses (ASL's sensor.yaml, Kalibr's camchain), boards
    (Kalibr's target file) and corners are found in the folder and those in it; the board's tags are looked for in some
    images. Where they show one tag alone, it is taken for a Lollypop's, and the draft is of a recording to verify with.
    Until each QUESTION in the draft is answered, it doesn't load, and says which one is open.

    Args:
        folder: The folder to look at.
        output: The manifest to write; by default recording.yaml in the folder.
        force: Replace a manifest that is there.
        json: Print what was found as JSON in place of words ('gtcal schema draft').
        quiet: Print nothing.
    """
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.documents import read_text
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs, write_text
    from gtcal.overview.draft import draft
    from gtcal.overview.survey import survey
    from gtcal.recordings.manifest import MANIFEST_NAMES

    manifest = output if output is not None else folder / MANIFEST_NAMES[0]
    if manifest.exists() and not force:
        raise GtcalError(f"{manifest}: is there already; --force replaces it, -o names another file")
    check_outputs([manifest])
    named = manifest.name in MANIFEST_NAMES
    if manifest.is_file() and not named and "gtcal_recording" not in read_text(manifest):
        raise GtcalError(f"{manifest}: is no manifest, which is all that --force replaces; give another file with -o")
    found = survey(folder)
    with shown_progress(quiet) as progress:
        drafted = draft(found, manifest, progress)
    write_text(manifest, drafted.text)
    if json:
        left = list(found.left)
        print_json(
            {
                "gtcal_draft": 1,
                "manifest": str(manifest),
                "questions": list(drafted.questions),
                "warnings": list(drafted.warnings),
                "left_aside": left,
            }
        )
    elif not quiet:
        _print(manifest, drafted, found.left)


def _print(manifest: Path, drafted: Draft, left: tuple[str, ...]) -> None:
    from gtcal.cli.terminal import Terminal

    console = Terminal(highlight=False, soft_wrap=True)
    for line in left:
        console.print(f"left aside: {line}", style="yellow")
    for line in drafted.warnings:
        console.print(f"warning: {line}", style="yellow")
    console.print(f"written: {manifest}")
    if drafted.questions:
        console.print(f"to be answered there, {len(drafted.questions)}:")
    for question, fields in _fields_by_question(drafted.questions).items():
        console.print(f"  {', '.join(fields)}: {question}")


def _fields_by_question(questions: Iterable[str]) -> dict[str, list[str]]:
    """What is asked of several cameras alike is asked once."""
    fields: dict[str, list[str]] = {}
    for line in questions:
        field, _, question = line.partition(": ")
        fields.setdefault(question, []).append(field)
    return fields
