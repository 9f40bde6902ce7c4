"""The process `cli-template` of a cluster: a fork server for commands of `rtc`: `python -m rtc.apps.cli.template`.

It has imported what commands need, and becomes a command for each call (rtc.apps.cli.forked). It declines calls of
other code: of another environment, or if a file of what it has loaded was changed since. It keeps no state.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import io
import os
import signal
import socket
import sys
import time
import traceback
from importlib import import_module
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import rtc
from rtc.apps.cli import forked
from rtc.apps.cli.forked import BEGIN, SOCKET, Call
from rtc.apps.cli.interrupts import leave
from rtc.language.parse import default_grammar
from rtc.runtime import environment, handover, process

MAX_CALL = 1 << 20  # bytes; the kernel's own limit is lower
MAX_FD = 256  # this process has opened fewer
LOOK_S = 1.0  # between two looks for the socket's file
CALL_S = 1.0  # for a call to arrive after its connection
# Nothing of these reads the environment or the standard streams when it is imported; modules of commands do.
LOADED = (
    "rich.live",
    "rtc.client.client",
    "rtc.client.past_runs",
    "rtc.model.cells.cell",
    "rtc.programs.loader",
    "rtc.programs.outcome_table",
    "rtc.runtime.process_table",
    "rtc.wording.commands",
    "rtc.wording.facts",
    "rtc.wording.feedback",
    "rtc.wording.outcomes",
    "rtc.wording.rehearsals",
)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rtc.apps.cli.template", description=__doc__)
    parser.add_argument("--run-dir", required=True, type=Path, help="run directory of the cluster, made by `rtc up`")
    handover.add_option(parser)
    path = parser.parse_args().run_dir / SOCKET
    load()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the processes of commands are not waited for
    process.freeze_heap()  # a later collection would copy these pages in every child
    print("ready", flush=True)
    while True:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
            path.unlink(missing_ok=True)
            listener.bind(str(path))
            listener.listen(128)
            serve(listener, path)


def load() -> None:
    """Import what commands need; typer and rich load much of theirs at their first use."""
    for name in LOADED:
        import_module(name)
    default_grammar()  # for `rtc parse`
    app = typer.Typer()
    app.command()(_nothing)
    app([], standalone_mode=False)
    table = Table("", box=None)
    table.add_row(Text("é", style="bold"))
    Console(file=io.StringIO(), force_terminal=True).print(table)


def _nothing(path: Annotated[Path | None, typer.Option()] = None, seconds: float = 0.0, as_json: bool = False) -> None:
    """A command with options of our kinds."""


def serve(listener: socket.socket, path: Path) -> None:
    """Fork a process for each call, until the socket was deleted."""
    loaded = _times_of_files(_files())
    mine = forked.code()
    listener.settimeout(LOOK_S)
    while True:
        try:
            line, _ = listener.accept()
        except TimeoutError:
            if path.exists():
                continue
            return
        line.settimeout(CALL_S)
        with line, contextlib.suppress(OSError, ValueError):  # a caller that is gone, or is none
            call = Call.from_bytes(line.recv(MAX_CALL))
            if call.code == mine and _times_of_files(loaded) == loaded and os.fork() == 0:
                _become(call, line)


def _files() -> list[str]:
    """Of rtc: the modules that this process has loaded, and the grammar that it has compiled."""
    root = os.path.dirname(str(rtc.__file__))
    files = [module.__dict__.get("__file__") or "" for module in list(sys.modules.values())]
    return [*(file for file in files if file.startswith(root)), os.path.join(root, "language", "command.lark")]


def _times_of_files(files: list[str] | dict[str, int]) -> dict[str, int]:
    """The times of the last changes (ns); 0 of a file that is gone."""
    times = {}
    for file in files:
        try:
            times[file] = os.stat(file).st_mtime_ns
        except OSError:
            times[file] = 0
    return times


def _become(call: Call, line: socket.socket) -> NoReturn:
    """Run the command, from the fork to the end of the process."""
    status = 1
    try:
        line.settimeout(None)
        answer, fds = b"", list[int]()
        with contextlib.suppress(OSError):  # the caller may have gone
            line.send(str(os.getpid()).encode())
            answer, fds, _, _ = socket.recv_fds(line, 1, 4)
        if answer != BEGIN:
            os._exit(1)
        _take_over(call, fds, keep=line.fileno())
        _die_with_caller(line)
        from rtc.apps.cli import main

        main.main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
        fcntl.fcntl(line, fcntl.F_SETFL, 0)  # the caller closes the line upon its answer
        line.send(bytes([status & 0xFF]))
    process.leave(status)


def _take_over(call: Call, fds: list[int], keep: int) -> None:
    """The place of the caller: streams, environment, working directory, priority and signals."""
    os.setsid()
    process.show_name(f"rtc {call.words[0]}")
    *streams, directory = fds
    os.fchdir(directory)
    for number, fd in enumerate(streams):
        os.dup2(fd, number)
    os.closerange(3, keep)  # these, and what a process of the cluster has inherited
    os.closerange(keep + 1, MAX_FD)
    for name, mode, number in (("stdin", "r", 0), ("stdout", "w", 1), ("stderr", "w", 2)):
        encoding, errors = call.streams[number]
        at_once = number == 2 or os.isatty(number)
        stream = open(number, mode, encoding=encoding, errors=errors, closefd=False)  # noqa: SIM115
        stream.reconfigure(line_buffering=at_once and mode == "w")  # type: ignore[attr-defined]
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    environment.replace(call.environment)
    time.tzset()
    os.umask(call.umask)
    with contextlib.suppress(OSError):  # a lower one needs a right
        os.setpriority(os.PRIO_PROCESS, 0, call.niceness)
    sys.argv = ["rtc", *call.words]
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    for number in forked.FORWARDED:
        usual = leave if number == signal.SIGINT else signal.SIG_DFL
        signal.signal(number, signal.SIG_IGN if number in call.ignored else usual)


def _die_with_caller(line: socket.socket) -> None:
    """Let the kernel end this process when the caller dies: it closes its end of the line, which sends no more.

    By SIGKILL, which also ends a stopped process."""
    fcntl.fcntl(line, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(line, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(line, fcntl.F_SETFL, fcntl.fcntl(line, fcntl.F_GETFL) | os.O_ASYNC)
    line.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        if not line.recv(1):
            os._exit(1)
    line.setblocking(True)


if __name__ == "__main__":
    main()
