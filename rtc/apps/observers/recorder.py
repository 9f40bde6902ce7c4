"""The recorder process: subscribes to a cluster and writes its run to a file. May be killed at any time.

`rtc record` runs `record`; the supervisor of `rtc up --record` starts `python -m rtc.apps.observers.recorder`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol, TypeVar

from rtc.apps.observers.feed import Feed, Received
from rtc.model.cells.cell import Cell
from rtc.runtime import handover, process
from rtc.runtime.keys import Endpoints
from rtc.runtime.process import Every, Process, now_s
from rtc.runtime.settings import Settings

WAIT_S = 0.1
NICENESS = 19  # of every observer: on busy cores the cluster comes first
RATE_HZ = 20.0  # default maximum rate of arm samples
LOST_S = 5.0  # shortest time between two messages about lost events

Result = TypeVar("Result")


class Sink(Protocol):
    """A file that takes what a feed receives."""

    def take(self, received: Received) -> None: ...

    def flush_if_due(self, now_s: float) -> None: ...

    def close(self) -> None: ...


class RawEvents:
    """Keeps the event stream as it came: one MessagePack map after the other. Raises FileExistsError."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = open(path, "xb")  # noqa: SIM115  closed by `close`
        self._flush = Every(0.5)

    def take(self, received: Received) -> None:
        self._file.write(received.event)

    def flush_if_due(self, now_s: float) -> None:
        if self._flush.due(now_s):
            self._file.flush()

    def close(self) -> None:
        self._file.close()


@dataclass
class Recorded:
    """What a recorder has received."""

    events: int = 0
    lost: int = 0


def default_name() -> str:
    """rtc-20261122-140322.mcap"""
    return time.strftime("rtc-%Y%m%d-%H%M%S.mcap")


def unused(path: Path) -> Path:
    """The path, with a number before its ending if the file exists."""
    found, n = path, 2
    while found.exists():
        found, n = path.with_name(f"{path.stem}-{n}{path.suffix}"), n + 1
    return found


def open_recording(
    path: Path, endpoints: Endpoints, name: str, rate_hz: float = RATE_HZ, pictures_hz: float = 0.0
) -> list[Sink]:
    """A new MCAP file for this cluster, and what draws its pictures. `name`: of the cell, or its file.

    Raises FileExistsError, OSError.
    """
    from rtc.apps.observers.pictures import RecordedPictures
    from rtc.apps.observers.recording import Recording

    here = endpoints if isinstance(endpoints, Settings) else None
    cell = Cell.load(name)
    about = {
        "cluster": here.run if here else "",
        "cell": here.cell if here else cell.name,
        "began": f"{time.time():.3f}",
    }
    recording = Recording(path, cell, about, rate_hz=rate_hz, shares_clock=not endpoints.far)
    if not pictures_hz:
        return [recording]
    return [recording, RecordedPictures(name, cell, recording, 1.0 / pictures_hz)]  # the first one is closed last


def record(me: Process, feed: Feed, sinks: list[Sink], for_s: float = float("inf")) -> Recorded:
    """Write what arrives until `me.stopping`, the end of the cluster, or `for_s`. Raises OSError on a full disk."""
    recorded, until_s = Recorded(), now_s() + for_s
    report = Every(LOST_S)
    while not me.stopping and not feed.over() and now_s() < until_s:
        for received in feed.read(min(WAIT_S, max(0.0, until_s - now_s()))):
            recorded.events += bool(received.event)
            for sink in sinks:
                sink.take(received)
        for sink in sinks:
            sink.flush_if_due(now_s())
        if feed.lost > recorded.lost and report.due(now_s()):
            me.log.warning("%d events did not arrive", feed.lost)
            recorded.lost = feed.lost
    recorded.lost = feed.lost
    return recorded


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rtc.apps.observers.recorder", description="Record one cluster.")
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--into", required=True, type=Path, help="directory of the recording")
    handover.add_option(parser)
    given = parser.parse_args()
    process.show_name("recorder")
    handed = handover.claim_role("recorder", given.run_dir, given.handed)
    with process.start("recorder", given.run_dir) as me:
        process.nice(NICENESS)
        process.nice_session(NICENESS)
        feed = Feed(me, handed.settings, world=True)
        sinks = _try(me, lambda: _opened(me, given.into, handed.settings)) or []
        me.ready()
        if sinks:
            _try(me, lambda: record(me, feed, sinks))
        for sink in reversed(sinks):
            _try(me, sink.close)
        while not (me.stopping or feed.over()):  # after a full disk; another file would not be better
            me.wait(1.0)


def _opened(me: Process, folder: Path, settings: Settings) -> list[Sink]:
    path = unused(folder / default_name())
    sinks = open_recording(path, settings, settings.cell)
    me.log.info("records to %s", path)
    return sinks


def _try(me: Process, action: Callable[[], Result]) -> Result | None:
    """The result; None, with a note for people, if the disk is full or the directory is gone."""
    try:
        return action()
    except OSError as error:
        me.note(f"nothing is recorded: {error}")
        return None


if __name__ == "__main__":
    main()
