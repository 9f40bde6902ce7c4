"""The client's side of a halt, with sockets that answer, or do not, as broker and subsystems would."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest
import zmq

from rtc.apps.cli.halt_words import as_text, confirmed, in_words
from rtc.apps.console.halt_lines import HaltLines
from rtc.client.client import Client
from rtc.client.halt import HaltLine, SubsystemHalt
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.subsystems import Subsystem
from rtc.protocol.wire import frames, reader
from rtc.runtime.process import open_socket
from rtc.runtime.settings import Settings

NAMES = ("MCM", "MCM-2")
WAIT_S = 0.5


@pytest.fixture
def settings(tmp_path):
    both = tuple(Subsystem(name=name, performers=[f"ARM-{n}"], estop=True) for n, name in enumerate(NAMES))
    return Settings(run_dir=str(tmp_path), subsystems=both)


def answers(socket: zmq.Socket[bytes], name: str, ended: threading.Event) -> None:
    """At rest at once, to each order."""
    read = reader(m.HaltOrder)
    while not ended.is_set():
        if not socket.poll(20):
            continue
        peer, *parts = socket.recv_multipart()
        order, now_s = read(parts), time.monotonic()
        for answer in (
            m.HaltStarted(halt=order.halt, subsystem=name, received_at_s=now_s, decelerating_at_s=now_s, moving=[]),
            m.HaltAtRest(halt=order.halt, subsystem=name, at_s=now_s, at_rest=True, performers=[f"ARM of {name}"]),
        ):
            socket.send_multipart([peer, *frames(answer)])


class TwoMcms:
    """Subsystems of arms of which the first answers at once, and the second from `answer` on."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], settings: Settings) -> None:
        self._sockets = [
            open_socket(context, zmq.ROUTER, settings.endpoint("estop", name), bind=True) for name in NAMES
        ]
        self._ended, self._threads = threading.Event(), list[threading.Thread]()
        self.answer(0)

    def answer(self, n: int = 1) -> None:
        self._threads.append(threading.Thread(target=answers, args=(self._sockets[n], NAMES[n], self._ended)))
        self._threads[-1].start()

    def end(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join()
        for socket in self._sockets:
            socket.close()


@pytest.mark.parametrize("answered", [True, False])
def test_what_has_come_to_rest_is_stated_while_the_line_waits_for_others(settings, answered) -> None:
    """The line waited its 2 s in silence, and then stated that a subsystem which never answered has not come to rest.
    `answered`: the other one answers once it is known that the first is at rest."""
    stated: list[str] = []
    with zmq.Context() as context:
        mcms = TwoMcms(context, settings)

        def note(found: SubsystemHalt, awaited: list[str]) -> None:
            stated.append(as_text([confirmed(found, awaited)], False))
            assert awaited == ["MCM-2"]
            if answered:
                mcms.answer()

        line = HaltLine(context, settings)
        try:
            result = line.halt(timeout_s=8.0 if answered else WAIT_S, on_rest=note)
        finally:
            line.close()
            mcms.end()
    [words] = stated
    assert "MCM: rest confirmed" in words
    assert result.confirmed is answered
    assert answered or result.message == "MCM-2 has not answered; MCM rests"  # wording: who
    assert answered or "NOT CONFIRMED" in as_text(in_words(result), False)


def test_a_program_learns_at_once_what_rests(settings) -> None:
    """Programs, the interpreter and the page waited in silence, where `rtc halt` stated what rests."""
    settings.save()
    stated: list[list[str]] = []
    with zmq.Context() as context:
        mcms = TwoMcms(context, settings)

        def note(found: SubsystemHalt, awaited: list[str]) -> None:
            stated.append([found.name, *awaited])
            mcms.answer()

        try:
            with Client(settings.run_dir, need_broker=False) as rtc:
                assert rtc.halt(timeout_s=8.0, on_rest=note).confirmed
        finally:
            mcms.end()
    assert stated == [["MCM", "MCM-2"]]


def test_a_page_learns_at_once_what_rests(settings) -> None:
    stated: list[dict[str, Any]] = []
    with zmq.Context() as context:
        mcms = TwoMcms(context, settings)

        def note(rests: dict[str, Any]) -> None:
            stated.append(rests)
            mcms.answer()

        async def order() -> dict[str, Any]:
            halts = HaltLines(settings, [f"ARM-{n}" for n in range(len(NAMES))])
            try:
                return await halts.order("ALL", note)
            finally:
                halts.close()

        try:
            assert asyncio.run(order())["confirmed"]
        finally:
            mcms.end()
    assert [(one["name"], one["awaited"]) for one in stated] == [("MCM", ["MCM-2"])]


def _answering(
    socket: zmq.Socket[bytes], known: str, is_broker: bool, orders: list[str], ended: threading.Event
) -> None:
    """A broker or a subsystem: it obeys ALL and `known`, and declines every other scope. A broker has it confirmed."""
    read = reader(m.HaltOrder)
    while not ended.is_set():
        if not socket.poll(20):
            continue
        peer, *parts = socket.recv_multipart()
        order, now_s = read(parts), time.monotonic()
        orders.append(order.scope)
        started = m.HaltStarted(
            halt=order.halt, subsystem="MCM", received_at_s=now_s, decelerating_at_s=now_s, moving=["RIGHT-ARM"]
        )
        rest = m.HaltAtRest(halt=order.halt, subsystem="MCM", at_s=now_s, at_rest=True, performers=["RIGHT-ARM"])
        declined = m.Declined(request=order.halt, refusal=Refusal(reason=RefusalReason.NAME, message="who?"))
        knows = order.scope == "ALL" or (is_broker and order.scope == known)
        for answer in (started, rest) if knows else (declined,):
            socket.send_multipart([peer, *frames(answer)])


@pytest.mark.parametrize(
    ("scope", "broker", "halted"),
    [
        ("MODULE", "answers", "MODULE"),  # "NOTHING HALTED: there is no scope MODULE", while it was halted
        ("RIHGT-ARM", "answers", "ALL"),
        ("MODULE", "is silent", "ALL"),
        ("MODULE", "is dead", "ALL"),
        ("RIGHT ARM", "answers", "ALL"),
    ],
)
def test_a_halt_is_never_refused_for_its_scope_and_says_what_was_halted(tmp_path, scope, broker, halted) -> None:
    settings = Settings(run_dir=str(tmp_path))
    orders: list[str] = []
    ended = threading.Event()
    with zmq.Context() as context:
        sockets = [open_socket(context, zmq.ROUTER, settings.endpoint("estop"), bind=True)]
        if broker != "is dead":
            sockets.append(open_socket(context, zmq.ROUTER, settings.endpoint("halt"), bind=True))
        threads = [
            threading.Thread(target=_answering, args=(socket, "MODULE", n == 1, orders, ended))
            for n, socket in enumerate(sockets[: 2 if broker == "answers" else 1])
        ]
        for thread in threads:
            thread.start()
        line = HaltLine(context, settings)
        try:
            assert line.ready() or broker == "is dead"
            result = line.halt(scope, timeout_s=WAIT_S)
        finally:
            line.close()
            ended.set()
            for thread in threads:
                thread.join()
            for socket in sockets:
                socket.close()
    assert (result.scope, result.moving, result.confirmed) == (halted, ["RIGHT-ARM"], True)
    assert (orders[-1] == "ALL") is (halted == "ALL")
    assert bool(result.unknown) is (halted == "ALL" and scope != "RIGHT ARM")
