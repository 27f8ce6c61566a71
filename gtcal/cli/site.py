"""gtcal site: a store as a static web site."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def site(
    out: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")],
    *,
    store: Annotated[Path, tyro.conf.arg(aliases=["-s"])] = Path("store"),
    run_length: float = 1000.0,
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False,
) -> None:
    """Write a static web site of a store: a page of the fleet, one of each rig, and one of each recording.

    Open OUT/index.html, from the disk or a file share: no server, no network. The fleet's page has a row per rig, those
    that need somebody first, to be sorted and filtered; a rig's page its charts, its calibrations side by side, and its
    verifications, each linked to its page: the report where 'gtcal batch --reports' wrote one, else what the store has
    of it. Run it again to renew it.

    Args:
        out: Folder to write; new, empty, or of an earlier site.
        store: Folder of the store that 'gtcal batch' made.
        run_length: Of the control charts, as of 'gtcal history'.
        quiet: Show no progress and print nothing.
    """
    from gtcal.cli.progress import shown_progress
    from gtcal.errors import GtcalError
    from gtcal.files import check_outputs
    from gtcal.fleet.site import write_site
    from gtcal.fleet.store import Store

    opened = Store.opened(store)
    if out.resolve().is_relative_to(store.resolve()) or store.resolve().is_relative_to(out.resolve()):
        raise GtcalError(f"{out}: is in the store, or the store in it; give a folder of its own")
    check_outputs([out], folders=True)
    with shown_progress(quiet) as progress:
        n_rigs = write_site(out, opened, run_length=run_length, progress=progress)
    if not quiet:
        print(f"written: {out / 'index.html'}, {n_rigs} {'rig' if n_rigs == 1 else 'rigs'}")
