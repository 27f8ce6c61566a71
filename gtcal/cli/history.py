"""gtcal history: a rig over months."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gtcal.fleet.history import History
    from gtcal.fleet.store import Store


def history(
    rig: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[RIG]")] = None,
    *,
    store: Annotated[Path, tyro.conf.arg(aliases=["-s"])] = Path("store"),
    accept: str | None = None,
    rebuild: bool = False,
    figure: Path | None = None,
    to: Literal["csv", "parquet"] | None = None,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    run_length: float = 1000.0,
    json: bool = False,
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> int:
    """Show what a rig's calibrations and verifications found over time, what of it is no chance, and when it will leave
    the tolerance; without a RIG, a line on each.

        gtcal history rig07 --figure rig07.png

    Each camera's mean error in the Lollypop's image (along x and y, outwards and around), and its place, attitude and
    focal length against the accepted calibration, are held against their own past since that calibration: by control
    charts (an EWMA of self-starting scores) that need not be told what is normal. What follows from the value before is
    taken away first. The charts of the whole store are watched together; their limits are set so that all of them,
    where nothing has changed, give one false alarm in --run-length rounds, in each of which every rig is recorded once.
    A chart begins to tell after five recordings; each accepted calibration is a new start.

    Exit codes: 0 the rig holds, 3 the last verification fails or a chart says that it is no longer what it was, 4 it
    can't be told; without a RIG, over all.

    Args:
        rig: The rig; by default all.
        store: Folder of the store that 'gtcal batch' made.
        accept: Accept the calibration of this recording: the rig is used with it from then on, the next 'gtcal batch'
            verifies with it, and the history begins anew there.
        rebuild: Make the store's index anew from its files, and say where the two disagreed.
        figure: PNG or SVG file to write: errors, charts, and how the cameras moved.
        to: Write all numbers as a table, a row per recording, camera and quantity.
        output: Its file; by default history.csv or history.parquet.
        run_length: See above; more, fewer false alarms and later true ones.
        json: Print JSON in place of tables ('gtcal schema history').
        verbose: Show the calibrations too, and every recording.
        quiet: Print nothing; the exit code tells.
    """
    from gtcal.cli.history_tables import history_document, print_fleet, print_history
    from gtcal.cli.json_output import print_json
    from gtcal.cli.progress import shown_progress
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs
    from gtcal.fleet.history import histories
    from gtcal.fleet.rebuild import rebuild as made_anew
    from gtcal.fleet.store import Store

    if (figure is not None or accept is not None) and rig is None:
        raise GtcalError(f"{'--figure' if figure is not None else '--accept'}: of which rig? give its name")
    if output is not None and to is None:
        raise GtcalError("-o is the file of a table: say which kind with --to csv or --to parquet")
    if not run_length > 1.0:
        raise GtcalError(f"--run-length {run_length}: expected more than 1")
    opened = Store.opened(store)
    table = None if to is None else output or Path(f"history.{to}")
    check_outputs((figure, table), (opened.index_path,))
    if rebuild:
        with opened.locked(), shown_progress(quiet) as progress:
            disagreed = made_anew(opened, progress=progress)
        if not quiet:
            _say(disagreed)
    found = histories(opened, run_length=run_length)
    if rig is not None and rig not in found:
        raise GtcalError(f"{store}: has no rig {rig!r}; rigs: {', '.join(found) or 'none yet'}")
    if accept is not None and rig is not None:
        _accept(opened, found[rig], accept)
        found = histories(opened, run_length=run_length)
    shown = list(found.values()) if rig is None else [found[rig]]
    if figure is not None:
        from gtcal.fleet.history_figure import write_history_figure

        write_history_figure(figure, shown[0])
    if table is not None:
        _write_table(table, shown, to == "parquet")
    if json:
        print_json(history_document(shown, run_length))
    elif not quiet:
        if rig is None:
            print_fleet(shown)
        else:
            print_history(shown[0], run_length, verbose=verbose)
        written = [str(path) for path in (figure, table) if path is not None]
        if written:
            print(f"written: {', '.join(written)}")
    return _exit_code(shown)


def _say(disagreed: Sequence[str]) -> None:
    from gtcal.plain import one_line

    for line in disagreed:
        print(one_line(line))
    print(f"index made anew; it and the files disagreed in {len(disagreed)} records" if disagreed else
          "index made anew; it agreed with the files")  # fmt: skip


def _accept(store: Store, history: History, name: str) -> None:
    from gtcal.errors import GtcalError

    names = [event.record.name for event in history.calibrations]
    if name not in names:
        raise GtcalError(f"rig {history.rig!r} has no calibration {name!r}; it has: {', '.join(names) or 'none'}")
    with store.locked():
        store.accept(history.rig, name)


def _write_table(path: Path, histories: Sequence[History], parquet: bool) -> None:
    from gtcal.errors import GtcalError
    from gtcal.files import staged
    from gtcal.fleet.history import frame_of
    from gtcal.plain import csv_cell

    frame = frame_of(histories)
    with staged(path) as aside:
        if parquet:
            try:
                frame.to_parquet(aside, index=False)
            except ImportError:
                raise GtcalError("Parquet needs pyarrow: pip install 'gtcal[fleet]'") from None
        else:
            texts = ["rig", "recording", "camera"]
            frame[texts] = frame[texts].map(csv_cell)
            frame.to_csv(aside, index=False)


def _exit_code(histories: Sequence[History]) -> int:
    states = {history.status for history in histories}
    if states & {"fails", "changed"}:
        return 3
    return 4 if states & {"can't tell", "not verified"} or any(history.failures for history in histories) else 0
