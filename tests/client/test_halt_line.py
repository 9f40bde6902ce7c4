"""The client's side of a halt, with sockets that answer, or do not, as broker and subsystems would."""

from __future__ import annotations

import threading
import time

import pytest
import zmq

from rtc.apps.cli.halt_words import as_text, confirmed, in_words
from rtc.client.halt import HaltLine, SubsystemHalt
from rtc.protocol import messages as m
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


@pytest.mark.parametrize("answered", [True, False])
def test_what_has_come_to_rest_is_stated_while_the_line_waits_for_others(settings, answered) -> None:
    """The line waited its 2 s in silence, and then stated that a subsystem which never answered has not come to rest.
    `answered`: the other one answers once it is known that the first is at rest."""
    stated: list[str] = []
    ended, threads = threading.Event(), []
    with zmq.Context() as context:
        sockets = [open_socket(context, zmq.ROUTER, settings.endpoint("estop", name), bind=True) for name in NAMES]

        def begin(n: int) -> None:
            threads.append(threading.Thread(target=answers, args=(sockets[n], NAMES[n], ended)))
            threads[-1].start()

        def note(found: SubsystemHalt, awaited: list[str]) -> None:
            stated.append(as_text([confirmed(found, awaited)], False))
            assert awaited == ["MCM-2"]
            if answered:
                begin(1)

        line = HaltLine(context, settings, on_rest=note)
        begin(0)
        try:
            result = line.halt(timeout_s=60.0 if answered else WAIT_S)
        finally:
            ended.set()
            for thread in threads:
                thread.join()
            line.close()
            for socket in sockets:
                socket.close()
    [words] = stated
    assert "MCM: rest confirmed" in words
    assert result.confirmed is answered
    assert answered or result.message == "MCM-2 has not answered"
    assert answered or "NOT CONFIRMED" in as_text(in_words(result), False)
