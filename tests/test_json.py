"""--json: every command that shows a table prints it as JSON too, alone on standard output, as its schema says."""

from __future__ import annotations

import inspect
import json
import re
from importlib import import_module
from pathlib import Path

import pytest
from calibration_support import HEADSET, simulated
from cli_support import run

from gtcal.cli import COMMANDS
from gtcal.cli.json_output import alone_on_standard_output, print_json
from gtcal.cli.json_schemas import MODELS, NAMES, PRINTED_BY, schema_of
from gtcal.simulation import write_simulation
from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop, write_lollypop_simulation

WITHOUT_A_TABLE = {"board", "completion", "convert", "export", "guide", "report", "schema", "simulate", "site"}

LONG = pytest.mark.long
CASES = (
    pytest.param("calibration", ["calibrate", "rec", "--no-effects", "-o", "out.json"], marks=LONG),
    pytest.param("calibration", ["info", "cal.json"]),
    pytest.param("verification", ["verify", "cal.json", "lollypop", "-o", "out.json"]),
    pytest.param("verification", ["info", "verification.json"]),
    pytest.param("drift", ["drift", "cal.json", "lollypop", "-o", "out.json"]),
    pytest.param("uncertainty", ["uncertainty", "cal.json"]),
    pytest.param("difference", ["diff", "cal.json", "other.json"]),
    pytest.param("summary", ["info", "rec"]),
    pytest.param("summary", ["info", "lollypop"]),
    pytest.param("mocap-file", ["info", "rec/platform.csv"]),
    pytest.param("draft", ["init", "rec", "-o", "draft.yaml"]),
    pytest.param("detection", ["detect", "rec"]),
    pytest.param("diagnosis", ["doctor", "rec"], marks=LONG),
    pytest.param("selfcheck", ["selfcheck", "rec"], marks=LONG),
    pytest.param("comparison", ["compare", "rec"], marks=LONG),
    pytest.param("demo", ["demo", "-o", "demo", "--frames", "24", "--image-scale", "0.25"], marks=LONG),
)
"""By schema. batch, history and watch: tests/test_fleet.py. Of poses in place of corners: tests/test_pose_level.py."""


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings and results."""
    folder = tmp_path_factory.mktemp("json")
    simulation = simulated(HEADSET, frames=40)
    write_simulation(simulation, folder / "rec", images=False)
    device = LollypopOptions(rig=simulation.options.rig, calibrated_in=simulation.scene, n_frames=60)
    write_lollypop_simulation(simulate_lollypop(device, seed=2), folder / "lollypop", images=False)
    assert run("calibrate", folder / "rec", "-o", folder / "cal.json", "--no-effects", "-q").code == 0
    (folder / "other.json").write_text((folder / "cal.json").read_text() + "\n")
    code = run("verify", folder / "cal.json", folder / "lollypop", "-o", folder / "verification.json", "-q").code
    assert code in (0, 4)
    return folder


def test_every_command_is_thought_of() -> None:
    assert set(PRINTED_BY) | WITHOUT_A_TABLE == set(COMMANDS)
    assert not set(PRINTED_BY) & WITHOUT_A_TABLE
    for command in COMMANDS:
        module = import_module(f"gtcal.cli.{command}")
        takes = "json" in inspect.signature(getattr(module, command)).parameters
        assert takes == (command in PRINTED_BY and command != "watch"), command
        shows = re.search(r"import .*\b(print_\w+|\w+_table|new_table)\b", inspect.getsource(module))
        assert command in PRINTED_BY or shows is None, f"{command} shows a table"


def test_every_document_is_documented() -> None:
    assert {name for names in PRINTED_BY.values() for name in names} == set(MODELS) - {"jobs"}
    tested = {case.values[0] for case in CASES}
    assert set(MODELS) - tested == {"jobs", "batch", "batch-plan", "history", "watch", "pose-calibration",
                                    "pose-comparison"}  # fmt: skip
    listed = run("schema", "--list").out
    for name in NAMES:
        schema = schema_of(name)
        assert schema["description"]
        assert f"{name} " in listed
        head = f"gtcal_{name.replace('-', '_')}"
        assert name in ("recording", "lollypop-recording") or schema["properties"][head]["const"] == 1
    assert json.loads(run("schema", "verification").out) == schema_of("verification")
    ran = run("schema", "verifications")
    assert (ran.code, ran.err.count("\n")) == (1, 1)


@pytest.mark.parametrize(("name", "arguments"), CASES, ids=lambda value: value if isinstance(value, str) else "")
def test_json_is_alone_on_standard_output(
    name: str, arguments: list[str], ground: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for file in ground.iterdir():
        (tmp_path / file.name).symlink_to(file)
    ran = run(*arguments, "--json")
    assert ran.code in (0, 1, 3, 4), ran.err
    MODELS[name].model_validate_json(ran.out)  # all of it is one document
    assert next(iter(json.loads(ran.out))) == f"gtcal_{name.replace('-', '_')}"
    if "-o" in arguments and name != "draft" and name != "demo":
        assert json.loads(Path("out.json").read_text()) == json.loads(ran.out)


def test_an_error_is_no_json(ground: Path) -> None:
    ran = run("info", ground / "absent", "--json")
    assert (ran.code, ran.out, ran.err.count("\n")) == (1, "", 1)
    ran = run("uncertainty", ground / "cal.json", "--json", "-o", "/dev/stdout")
    assert (ran.code, ran.out) == (1, "") or "leave out the output" in ran.err


def test_other_words_go_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    with alone_on_standard_output():
        print("beside")
        print_json({"number": float("nan")})
    seen = capsys.readouterr()
    assert json.loads(seen.out) == {"number": None}
    assert seen.err == "beside\n"
