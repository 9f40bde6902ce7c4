"""The world database process: `python -m rtc.world --run-dir D`. It connects a socket to `server.Server`.

It continues with the database in the run directory, or creates one with the initial facts of the cell. With --template
it is the fork server of later world database processes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import zmq

from rtc.protocol import wire
from rtc.protocol.messages import ProcessHello, ToWorld, UnreadableMessages, WorldChange
from rtc.protocol.outcomes import WireError
from rtc.protocol.versions import VERSION
from rtc.runtime import damaged_database, fork_server, handover, process
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import Every, Process, inbox, now_s, send
from rtc.runtime.settings import BOUNDS, Settings
from rtc.world import lease
from rtc.world.model import initial_facts
from rtc.world.server import Packer, Server, make_suspect
from rtc.world.store import Store

if TYPE_CHECKING:
    from rtc.model.cells.cell import Cell

FILE = "world.db"
BORN = b"world"  # marker in the role's handover data: the database has begun in this run
PER_TURN = 256  # maximum number of requests per loop iteration, and so per transaction
REPORT_DROPPED_S = 0.5  # period of reports to the broker about unreadable messages


def main() -> None:
    fork_server.main("python -m rtc.world", "The world database of one cluster.", live)


def live(run_dir: Path, fd: int = -1) -> None:
    """Runs the world database until it receives SIGTERM. `fd`: the handover file of the supervisor
    (rtc.runtime.handover)."""
    process.show_name("world")
    given = handover.claim_role("world", run_dir, fd)
    with process.start("world", run_dir) as me:
        path = run_dir / FILE
        store = damaged_database.open_or_set_aside(path, lambda: Store(path), me.note)
        with damaged_database.put_aside_when_damaged(path, me.note):
            _live(me, given, store)


def _live(me: Process, given: handover.Handover, store: Store) -> None:
    settings = given.settings
    _begin(me, given, store)
    socket = me.socket(zmq.ROUTER, settings.endpoint("world"), bind=True, bounds=BOUNDS["world"])
    broker = me.socket(zmq.DEALER, settings.endpoint("supervisor"), identity="world", poll=False)
    send(broker, ProcessHello(name="world", protocol=VERSION))
    server = Server(store, given.lease_key, lambda: _fixed(settings), given.motions)
    store.saved = lambda version: given.save_counters("world", BORN, version)
    process.freeze_heap()
    me.ready()
    serve(
        me, socket, server, lambda dropped: send(broker, UnreadableMessages(counts={"world": dropped})), MemoryGuard()
    )
    store.close()


def _begin(me: Process, given: handover.Handover, store: Store) -> None:
    """Fill a new database from the cell; mark facts suspect if changes were lost.

    Changes were lost if the database is new although this run had one, or older than its last saved version. Then all
    facts that a motion changes become suspect. Versions continue above the highest one that was ever sent.
    """
    kept = given.remembered("world")
    version = kept[1] if kept else 0
    new = store.version == 0
    if not new and store.version >= version:
        return
    why = "the world database began anew" if new else "the world database lost its last changes"
    store.version = max(store.version, version)
    if new:
        from rtc.model.cells.cell import Cell

        cell = Cell.load(given.settings.cell)
        store.write("cell", initial_facts(cell), source="cell", at_s=now_s())
        if places := _taught(me, cell):
            store.write("taught", places, source="taught", at_s=now_s())
    if version:
        make_suspect(store, f"{lease.DOUBT}{store.version + 1}", why, _fixed(given.settings), now_s())
        me.note(f"{why}; facts of arms and things are suspect")
    store.save()
    given.save_counters("world", BORN, store.version)


def _taught(me: Process, cell: Cell) -> list[WorldChange]:
    """The places taught in earlier runs. A file that cannot be read is reported."""
    from rtc.model.cells import taught, taught_file

    try:
        known = taught_file.load(cell)
    except (OSError, msgspec.MsgspecError) as error:
        me.note(f"the taught places in {taught_file.file_of(cell)} cannot be read: {error}")
        return []
    return [
        WorldChange(key=taught.key_of(place, arm), value=joints)
        for place, by_arm in known.items()
        for arm, joints in by_arm.items()
    ]


def _fixed(settings: Settings) -> list[str]:
    """The names of the objects of the cell that no motion can change. A bolt is fixed but for its thread."""
    from rtc.model.cells.cell import Cell

    return [thing.name for thing in Cell.load(settings.cell).objects if thing.fixed and thing.thread is None]


def serve(
    me: Process,
    socket: zmq.Socket[bytes],
    server: Server,
    report_dropped: Callable[[int], object] = lambda _: None,
    guard: MemoryGuard | None = None,
) -> None:
    """Answers requests until `me.stopping`. The commits of one iteration are saved before its answers.

    `report_dropped` is called every REPORT_DROPPED_S with the number of unreadable messages, if there were any.
    """
    read = wire.reader(ToWorld)
    packer = Packer()
    dropped, due = 0, Every(REPORT_DROPPED_S)
    while not me.stopping:
        me.wait(REPORT_DROPPED_S)
        if dropped and due.due(now_s()):
            report_dropped(dropped)
        if guard is not None and guard.alarm(now_s()):
            me.log.warning("more than %.0f MB: the socket is closed and opened again", guard.limit_mb)
            socket = me.reopen(socket, socket.getsockopt_string(zmq.LAST_ENDPOINT), BOUNDS["world"])
        answers: list[tuple[bytes, Any]] = []
        for sender, *parts in inbox(socket, PER_TURN):
            try:
                answers.append((sender, server.answer(read(parts), now_s())))
            except WireError as error:
                dropped += 1
                if dropped & (dropped - 1) == 0:  # logs number 1, 2, 4, 8 ...: a flood must not fill the log
                    me.log.warning("dropped message %d, from %r: %s", dropped, sender[:40], error)
        server.store.save()
        for sender, answer in answers:
            send(socket, packer.pack(answer), to=sender)


if __name__ == "__main__":
    main()
