"""rtc observe: metrics for Prometheus and traces for OpenTelemetry, from a process of its own."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from rtc.apps.cli.output import RunDir, With, cli_error, console, duration_s
from rtc.runtime import process
from rtc.runtime.extras import missing
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.run_dir import running_settings
from rtc.runtime.settings import Settings, default_run_dir

HERE = "127.0.0.1"


def observe(
    prometheus: Annotated[
        str,
        typer.Option(help="[HOST:]PORT: answer scrapes at http://HOST:PORT/metrics; 0: any port.", show_default="off"),
    ] = "",
    otlp: Annotated[
        str, typer.Option(help="URL of an OTLP/HTTP collector, which gets the traces.", show_default="off")
    ] = "",
    for_: Annotated[str, typer.Option("--for", help="How long, such as 60s.", show_default="until Ctrl-C")] = "",
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Export metrics and traces of a cluster, until Ctrl-C or its end. At least one of the two options is needed.

    Example:  rtc observe --prometheus 9464
    Example:  rtc observe --prometheus 0.0.0.0:9464 --otlp http://localhost:4318
    """
    if not (prometheus or otlp):
        raise cli_error("nothing to export: give --prometheus PORT, --otlp URL, or both", 2)
    host, port = _address(prometheus) if prometheus else ("", 0)
    if otlp and not otlp.startswith(("http://", "https://")):
        raise cli_error(f"--otlp is a URL such as http://localhost:4318; not {otlp}", 2)
    for purpose in (*(["prometheus"] if prometheus else []), *(["otlp"] if otlp else [])):
        if need := missing(purpose):
            raise cli_error(need, 2)
    for_s = duration_s(for_, "--for") if for_ else math.inf
    endpoints: Endpoints = KeyFile.load(key) if key else running_settings(run_dir or default_run_dir())
    _observe(endpoints, host, port, otlp, for_s)


def _observe(endpoints: Endpoints, host: str, port: int, otlp: str, for_s: float) -> None:
    from rtc.apps.observers.feed import Feed
    from rtc.apps.observers.observer import Watcher, observe
    from rtc.apps.observers.recorder import NICENESS

    process.log_to_stderr(logging.WARNING)
    with process.start("rtc observe", Path()) as me:
        process.nice(NICENESS)
        feed = Feed(me, endpoints, telemetry=bool(host), records=bool(otlp))
        watchers: list[Watcher] = []
        if host:
            from rtc.apps.observers.metrics import Metrics

            watchers.append(metrics := Metrics(lambda: feed.lost, process.now_s))
            try:
                port = metrics.serve(port, host)
            except OSError as error:
                raise cli_error(f"--prometheus: {host}:{port} cannot be used: {error.strerror or error}", 2) from None
            console.print(Text(f"metrics at http://{host}:{port}/metrics"))
        if otlp:
            from rtc.apps.observers.traces import Traces

            run = endpoints.run if isinstance(endpoints, Settings) else ""
            watchers.append(Traces(run, otlp, shares_clock=not endpoints.far))
            console.print(Text(f"traces to {otlp}"))
        observe(me, feed, watchers, for_s)
        for watcher in watchers:
            watcher.close()


def _address(text: str) -> tuple[str, int]:
    """(host, port) of [HOST:]PORT. Raises typer.Exit, with the reason printed."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) < 65536):
        raise cli_error(f"--prometheus is a port such as 9464, or HOST:PORT; not {text}", 2)
    return host.strip("[]") or HERE, int(port)
