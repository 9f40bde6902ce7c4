"""The broker process of one cluster, new or restarted: `python -m broker --run-dir DIR`.

With --template it is the fork server of the next broker.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator
from pathlib import Path

from broker.decisions.events import BrokerRestarted, JournalLost, ProgramInstalled
from broker.decisions.state import State
from broker.persistence.journal import Journal
from broker.persistence.program_store import ProgramStore
from broker.persistence.replay import replay
from broker.router.core import Core
from broker.router.loop import ORPHAN_LIMIT_S, Router
from rtc.programs import sandbox
from rtc.protocol.messages import CommandRecord, WorkerKind
from rtc.protocol.outcomes import RtcError
from rtc.runtime import damaged_database, fork_server, handover, process
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.settings import Settings
from rtc.world.client import WorldClient
from rtc.world.lease import DOUBT, sign

RANK, NICENESS = 1, -5  # below the MCM with its servo tick of 1 ms, above all other processes
LAST_S = 1.0  # for a broker without a supervisor to end, once the outcomes are sent
DOUBT_LIMIT_S = 2.0  # time limit for the world database to mark its facts


def main() -> None:
    fork_server.main("python -m broker", __doc__, live)


def live(run_dir: Path, fd: int = -1) -> None:
    """Run the broker until it is ordered to end. `fd`: descriptor handed over by the supervisor
    (rtc.runtime.handover)."""
    process.show_name("broker")
    given = handover.claim_role("broker", run_dir, fd)
    settings = given.settings
    with process.start("broker", run_dir) as me:
        priority = process.raise_priority(RANK, NICENESS)
        first = State(timeout_scale=settings.timeout_scale, life=secrets.token_hex(2))
        path = run_dir / "journal.db"
        journal, state, ended = damaged_database.open_or_set_aside(
            path, lambda: _opened(path, settings.run, first), me.note
        )
        with damaged_database.put_aside_when_damaged(path, me.note):
            _serve(me, given, journal, state, ended, priority)


def _opened(path: Path, run: str, first: State) -> tuple[Journal, State, dict[str, CommandRecord]]:
    journal = Journal.open(path, run, first)
    return journal, *replay(journal)


def _serve(
    me: process.Process,
    given: handover.Handover,
    journal: Journal,
    state: State,
    ended: dict[str, CommandRecord],
    priority: str,
) -> None:
    """Continue from the replayed state."""
    settings, now = given.settings, time.monotonic()
    lost = lost_batches(journal, state, given, now, secrets.token_hex(2))
    store = ProgramStore(journal, state.programs)
    journal.written = lambda batch: given.save_counters("broker", state.life.encode(), batch, state.accepted)
    core = Core(me, settings, journal, state, store, given, start_check=sandbox.CheckProcess)
    router = Router(core, MemoryGuard())
    if given.fd >= 0:  # started by a supervisor
        me.end_with_parent(ORPHAN_LIMIT_S * settings.timeout_scale + LAST_S)
    restarted = bool(state.programs)
    if restarted:
        me.log.info("restarted: %d commands live, %d ended in the journal", len(state.commands), len(ended))
        journal.keep_records(ended.values())
        router.enqueue(BrokerRestarted(at_s=now))
    else:
        for installed in _first_programs(settings, store, now):
            router.enqueue(installed)
    if lost is not None:
        me.note(f"{lost.why}; what was under way has ended, facts of arms and things are suspect")
        _doubt_the_world(me, given, lost)
        router.enqueue(lost)
    router.run_once()
    process.freeze_heap()
    me.log.info("priority: %s", priority)
    me.ready()
    if restarted:  # so that repeated restarts do not replay ever more events
        journal.snapshot(state)
    router.run()
    journal.close()


def lost_batches(journal: Journal, state: State, given: handover.Handover, now: float, life: str) -> JournalLost | None:
    """The event of a journal that lacks decisions of this run; None if it is complete. `life`: its new id."""
    kept = given.remembered("broker")
    if kept is None:
        return None
    before, batch, accepted = kept
    missing = batch - journal.last_batch()
    same = before == state.life.encode()
    if same and missing <= 0:
        return None
    why = f"the journal lost its last {missing} batches" if same else "the journal was lost"
    return JournalLost(at_s=now, why=why, life=life, accepted=accepted)


def _doubt_the_world(me: process.Process, given: handover.Handover, lost: JournalLost) -> None:
    """Mark world facts as suspect before a plan uses them: lost decisions may have changed them."""
    world = WorldClient(given.settings.endpoint("world"), me.context, limit_s=DOUBT_LIMIT_S)
    try:
        world.doubt(sign(given.lease_key, f"{DOUBT}{lost.life}", []), lost.why)
    except RtcError as error:
        me.note(f"{error}: its facts are not marked suspect")
    world.close()


def _first_programs(settings: Settings, store: ProgramStore, now: float) -> Iterator[ProgramInstalled]:
    """Install the default programs and the cell of a new cluster."""
    from rtc.model.cells.cell import Cell
    from rtc.programs import loader

    for kind in WorkerKind:
        yield ProgramInstalled(at_s=now, kind=kind, digest=store.keep(loader.default(kind)))
    yield ProgramInstalled(at_s=now, kind=None, digest=store.keep(Cell.load(settings.cell).encode()))


if __name__ == "__main__":
    main()
