"""The station at the capture volume: each recording of the Lollypop is verified as soon as it is complete."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from gtcal.errors import GtcalError
from gtcal.files import sha256_of
from gtcal.fleet import index
from gtcal.fleet.batch import run_batch
from gtcal.fleet.jobs import Job, taken_ns_in
from gtcal.fleet.jobs_file import TakenFrom, recordings_in, stated_by_place
from gtcal.fleet.rebuild import catch_up
from gtcal.fleet.record import Record
from gtcal.fleet.store import Store
from gtcal.fleet.workers import InThisProcess
from gtcal.names import check_name
from gtcal.recordings.manifest import load_fields
from gtcal.verification.verification import VerificationOptions

_WAIT_FOR_STORE_S = 30.0
_AHEAD_S = 0.5

Snapshot = tuple[tuple[str, int, int], ...]
"""Of a recording's folder: every file in it with its size and time, by name."""


@dataclass(frozen=True)
class Seen:
    """A recording that was verified, or could not be. remarks: what there is to say. waited_s: from when its files
    ceased to grow."""

    record: Record
    remarks: tuple[str, ...]
    waited_s: float


@dataclass
class Station:
    """What is watched, and what is known of it.

    rig: of all recordings; None where the folders below say it. calibration: to verify; None for the rig's accepted one
    in the store. settle_s: so long no file of a recording may have grown."""

    folder: Path
    store: Store
    options: VerificationOptions
    command_line: tuple[str, ...]
    rig: str | None = None
    calibration: Path | None = None
    taken_from: TakenFrom = "stamps"
    settle_s: float = 2.0
    _coming: Snapshot = ()
    _growing: dict[Path, tuple[Snapshot, float]] = field(default_factory=dict)
    _settled: dict[Path, Snapshot] = field(default_factory=dict)

    def completed(self) -> Iterator[tuple[Path, float]]:
        """The manifests of recordings that have become complete, and for how long they have not grown, s; each once,
        and again where its files have changed since. What others have by now is fingerprinted meanwhile, which takes
        longest of what can be done before they are complete."""
        manifests = list(recordings_in(self.folder))
        coming = tuple(file for path in _coming(self.folder, {m.parent for m in manifests}) for file in snapshot(path))
        _fingerprint_ahead(self._coming, coming)
        self._coming, now = coming, time.monotonic()
        for manifest in manifests:
            seen = snapshot(manifest.parent)
            if self._settled.get(manifest) == seen:
                continue
            before, since = self._growing.get(manifest, ((), now))
            _fingerprint_ahead(before, seen)
            if before != seen:
                self._growing[manifest] = seen, now
            elif now - since >= self.settle_s:
                self._settled[manifest] = seen
                if _is_lollypop(manifest):
                    yield manifest, now - since

    @property
    def waits(self) -> bool:
        """Whether a recording is there that may still be growing."""
        return any(self._settled.get(manifest) != seen for manifest, (seen, _) in self._growing.items())

    def verify(self, manifest: Path, idle_s: float) -> Seen | None:
        """Verify a recording into the store; None where that was done before, and nothing has changed.

        Raises GtcalError where the store can't be written."""
        began = time.monotonic()
        job = self._job(manifest)
        with _locked(self.store):
            with index.opened_index(self.store.index_path) as connection:
                catch_up(self.store, connection)
            found = run_batch(self.store, [job], InThisProcess(), self.command_line)
            if not found.ended:
                return None
            remarks = _remarks(self.store, job)
        return Seen(found.ended[0], remarks, idle_s + time.monotonic() - began)

    def _job(self, manifest: Path) -> Job:
        place = stated_by_place(self.folder, manifest)
        rig = self.rig or place["rig"]
        check_name("rig", rig)
        return Job(
            rig=rig,
            name=place["name"] if self.rig is None else "_".join(manifest.parent.relative_to(self.folder).parts) or rig,
            kind="verify",
            recordings=(manifest,),
            options=self.options,
            calibration=self.calibration,
            taken_ns=taken_ns_in(manifest.parent.name) if self.taken_from == "name" else None,
            where=str(manifest),
        )


def warm_up() -> None:
    """Have done before a recording comes what takes a while at first use only: kernels are read, or compiled."""
    from gtcal.simulation.lollypop import LollypopOptions, simulate_lollypop
    from gtcal.verification.workflow import verify

    simulation = simulate_lollypop(LollypopOptions(n_frames=60), seed=0)
    verify(simulation.recording, simulation.true_calibration())


def snapshot(folder: Path) -> Snapshot:
    """Of a folder, without what is hidden in it: what gtcal keeps beside a recording is no part of it."""
    found = []
    for path in sorted(folder.rglob("*")):
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        try:
            status = path.stat()
        except OSError:  # taken away in between
            continue
        if not path.is_dir():
            found.append((str(path), status.st_size, status.st_mtime_ns))
    return tuple(found)


def _coming(folder: Path, recordings: set[Path]) -> Iterator[Path]:
    """The folders below one that hold no recording yet, as those do whose manifest is written last."""
    for path in sorted(folder.iterdir()):
        if not path.is_dir() or path.name.startswith(".") or path in recordings:
            continue
        if any(recording.is_relative_to(path) for recording in recordings):
            yield from _coming(path, recordings)
        else:
            yield path


def _fingerprint_ahead(before: Snapshot, now: Snapshot) -> None:
    """Of the files that have not changed between two looks, as long as that takes no time that is needed to look. What
    was computed is remembered by ``sha256_of``."""
    until = time.monotonic() + _AHEAD_S
    for path, *_ in sorted(set(before) & set(now)):
        if time.monotonic() > until:
            return
        with suppress(GtcalError):  # taken away in between, or what is told when it is verified
            sha256_of(Path(path))


def _is_lollypop(manifest: Path) -> bool:
    """Of a manifest that can't be read, too: that is told when it is verified."""
    try:
        return "device" in load_fields(manifest)
    except GtcalError:
        return True


@contextmanager
def _locked(store: Store) -> Iterator[None]:
    """The store's lock, waited for while a batch holds it."""
    until = time.monotonic() + _WAIT_FOR_STORE_S
    with ExitStack() as stack:
        while True:
            try:
                stack.enter_context(store.locked())
                break
            except GtcalError:
                if time.monotonic() > until:
                    raise
                time.sleep(0.5)
        yield


def _remarks(store: Store, job: Job) -> tuple[str, ...]:
    with index.opened_index(store.index_path) as connection:
        rows = connection.execute(
            "SELECT text FROM remark JOIN current ON remark.job = current.id "
            "WHERE rig = ? AND kind = ? AND name = ? ORDER BY place",
            job.identity,
        )
        return tuple(text for (text,) in rows)
