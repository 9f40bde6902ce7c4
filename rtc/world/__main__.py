"""The world database process: `python -m rtc.world --run-dir D`. A socket round `server.Server`; it decides nothing.

A database found in the run directory is gone on with; otherwise it begins with what the cell says. With --template it
is the process that the next one is forked from.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

from rtc import damage, handed, process, template, wire
from rtc.memory import MemoryGuard
from rtc.messages import Dropped, ToWorld
from rtc.outcomes import WireError
from rtc.process import Every, Process, inbox, now_s, send
from rtc.settings import BOUNDS, Settings
from rtc.world import lease
from rtc.world.model import initial_facts
from rtc.world.server import Packer, Server, doubt_everything
from rtc.world.store import Store

FILE = "world.db"
BORN = b"world"  # in the memory of the role: it has begun in this run
PER_TURN = 256  # requests in one turn of the loop, and so in one transaction
TELL_S = 0.5  # how often the broker hears of messages that could not be read


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rtc.world", description="The world database of one cluster.")
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--template", action="store_true", help="be the one that a database is forked from")
    handed.add_option(parser)
    given = parser.parse_args()
    if given.template:
        template.serve(lambda order: live(given.run_dir, given.handed))
    else:
        live(given.run_dir, given.handed)


def live(run_dir: Path, fd: int = -1) -> None:
    """Be the world database until told to end. `fd`: what the supervisor hands over (rtc.handed)."""
    process.show_name("world")
    given = handed.begin("world", run_dir, fd)
    with process.start("world", run_dir) as me:
        path = run_dir / FILE
        store = damage.open_or_set_aside(path, lambda: Store(path), me.note)
        with damage.put_aside_when_damaged(path, me.note):
            _live(me, given, store)


def _live(me: Process, given: handed.Handed, store: Store) -> None:
    settings = given.settings
    _begin(me, given, store)
    socket = me.socket(zmq.ROUTER, settings.endpoint("world"), bind=True, bounds=BOUNDS["world"])
    broker = me.socket(zmq.DEALER, settings.endpoint("supervisor"), identity="world", poll=False)
    server = Server(store, given.lease_key, lambda: _fixed(settings))
    store.saved = lambda version: given.remember("world", BORN, version)
    process.freeze_heap()
    me.ready()
    serve(me, socket, server, lambda dropped: send(broker, Dropped(counts={"world": dropped})), MemoryGuard())
    store.close()


def _begin(me: Process, given: handed.Handed, store: Store) -> None:
    """A new database begins with what the cell says. If it had begun before in this run, or knew more, everything that
    a motion changes is in doubt; versions go on above the highest that anybody has read."""
    kept = given.remembered("world")
    version = kept[1] if kept else 0
    new = store.version == 0
    if not new and store.version >= version:
        return
    why = "the world database began anew" if new else "the world database lost its last changes"
    store.version = max(store.version, version)
    if new:
        from rtc.cell import Cell  # brings numpy; a restart, which should be quick, does without

        store.write("cell", initial_facts(Cell.load(given.settings.cell)), source="cell", at_s=now_s())
    if version:
        doubt_everything(store, f"{lease.DOUBT}{store.version + 1}", why, _fixed(given.settings), now_s())
        me.note(f"{why}; facts of arms and things are suspect")
    store.save()
    given.remember("world", BORN, store.version)


def _fixed(settings: Settings) -> list[str]:
    """The things of the cell that nothing moves."""
    from rtc.cell import Cell

    return [thing.name for thing in Cell.load(settings.cell).objects if thing.fixed]


def serve(
    me: Process,
    socket: zmq.Socket[bytes],
    server: Server,
    tell_dropped: Callable[[int], object] = lambda _: None,
    guard: MemoryGuard | None = None,
) -> None:
    """Answer until told to stop. A turn's commits are on disk, in one transaction, before any of its answers go.
    `tell_dropped` hears now and then how many messages could not be read, if any."""
    read = wire.reader(ToWorld)
    packer = Packer()
    dropped, due = 0, Every(TELL_S)
    while not me.stopping:
        me.wait(TELL_S)
        if dropped and due.due(now_s()):
            tell_dropped(dropped)
        if guard is not None and guard.alarm(now_s()):
            me.log.warning("more than %.0f MB: opening the door anew", guard.limit_mb)
            socket = me.open_anew(socket, socket.getsockopt_string(zmq.LAST_ENDPOINT), BOUNDS["world"])
        answers: list[tuple[bytes, Any]] = []
        for who, *parts in inbox(socket, PER_TURN):
            try:
                answers.append((who, server.answer(read(parts), now_s())))
            except WireError as error:
                dropped += 1
                if dropped & (dropped - 1) == 0:  # the 1st, 2nd, 4th, 8th ...: a flood must not fill the log
                    me.log.warning("dropped message %d, from %r: %s", dropped, who[:40], error)
        server.store.save()
        for who, answer in answers:
            send(socket, packer.pack(answer), to=who)


if __name__ == "__main__":
    main()
