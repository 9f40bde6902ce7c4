"""One worker process with a trivial function: `python -m benchmarks.load.worker --run-dir D --kind binder --node 2`.

As `workers.__main__`, except for the function.
"""

from __future__ import annotations

import argparse
import gc
import os
from pathlib import Path
from typing import Any

from benchmarks.load.trivial import FUNCTIONS, asleep, busy
from rtc.protocol.messages import WorkerHello, WorkerKind
from rtc.protocol.versions import VERSION
from rtc.runtime import process
from rtc.runtime.link import Link
from rtc.runtime.settings import Settings
from rtc.world.client import WorldClient
from workers.runtime.worker_loop import WorkerLoop

NICENESS = 5  # as the real workers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--kind", required=True, type=WorkerKind)
    parser.add_argument("--node", required=True, type=int)
    parser.add_argument("--busy-s", type=float, default=0.0, help="work of every job")
    parser.add_argument("--asleep-s", type=float, default=0.0, help="sleep of every job, without work")
    given = parser.parse_args()
    work(given.run_dir, given.kind, given.node, busy_s=given.busy_s, asleep_s=given.asleep_s)


def work(run_dir: Path, kind: WorkerKind, node: int, *, busy_s: float = 0.0, asleep_s: float = 0.0) -> None:
    """Run one worker until it is asked to stop. `busy_s`, `asleep_s`: duration of each job, spent or slept."""
    name = f"{kind}@{node}"
    with process.start(name, run_dir) as me:
        process.nice(NICENESS)
        process.show_name(name)
        settings = Settings.load(run_dir)
        function: Any = FUNCTIONS[kind]
        if busy_s:
            function = function._replace(body=busy(function.body, busy_s))
        if asleep_s:
            function = function._replace(body=asleep(function.body, asleep_s))
        link = Link.connect(me, settings.endpoint("workers"), name)
        world = WorldClient(settings.endpoint("world"), me.context)
        hello = WorkerHello(protocol=VERSION, name=name, node=node, kind=kind, pid=os.getpid())
        shell = WorkerLoop(me, hello, function, link, world, lambda cell: cell)
        process.freeze_heap()
        gc.set_threshold(50_000, 20, 20)
        me.ready()
        shell.run()
        world.close()


if __name__ == "__main__":
    main()
