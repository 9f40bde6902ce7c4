"""A remote worker and its broker: the end without an answer, the health file, systemd, and the leave on an order."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import ClusterError, Refusal, RefusalReason
from rtc.protocol.roles import Role
from rtc.protocol.versions import VERSION
from rtc.runtime.keys import KeyRing
from rtc.runtime.link import Link
from rtc.runtime.process import Process, now_s, send
from rtc.world.client import WorldClient
from workers.runtime import health
from workers.runtime.contact import BrokerContact, Systemd
from workers.runtime.worker_loop import WorkerLoop

HELLO = m.WorkerHello(protocol=VERSION, name="parser", node=None, kind=m.WorkerKind.PARSER, pid=1, instance="a")
LONG_S, SHORT_S = 1000.0, 0.2
LIMIT_MS = 10_000


class Function:
    """The worker function: its job waits until the test lets it go on."""

    INPUT = m.ParserInput
    NEEDS_WORLD = NEEDS_CELL = False

    def __init__(self) -> None:
        self.began, self.go_on = threading.Event(), threading.Event()

    def compile(self, program: bytes) -> Any:
        return program

    def run(self, compiled: Any, cell: Any, world: Any, data: m.ParserInput) -> Any:
        self.began.set()
        assert self.go_on.wait(10)
        return data.text


class Broker:
    """The broker's end, and the worker's loop in a thread."""

    def __init__(self, path: Path) -> None:
        self.process = Process("broker", path)
        self.socket = self.process.socket(zmq.ROUTER, f"ipc://{path}/workers.sock", bind=True)
        self.read = wire.reader(m.WorkerToBroker)
        self.function = Function()
        self.path = path
        self.why: list[str] = []

    def start(self, limit_s: float = LONG_S, **options: Any) -> None:
        self.worker = Process("parser", self.path)
        link = Link.connect(self.worker, f"ipc://{self.path}/workers.sock", "peer")
        world = WorldClient(f"ipc://{self.path}/world.sock", self.worker.context)
        self.contact = BrokerContact(now_s(), limit_s, **options)
        programs = {"p": b""}
        loop = WorkerLoop(self.worker, HELLO, self.function, link, world, lambda cell: None, programs, {}, self.contact)

        def run() -> None:
            self.why.append(loop.run())
            world.close()

        self.thread = threading.Thread(target=run)
        self.thread.start()
        assert self.recv() == HELLO  # a message to a worker that is not connected yet would be dropped

    def recv(self) -> Any:
        assert self.socket.poll(LIMIT_MS)
        _, *parts = self.socket.recv_multipart()
        return self.read(parts)

    def recv_other(self) -> Any:
        """The next message that is not a heartbeat."""
        while isinstance(message := self.recv(), m.Heartbeat):
            pass
        return message

    def send(self, message: Any) -> None:
        assert send(self.socket, message, to=b"peer")

    def answer_heartbeat(self) -> None:
        while not isinstance(message := self.recv(), m.Heartbeat):
            pass
        assert message.at_s > 0.0
        self.send(m.Heartbeat(name=message.name, at_s=message.at_s))

    def give(self, name: str, text: str) -> None:
        job = m.Job(id=name, attempt=1, program="p", input=wire.raw(m.ParserInput(text=text)))
        self.send(m.JobBatch(jobs=[job]))

    def close(self) -> None:
        self.function.go_on.set()
        self.worker.stop()
        self.thread.join(10)
        assert not self.thread.is_alive()
        self.worker.close()
        self.process.close()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    made = Broker(tmp_path)
    yield made
    made.close()


def test_a_worker_whose_broker_never_answers_ends_with_the_reason(broker: Broker) -> None:
    broker.start(SHORT_S)
    broker.thread.join(10)
    assert "has not answered parser for 0.2 s" in broker.why[0]


def test_a_worker_whose_broker_is_lost_ends_with_the_reason(broker: Broker) -> None:
    broker.start()
    broker.answer_heartbeat()
    broker.answer_heartbeat()
    broker.contact.limit_s = SHORT_S
    broker.socket.close(linger=0)
    broker.process.poller.unregister(broker.socket)
    broker.thread.join(10)
    assert "has not answered" in broker.why[0]


def test_requests_for_a_hello_are_not_answers_of_the_broker(broker: Broker) -> None:
    """The gateway alone sends them too."""
    broker.start(SHORT_S * 2)
    while not broker.why:
        if broker.socket.poll(100):
            broker.recv()
            broker.send(m.HelloWanted())
            broker.send(m.CancelJobs(jobs=[]))
        broker.thread.join(0)
    assert "has not answered" in broker.why[0]


def test_a_job_longer_than_the_limit_does_not_end_the_worker(broker: Broker) -> None:
    broker.start()
    broker.give("C-1/1", "x")
    assert broker.function.began.wait(10)
    during_s = now_s()
    assert broker.contact.lost(during_s + LONG_S)
    broker.function.go_on.set()
    assert broker.recv_other().results[0].id == "C-1/1"
    assert not broker.contact.lost(during_s + LONG_S)  # the limit begins again when the job ends


def test_a_worker_uses_its_assigned_address_from_then_on(broker: Broker) -> None:
    broker.start()
    broker.send(m.WorkerAddress(name="parser@16", node=16))
    while broker.recv().name != "parser@16":
        pass
    broker.worker.stop()
    assert broker.recv_other() == m.WorkerGone(name="parser@16", in_order=True)


def test_a_worker_that_is_ordered_to_stop_sends_the_result_in_progress_and_takes_leave(broker: Broker) -> None:
    broker.start()
    broker.give("C-1/1", "x")
    broker.give("C-1/2", "not begun")
    assert broker.function.began.wait(10)
    broker.worker.stop()
    broker.function.go_on.set()

    messages = [broker.recv_other() for _ in range(2)]

    assert [type(message) for message in messages] == [m.ResultBatch, m.WorkerGone]
    assert [result.id for result in messages[0].results] == ["C-1/1"]
    broker.thread.join(10)
    assert broker.why == [""]


def test_a_rejected_worker_ends_with_the_reason(broker: Broker) -> None:
    broker.start()
    broker.send(m.Shutdown(why="the key w1 has 32 workers already"))
    broker.thread.join(10)
    assert "has 32 workers" in broker.why[0]


def test_a_remote_worker_of_another_version_ends_with_the_reason(broker: Broker) -> None:
    broker.start()
    refusal = Refusal(reason=RefusalReason.VERSION, message="parser speaks version 3, this cluster version 2")
    broker.send(m.Declined(request="", refusal=refusal))
    broker.thread.join(10)
    assert refusal.message in broker.why[0]  # wording: of the broker, unchanged


def test_the_health_file_shows_the_age_of_the_last_answer(broker: Broker, tmp_path: Path) -> None:
    file = tmp_path / "health"
    broker.start(health=file)
    assert health.check(file, 1.0, now_s()) == (False, "the broker has not answered yet")
    for _ in range(3):  # a heartbeat may have been sent before the previous answer was read
        broker.answer_heartbeat()

    healthy, reason = health.check(file, 30.0, now_s())
    assert healthy, reason
    stale, reason = health.check(file, 30.0, now_s() + 31.0)
    assert not stale
    assert "the limit is 30 s" in reason
    broker.worker.stop()
    broker.thread.join(10)
    broker.contact.close()
    assert not health.check(file, 30.0, now_s())[0]


def test_a_health_file_of_something_else_is_not_healthy(tmp_path: Path) -> None:
    file = tmp_path / "health"
    file.write_text("binder@18 1000.0\n")
    assert health.check(file, 30.0, 1005.0)[0]
    assert not health.check(file, 30.0, 5.0)[0]  # from before a restart of the machine
    file.write_text("something else\n")
    assert not health.check(file, 30.0, 1005.0)[0]
    with pytest.raises(ClusterError, match="health file"):
        BrokerContact(0.0, health=tmp_path / "missing" / "health")


@pytest.mark.parametrize("abstract", [False, True], ids=["file", "abstract name"])
def test_systemd_is_notified_while_the_broker_answers_and_only_then(tmp_path: Path, abstract: bool) -> None:
    address = f"@rtc-test-{tmp_path}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + address[1:] if abstract else address)
        systemd.settimeout(5.0)
        contact = BrokerContact(0.0, systemd=Systemd(address))
        contact.worked(1.0)  # not an answer
        contact.answered("binder@18", 2.0)
        contact.answered("binder@18", 2.1)  # too soon to be sent again
        contact.answered("binder@18", 3.0)
        contact.close()
        received = [systemd.recv(1000).decode() for _ in range(3)]
    assert received == ["READY=1\nSTATUS=joined as binder@18\nWATCHDOG=1", "WATCHDOG=1", "STOPPING=1"]


def test_a_lost_systemd_does_not_disturb(tmp_path: Path) -> None:
    contact = BrokerContact(0.0, systemd=Systemd(str(tmp_path / "gone")))
    contact.answered("binder@18", 2.0)
    contact.close()


@pytest.mark.slow
@pytest.mark.untimed
def test_the_process_ends_with_a_status_and_a_message(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:  # accepts connections and is not a cluster
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        KeyRing(tmp_path).new("w1", Role.WORKER, address, tmp_path / "w1.key")
        command = [sys.executable, "-m", "workers", "--kind", "parser", "--with", str(tmp_path / "w1.key")]
        done = subprocess.run(
            [*command, "--lost-after", "0.5", "--health", str(tmp_path / "health")],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert done.returncode == 1
    assert "the broker has not answered parser for 0.5 s" in done.stderr
    assert address.rpartition(":")[0] in done.stderr
    assert not (tmp_path / "health").exists()


@pytest.mark.slow
@pytest.mark.untimed
def test_the_probe_has_a_status_and_a_reason(tmp_path: Path) -> None:
    file = tmp_path / "health"

    def probe(*options: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "workers.runtime.health", str(file), *options]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    assert probe().returncode == 1
    file.write_text(f"binder@18 {now_s():.3f}\n")
    done = probe("--within", "60")
    assert (done.returncode, done.stdout.startswith("the broker answered binder@18")) == (0, True)


LOCAL, REMOTE = ["--run-dir", "x", "--kind", "parser", "--node", "0"], ["--with", "w.key", "--kind", "parser"]


@pytest.mark.parametrize(
    "options",
    [
        [*LOCAL, "--lost-after", "5"],
        [*LOCAL, "--health", "x"],
        [*REMOTE, "--template"],
        [*REMOTE, "--node", "-1"],
        [*REMOTE, "--node", "99999999999999999999"],
        [*REMOTE, "--lost-after", "nan"],
    ],
)
def test_options_without_effect_or_out_of_range_are_refused(
    options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from workers import __main__ as program

    monkeypatch.setattr(sys, "argv", ["workers", *options])
    with pytest.raises(SystemExit) as ended:
        program.main()
    assert ended.value.code == 2  # of argparse; a missing key file would end with a message
