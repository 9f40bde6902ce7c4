"""rtc record, play: write the run of a cluster to a file, and show its story."""

from __future__ import annotations

import logging
import math
import os
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from rtc.apps.cli.cluster_cell import cell_file
from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, duration_s, emit_json, errors
from rtc.client.client import Client
from rtc.runtime import process
from rtc.runtime.extras import missing
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.run_dir import running_settings
from rtc.runtime.settings import Settings, default_run_dir


def record(
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The MCAP file.", show_default="rtc-DATE-TIME.mcap")
    ] = None,
    raw: Annotated[
        Path | None, typer.Option("--raw", help="Keep the event stream as MessagePack in this file; without -o alone.")
    ] = None,
    rate: Annotated[float, typer.Option(min=0.1, max=50, help="Samples of the arms per second while they move.")] = 20,
    pictures: Annotated[
        float, typer.Option(min=0, max=5, help="Pictures of the scene per second; each needs processor time.")
    ] = 0,
    for_: Annotated[str, typer.Option("--for", help="How long, such as 60s.", show_default="until Ctrl-C")] = "",
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Record what a cluster does, until Ctrl-C or its end. The file is MCAP with the schemas of Foxglove.

    It contains commands, progress and outcomes, joints and frames of the arms, and their URDFs. The recorder is a
    process of its own: the cluster does not wait for it.

    Example:  rtc record -o run.mcap
    Example:  rtc record -o run.mcap --pictures 1
    Example:  rtc record --raw events.msgpack --for 60s
    """
    for_s = duration_s(for_, "--for") if for_ else math.inf
    mcap = out is not None or raw is None
    if pictures and not mcap:
        raise cli_error("--pictures needs an MCAP file for them: give -o FILE too", 2)
    if mcap and (need := missing("record")):
        raise cli_error(need, 2)
    endpoints: Endpoints = KeyFile.load(key) if key else running_settings(run_dir or default_run_dir())
    from rtc.apps.observers import recorder
    from rtc.apps.observers.feed import Feed

    path = out or recorder.unused(Path(recorder.default_name()))
    _check_writable({file.parent for file in (path if mcap else None, raw) if file is not None})
    sinks: list[recorder.Sink] = []
    process.log_to_stderr(logging.WARNING)
    with (
        process.start("rtc record", default_run_dir() if run_dir is None else run_dir) as me,
        nullcontext(endpoints.cell) if isinstance(endpoints, Settings) else cell_file(_sent_cell(key)) as cell,
    ):
        process.nice(recorder.NICENESS)
        try:
            sinks += recorder.open_recording(path, endpoints, cell, rate, pictures) if mcap else []
            sinks += [recorder.RawEvents(raw)] if raw else []
            files = ", ".join(str(file) for file in ([path] if mcap else []) + ([raw] if raw else []))
            feed = Feed(me, endpoints, telemetry=mcap, records=mcap, world=mcap)
            console.print(Text(f"recording to {files}; Ctrl-C ends it"))
            done = recorder.record(me, feed, sinks, for_s)
            while sinks:
                sinks.pop().close()
        except FileExistsError as error:
            raise cli_error(f"{error.filename} exists already; choose another file", 2) from None
        except OSError as error:
            raise cli_error(f"the recording has ended: {error}") from None
        finally:
            for sink in sinks:
                with suppress(OSError):
                    sink.close()
    lost = f"; {done.lost} events did not arrive" if done.lost else ""
    console.print(Text(f"{files}: {done.events} events{lost}"))


def _check_writable(folders: set[Path]) -> None:
    for folder in folders:
        if not os.access(folder, os.W_OK | os.X_OK):
            why = "is not writable" if folder.is_dir() else "is not a directory"
            raise cli_error(f"{folder} {why}; choose another place for the file", 2)


def _sent_cell(key: Path | None) -> bytes:
    with Client(key=key) as rtc:
        return rtc.cell()


def play(
    file: Annotated[Path, typer.Argument(help="An MCAP file of rtc record.")],
    extract: Annotated[
        Path | None, typer.Option(help="Also write the attachments (URDFs, cell) to this directory.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Show the story of a recording: commands, phases, ends and halts, with their times.

    A recording whose recorder was killed is shown up to its last written chunk.

    Example:  rtc play run.mcap
    """
    if need := missing("record"):
        raise cli_error(need, 2)
    from rtc.apps.observers import playback

    try:
        found = playback.read(file)
        written, left_out = playback.extract(found, extract) if extract else ([], [])
    except OSError as error:
        raise cli_error(f"{error.filename or file}: {error.strerror or error}", 2) from None
    except playback.NotARecording as error:
        raise cli_error(str(error), 2) from None
    if json:
        emit_json(playback.as_json(found))
        return
    for line in playback.in_words(found):
        console.print(Text(line))
    for path in written:
        console.print(Text(f"written: {path}"))
    for name in left_out:
        errors.print(Text(f"rtc: not written: {name[:80]!r} is not the name of a file"))
