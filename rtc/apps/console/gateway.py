"""The gateway process: one thread follows the cluster, one serves pages, one waits for the truth of a simulator.

A second process accepts the connections and answers halts (`halt_door`).

The main thread follows the cluster, and ends with it or at a signal. Everything a page sees is in the `Hub`, which
belongs to the event loop of the thread that serves pages.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import os
import socket as sockets
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import msgspec
import uvicorn

from rtc.apps.console import halt_door, token
from rtc.apps.console.access import Access
from rtc.apps.console.camera_pictures import CameraPictures
from rtc.apps.console.halt_door import HaltDoor, take_connections
from rtc.apps.console.halt_lines import HaltLines
from rtc.apps.console.hub import Hub
from rtc.apps.console.paced import PacedSocket, configured, taker
from rtc.apps.console.reopened import ReopenedClient
from rtc.apps.console.server import Console
from rtc.apps.console.truth import TruthReader
from rtc.apps.observers.feed import Feed
from rtc.client import aio
from rtc.language.parse import Grammar
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import ClusterError
from rtc.protocol.roles import Role
from rtc.runtime import process
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.process import Process, now_s
from rtc.runtime.settings import Settings

HOST = "127.0.0.1"

NICENESS = -5
TICK_S = 0.05
WAIT_S = 0.25
START_S = 10.0


class ConsoleOptions(NamedTuple):
    """What `rtc console` was called with."""

    endpoints: Endpoints
    make_client: Callable[[], aio.Client]
    cell: Cell
    grammar: str
    role: Role
    round_trip_s: float  # to the cluster


def listen(port: int, others: bool) -> sockets.socket:
    """A socket on this machine only. `others`: take any free port if this one is taken. Raises OSError."""
    made = sockets.socket(sockets.AF_INET, sockets.SOCK_STREAM)
    made.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
    try:
        made.bind((HOST, port))
    except OSError:
        if not others:
            made.close()
            raise
        made.bind((HOST, 0))
    made.listen(64)
    return made


def serve(me: Process, given: ConsoleOptions, listening: sockets.socket, opened: Callable[[str], None]) -> None:
    """Serve pages until `me.stopping` or the end of the cluster. `opened` gets the link."""
    port = listening.getsockname()[1]
    settings = given.endpoints if isinstance(given.endpoints, Settings) else None
    secret = token.of_run(settings.path, settings.run) if settings else token.of_run(None, "")
    access = Access(port, secret, given.role)
    process.nice(NICENESS)  # a person looks at its pages while workers compute
    process.nice_session(NICENESS)
    with _parts(given, access) as console:
        door = HaltDoor(_for_halts(given, access), listening)
        web = _Web(console, door.channel)
        reader = _reader(settings, console.hub, web)
        try:
            web.start()
            opened(f"http://{HOST}:{port}/#{access.token}")
            _follow(me, Feed(me, given.endpoints, world=True), console.hub, web, door)
        finally:
            if reader is not None:
                reader.close()
            web.stop()
            door.close()


def _for_halts(given: ConsoleOptions, access: Access) -> halt_door.HaltDoorOptions:
    arms = [arm.name for arm in given.cell.arms]
    stated = halt_door.HaltDoorOptions(access=access, arms=arms, round_trip_s=given.round_trip_s)
    if isinstance(given.endpoints, KeyFile):
        return msgspec.structs.replace(stated, key=given.endpoints)
    return msgspec.structs.replace(stated, settings=given.endpoints)


@contextlib.contextmanager
def _parts(given: ConsoleOptions, access: Access) -> Iterator[Console]:
    """What answers pages, with its halt lines and pictures."""
    endpoints = given.endpoints
    pictures = CameraPictures(endpoints.cell) if isinstance(endpoints, Settings) else None
    halts = HaltLines(endpoints, [arm.name for arm in given.cell.arms], given.round_trip_s)
    hello: dict[str, Any] = {"life": os.urandom(4).hex(), "role": given.role, "where": _where(endpoints)}
    hello |= {"delay_s": 0.5 * given.round_trip_s} if endpoints.far else {}
    hub = Hub(given.cell, now_s, hello)
    client, grammar = ReopenedClient(given.make_client), Grammar(given.grammar)
    try:
        yield Console(hub, access, halts, client, grammar, pictures, endpoints)
    finally:
        if pictures is not None:
            pictures.close()
        halts.close()


def _where(endpoints: Endpoints) -> str:
    return endpoints.address if isinstance(endpoints, KeyFile) else str(getattr(endpoints, "run_dir", ""))


class _Web:
    """The thread that serves pages. `call` runs a function in its event loop."""

    def __init__(self, console: Console, channel: sockets.socket) -> None:
        self._server, self._channel = uvicorn.Server(configured(console.app(), PacedSocket)), channel
        self._console = console
        self._reading: set[asyncio.Task[None]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="pages", daemon=True)

    def start(self) -> None:
        self._thread.start()
        if not self._started.wait(START_S):
            raise ClusterError("the console does not start")

    def call(self, function: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):  # it closes now
                self._loop.call_soon_threadsafe(function, *arguments)

    def stop(self) -> None:
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # answers that are cut off are no errors
        self._server.should_exit = True
        self._thread.join()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        ticking = asyncio.create_task(self._tick())
        take_connections(self._channel, taker(self._server.config, self._server.server_state))
        self._started.set()
        try:
            await self._server.serve(sockets=[])  # it listens nowhere: connections are handed over
        finally:
            ticking.cancel()
            await self._console.close()

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            self._console.hub.tick()

    def read_records(self, live: bool) -> None:
        """Called in the event loop."""
        task = asyncio.create_task(self._console.read_records(live))
        self._reading.add(task)
        task.add_done_callback(self._reading.discard)


def _reader(settings: Settings | None, hub: Hub, web: _Web) -> TruthReader | None:
    if settings is None:
        return None
    return TruthReader(
        settings,
        functools.partial(web.call, hub.take_truth),
        wanted=lambda: bool(hub.frames),
        moving=lambda: bool(hub.moving),
    )


def _follow(me: Process, feed: Feed, hub: Hub, web: _Web, door: HaltDoor) -> None:
    """Raises ClusterError if the process for halts has ended."""
    lost = 0
    web.call(web.read_records, False)
    while not me.stopping and not feed.over():
        if door.ended:
            raise ClusterError("the console ends, because its process for halts has; start rtc console again")
        if batch := list(feed.read(WAIT_S)):
            web.call(hub.take, batch)
        if feed.lost > lost:
            web.call(hub.story.take_lost, feed.lost - lost, now_s())
            lost = feed.lost
            web.call(web.read_records, True)
