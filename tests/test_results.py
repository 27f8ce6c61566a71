"""What README and guide show of results is what scripts/RESULTS.md has; and that is written by scripts/results.py."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import results
from guide_support import ALL, PAGES

ROOT = Path(__file__).resolve().parents[1]
_EXCERPT = re.compile(r"<!-- excerpt -->\n```text\n(.*?)```", re.S)
_UNMARKED = re.compile(r"(?<!<!-- excerpt -->\n)```text\n")
TWO = """\
# Results

## One

<!-- run: one.py --runs 3 -->
![A picture](pictures/one.png)

```text
old
```

```text
older
```

## Two

<!-- with data: two.py DATA -->
```text
stays
```
"""


def test_every_line_of_an_excerpt_stands_in_the_results() -> None:
    excerpts = _EXCERPT.findall(ALL)
    lines = set(results.RESULTS.read_text(encoding="utf-8").splitlines())
    assert len(excerpts) > 5
    assert [line for excerpt in excerpts for line in excerpt.splitlines() if line not in lines] == []


def test_every_table_that_is_shown_is_an_excerpt() -> None:
    assert [page.name for page in PAGES if _UNMARKED.search(page.read_text(encoding="utf-8"))] == []


def test_every_result_is_of_a_script_that_is_there() -> None:
    known = results.commands(results.RESULTS.read_text(encoding="utf-8"))
    assert len(known) > 5
    assert [command for command in known if not (results.HERE / command.split()[0]).is_file()] == []


def test_what_is_printed_takes_the_place_of_what_was() -> None:
    assert results.commands(TWO) == ["one.py --runs 3"]
    new = results.renewed(TWO, "one.py --runs 3", "new\n", "Printed today.")
    assert "old" not in new
    assert "![A picture](pictures/one.png)\n\n```text\nnew\n```\n\nPrinted today.\n\n## Two" in new
    assert new.endswith("<!-- with data: two.py DATA -->\n```text\nstays\n```\n")
    assert results.renewed(new, "one.py --runs 3", "new", "Printed today.") == new


def test_a_script_runs_and_its_output_is_plain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "HERE", tmp_path)
    (tmp_path / "one.py").write_text("import sys; print('\\x1b[1mbold\\x1b[0m  ', *sys.argv[1:])")
    assert results.printed_by("one.py --runs 3") == "bold   --runs 3"
    (tmp_path / "one.py").write_text("raise SystemExit(1)")
    with pytest.raises(subprocess.CalledProcessError):
        results.printed_by("one.py")
    assert re.fullmatch(r"Printed on \d{4}-\d\d-\d\d by gtcal \S+, \d+ cores of .*\S\.", results.stamp_of_now())


def test_the_command_lists_what_there_is_and_names_what_is_not() -> None:
    def ran(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, ROOT / "scripts" / "results.py", *arguments], capture_output=True, text=True, check=False
        )

    assert "study_basins.py" in ran("--list").stdout
    assert ran("--list", "study_basins.py").stdout == "study_basins.py\n"
    wrong = ran("study_nothing.py")
    assert (wrong.returncode, "study_nothing.py: RESULTS.md has no results of it" in wrong.stderr) == (2, True)
