"""`python -m broker --run-dir DIR`: the broker process of one cluster, new or restarted; with --template, the process
that the next broker is forked from."""

from __future__ import annotations

import argparse
import secrets
import time
from collections.abc import Iterator
from pathlib import Path

from broker.events import BrokerRestarted, ProgramInstalled
from broker.journal import Journal
from broker.program_store import ProgramStore
from broker.replay import replay
from broker.router import Router
from broker.state import State
from rtc import handed, process, template
from rtc.memory import Guard
from rtc.messages import WorkerKind
from rtc.settings import Settings

RANK, NICENESS = 1, -5  # after the MCM, whose servo ticks every millisecond, and before everybody else


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m broker", description=__doc__)
    arguments.add_argument("--run-dir", required=True, type=Path, help="of the cluster, as made by `rtc up`")
    arguments.add_argument("--template", action="store_true", help="be the one that a broker is forked from")
    handed.add_option(arguments)
    given = arguments.parse_args()
    if given.template:
        template.serve(lambda order: live(given.run_dir, given.handed))
    else:
        live(given.run_dir, given.handed)


def live(run_dir: Path, fd: int = -1) -> None:
    """Be the broker until told to end. `fd`: what the supervisor hands over (rtc.handed)."""
    process.show_name("broker")
    given = handed.begin("broker", run_dir, fd)
    settings = given.settings
    with process.start("broker", run_dir) as me:
        priority = process.come_first(RANK, NICENESS)
        patience = 1.0 / settings.speed if 0 < settings.speed < 1 else 1.0
        first = State(patience=patience, life=secrets.token_hex(2))
        journal = Journal.open(run_dir / "journal.db", settings.run, first)
        state, ended = replay(journal)
        store = ProgramStore(journal, state.programs)
        router = Router(me, settings, journal, state, store, given)
        router.guard = Guard()
        now = time.monotonic()
        restarted = bool(state.programs)
        if restarted:
            me.log.info("restarted: %d commands live, %d ended in the journal", len(state.commands), len(ended))
            journal.keep_stories(ended.values())
            router.hear(BrokerRestarted(at_s=now))
        else:
            for installed in _first_programs(settings, store, now):
                router.hear(installed)
        router.turn()
        process.freeze_heap()
        me.log.info("priority: %s", priority)
        me.ready()
        if restarted:  # whoever is killed again and again has not ever more to replay
            journal.snapshot(state)
        router.run()
        journal.close()


def _first_programs(settings: Settings, store: ProgramStore, now: float) -> Iterator[ProgramInstalled]:
    """Of a new cluster: the programs that come with the project, and its cell."""
    from rtc import program  # these two bring lark, yaml and numpy; a restart, which should be quick, does without
    from rtc.cell import Cell

    for kind in WorkerKind:
        yield ProgramInstalled(at_s=now, kind=kind, digest=store.keep(program.default(kind)))
    yield ProgramInstalled(at_s=now, kind=None, digest=store.keep(Cell.load(settings.cell).encode()))


if __name__ == "__main__":
    main()
