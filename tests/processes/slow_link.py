"""A slow link to the gateway of a cluster: a thread passes what TCP carries, each part after a delay, and in order."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator

from rtc.protocol.roles import TCP_ENDPOINTS

MESSAGE = b"\x07MESSAGE"  # of CURVE: the handshake is over


class SlowLink:
    """Ports `near` and following lead to those at `far`. What precedes the first message of a connection has no delay:
    a handshake takes four more round trips, which no test needs to wait for."""

    def __init__(self, near: int, far: int, delay_s: float) -> None:
        self._near, self._far, self._delay_s = near, far, delay_s
        self._writers: set[asyncio.StreamWriter] = set()
        self._servers: list[asyncio.Server] = []
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._run(self._open())

    def cut(self) -> None:
        """All connections end, and no new one is made."""
        self._run(self._cut())

    def close(self) -> None:
        self.cut()
        self._run(self._end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _run(self, work) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(10.0)

    async def _open(self) -> None:
        for n in range(len(TCP_ENDPOINTS)):
            self._servers.append(await asyncio.start_server(self._accept(self._far + n), "127.0.0.1", self._near + n))

    async def _cut(self) -> None:
        for server in self._servers:
            server.close()
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    async def _end(self) -> None:
        tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _accept(self, port: int):
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                there, thither = await asyncio.open_connection("127.0.0.1", port)
            except OSError:
                writer.transport.abort()
                return
            self._writers |= {writer, thither}
            await asyncio.gather(self._pass_on(reader, thither), self._pass_on(there, writer))

        return serve

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        delay_s = 0.0
        with contextlib.suppress(OSError):
            while data := await reader.read(1 << 16):
                delay_s = self._delay_s if MESSAGE in data else delay_s
                self._loop.call_later(delay_s, _write, writer, data)
        self._loop.call_later(delay_s, writer.close)


def _write(writer: asyncio.StreamWriter, data: bytes) -> None:
    if not writer.is_closing():
        writer.write(data)


@contextlib.contextmanager
def slow_link(near: int, far: int, delay_s: float) -> Iterator[SlowLink]:
    made = SlowLink(near, far, delay_s)
    try:
        yield made
    finally:
        made.close()
