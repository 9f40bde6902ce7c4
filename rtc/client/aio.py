"""The client for asyncio: the methods of `rtc.Client`, to be awaited.

    from rtc import aio

    async with aio.Client() as client:
        lift = await client.submit("LIFT MACS-NEW BY 10 CM WITH RIGHT-ARM")
        async for note in lift.notes():
            print(note)
        (await lift.wait()).raise_for_outcome()

It has the same core as that class, `rtc.client.core`. A wait that is cancelled, or ends by its time limit, changes
nothing in motion: the command continues. Stop it by `halt`, which bypasses all queues here as well. Callbacks are
called in the event loop, except that of a halt.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import zmq.asyncio

from rtc.client import client as threaded
from rtc.client.core import ANSWER_S, Answer, OnProgress, Query, SubmittedCommand
from rtc.client.halt import HaltResult, OnRest
from rtc.client.rehearsing import AboutTest, following, rehearsals
from rtc.client.session import ClientSession
from rtc.client.subscription import subscribed
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, RtcError, TimedOut, WireError
from rtc.protocol.wire import reader

Result = TypeVar("Result")
Published = TypeVar("Published")


class CommandHandle(SubmittedCommand):
    """One command of a client, from `Client.submit`. `number`: C-n. Use it in the client's event loop."""

    def __init__(self, client: Client, text: str, changed: asyncio.Event, on_progress: OnProgress | None) -> None:
        """`changed` is set with each note, number and end, and when the cluster is lost."""

        def take_note(note: m.ProgressNote) -> None:
            self._notes.append(note)
            changed.set()
            if on_progress is not None:
                asyncio.get_running_loop().call_soon(on_progress, note)  # its errors are not those of this client

        super().__init__(text, take_note, lambda _: changed.set(), lambda _: client.end(changed))
        self._client, self._changed = client, changed
        self._notes: deque[m.ProgressNote] = deque()

    @property
    def progress(self) -> m.ProgressNote | None:
        """Its latest note."""
        return self.latest_note

    @property
    def ended(self) -> m.CommandEnded | None:
        """Its end; None while it is in progress."""
        return self.known_end

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

    async def wait_for_answer(self) -> None:
        """Until it is accepted. Raises RequestDeclined if it is not."""
        while not self.answered:
            await self._change()
        self.raise_if_declined()


class Client:
    """A connection to one cluster, as an async context manager. Arguments and errors are those of `rtc.Client`."""

    def __init__(self, run_dir: str | Path | None = None, *, need_broker: bool = True, **options: Any) -> None:
        self._run_dir, self._need_broker, self._options = run_dir, need_broker, options
        self._blocking = ThreadPoolExecutor(1, "rtc client")
        self._blocking_client: threaded.Client | None = None  # of that thread
        self._lost: RtcError | None = None
        self._waiting: set[asyncio.Event] = set()  # of unfinished commands and queries
        self._exchanged = asyncio.Event()
        self._soon: asyncio.Handle | None = None  # the next exchange
        self._later: asyncio.TimerHandle | None = None  # the one after a silence

    async def __aenter__(self) -> Client:
        self._loop = asyncio.get_running_loop()
        self._session = ClientSession(self._run_dir, need_broker=False, **self._options)
        self._core = self._session.core
        for descriptor in self._session.connection.descriptors:
            self._loop.add_reader(descriptor, self._exchange)
        try:
            while self._need_broker and self._core.welcome is None:
                self._exchanged.clear()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._core.hello_wait_s(time.monotonic())):
                        await self._exchanged.wait()
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        for descriptor in self._session.connection.descriptors:
            self._loop.remove_reader(descriptor)
        for due in (self._soon, self._later):
            if due is not None:
                due.cancel()
        await asyncio.to_thread(self._close)

    # --- sentences --------------------------------------------------------------------------------------

    async def submit(self, text: str, **how: Any) -> CommandHandle:
        """Submit one sentence; its handle, after the cluster has journalled it. `how`: as in `rtc.Client.submit`.

        Raises RequestDeclined if the cluster does not accept it, TimedOut if it does not answer.
        """
        handle = self._begin(text, **how)
        await self._within(ANSWER_S, "the sentence was not accepted", handle.wait_for_answer())
        return handle

    async def run(self, text: str, timeout_s: float | None = None, **how: Any) -> m.CommandEnded:
        """Submit one sentence and wait for its outcome. Raises TimedOut after `timeout_s`; the command continues."""
        return await self._begin(text, **how).wait(timeout_s)

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
        return await asyncio.to_thread(self._session.halt, scope, timeout_s, on_rest)

    def halt_ready(self) -> bool:
        """True once the halt sockets of broker and MCM are both connected."""
        return self._session.halt_ready()

    async def call(self, function: Callable[[threaded.Client], Result]) -> Result:
        """The result of a function of an `rtc.Client`, in a thread: `await client.call(lambda c: c.world.view())`.
        Other calls of this method wait meanwhile."""
        self.raise_if_lost()
        return await self._loop.run_in_executor(self._blocking, self._call, function)

    async def status(self) -> m.Status:
        """Processes, workers, queues, resources, commands (see docs/protocol.md)."""
        return (await self._ask(m.StatusQuery(request=self._session.next_request()), m.StatusReply)).status

    async def trace(self, command: str) -> m.CommandRecord:
        """The record of a command. Raises RequestDeclined for an unknown command."""
        query = m.TraceQuery(request=self._session.next_request(), command=command.upper())
        return (await self._ask(query, m.TraceReply)).record

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

    def _begin(
        self,
        text: str,
        *,
        on_progress: OnProgress | None = None,
        progress: bool = True,
        traceparent: str = "",
        saved: m.SavedWorld | None = None,
        **about: str,
    ) -> CommandHandle:
        """Send one sentence. `about`: the fields of an AboutTest."""
        self.raise_if_lost()
        changed = asyncio.Event()
        handle = CommandHandle(self, text, changed, on_progress)
        wanted = progress or on_progress is not None
        self._session.send(handle, progress=wanted, traceparent=traceparent, about=AboutTest(**about), saved=saved)
        self._waiting.add(changed)
        self._exchange_soon()
        return handle

    async def _ask(self, message: Any, kind: type[Answer], within_s: float = ANSWER_S) -> Answer:
        self.raise_if_lost()
        changed = asyncio.Event()
        query = Query(message, kind, within_s, changed.set)
        self._core.ask(query, time.monotonic())
        self._waiting.add(changed)
        self._exchange_soon()
        try:
            await self._within(within_s, "the broker did not answer", changed.wait())
            self.raise_if_lost()
            return query.result
        finally:
            self._waiting.discard(changed)
            self._core.forget(query)

    async def _within(self, seconds: float, otherwise: str, waiting: Awaitable[object]) -> None:
        """Wait, and for the round trip in addition. Raises TimedOut with the text `otherwise`."""
        try:
            await asyncio.wait_for(waiting, seconds + self._session.round_trip_s)
        except TimeoutError:
            raise TimedOut(f"{otherwise} (waited {seconds:.1f} s)") from None

    def _subscribe(self, endpoint: str, read: Callable[[Sequence[bytes]], Published]) -> AsyncIterator[Published]:
        return _each(subscribed(self._session.context, self._session.endpoints, endpoint), read)

    def end(self, changed: asyncio.Event) -> None:
        """Called by a command that has ended: nothing more is awaited."""
        changed.set()
        self._waiting.discard(changed)

    def _exchange_soon(self) -> None:
        """After what is done now, so that requests of several tasks travel together."""
        if self._soon is None:
            self._soon = self._loop.call_soon(self._exchange)

    def _exchange(self) -> None:
        """Send and take what is there. Again when a socket is readable, or after a silence."""
        for due in (self._soon, self._later):
            if due is not None:
                due.cancel()
        self._soon = self._later = None
        try:
            self._session.connection.exchange()
            self._core.check()
        except RtcError as error:
            self._lost = error
            for changed in self._waiting:
                changed.set()
        self._exchanged.set()
        if self._lost is None and (wait_s := self._core.wait_s(time.monotonic())) < math.inf:
            self._later = self._loop.call_later(wait_s, self._exchange)

    def _call(self, function: Callable[[threaded.Client], Result]) -> Result:
        if self._blocking_client is None:
            options = {name: value for name, value in self._options.items() if name != "on_silence"}
            self._blocking_client = threaded.Client(self._run_dir, need_broker=self._need_broker, **options)
        return function(self._blocking_client)

    def _close(self) -> None:
        if self._blocking_client is not None:
            self._blocking.submit(self._blocking_client.close)
        self._blocking.shutdown()
        self._session.close()


async def _each(raw: zmq.Socket[bytes], read: Callable[[Sequence[bytes]], Published]) -> AsyncIterator[Published]:
    with raw:
        socket = zmq.asyncio.Socket.from_socket(raw)
        while True:
            try:
                yield read(await socket.recv_multipart())
            except WireError:
                continue  # of a newer version
