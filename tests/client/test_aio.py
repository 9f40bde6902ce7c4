"""`rtc.aio.Client`: the tests of the other client, and what only awaiting has."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
import zmq

from rtc import aio
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, OutcomeKind
from rtc.protocol.wire import frames
from rtc.runtime.settings import Settings
from tests.client import test_client
from tests.client.test_client import (  # noqa: F401  collected here too
    SmallBroker,
    accepting,
    broker,
    ended,
    obliging,
    run_dir,
    test_a_broker_of_another_version_is_refused,
    test_a_broker_that_listens_and_says_nothing_is_no_cluster,
    test_a_client_closes_although_its_broker_is_gone_for_good,
    test_a_client_of_the_same_name_has_requests_of_its_own,
    test_a_command_that_does_not_end_in_time_is_reported_and_goes_on,
    test_a_declined_sentence_is_an_exception_of_submit_and_a_refusal_of_run,
    test_a_halt_goes_to_broker_and_mcm_with_one_name,
    test_a_handle_halts_its_own_command,
    test_a_new_broker_receives_the_same_requests_again,
    test_a_question_too_many_is_asked_again,
    test_an_unknown_command_has_no_trace,
    test_bytes_that_are_no_text_travel_as_a_mark,
    test_control_of_a_command_that_is_refused_raises,
    test_no_cluster_is_reported_within_a_second_with_what_to_do,
    test_run_gives_the_outcome_and_tells_the_progress,
    test_submit_then_wait,
)

LIMIT_S = 5.0


class Blocking:
    """What the tests of the other client call, by one await each."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._runner = asyncio.Runner()
        try:
            self._own = self._await(aio.Client(*arguments, **options).__aenter__())
        except BaseException:
            self._runner.close()
            raise

    def __enter__(self) -> Blocking:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._await(self._own.__aexit__())
        self._runner.close()

    def submit(self, text: str, **how: Any) -> BlockingHandle:
        return BlockingHandle(self._await, self._await(self._own.submit(text, **how)))

    def __getattr__(self, name: str) -> Callable[..., Any]:
        found = getattr(self._own, name)
        if not asyncio.iscoroutinefunction(found):
            return found
        return lambda *arguments, **options: self._await(found(*arguments, **options))

    def _await(self, what: Coroutine[Any, Any, Any]) -> Any:
        return self._runner.run(what)


class BlockingHandle:
    def __init__(self, wait_for: Callable[[Coroutine[Any, Any, Any]], Any], own: aio.CommandHandle) -> None:
        self._await, self._own = wait_for, own

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._own, name)
        if not asyncio.iscoroutinefunction(found):
            return found
        return lambda *arguments, **options: self._await(found(*arguments, **options))

    def pause(self, _limit_s: float) -> None:
        self._await(self._own.pause())


@pytest.fixture(autouse=True)
def _asynchronous(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(test_client, "Client", Blocking)


def run(what: Callable[[aio.Client], Coroutine[Any, Any, None]], directory: Path) -> None:
    async def whole() -> None:
        async with asyncio.timeout(LIMIT_S), aio.Client(directory) as rtc:
            await what(rtc)

    asyncio.run(whole())


def test_many_commands_are_awaited_at_once_and_each_has_its_end(broker: SmallBroker, run_dir: Path) -> None:  # noqa: F811
    async def use(rtc: aio.Client) -> None:
        ends = await rtc.run_many([f"STOW {n}" for n in range(1, 20)])
        assert [end.command for end in ends] == [f"C-{n}" for n in range(1, 20)]
        assert (await rtc.status()).cluster == "test"

    run(use, run_dir)


def test_a_cancelled_wait_changes_nothing_and_can_be_repeated(run_dir: Path) -> None:  # noqa: F811
    may_end = threading.Event()

    def on_request(message: m.ClientToBroker) -> list[object]:
        match message:
            case m.StatusQuery() if may_end.is_set():
                return [ended(small.sentences()[0].request, "C-1"), *obliging(message)]
            case m.StatusQuery():
                return obliging(message)
        return accepting(message)

    small = SmallBroker(run_dir, on_request)

    async def use(rtc: aio.Client) -> None:
        stow = await rtc.submit("STOW LEFT-ARM 1")
        waiting = asyncio.ensure_future(stow.wait())
        await rtc.status()
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        assert stow.ended is None
        may_end.set()
        await rtc.status()
        assert (await stow.wait()).outcome.kind is OutcomeKind.SUCCEEDED

    run(use, run_dir)
    assert [sentence.text for sentence in small.sentences()] == ["STOW LEFT-ARM 1"]  # no ABORT, no HALT
    assert not small.halted
    small.stop()


def test_notes_are_an_async_iterator_that_ends_with_the_command(broker: SmallBroker, run_dir: Path) -> None:  # noqa: F811
    async def use(rtc: aio.Client) -> None:
        stow = await rtc.submit("STOW LEFT-ARM 3")
        assert [note.phase async for note in stow.notes()] == [m.Phase.PARSING]
        assert stow.outcome is not None

    run(use, run_dir)


def test_events_of_all_clients_are_an_async_iterator(broker: SmallBroker, run_dir: Path) -> None:  # noqa: F811
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    published = context.socket(zmq.XPUB)
    published.bind(Settings.load(run_dir).endpoint("events"))

    async def use(rtc: aio.Client) -> None:
        events = rtc.events()
        first = asyncio.ensure_future(anext(events))
        await asyncio.to_thread(published.recv)  # the subscription
        published.send_multipart(frames(ended("", "C-4")))
        event = await first
        assert isinstance(event, m.CommandEnded)
        assert event.command == "C-4"

    run(use, run_dir)
    context.destroy(linger=0)


def test_a_lost_cluster_is_an_error_of_every_wait(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    small = SmallBroker(run_dir, accepting)

    async def use(rtc: aio.Client) -> None:
        stow = await rtc.submit("STOW LEFT-ARM 1")
        waiting = asyncio.ensure_future(stow.wait())

        def gone(*_: object) -> None:
            raise NoCluster("the cluster is gone")

        monkeypatch.setattr("rtc.client.liveness.BrokerLiveness.check", gone)
        with pytest.raises(NoCluster):
            await waiting
        with pytest.raises(NoCluster):
            await rtc.run("STOW LEFT-ARM 2")

    run(use, run_dir)
    small.stop()
