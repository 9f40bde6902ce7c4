"""rtc console: a page in the browser for a running cluster."""

from __future__ import annotations

import logging
import webbrowser
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from rtc.apps.cli.cluster_cell import cell_file
from rtc.apps.cli.output import RunDir, With, cli_error
from rtc.apps.cli.output import console as screen
from rtc.client.client import Client
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.roles import Role
from rtc.runtime import process
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.run_dir import running_settings
from rtc.runtime.settings import default_run_dir

PORT = 8400
ANY = -1  # PORT, or any free one if that is taken


def console(
    port: Annotated[
        int, typer.Option(min=ANY, max=65535, help="Port on this machine; 0: any.", show_default=f"{PORT}, or any")
    ] = ANY,
    role: Annotated[str, typer.Option(help="operator, or observer: pages that can only look.")] = "operator",
    up: Annotated[bool, typer.Option("--up", help="Start a cluster for it first; it ends with the console.")] = False,
    browse: Annotated[bool, typer.Option("--open", help="Also open the page in the browser of this machine.")] = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Serve a web page of a cluster, and print its link: scene, sentences, commands, facts and HALT. Ctrl-C ends it.

    The page is served on this machine only, to those who have the link. From another machine: forward the port by ssh,
    and open the link there. A stop by this page is no certified emergency stop.

    Example:  rtc console
    Example:  rtc console --up --open
    Example:  rtc console --with alice.key
    """
    if role not in (Role.OPERATOR, Role.OBSERVER):
        raise cli_error(f"--role is operator or observer; not {role}", 2)
    if up and (run_dir or key):
        raise cli_error("--up starts a cluster of its own: give neither --run-dir nor --with", 2)
    with ExitStack() as stack:
        if up:
            from rtc.apps.demos.own_cluster import own_cluster

            screen.print("starting a cluster ...")
            run_dir = stack.enter_context(own_cluster())
        _serve(port, Role(role), browse, run_dir or default_run_dir(), key)


def _serve(port: int, role: Role, browse: bool, run_dir: Path, key: Path | None) -> None:
    from rtc.apps.console import gateway
    from rtc.client import aio

    endpoints: Endpoints = KeyFile.load(key) if key else running_settings(run_dir)
    role = endpoints.role if isinstance(endpoints, KeyFile) else role
    how: dict[str, Any] = {"name": "console", "key": key}
    with Client(run_dir, **how) as client:
        cell = _cell_of(client)
        grammar = client.program(m.WorkerKind.PARSER).body.decode()
        round_trip_s = client.round_trip_s
    process.log_to_stderr(logging.WARNING)
    try:
        listening = gateway.listen(PORT if port == ANY else port, others=port == ANY)
    except OSError as error:
        words = f"port {port} cannot be used: {error.strerror or error}; choose another, or --port 0"
        raise cli_error(words, 2) from None
    with process.start("rtc console", Path()) as me, listening:
        make_client = partial(aio.Client, run_dir, **how)
        given = gateway.ConsoleOptions(endpoints, make_client, cell, grammar, role, round_trip_s)
        gateway.serve(me, given, listening, partial(_opened, browse))


def _cell_of(client: Client) -> Cell:
    if not client.far:
        return Cell.load(client.settings.cell)
    with cell_file(client.cell()) as name:
        return Cell.load(name)


def _opened(browse: bool, link: str) -> None:
    screen.print(Text(link))
    screen.print("open this link in a browser; Ctrl-C ends the console, and the cluster continues")
    if browse:
        webbrowser.open(link)
