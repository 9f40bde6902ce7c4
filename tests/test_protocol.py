"""docs/protocol.md is enough: a client of nothing but zmq and the reference msgpack library, against a real cluster."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

LIMIT_MS = 60_000


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    run_dir = tmp_path_factory.mktemp("rtc")
    deploy = [sys.executable, "-P", "-m", "rtc.apps.cli.entry"]
    options = ["--mcm", "kinematic", "--speed", "max", "--run-dir", str(run_dir)]
    subprocess.run([*deploy, "up", "-d", *options], check=True, timeout=60)
    yield run_dir
    subprocess.run([*deploy, "down", "--run-dir", str(run_dir)], check=True, timeout=60)


class Bare:
    """A client written from the page alone."""

    def __init__(
        self, context: zmq.Context[zmq.Socket[bytes]], run_dir: Path, file: str, kind: int = zmq.DEALER
    ) -> None:
        self.socket = context.socket(kind)
        self.socket.setsockopt(zmq.LINGER, 0)
        if kind == zmq.DEALER:
            self.socket.setsockopt(zmq.IDENTITY, f"bare-{uuid.uuid4().hex}".encode())
        else:
            self.socket.subscribe(b"")
        self.socket.connect(f"ipc://{run_dir}/{file}")

    def send(self, **message: Any) -> None:
        self.socket.send_multipart([b"RTC1", msgpack.packb(message)])

    def recv(self) -> dict[str, Any]:
        assert self.socket.poll(LIMIT_MS), "nothing was received"
        protocol, body = self.socket.recv_multipart()
        assert protocol == b"RTC1"
        message: dict[str, Any] = msgpack.unpackb(body)
        return message

    def recv_until(self, kind: str) -> list[dict[str, Any]]:
        received = [self.recv()]
        while received[-1]["type"] != kind:
            received.append(self.recv())
        return received


@pytest.fixture
def context() -> Iterator[zmq.Context[zmq.Socket[bytes]]]:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    yield context
    context.destroy(linger=0)


@pytest.fixture
def front(context: zmq.Context[zmq.Socket[bytes]], run_dir: Path) -> Bare:
    front = Bare(context, run_dir, "front.sock")
    front.send(type="ClientHello", client="bare", protocol=6)
    assert front.recv()["type"] == "Welcome"
    return front


def test_a_sentence_and_its_outcome(front: Bare) -> None:
    front.send(type="CommandText", request="1", text="STOW LEFT-ARM")
    accepted, *notes, ended = front.recv_until("CommandEnded")

    assert (accepted["type"], accepted["request"]) == ("Accepted", "1")
    assert [note["type"] for note in notes] == ["ProgressNote"] * len(notes)
    assert {"parsing", "elaborating", "binding", "executing"} <= {note["phase"] for note in notes}
    assert (ended["command"], ended["request"]) == (accepted["command"], "1")
    assert ended["outcome"]["kind"] == "succeeded", ended


def test_a_wrong_sentence_is_refused_with_its_column(front: Bare) -> None:
    front.send(type="CommandText", request="1", text="STOW LEFT-LEG", progress=False)
    ended = front.recv_until("CommandEnded")[-1]

    assert ended["outcome"]["kind"] == "refused"
    assert ended["outcome"]["refusal"]["reason"] == "sentence"
    assert ended["outcome"]["refusal"]["column"] == len("STOW ")


def test_the_same_request_again_is_the_same_command(front: Bare) -> None:
    for _ in range(2):
        front.send(type="CommandText", request="1", text="STOW RIGHT-ARM", progress=False)
    first = front.recv_until("CommandEnded")
    front.send(type="CommandText", request="1", text="STOW RIGHT-ARM", progress=False)
    again = front.recv_until("CommandEnded")

    assert len({message["command"] for message in [*first, *again]}) == 1


def test_another_version_is_declined_with_both_and_listed(
    context: zmq.Context[zmq.Socket[bytes]], run_dir: Path, front: Bare
) -> None:
    other = Bare(context, run_dir, "front.sock")
    other.send(type="ClientHello", client="from-the-future", protocol=7)
    other.send(type="CommandText", request="1", text="STOW LEFT-ARM")
    refusals = [other.recv(), other.recv()]
    assert [declined["request"] for declined in refusals] == ["", "1"]
    for declined in refusals:
        assert (declined["type"], declined["refusal"]["reason"]) == ("Declined", "version")
        assert {"6", "7"} <= set(declined["refusal"]["message"].split())
    front.send(type="StatusQuery", request="s")
    status = front.recv_until("StatusReply")[-1]["status"]
    assert [(row["name"], row["protocol"]) for row in status["refused"]] == [("from-the-future", 7)]


def test_messages_in_one_array(front: Bare) -> None:
    """Announced by the ability `arrays`, the answers may come in arrays too; each is a message like any other."""
    front.send(type="ClientHello", client="bare", protocol=6, abilities=["arrays"])
    assert front.recv()["abilities"] == ["arrays"]
    sentences = [
        {"type": "CommandText", "request": str(n), "text": "STOW LEFT-LEG", "progress": False} for n in range(1, 4)
    ]
    front.socket.send_multipart([b"RTC1", msgpack.packb(sentences)])
    received: list[dict[str, Any]] = []
    while sum(message["type"] == "CommandEnded" for message in received) < len(sentences):
        assert front.socket.poll(LIMIT_MS), "nothing was received"
        body = msgpack.unpackb(front.socket.recv_multipart()[1])
        received += body if isinstance(body, list) else [body]

    for kind in ("Accepted", "CommandEnded"):
        assert [message["request"] for message in received if message["type"] == kind] == ["1", "2", "3"]


def test_bytes_that_are_no_message_get_a_clear_answer(front: Bare) -> None:
    for parts in ([b"RTC1", b"\xc1"], [b"RTC0", msgpack.packb({"type": "StatusQuery"})], [b"RTC1", msgpack.packb([1])]):
        front.socket.send_multipart(parts)
        answer = front.recv()
        assert (answer["type"], answer["request"]) == ("Declined", "")

    front.send(type="StatusQuery", request="2", a_key_of_the_future=1)
    assert front.recv()["type"] == "StatusReply"


def test_status_has_the_layout_of_the_page(front: Bare) -> None:
    front.send(type="StatusQuery", request="1")
    status = front.recv()["status"]

    assert {"processes", "workers", "queues", "resources", "commands", "subsystems", "counters", "programs"} <= set(
        status
    )
    assert {worker["name"] for worker in status["workers"]} == {"parser@0", "elaborator@1", "binder@2", "analyzer@3"}


def test_a_trace_tells_every_phase(front: Bare) -> None:
    text = "stow LEFT-ARM"  # words that no test has given before, or they would be parsed already
    front.send(type="CommandText", request="1", text=text, progress=False)
    command = front.recv_until("CommandEnded")[-1]["command"]
    front.send(type="TraceQuery", request="2", command=command)
    record = front.recv()["record"]

    assert record["text"] == text
    assert record["notes"][-1]["phase"] == "ended"
    assert {note.get("node", "") for note in record["notes"]} >= {"parser@0", "elaborator@1", "binder@2"}


@pytest.mark.parametrize("endpoint", ["halt.sock", "estop.sock"])
def test_a_halt_by_either_endpoint_is_confirmed(
    context: zmq.Context[zmq.Socket[bytes]], front: Bare, run_dir: Path, endpoint: str
) -> None:
    bare = Bare(context, run_dir, endpoint)
    called_at_s = time.monotonic()
    bare.send(type="HaltOrder", halt=f"H-{os.getpid()}-{endpoint}", scope="ALL", called_at_s=called_at_s)
    received = {message["type"]: message for message in bare.recv_until("HaltAtRest")}

    assert received["HaltStarted"]["decelerating_at_s"] >= called_at_s
    assert received["HaltAtRest"]["at_rest"] is True


def test_the_world_can_be_read(context: zmq.Context[zmq.Socket[bytes]], run_dir: Path) -> None:
    world = Bare(context, run_dir, "world.sock")
    world.send(type="ReadView", request="1", keys=["MACS-NEW.frame"])
    view = world.recv()

    assert view["type"] == "View"
    assert [fact["key"] for fact in view["facts"]] == ["MACS-NEW.frame"]
    assert len(view["facts"][0]["value"]) == 7


def test_events_can_be_listened_to_by_anybody(
    context: zmq.Context[zmq.Socket[bytes]], front: Bare, run_dir: Path
) -> None:
    events = Bare(context, run_dir, "events.sock", zmq.SUB)
    received: list[dict[str, Any]] = []
    request = 0
    while not received:  # the subscription takes effect some time after it was made
        request += 1
        front.send(type="CommandText", request=f"e{request}", text="STOW LEFT-ARM", progress=False)
        command = front.recv_until("CommandEnded")[-1]["command"]
        while events.socket.poll(50):
            received.append(events.recv())

    assert received[-1]["type"] == "CommandEnded"
    assert received[-1]["command"] == command
    assert [message["seq"] for message in received] == list(range(received[0]["seq"], received[-1]["seq"] + 1))
