"""One worker process: `python -m workers --run-dir D --kind binder --node 2`.

Only the module of its own kind is imported, before `ready` is said: a parser never pays for robot models.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import os
from pathlib import Path
from typing import Any

import zmq

from rtc import process
from rtc.cell import Cell
from rtc.messages import WorkerHello, WorkerKind
from rtc.settings import Settings
from rtc.world.client import WorldClient
from workers.shell import Shell

NICENESS = 5  # the broker and the MCM come first


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m workers", description="One worker of a cluster.")
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--kind", required=True, type=WorkerKind, choices=list(WorkerKind), metavar="KIND")
    parser.add_argument("--node", required=True, type=int, help="address in the cube")
    given = parser.parse_args()
    name = f"{given.kind}@{given.node}"
    with process.start(name, given.run_dir) as me:
        process.nice(NICENESS)
        function = importlib.import_module(f"workers.{given.kind}")
        build_cell = _build_cell_here if function.NEEDS_CELL else _no_cell
        if function.NEEDS_CELL:
            importlib.import_module("workers.cell_model")
        settings = Settings.load(given.run_dir)
        socket = me.socket(zmq.DEALER, settings.endpoint("workers"), identity=name)
        world = WorldClient(settings.endpoint("world"), me.context)
        hello = WorkerHello(name=name, node=given.node, kind=given.kind, pid=os.getpid())
        shell = Shell(me, hello, function, socket, world, build_cell)
        process.freeze_heap()
        gc.set_threshold(50_000, 20, 20)  # jobs leave little behind; a collection in one would only delay it
        me.ready()
        shell.run()
        world.close()


def _build_cell_here(cell: Cell) -> Any:
    from workers.cell_model import CellModel

    return CellModel(cell)


def _no_cell(cell: Cell) -> None:
    """This kind works without."""


if __name__ == "__main__":
    main()
