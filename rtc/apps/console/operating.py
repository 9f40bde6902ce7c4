"""The stream of one page's operator to the arms: each message goes on at once, and each answer goes back to the page.

It invents nothing: the page names the grant and the newest time of the subsystem that it has received, so a page that
lags behind is refused as stale there. When the page has gone, what it held is let go. For one event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import zmq
import zmq.asyncio

from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError
from rtc.runtime.keys import Endpoints
from rtc.runtime.settings import BOUNDS

_read = wire.reader(m.OperateReply)
Answered = Callable[[dict[str, Any]], Awaitable[None]]


class OperatorStream:
    """One page. `operator`: its name, for people; `answered` gets what a subsystem has done with a message."""

    def __init__(self, endpoints: Endpoints, cell: Cell, operator: str, answered: Answered) -> None:
        self._endpoints, self._cell, self._operator, self._answered = endpoints, cell, operator, answered
        self._context = zmq.asyncio.Context()
        self._sockets: dict[str, zmq.asyncio.Socket] = {}  # subsystem -> its socket
        self._readers: set[asyncio.Task[None]] = set()
        self._held: dict[str, m.Operate] = {}  # arm -> the latest message with `hold`

    async def send(self, arm: str, wanted: dict[str, Any]) -> None:
        """Pass on one message of the page; an invalid one is answered."""
        try:
            message = msgspec.convert({**wanted, "operator": self._operator}, m.Operate)
            subsystem = self._cell.subsystem_of(arm)
        except (msgspec.ValidationError, KeyError) as error:
            return await self._answered({"arm": arm, "refused": str(error), "cut": ""})
        if message.hold:
            self._held[arm] = message
        else:
            self._held.pop(arm, None)
        return await self._pass_on(subsystem, arm, message)

    async def close(self) -> None:
        """Let go of what is held."""
        for arm, message in self._held.items():
            released = m.Operate(primitive=message.primitive, operator=self._operator, seen_at_s=message.seen_at_s)
            with contextlib.suppress(zmq.ZMQError):
                await self._pass_on(self._cell.subsystem_of(arm), arm, released)
        for task in self._readers:
            task.cancel()
        await asyncio.gather(*self._readers, return_exceptions=True)
        for socket in self._sockets.values():
            socket.close(linger=50)
        self._context.term()

    async def _pass_on(self, subsystem: str, arm: str, message: m.Operate) -> None:
        if subsystem not in self._sockets:
            self._open(subsystem, arm)
        try:
            await self._sockets[subsystem].send_multipart(wire.frames(message), flags=zmq.NOBLOCK)
        except zmq.Again:
            await self._answered({"arm": arm, "refused": f"{subsystem} does not answer", "cut": ""})

    def _open(self, subsystem: str, arm: str) -> None:
        socket = self._context.socket(zmq.DEALER)
        socket.setsockopt(zmq.MAXMSGSIZE, wire.MAX_BYTES)
        socket.setsockopt(zmq.SNDHWM, BOUNDS["operate"].unread)
        socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms
        self._endpoints.secure(socket)
        addresses = self._endpoints.addresses("operate")
        socket.connect(addresses.get(subsystem) or addresses[""])  # over tcp that of the first subsystem
        self._sockets[subsystem] = socket
        task = asyncio.create_task(self._read_answers(socket, arm))
        self._readers.add(task)

    async def _read_answers(self, socket: zmq.asyncio.Socket, arm: str) -> None:
        while True:
            with contextlib.suppress(WireError):
                answer = _read(await socket.recv_multipart())
                found = {"arm": arm, "at_s": answer.at_s, "refused": answer.refused, "cut": answer.cut}
                await self._answered(found)
