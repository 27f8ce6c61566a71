"""The README and the guide: chapters that are there, commands and options that exist, manifests that are ones."""

from __future__ import annotations

import re
import shlex
import textwrap
from pathlib import Path

import pytest
import yaml
from cli_support import run
from guide_support import PAGES, ROOT
from rich.console import Console

from gtcal.cli import COMMANDS
from gtcal.cli.markdown import shown_markdown
from gtcal.guide import CHAPTERS, about, markdown
from gtcal.pose_recordings.recording import PoseManifest
from gtcal.recordings.manifest import Manifest
from gtcal.several_boards.recording import BoardsManifest
from gtcal.verification.lollypop_recording import LollypopManifest

TEXTS = {page.stem: page.read_text(encoding="utf-8") for page in PAGES}


def test_the_chapters_are_the_files_and_are_linked_from_the_readme() -> None:
    assert {*CHAPTERS, "README"} == set(TEXTS)
    assert len(TEXTS["README"].splitlines()) <= 260
    for chapter in CHAPTERS:
        assert f"[{chapter}](gtcal/guide/{chapter}.md)" in TEXTS["README"]
        assert TEXTS[chapter].startswith(f"# {chapter.title()}: ")
        assert about(chapter)


def test_the_command_lists_the_chapters_and_shows_one_as_it_is_in_a_pipe() -> None:
    listed = run("guide")
    assert listed.code == 0
    assert all(f"gtcal guide {chapter} " in listed.out for chapter in CHAPTERS)
    shown = run("guide", "trust")
    assert shown.out == markdown("trust")
    assert "<!--" not in shown.out
    assert shown.out.startswith("# Trust: ")
    wrong = run("guide", "trusst")
    assert wrong.code == 1
    assert "did you mean 'trust'?" in wrong.err


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_a_terminal_shows_all_of_a_chapter_however_narrow(chapter: str) -> None:
    """Its words in order, and no line of code broken or cut."""
    console = Console(width=60, force_terminal=True, color_system=None, legacy_windows=False)
    with console.capture() as captured:
        console.print(shown_markdown(markdown(chapter)), crop=False)
    shown = captured.get()
    for code in re.findall(r"^```\w*\n(.*?)^```", markdown(chapter), re.DOTALL | re.MULTILINE):
        assert all(line.rstrip() in shown for line in code.splitlines())
    assert "```" not in shown


def commands_in(text: str) -> list[str]:
    """What is typed: in text between back quotes, which a line's end may break, and in blocks."""
    blocks = [body for language, body in re.findall(r"```(\w*)\n(.*?)```", text, re.DOTALL) if language == "bash"]
    indented = re.findall(r"^ {4,}(gtcal .*)$", text, re.MULTILINE)
    typed = re.findall(r"`(gtcal [^`]*)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    lines = [line.partition("#")[0] for body in blocks for line in body.splitlines() if line.startswith("gtcal ")]
    return [" ".join(command.split()) for command in (*lines, *indented, *typed)]


def test_every_command_and_option_is_there() -> None:
    helps = {name: run(name, "--help").out for name in COMMANDS}
    wrong, seen = [], set()
    for page, text in TEXTS.items():
        for command in commands_in(text):
            words = shlex.split(command)[1:]
            name = words[0]
            if name in ("...", "COMMAND"):
                continue
            seen.add(name)
            if name not in COMMANDS:
                wrong.append((page, command))
                continue
            options = [word for word in words[1:] if word.startswith("-") and word != "--help"]
            wrong += [
                (page, command, option) for option in options if option not in helps[name].replace(",", " ").split()
            ]
            if name == "guide" and words[1:] and words[1] not in (*CHAPTERS, "..."):
                wrong.append((page, command))
    assert wrong == []
    assert seen >= {"calibrate", "verify", "doctor", "diff", "batch", "guide", "uncertainty", "export"}


def test_every_option_that_is_named_alone_is_one_of_some_command() -> None:
    helps = " ".join(run(name, "--help").out for name in COMMANDS).replace(",", " ").split()
    for page, text in TEXTS.items():
        for option in re.findall(r"`(--[a-z-]+)", text):
            assert option in helps, (page, option)


def test_every_link_leads_to_a_file() -> None:
    links = 0
    for page, text in zip(PAGES, TEXTS.values(), strict=True):
        for link in re.findall(r"\]\(([^)]+)\)", text):
            if not link.startswith(("https://", "#")):
                links += 1
                assert (page.parent / link.partition("#")[0]).is_file(), (page, link)
        for script in re.findall(r"(?:scripts|tests)/\w+\.(?:py|md)|gtcal/\w+/\w+\.py|example_\w+\.py", text):
            assert (ROOT / script).is_file() or (ROOT / "scripts" / script).is_file(), (page, script)
    assert links > 15


def manifests() -> list[tuple[str, dict[str, object]]]:
    blocks = [
        (page, yaml.safe_load(textwrap.dedent(body)))
        for page, text in TEXTS.items()
        for body in re.findall(r"^ *```yaml\n(.*?)```", text, re.DOTALL | re.MULTILINE)
    ]
    return [(page, fields) for page, fields in blocks if "gtcal_recording" in fields]


def test_every_manifest_is_one(tmp_path: Path) -> None:
    seen = set()
    for _, fields in manifests():
        if "layout" in fields:  # which says the rest
            continue
        cameras = fields["cameras"]
        assert isinstance(cameras, dict)
        kinds = {"device": LollypopManifest, "board": Manifest, "boards": BoardsManifest}
        kind = next((kind for field, kind in kinds.items() if field in fields), PoseManifest)
        kind.model_validate(fields)
        seen.add(kind)
    assert seen == {Manifest, LollypopManifest, BoardsManifest, PoseManifest}
