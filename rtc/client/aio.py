"""The client for asyncio: the methods of `rtc.Client`, to be awaited.

    from rtc import aio

    async with aio.Client() as client:
        lift = await client.submit("LIFT MACS-NEW BY 10 CM WITH RIGHT-ARM")
        async for note in lift.notes():
            print(note)
        (await lift.wait()).raise_for_outcome()

A thread has the `rtc.Client`. Calls are passed to it, and their results back; so commands, queries and callbacks are
those of that class. A wait that is cancelled, or ends by its time limit, changes nothing in motion: the command
continues. Stop it by `halt`, which bypasses all queues here as well.
"""

from __future__ import annotations

import asyncio
import os
import select
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import zmq.asyncio

from rtc.client import client as threaded
from rtc.client.halt import HaltResult, OnRest
from rtc.client.handle import CommandHandle as ThreadedHandle
from rtc.client.rehearsing import following, rehearsals
from rtc.client.subscription import subscribed
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, RequestDeclined, RtcError, TimedOut, WireError
from rtc.protocol.wire import reader

Result = TypeVar("Result")
Published = TypeVar("Published")
Job = tuple[asyncio.Future[Any], Callable[[threaded.Client], Any]]


class CommandHandle:
    """One command of a client, from `Client.submit`. `number`: C-n. Use it in the client's event loop."""

    def __init__(self, client: Client, text: str) -> None:
        self.text = text
        self.number = ""
        self.progress: m.ProgressNote | None = None  # its latest note
        self.ended: m.CommandEnded | None = None  # None while it is in progress
        self._client = client
        self._changed = asyncio.Event()
        self._notes: deque[m.ProgressNote] = deque()

    @property
    def outcome(self) -> Outcome | None:
        """How it ended; None while it is in progress."""
        return None if self.ended is None else self.ended.outcome

    async def wait(self, timeout_s: float | None = None) -> m.CommandEnded:
        """Its end, as often as called. Raises TimedOut if it does not end in time; it then continues. Raises the error
        of a lost cluster."""
        try:
            async with asyncio.timeout(timeout_s):
                while self.ended is None:
                    await self._change()
        except TimeoutError:
            raise TimedOut(f"{self.number} has not ended; it continues (waited {timeout_s} s)") from None
        return self.ended

    async def raise_for_outcome(self, timeout_s: float | None = None) -> m.CommandEnded:
        """Wait for its end. Raises NotSucceeded unless it succeeded, and as `wait` does."""
        return (await self.wait(timeout_s)).raise_for_outcome()

    async def notes(self) -> AsyncIterator[m.ProgressNote]:
        """Its notes from the first one, until it has ended. For one reader."""
        while True:
            while self._notes:
                yield self._notes.popleft()
            if self.ended is not None:
                return
            await self._change()

    async def halt(self, timeout_s: float = 2.0) -> HaltResult:
        """Stop this command now, past all queues."""
        return await self._client.halt(self.number, timeout_s)

    async def pause(self) -> None:
        """Stop on its path and wait there. Raises NotSucceeded, for example if it has ended."""
        await self._control("PAUSE")

    async def resume(self) -> None:
        """Continue after `pause`. Raises as `pause` does."""
        await self._control("RESUME")

    async def abort(self) -> None:
        """End it; its end is ABORTED. Raises as `pause` does."""
        await self._control("ABORT")

    async def _control(self, verb: str) -> None:
        (await self._client.run(f"{verb} {self.number}")).raise_for_outcome()

    async def _change(self) -> None:
        """Wait for the next note, number or end. Raises the error of a lost cluster."""
        self._client.raise_if_lost()
        self._changed.clear()
        await self._changed.wait()

    # --- called by the client, in the event loop --------------------------------------------------------

    async def answered(self) -> None:
        while not self.number and self.ended is None:
            await self._change()

    def take(self, number: str, ended: m.CommandEnded | None) -> None:
        self.number, self.ended = number, ended
        self.wake()

    def take_note(self, note: m.ProgressNote) -> None:
        if note.seq:
            self.progress = note
        self._notes.append(note)
        self.wake()

    def wake(self) -> None:
        self._changed.set()


class Client:
    """A connection to one cluster, as an async context manager. Arguments and errors are those of `rtc.Client`."""

    def __init__(self, run_dir: str | Path | None = None, **options: Any) -> None:
        self._arguments, self._options = run_dir, options
        self._jobs: deque[Job] = deque()
        self._closing = False
        self._lost: RtcError | None = None
        self._handles: set[CommandHandle] = set()  # of commands that have not ended

    async def __aenter__(self) -> Client:
        self._loop = asyncio.get_running_loop()
        self._waker = os.eventfd(0)
        opened: asyncio.Future[threaded.Client] = self._loop.create_future()
        self._thread = threading.Thread(target=self._serve, args=(opened,), name="rtc client", daemon=True)
        self._thread.start()
        try:
            self._client = await opened
        except BaseException:
            await self._end()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._end()

    # --- sentences --------------------------------------------------------------------------------------

    async def submit(self, text: str, **how: Any) -> CommandHandle:
        """Submit one sentence; its handle, after the cluster has journalled it. `how`: as in `rtc.Client.begin`.

        Raises RequestDeclined if the cluster does not accept it.
        """
        handle = await self._begin(text, how)
        await handle.answered()
        if handle.ended is not None and not handle.number:
            refusal = handle.ended.outcome.refusal
            assert refusal is not None
            raise RequestDeclined(refusal)
        return handle

    async def run(self, text: str, timeout_s: float | None = None, **how: Any) -> m.CommandEnded:
        """Submit one sentence and wait for its outcome. Raises TimedOut after `timeout_s`; the command continues."""
        return await (await self._begin(text, how)).wait(timeout_s)

    async def run_many(self, texts: Sequence[str], timeout_s: float | None = None) -> list[m.CommandEnded]:
        """Submit all sentences at once and wait; outcomes in their order. Raises as `run` does."""
        return list(await asyncio.gather(*(self.run(text, timeout_s) for text in texts)))

    async def test(
        self, texts: Sequence[str], labels: Sequence[str] = (), *, keep_going: bool = False
    ) -> list[m.CommandEnded]:
        """Test sentences on paper: nothing moves, and nothing is written (`rtc.client.rehearsing`)."""
        found: list[m.CommandEnded] = []
        asking = rehearsals(texts, labels, keep_going=keep_going)
        asked = next(asking, None)
        while asked is not None:
            found.append(await self.run(asked.text, after_test=asked.after_test, label=asked.label))
            asked = following(asking, found[-1])
        return found

    # --- stopping, looking -------------------------------------------------------------------------------

    async def halt(self, scope: str = "ALL", timeout_s: float = 2.0, on_rest: OnRest | None = None) -> HaltResult:
        """Stop motion now, as `rtc.Client.halt`. A halt that has been called is sent, also if the wait is cancelled.
        `on_rest` is called in another thread."""
        return await asyncio.to_thread(self._client.halt, scope, timeout_s, on_rest)

    def halt_ready(self) -> bool:
        """True once the halt sockets of broker and MCM are both connected."""
        return self._client.halt_ready()

    async def call(self, function: Callable[[threaded.Client], Result]) -> Result:
        """The result of a function of the `rtc.Client`, in its thread: `await client.call(lambda c: c.world.view())`.
        Other calls wait meanwhile, but no halt."""
        self.raise_if_lost()
        future: asyncio.Future[Result] = self._loop.create_future()
        self._jobs.append((future, function))
        os.eventfd_write(self._waker, 1)
        return await future

    async def status(self) -> m.Status:
        """Processes, workers, queues, resources, commands (see docs/protocol.md)."""
        return await self.call(lambda client: client.status())

    async def trace(self, command: str) -> m.CommandRecord:
        """The record of a command. Raises RequestDeclined for an unknown command."""
        return await self.call(lambda client: client.trace(command))

    async def load(self, kind: str, file: str | Path) -> m.ProgramLoaded:
        """Load a program file into the running cluster. Raises RequestDeclined if it is invalid."""
        return await self.call(lambda client: client.load(kind, file))

    def events(self) -> AsyncIterator[m.ProgressNote | m.CommandEnded]:
        """Progress and ends of all commands of all clients, from the first `await` on. Endless."""
        return self._subscribe("events", reader(m.ProgressNote | m.CommandEnded))

    def telemetry(self) -> AsyncIterator[m.Telemetry]:
        """Joints, wrench, tcp pose and hand width of every arm, as the MCM publishes them. Endless."""
        return self._subscribe("telemetry", reader(m.Telemetry))

    def raise_if_lost(self) -> None:
        """Raises the error with which the cluster was lost, if it was."""
        if self._lost is not None:
            raise self._lost

    # --- inside -----------------------------------------------------------------------------------------

    async def _begin(self, text: str, how: dict[str, Any]) -> CommandHandle:
        handle, on_progress = CommandHandle(self, text), how.pop("on_progress", None)
        self._handles.add(handle)

        def noted(note: m.ProgressNote) -> None:
            self._soon(handle.take_note, note)
            if on_progress is not None:
                self._soon(on_progress, note)

        def begin(client: threaded.Client) -> ThreadedHandle:
            begun: ThreadedHandle = client.begin(
                text, on_progress=noted, on_change=lambda: self._soon(self._taken, handle, begun), **how
            )
            client.receive()  # sends it
            return begun

        await self.call(begin)
        return handle

    def _taken(self, handle: CommandHandle, begun: ThreadedHandle) -> None:
        handle.take(begun.number, begun.known_end)
        if handle.ended is not None:
            self._handles.discard(handle)

    def _subscribe(self, endpoint: str, read: Callable[[Sequence[bytes]], Published]) -> AsyncIterator[Published]:
        raw = subscribed(self._client.context, self._client.endpoints, endpoint)
        return _each(raw, read)

    async def _end(self) -> None:
        self._closing = True
        os.eventfd_write(self._waker, 1)
        await asyncio.to_thread(self._thread.join)
        os.close(self._waker)

    # --- in the thread ------------------------------------------------------------------------------------

    def _serve(self, opened: asyncio.Future[threaded.Client]) -> None:
        try:
            client = threaded.Client(self._arguments, **self._options)
        except Exception as error:  # raised where the client is opened
            self._soon(_fail, opened, error)
            return
        client.wake_by(self._waker)
        self._soon(_finish, opened, client)
        with client:
            while not self._closing:
                while self._jobs:
                    self._perform(client, *self._jobs.popleft())
                try:
                    client.receive_until(lambda: self._jobs or self._closing, None, "")
                except RtcError as error:
                    self._soon(self._lose, error)
                    select.select([self._waker], [], [])
                    os.eventfd_read(self._waker)

    def _perform(
        self, client: threaded.Client, future: asyncio.Future[Any], job: Callable[[threaded.Client], Any]
    ) -> None:
        try:
            result = job(client)
        except Exception as error:  # raised where it was awaited
            self._soon(_fail, future, error)
        else:
            self._soon(_finish, future, result)

    def _lose(self, error: RtcError) -> None:
        self._lost = error
        for handle in self._handles:
            handle.wake()

    def _soon(self, function: Callable[..., object], *arguments: object) -> None:
        """Call a function in the event loop; nothing if that has ended."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)


async def _each(raw: zmq.Socket[bytes], read: Callable[[Sequence[bytes]], Published]) -> AsyncIterator[Published]:
    with raw:
        socket = zmq.asyncio.Socket.from_socket(raw)
        while True:
            try:
                yield read(await socket.recv_multipart())
            except WireError:
                continue  # of a newer version


def _finish(future: asyncio.Future[Any], result: object) -> None:
    if not future.done():
        future.set_result(result)


def _fail(future: asyncio.Future[Any], error: Exception) -> None:
    if not future.done():
        future.set_exception(error)
