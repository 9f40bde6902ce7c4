"""One worker process: `python -m workers --run-dir D --kind binder --node 2`; or, with --template, the process that
others are forked from, each by an order: {"kind", "node"}.

Only the module of its own kind is imported, before `ready` is said: a parser never pays for robot models.
"""

from __future__ import annotations

import argparse
import gc
import os
from pathlib import Path
from typing import Any

import msgspec
import zmq

from rtc import process, template
from rtc.cell import Cell
from rtc.messages import WorkerHello, WorkerKind
from rtc.settings import Settings
from rtc.world.client import WorldClient
from workers import imports
from workers.shell import Shell
from workers.warm import Warm, warm

NICENESS = 5  # the broker and the MCM come first


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m workers", description="One worker of a cluster.")
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--template", action="store_true", help="be the one that workers are forked from")
    parser.add_argument("--kind", type=WorkerKind, choices=list(WorkerKind), metavar="KIND")
    parser.add_argument("--node", type=int, help="address in the cube")
    given = parser.parse_args()
    if given.template:
        serve(given.run_dir)
    elif given.kind is None or given.node is None:
        parser.error("a worker needs --kind and --node")
    else:
        work(given.run_dir, given.kind, given.node, Warm())


class Order(msgspec.Struct, frozen=True):
    kind: WorkerKind
    node: int


def serve(run_dir: Path) -> None:
    """Be the template: make for all kinds what each needs, then fork as ordered."""
    process.log_to_stderr()
    prepared = warm(run_dir)
    read = msgspec.json.Decoder(Order).decode

    def be(order: bytes) -> None:
        wanted = read(order)
        work(run_dir, wanted.kind, wanted.node, prepared)

    template.serve(be)


def work(run_dir: Path, kind: WorkerKind, node: int, warm: Warm) -> None:
    """Be one worker until told to end. `warm` is what has been made for it already."""
    name = f"{kind}@{node}"
    process.show_name(name)
    with process.start(name, run_dir) as me:
        process.nice(NICENESS)
        function: Any = imports.load(kind)
        if function.NEEDS_CELL:
            imports.load("cell_model")
        settings = Settings.load(run_dir)
        socket = me.socket(zmq.DEALER, settings.endpoint("workers"), identity=name)
        world = WorldClient(settings.endpoint("world"), me.context)
        hello = WorkerHello(name=name, node=node, kind=kind, pid=os.getpid())
        shell = Shell(me, hello, function, socket, world, _models_of, warm.programs.get(kind, {}), warm.cells)
        process.freeze_heap()
        gc.set_threshold(50_000, 20, 20)  # jobs leave little behind; a collection in one would only delay it
        me.ready()
        shell.run()
        world.close()


def _models_of(cell: Cell) -> Any:
    from workers.cell_model import CellModel  # brings pinocchio; only kinds that need a cell come here

    return CellModel(cell)


if __name__ == "__main__":
    main()
