"""The halt order that leaves before any library is loaded: equal bytes, and what it does without listeners."""

from __future__ import annotations

import socket as unix
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import zmq

from rtc.client.first_order import Dealer, FirstOrder, NotConnected, order, scope_of
from rtc.language.fastpath import named_scope
from rtc.protocol import messages as m
from rtc.protocol.wire import frames, reader

LONG = "X" * 200


@pytest.mark.parametrize("scope", ["ALL", "RIGHT-ARM", "C-7", LONG])
def test_the_order_has_the_bytes_of_the_message(scope: str) -> None:
    sent = m.HaltOrder(halt="H-0123456789ab", scope=scope, called_at_s=1234.5)
    assert reader(m.ToHalt)(order(sent.halt, scope, 1234.5)) == sent
    assert order(sent.halt, scope, 1234.5) == frames(sent) or scope == "ALL"  # a default, which `frames` leaves out


WORDS = [
    "ALL",
    "all",
    "both-arms",
    "LEFT-ARM",
    "right_end_eff",
    "C-7",
    "c_12",
    "GANTRY",
    "crawler_2",
    "C-",
    "DOOR-2",
    "S&P",
    *("RIGHT ARM", "RIGHT-ARM LEFT-ARM", "ALL ALL", " ", "", "arm gantry", "ARM LEFT-ARM", "ARM C-7", "right-arm."),
    *("!", "RIGHT_ARM, LEFT-ARM", "--all", "C-7 C-8", "X" * 3000, "ÄRM", "macs_new"),
]


@pytest.mark.parametrize("word", WORDS)
def test_a_word_names_the_same_scope_as_in_a_sentence(word: str) -> None:
    assert scope_of(word) == named_scope(word)


def test_the_order_arrives_at_both_sockets_and_the_answers_return(tmp_path: Path) -> None:
    with zmq.Context() as context, context.socket(zmq.ROUTER) as broker, context.socket(zmq.ROUTER) as arms:
        broker.bind(f"ipc://{tmp_path}/halt.sock")
        arms.bind(f"ipc://{tmp_path}/estop.sock")
        sent = FirstOrder(str(tmp_path), "ALL")

        assert set(sent.sent_to) == {"halt.sock", "estop.sock"}
        for socket, name in ((broker, "halt.sock"), (arms, "estop.sock")):
            peer, *parts = socket.recv_multipart()
            assert reader(m.ToHalt)(parts).halt == sent.halt
            long = m.HaltAtRest(halt=sent.halt, subsystem=LONG, at_s=1.0, at_rest=True, performers=[LONG] * 5)
            for answer in (long, long):
                socket.send_multipart([peer, *frames(answer)])
            found: list[m.FromHalt] = []
            dealer = sent.sent_to[name]
            while len(found) < 2 and zmq.select([dealer], [], [], 10)[0]:
                while (parts := _received(dealer)) is not None:
                    found.append(reader(m.FromHalt)(parts))
            assert found == [long, long]
            dealer.close()


def _received(dealer: Dealer) -> list[bytes] | None:
    try:
        return dealer.recv_multipart()
    except NotConnected:
        return None


def test_a_listener_that_does_not_answer_does_not_keep_the_other_waiting(tmp_path: Path) -> None:
    with zmq.Context() as context, context.socket(zmq.ROUTER) as arms, unix.socket(unix.AF_UNIX) as stopped:
        stopped.bind(str(tmp_path / "halt.sock"))
        stopped.listen()
        arms.bind(f"ipc://{tmp_path}/estop.sock")
        sent = FirstOrder(str(tmp_path), "ALL")
        assert set(sent.sent_to) == {"estop.sock"}
        assert arms.poll(10_000)
        sent.sent_to["estop.sock"].close()


@pytest.mark.parametrize("what", ["nothing", "left over", "ends at once"])
def test_without_a_listener_nothing_is_sent(tmp_path: Path, what: str) -> None:
    with unix.socket(unix.AF_UNIX) as left:
        if what != "nothing":
            left.bind(str(tmp_path / "halt.sock"))
        if what == "ends at once":
            left.listen()
            threading.Thread(target=lambda: left.accept()[0].close(), daemon=True).start()
        assert FirstOrder(str(tmp_path), "ALL").sent_to == {}
    assert FirstOrder(str(tmp_path / "absent"), "ALL").sent_to == {}


def test_it_needs_no_library() -> None:
    code = "import sys, rtc.client.first_order, rtc.apps.cli.entry; print(*sys.modules)"
    bare = subprocess.run(
        [sys.executable, "-S", "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    slow = {"zmq", "msgspec", "typer", "rich", "numpy", "pinocchio", "lark", "pathlib", "re", "typing", "json"}
    assert not slow & set(bare.stdout.split())
