"""Start of one worker: its sockets, its hello and its loop, in this process or in a thread of another program.

Local workers belong to the supervisor of their cluster. A remote worker (`join`) belongs to the engine that started
it, and ends by itself if it has lost its broker.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from typing import Any

from rtc.model.cells.cell import Cell
from rtc.model.robot import compiled
from rtc.protocol.messages import REHEARSER, WorkerHello, WorkerKind
from rtc.protocol.outcomes import ClusterError
from rtc.protocol.versions import BOXES, VERSION
from rtc.runtime import process
from rtc.runtime.handover import Handover
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.link import Link
from rtc.runtime.memory_guard import limit_data
from rtc.runtime.process import Process
from rtc.world.client import WorldClient
from workers.runtime import lazy_import
from workers.runtime.contact import BrokerContact
from workers.runtime.preload import Preloaded, preload
from workers.runtime.worker_loop import WorkerLoop

NICENESS = 5  # lower priority than the broker and the MCM
IDLE_NICENESS = 19  # of a rehearser: it takes the time that live commands leave


def work(given: Handover, kind: WorkerKind, node: int, prepared: Preloaded) -> None:
    """Run a local worker until it is ordered to stop. `prepared`: programs and cell models, compiled."""
    name = f"{kind}@{node}"
    process.show_name(name)
    limit_data()
    with process.start(name, ".") as me:
        hello = WorkerHello(name=name, node=node, kind=kind, pid=os.getpid(), protocol=VERSION, abilities=_abilities())
        run(me, given.settings, hello, prepared, world_version=given.world_version)


def rehearse(given: Handover, number: int, prepared: Preloaded) -> None:
    """Run a rehearser until it is ordered to stop. It is no node of the cube."""
    name = f"{REHEARSER}@{number}"
    process.show_name(name)
    limit_data()
    with process.start(name, ".") as me:
        hello = WorkerHello(
            name=name,
            node=number,
            kind=WorkerKind.ELABORATOR,
            pid=os.getpid(),
            protocol=VERSION,
            abilities=_abilities(),
            rehearses=True,
        )
        run(me, given.settings, hello, prepared, world_version=given.world_version)


def _abilities() -> list[str]:
    return [BOXES] if compiled() else []


def join(key: KeyFile, kind: WorkerKind, node: int | None, contact: BrokerContact, me: Process) -> None:
    """Run a worker of a cluster on another machine until `me` is stopped. Without a `node` the cluster assigns one.

    Raises ClusterError if the cluster rejects the worker or does not answer any more; KeyTrouble if the key does not
    admit workers.
    """
    hello = WorkerHello(
        name=kind.value if node is None else f"{kind}@{node}",
        node=node,
        kind=kind,
        pid=os.getpid(),
        instance=os.urandom(8).hex() if node is None else "",
        protocol=VERSION,
        abilities=_abilities(),
    )
    try:
        why = run(me, key, hello, preload([kind], cell=None), contact)
    finally:
        contact.close()
    if why:
        raise ClusterError(why)


def run(
    me: Process,
    endpoints: Endpoints,
    hello: WorkerHello,
    prepared: Preloaded,
    contact: BrokerContact | None = None,
    world_version: Callable[[], int | None] = lambda: None,
) -> str:
    """Run the loop of one worker. Returns the reason if it ended by itself; empty after an order to stop."""
    process.nice(IDLE_NICENESS if hello.rehearses else NICENESS)
    function: Any = lazy_import.load(REHEARSER if hello.rehearses else hello.kind)
    if function.NEEDS_CELL:
        lazy_import.load("workers.planning.robot_models")
    # Over tcp the hello carries the name.
    identity, secure = ("", endpoints.secure) if endpoints.far else (hello.name, None)
    link = Link.connect(me, endpoints.endpoint("workers"), identity, secure)
    world = WorldClient(endpoints.endpoint("world"), me.context, secure=secure)
    kinds = WorkerKind if hello.rehearses else (hello.kind,)
    programs = {name: program for kind in kinds for name, program in prepared.programs.get(kind, {}).items()}
    compilers = function.COMPILERS if hello.rehearses else {}
    loop = WorkerLoop(
        me, hello, function, link, world, _models_of, programs, prepared.cells, contact, compilers, world_version
    )
    process.freeze_heap()
    gc.set_threshold(50_000, 20, 20)  # jobs leave little garbage; a collection would delay a job
    if contact is None:
        me.ready()
    why = loop.run()
    world.close()
    return why


def _models_of(cell: Cell) -> Any:
    from workers.planning.robot_models import CellModel

    return CellModel(cell)
