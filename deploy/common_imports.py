"""The fork server of a cluster's other fork servers: `python -m deploy.common_imports`.

It has imported what several kinds of processes import, and becomes the process of the command of each order. It builds
nothing: a fork server that it forks builds what its own kind needs.
"""

from __future__ import annotations

import importlib
import runpy
import sys
from collections.abc import Sequence

import msgspec

from rtc.runtime import fork_server, process

NAME = "common-template"  # its own process name

# What at least two kinds import. None of these starts a thread or opens a socket.
COMMON = (
    "rtc.model.cells.cell",
    "rtc.model.robot.collision",
    "rtc.programs.loader",
    "rtc.runtime.handover",
    "rtc.runtime.memory_guard",
)


class ForkOrder(msgspec.Struct, frozen=True):
    name: str
    module: str
    arguments: list[str]


def order_of(name: str, command: Sequence[str]) -> bytes:
    """The order to become the process `name` of this command: python ... -m MODULE ARGUMENTS."""
    _, module, *arguments = command[command.index("-m") :]
    return msgspec.json.encode(ForkOrder(name, module, arguments))


def main() -> None:
    process.show_name(NAME)
    for name in COMMON:
        importlib.import_module(name)
    fork_server.serve(become)


def become(order: bytes) -> None:
    """Run the command of the order, in a process just forked."""
    wanted = msgspec.json.decode(order, type=ForkOrder)
    process.show_name(wanted.name)
    sys.argv = [wanted.module, *wanted.arguments]
    runpy.run_module(wanted.module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
