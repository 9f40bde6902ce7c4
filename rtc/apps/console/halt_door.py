"""The process that accepts the connections of pages and answers their halts; all others it hands on to the gateway.

Halts have a process, an event loop and, if permitted, a real-time priority of their own. So no halt waits for what
pages send to the gateway, for what the gateway computes, or for other programs on a busy machine. The first bytes of a
connection say whether it wants /halt; the descriptor of any other goes to the gateway unread. It ends with the gateway.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.server import ServerState

from rtc.apps.console.access import Access, body, objects
from rtc.apps.console.access_check import AccessCheck
from rtc.apps.console.halt_lines import HaltLines, OnNews
from rtc.apps.console.paced import PacedHaltSocket, configured, taker
from rtc.protocol import messages as m
from rtc.runtime import process
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.settings import Settings

RANK, NICENESS = 1, -10  # as the broker, below the MCM
FIRST = 12  # bytes; a request line is longer
WANTS_HALT = (b"GET /halt ", b"POST /halt ")
UNDECIDED_S = 5.0  # a connection that has not stated by then what it wants is closed
PER_TURN = 16  # connections that are accepted before others have their turn
AGAIN_S = 0.1  # after accepting has failed, such as without free descriptors
END_S = 3.0


class HaltDoorOptions(msgspec.Struct, frozen=True, kw_only=True):
    """What the process needs. One of `settings` and `key` is set."""

    access: Access
    arms: list[str]
    round_trip_s: float
    settings: Settings | None = None
    key: KeyFile | None = None


class HaltDoor:
    """The gateway's side: starts and ends the process. `channel` yields the connections of pages."""

    def __init__(self, given: HaltDoorOptions, listening: socket.socket) -> None:
        self.channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        descriptors = (listening.fileno(), theirs.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "rtc.apps.console.halt_door", *map(str, descriptors)],
            stdin=subprocess.PIPE,
            pass_fds=descriptors,
            process_group=0,  # Ctrl-C is the gateway's; it ends when the channel does, also if the gateway is killed
        )
        theirs.close()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError), self._process.stdin as stdin:
            stdin.write(msgspec.json.encode(given))

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def close(self) -> None:
        self.channel.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


# --- the process -----------------------------------------------------------------------------------------


def app(access: Access, halts: HaltLines) -> Starlette:
    """POST /halt and the socket /halt, for pages that are admitted."""

    async def order(scope: str, on_news: OnNews | None = None) -> dict[str, Any]:
        if refused := access.refuses("halt", m.HaltOrder):
            return {"error": refused.message}
        return await halts.order(scope, on_news)

    async def post(request: Request) -> Response:
        given = await body(request)
        found = await order(str(given.get("scope", "ALL")))
        return JSONResponse(found, headers={"Connection": "close"})  # the browser must not ask for a picture here

    async def serve(page: WebSocket) -> None:
        """Each order is a task of its own, so that the next one does not wait for the rest of the first."""
        orders: set[asyncio.Task[None]] = set()

        async def obey(asked: dict[str, Any]) -> None:
            number, news = asked.get("id"), list[asyncio.Task[None]]()

            def report(rests: dict[str, Any]) -> None:
                news.append(asyncio.create_task(answer(page, {"id": number, "rests": rests})))

            result = await order(str(asked.get("scope", "ALL")), report)
            await asyncio.gather(*news)
            await answer(page, {"id": number, "result": result})

        await page.accept()
        async for asked in objects(page):
            if "ping" in asked:
                await answer(page, {"pong": asked["ping"]})
                continue
            task = asyncio.create_task(obey(asked))
            orders.add(task)
            task.add_done_callback(orders.discard)

    admission = Middleware(AccessCheck, port=access.port, token=access.token, cookie=access.cookie)
    return Starlette(
        middleware=[admission], routes=[Route("/halt", post, methods=["POST"]), WebSocketRoute("/halt", serve)]
    )


async def answer(page: WebSocket, message: dict[str, Any]) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the page is gone; the halt is done
        await page.send_json(message)


class Sorter:
    """Accepts connections; `here` serves one that wants a halt, the channel takes the others."""

    def __init__(self, listening: socket.socket, channel: socket.socket, here: Callable[[socket.socket], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._listening, self._channel, self._here = listening, channel, here
        listening.setblocking(False)
        channel.setblocking(False)
        self._listen()

    def _listen(self) -> None:
        self._loop.add_reader(self._listening, self._accept)

    def _accept(self) -> None:
        for _ in range(PER_TURN):
            try:
                connection, _ = self._listening.accept()
            except BlockingIOError:
                return
            except OSError:
                self._loop.remove_reader(self._listening)
                self._loop.call_later(AGAIN_S, self._listen)
                return
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, FIRST)
            limit = self._loop.call_later(UNDECIDED_S, self._drop, connection)
            self._loop.add_reader(connection, self._sort, connection, limit)

    def _sort(self, connection: socket.socket, limit: asyncio.TimerHandle) -> None:
        self._loop.remove_reader(connection)
        limit.cancel()
        try:
            first = connection.recv(FIRST, socket.MSG_PEEK)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVLOWAT, 1)
            if first.startswith(WANTS_HALT):
                return self._here(connection)
            if first:
                socket.send_fds(self._channel, [b"c"], [connection.fileno()])
        except OSError:  # it is gone, or the gateway has more to do than it can
            pass
        return connection.close()

    def _drop(self, connection: socket.socket) -> None:
        self._loop.remove_reader(connection)
        connection.close()


def take_connections(channel: socket.socket, take: Callable[[socket.socket], None]) -> None:
    """In the gateway's event loop: serve what the process hands on, until the channel ends."""
    loop = asyncio.get_running_loop()
    channel.setblocking(False)

    def receive() -> None:
        for _ in range(PER_TURN):
            try:
                data, descriptors, _, _ = socket.recv_fds(channel, 1, 1)
            except BlockingIOError:
                return
            except OSError:
                data, descriptors = b"", []
            if not data:
                loop.remove_reader(channel)
                return
            for descriptor in descriptors:
                take(socket.socket(fileno=descriptor))

    loop.add_reader(channel, receive)


async def _serve(given: HaltDoorOptions, halts: HaltLines, listening: socket.socket, channel: socket.socket) -> None:
    config = configured(app(given.access, halts), PacedHaltSocket)
    Sorter(listening, channel, taker(config, ServerState()))
    over = asyncio.Event()
    asyncio.get_running_loop().add_reader(channel, over.set)  # nothing comes through it but its end
    await over.wait()
    os._exit(0)  # orders under way have been sent; nothing waits for their results


def _raise_priority() -> None:
    """Of this thread and those that it starts."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(RANK))
    except OSError:
        process.nice(NICENESS)
        process.nice_session(NICENESS)


def main() -> None:
    listening, channel = (socket.socket(fileno=int(one)) for one in sys.argv[1:])
    given = msgspec.json.decode(sys.stdin.buffer.read(), type=HaltDoorOptions)
    process.log_to_stderr()
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    endpoints: Endpoints | None = given.settings or given.key
    assert endpoints is not None
    _raise_priority()
    halts = HaltLines(endpoints, given.arms, given.round_trip_s)
    asyncio.run(_serve(given, halts, listening, channel))


if __name__ == "__main__":
    main()
