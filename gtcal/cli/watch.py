"""gtcal watch: the station at the capture volume."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

if TYPE_CHECKING:
    from gtcal.fleet.watch import Seen


def watch(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")],
    *,
    store: Annotated[Path, tyro.conf.arg(aliases=["-s"])] = Path("store"),
    rig: str | None = None,
    calibration: Path | None = None,
    page: Path | None = None,
    settle_s: float = 2.0,
    count: int | None = None,
    once: bool = False,
    taken_from: Literal["stamps", "name"] = "stamps",
    images: Literal["all", "expected"] = "expected",
    max_rmse_px: float = 0.5,
    max_rmse_mm: float = 1.0,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Verify each recording of the Lollypop in a folder as soon as it is complete, and show the verdict large.

    A recording (FOLDER/RIG/RECORDING, or FOLDER/RECORDING) is complete when its manifest is there and none of its files
    has grown for --settle-s. It is verified with the rig's accepted calibration in the store (see 'gtcal batch'), or
    with --calibration, and goes into the store. Open the page in a browser beside the capture volume: it asks for
    itself anew every second. Standard output has a line of JSON per recording.

    Runs until Ctrl-C. With --once or --count it ends by itself, with the exit codes of 'gtcal verify' over all that it
    saw: 0 the calibration holds, 3 it does not, 4 it can't be told; 1 a recording could not be verified.

    Args:
        folder: Where recordings appear.
        store: Folder of the store; made where it is missing.
        rig: The rig of all recordings; by default what the folders say.
        calibration: calibration.json to verify; by default the rig's last accepted one before the recording.
        page: HTML file to write; by default watch.html in the store.
        settle_s: So long no file may have grown.
        count: End after so many recordings.
        once: End after the recordings that are there.
        taken_from: As of 'gtcal batch'.
        images: Of cameras that come as images, as of 'gtcal verify': 'expected' is soon enough for an operator who
            waits; 'all' may take a minute or more.
        max_rmse_px: Tolerance on e_2D, as of 'gtcal verify'.
        max_rmse_mm: Tolerance on e_3D.
        quiet: Print nothing but the lines of JSON.
    """
    import json
    import sys
    import time

    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs
    from gtcal.fleet.store import Store
    from gtcal.fleet.watch import Station, warm_up
    from gtcal.fleet.watch_page import verdict, waiting, write_page
    from gtcal.verification.verification import VerificationOptions

    if not folder.is_dir():
        raise GtcalError(f"{folder}: is no folder; give the one in which recordings appear")
    if not settle_s > 0.0 or (count is not None and count < 1):
        raise GtcalError("--settle-s and --count are above 0")
    options = VerificationOptions(images=images, max_rmse_px=max_rmse_px, max_rmse_mm=max_rmse_mm)
    opened = Store.made(store)
    shown_at = page or store / "watch.html"
    check_outputs([shown_at], [] if calibration is None else [calibration])
    command_line = (Path(sys.argv[0]).name, *sys.argv[1:])
    station = Station(folder, opened, options, command_line, rig, calibration, taken_from, settle_s)
    warm_up()
    write_page(shown_at, waiting(folder))
    if not quiet:
        print(f"watching {folder}; open {shown_at}", file=sys.stderr)
    seen: list[Seen] = []
    while count is None or len(seen) < count:
        for manifest, idle_s in station.completed():
            found = station.verify(manifest, idle_s)
            if found is not None:
                write_page(shown_at, verdict(found))
                print(json.dumps(_document(found)), flush=True)
                seen.append(found)
        if once and not station.waits:
            break
        time.sleep(min(settle_s / 4.0, 0.5))
    return _exit_code(seen)


def _document(seen: Seen) -> dict[str, Any]:
    from gtcal.fleet.jobs import utc

    record = seen.record
    return {
        "gtcal_watch": 1,
        "rig": record.rig,
        "name": record.name,
        "verdict": record.verdict or None,
        "error": record.error or None,
        "remarks": list(seen.remarks),
        "taken_utc": None if record.taken_ns is None else utc(record.taken_ns).isoformat(),
        "seconds_after_it_ended": round(seen.waited_s, 3),
    }


def _exit_code(seen: list[Seen]) -> int:
    from gtcal.verification.verdict import overall_verdict
    from gtcal.verification.verification import Verdict

    if any(one.record.error for one in seen):
        return 1
    return overall_verdict(Verdict(one.record.verdict) for one in seen).exit_code
