"""A bound on what is read from one page's socket: a page that floods waits, and the others have their turn.

Without a bound one read takes 256 KiB, which may be 40,000 frames: the event loop does nothing else for a second.
A page that is well sends 40 messages of 200 bytes per second and arm that is moved by hand; the bound is 25 KB/s.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable
from functools import partial
from typing import Any

from uvicorn import Config
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from uvicorn.server import ServerState

PERIOD_S = 0.02
MAX_UNREAD = 1 << 20  # bytes of answers that a page does not read; then its socket is closed
MAX_MESSAGE = 64 << 10


class PacedSocket(WebSocketsSansIOProtocol):
    """Reads about `bytes_per_period` of one socket, then nothing until the period is over."""

    bytes_per_period = 512

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._read, self._until_s, self._waits = 0, 0.0, False
        transport.max_size = self.bytes_per_period  # type: ignore[attr-defined]  # of one read

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.transport.get_write_buffer_size() > MAX_UNREAD:
            return self.transport.abort()
        now_s = self.loop.time()
        if now_s > self._until_s:
            self._read, self._until_s = 0, now_s + PERIOD_S
        self._read += len(data)
        if self._read >= self.bytes_per_period and not self._waits:
            self._waits = True
            self.transport.pause_reading()
            self.loop.call_at(self._until_s, self._go_on)
        return None

    async def receive(self) -> Any:
        await asyncio.sleep(0)  # others have their turn after each message, also if more have been read already
        message = await super().receive()
        if self._waits:
            self.transport.pause_reading()  # it has just been resumed
        return message

    def _go_on(self) -> None:
        self._waits = False
        if not self.read_paused and not self.transport.is_closing():
            self.transport.resume_reading()


class PacedHaltSocket(PacedSocket):
    """A page that is well sends two short messages per second here."""

    bytes_per_period = 256


def configured(app: Any, socket_class: type[PacedSocket]) -> Config:
    """For connections that are handed over; frames are not compressed, because they do not leave this machine."""
    logging.getLogger("asyncio").setLevel(logging.ERROR)  # else each answer to a page that has just gone is a warning
    config = Config(
        app,
        ws=socket_class,
        log_level="warning",
        access_log=False,
        ws_max_size=MAX_MESSAGE,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
        lifespan="off",
    )
    config.load()
    return config


def taker(config: Config, state: ServerState) -> Callable[[socket.socket], None]:
    """A function that serves a connection which has been accepted; it is called in the event loop."""
    loop = asyncio.get_running_loop()
    protocol: Any = config.http_protocol_class
    made: Callable[[], Any] = partial(protocol, config=config, server_state=state, app_state={}, _loop=loop)
    opening: set[asyncio.Task[Any]] = set()

    def take(connection: socket.socket) -> None:
        task = asyncio.create_task(_open(made, connection))
        opening.add(task)
        task.add_done_callback(opening.discard)

    return take


async def _open(made: Callable[[], Any], connection: socket.socket) -> None:
    try:
        await asyncio.get_running_loop().connect_accepted_socket(made, connection)
    except OSError:  # the page has gone
        connection.close()
