"""Entry point of a worker process: `python -m workers --run-dir D --kind binder --node 2`.

With --template the process is the fork server: it forks one worker per order {"kind", "node"}. With a worker's key it
joins a cluster on another machine: `python -m workers --kind binder --node 18 --with w.key`.

A worker imports only the module of its own kind, and does so before it signals `ready`. A parser therefore does not
load robot models.
"""

from __future__ import annotations

import argparse
import gc
import os
from pathlib import Path
from typing import Any

import msgspec
import zmq

from rtc.cells.cell import Cell
from rtc.protocol.messages import WorkerHello, WorkerKind
from rtc.protocol.outcomes import KeyTrouble
from rtc.runtime import fork_server, handover, process
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.settings import Settings
from rtc.world.client import WorldClient
from workers.runtime import lazy_import
from workers.runtime.preload import Preloaded, preload
from workers.runtime.worker_loop import Shell

NICENESS = 5  # lower priority than the broker and the MCM


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m workers", description="One worker of a cluster.")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--run-dir", type=Path)
    where.add_argument(
        "--with", dest="key", type=Path, metavar="FILE", help="a worker's key, for a cluster on another machine"
    )
    parser.add_argument("--template", action="store_true", help="run as the fork server for workers")
    parser.add_argument("--kind", type=WorkerKind, choices=list(WorkerKind), metavar="KIND")
    parser.add_argument("--node", type=int, help="address in the cube")
    handover.add_option(parser)
    given = parser.parse_args()
    if given.template and given.run_dir:
        serve(handover.load(given.run_dir, given.handed).settings)
    elif given.kind is None or given.node is None:
        parser.error("a worker needs --kind and --node")
    elif given.key:
        join(given.key, given.kind, given.node)
    else:
        settings = handover.load(given.run_dir, given.handed).settings
        work(settings, given.kind, given.node, preload([given.kind], settings.cell))


class Order(msgspec.Struct, frozen=True):
    kind: WorkerKind
    node: int


def serve(settings: Settings) -> None:
    """Run as the fork server: preload programs and models for all kinds, then fork one worker per order."""
    process.log_to_stderr()
    prepared = preload(WorkerKind, settings.cell)
    read = msgspec.json.Decoder(Order).decode

    def be(order: bytes) -> None:
        wanted = read(order)
        work(settings, wanted.kind, wanted.node, prepared)

    fork_server.serve(be)


def join(key: Path, kind: WorkerKind, node: int) -> None:
    """Run as a worker of a cluster on another machine. Raises SystemExit with a message if the cluster rejects it."""
    try:
        if not work(KeyFile.load(key), kind, node, preload([kind], cell=None)):
            raise SystemExit(
                f"the cluster rejects {kind}@{node}: its own machine, or another key, has this node; "
                "see logs/gate.log of the cluster"
            )
    except KeyTrouble as error:
        raise SystemExit(str(error)) from None


def work(endpoints: Endpoints, kind: WorkerKind, node: int, prepared: Preloaded) -> bool:
    """Run one worker until it is asked to stop. Returns True if a signal stopped it, False if the cluster did.

    `prepared` holds the programs and cell models that are already compiled.
    """
    name = f"{kind}@{node}"
    process.show_name(name)
    with process.start(name, ".") as me:
        process.nice(NICENESS)
        function: Any = lazy_import.load(kind)
        if function.NEEDS_CELL:
            lazy_import.load("workers.planning.robot_models")
        identity, secure = (
            ("", endpoints.secure) if endpoints.far else (name, None)
        )  # over tcp the hello carries the name
        socket = me.socket(zmq.DEALER, endpoints.endpoint("workers"), identity=identity, secure=secure)
        world = WorldClient(endpoints.endpoint("world"), me.context, secure=secure)
        hello = WorkerHello(name=name, node=node, kind=kind, pid=os.getpid())
        shell = Shell(me, hello, function, socket, world, _models_of, prepared.programs.get(kind, {}), prepared.cells)
        process.freeze_heap()
        gc.set_threshold(50_000, 20, 20)  # jobs leave little garbage; a collection would delay a job
        me.ready()
        shell.run()
        world.close()
        return me.stopping


def _models_of(cell: Cell) -> Any:
    from workers.planning.robot_models import CellModel

    return CellModel(cell)


if __name__ == "__main__":
    main()
