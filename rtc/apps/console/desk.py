"""A thread with a client of its own, because a client belongs to one thread: the event loop hands it its work."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from rtc.client.client import Client
from rtc.protocol.outcomes import NoCluster, RtcError

WAIT_S = 0.05  # longest time until the messages of the broker are taken

Found = TypeVar("Found")
Job = tuple[Callable[[Client], Any], "Future[Any]"]


class Desk:
    """Performs functions of a client, one after the other. `connect` makes the client; again if its cluster is gone."""

    def __init__(self, name: str, connect: Callable[[], Client]) -> None:
        self._connect = connect
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._client: Client | None = None
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    async def ask(self, work: Callable[[Client], Found]) -> Found:
        """The result of `work`. Raises what it raises, and NoCluster."""
        return await asyncio.wrap_future(self.submit(work))

    def submit(self, work: Callable[[Client], Found]) -> Future[Found]:
        future: Future[Found] = Future()
        self._jobs.put((work, future))
        return future

    def close(self) -> None:
        self._jobs.put(None)
        self._thread.join()

    def _serve(self) -> None:
        while True:
            try:
                job = self._jobs.get(timeout=WAIT_S)
            except queue.Empty:
                if self._client is not None:
                    self._client.receive()
                continue
            if job is None:
                break
            self._perform(*job)
        if self._client is not None:
            self._client.close()

    def _perform(self, work: Callable[[Client], Any], future: Future[Any]) -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            if self._client is None:
                self._client = self._connect()
            future.set_result(work(self._client))
        except Exception as error:
            future.set_exception(error)
            if isinstance(error, NoCluster) and self._client is not None:
                with contextlib.suppress(RtcError):
                    self._client.close()
                self._client = None
