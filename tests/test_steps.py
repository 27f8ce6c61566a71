"""The steps of a calibration one by one, as the guide shows them, are the calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_support import HEADSET, simulated
from guide_support import block

from gtcal import CalibrationOptions, GtcalError, calibrate, steps
from gtcal.recordings.recording import write_recording

TIMES = ("duration_s", "provenance")


def without_times(document: Any) -> Any:
    if isinstance(document, dict):
        return {name: without_times(value) for name, value in document.items() if name not in TIMES}
    return [without_times(value) for value in document] if isinstance(document, list) else document


def test_the_guides_steps_are_what_calibrate_walks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(simulated(HEADSET).recording, "my_recording")
    code = block("steps", "python").replace("cam0", "front_left")
    quick = 'gtcal.CalibrationOptions(effects=False, mocap="exact")'
    assert "gtcal.CalibrationOptions()" in code
    space: dict[str, Any] = {}
    exec(code.replace("gtcal.CalibrationOptions()", quick), space)
    walked = space["calibration"]
    assert isinstance(space["seen"], steps.Seen)
    assert isinstance(space["timed"], steps.Timed)
    assert isinstance(space["known"], steps.Known)
    assert walked.clock is not None  # which was tested
    again = calibrate(space["recording"], space["options"])
    assert without_times(again.to_dict()) == without_times(walked.to_dict())
    assert np.isfinite(space["seen"].observations.views["front_left"].corners_px).all()


def test_each_step_holds_the_one_before_it_and_refuses_on_its_own() -> None:
    recording = simulated(HEADSET).recording
    options = CalibrationOptions(effects=False, mocap="exact", clock="trust")
    seen = steps.observed(recording, options)
    known = steps.known(steps.timed(seen))
    assert known.timed.seen is seen
    assert known.observations is seen.observations  # nothing is known, no shutter rolls
    assert known.options is options
    assert known.carried_over is None
    late = {name: replace(found, stamps_ns=found.stamps_ns + 10**12) for name, found in recording.detections.items()}
    with pytest.raises(GtcalError, match="time"):
        steps.observed(replace(recording, detections=late), options)
