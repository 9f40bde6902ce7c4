"""A real cluster reached over tcp: every role does what it may and nothing else, strangers get nothing, no one is hurt.

Exact arms in real time, so that a halt has something to stop. Half a minute in all.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket as sockets
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import zmq

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client import core, halt
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import ClusterError, NoCluster, OutcomeKind, Refusal, RefusalReason, RequestDeclined
from rtc.protocol.roles import TCP_ENDPOINTS, Role
from rtc.protocol.versions import VERSION
from rtc.runtime.keys import KeyFile, KeyRing, endpoint_address
from rtc.runtime.process_table import processes
from tests.campaigns.fuzz import Others

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

LIMIT_S = 60.0
QUIET_MS = 300  # who has got nothing by then gets nothing
SEED = 3
PAUSE = threading.Event()
STOW = "STOW RIGHT-ARM"
AWAY = "MOVE RIGHT-ARM TO JOINTS -40 110 -160 0 50 0 DEG JOINT-MOTION"
FRONT_WORDS = (
    m.ClientHello(protocol=VERSION, client="x"),
    m.CommandText(request="r", text=STOW),
    m.StatusQuery(request="s"),
)


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    cell = tmp_path_factory.mktemp("cell") / "cell.yaml"
    subsystem = "{name: TOOLS, performers: [CAMERA-4]}"
    cell.write_text(f"extends: swapout\nname: with-tools\nsubsystems: [{subsystem}]\n")
    with own_cluster(cell=str(cell), mcm="kinematic", listen=f"tcp://127.0.0.1:{free_ports()}") as path:
        yield path


def free_ports() -> int:
    """The first of as many free ports in a row as there are endpoints; others may be looking for some too."""
    for first in random.SystemRandom().sample(range(20_000, 32_000, len(TCP_ENDPOINTS)), k=100):
        with contextlib.ExitStack() as held, contextlib.suppress(OSError):
            for endpoint in range(len(TCP_ENDPOINTS)):
                held.enter_context(sockets.socket()).bind(("127.0.0.1", first + endpoint))
            return first
    raise AssertionError("no free ports")


@pytest.fixture
def new_key(run_dir: Path, tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Makes a key of a role; all are revoked at the end."""
    ring, made = KeyRing(run_dir), []
    address = address_of(run_dir)

    def new(role: str, name: str = "") -> Path:
        made.append(name or f"{role}-{len(made)}")
        path = tmp_path / f"{made[-1]}.key"
        ring.new(made[-1], Role(role), address, path)
        return path

    yield new
    for known in ring.known():
        ring.revoke(known.name)


def address_of(run_dir: Path) -> str:
    with Client(run_dir) as rtc:
        return rtc.settings.listen


@pytest.fixture
def context() -> Iterator[zmq.Context[Any]]:
    context: zmq.Context[Any] = zmq.Context()
    yield context
    context.destroy(linger=0)


def refusal_of(rtc: Client, text: str) -> RefusalReason:
    refusal = rtc.run(text, timeout_s=LIMIT_S).outcome.refusal
    assert refusal is not None
    return refusal.reason


def moving(rtc: Client) -> None:
    """Wait until an arm moves."""
    for sample in rtc.telemetry(silence_s=LIMIT_S):
        if max(max(map(abs, arm.velocities)) for arm in sample.arms.values()) > 0.05:
            return
    raise AssertionError("no telemetry")


def wait_for(condition: Callable[[], bool]) -> None:
    end = os.times().elapsed + LIMIT_S
    while not condition():
        assert os.times().elapsed < end
        PAUSE.wait(0.05)  # a client may not ask without end


# --- roles ---------------------------------------------------------------------------------------------


def test_an_operator_does_over_tcp_what_can_be_done_here(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(key=new_key("operator")) as rtc:
        notes: list[m.ProgressNote] = []
        ended = rtc.run(STOW, on_progress=notes.append, timeout_s=LIMIT_S)

        assert ended.outcome.kind is OutcomeKind.SUCCEEDED
        assert notes
        assert rtc.trace(ended.command).text == STOW
        assert "gate" in {row.name for row in rtc.status().processes}
        assert rtc.world.view(keys=["RIGHT-ARM"]).facts
        with pytest.raises(RequestDeclined) as declined:  # it is read, and does not check: so it was let through
            rtc.load("binder", Path(__file__))
        assert declined.value.refusal.reason is not RefusalReason.NOT_ALLOWED


def test_an_observer_sees_all_and_commands_nothing(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(run_dir) as here, Client(key=new_key("observer")) as rtc:
        assert here.run(STOW, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        events = rtc.events(silence_s=LIMIT_S)
        received: list[Any] = []
        listening = threading.Thread(target=lambda: received.append(next(events)))
        listening.start()
        while listening.is_alive():  # its subscription has to arrive first
            here.run(STOW, timeout_s=LIMIT_S)
        events.close()  # type: ignore[attr-defined]

        assert isinstance(received[0], m.ProgressNote | m.CommandEnded)
        assert next(rtc.telemetry(silence_s=LIMIT_S)).arms
        assert rtc.world.view(keys=["RIGHT-ARM"]).facts
        assert refusal_of(rtc, STOW) is RefusalReason.NOT_ALLOWED
        halted = rtc.halt()
        assert not halted.confirmed
        assert "observer" in halted.message  # wording: why not
        with pytest.raises(RequestDeclined, match="not allowed"):
            rtc.load("binder", Path(__file__))
        assert here.status().halts.called == 0 or here.status().commands_live == 0


def test_a_planner_controls_its_own_commands_only(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(run_dir) as here, Client(key=new_key("planner")) as rtc:
        theirs, own = here.submit("HOLD LEFT-ARM"), rtc.submit("HOLD RIGHT-ARM")

        assert refusal_of(rtc, f"ABORT {theirs}") is RefusalReason.NOT_ALLOWED
        assert refusal_of(rtc, "RESUME ALL") is RefusalReason.NOT_ALLOWED
        assert rtc.run(f"ABORT {own}", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        assert own.wait(LIMIT_S).outcome.kind is OutcomeKind.ABORTED
        assert here.trace(own.number).source == "aip"
        assert rtc.halt(theirs.number, timeout_s=LIMIT_S).confirmed
        assert theirs.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED


def test_a_halt_over_tcp_stops_a_moving_arm(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(run_dir) as here, Client(key=new_key("operator")) as rtc:
        assert here.run(STOW, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        command = rtc.submit(AWAY)
        moving(here)

        halted = rtc.halt(timeout_s=LIMIT_S)

        assert (halted.confirmed, halted.moving, halted.sent_to) == (True, ["RIGHT-ARM"], ["estop", "halt"])
        assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED


def test_a_worker_key_serves_and_does_nothing_else(new_key: Callable[[str], Path], run_dir: Path) -> None:
    """The binder from elsewhere gets jobs, and what it binds is done."""
    key = new_key("worker")
    with pytest.raises(Exception, match="role worker"):
        Client(key=key)
    with Client(run_dir) as here, worker(key, 18):
        wait_for(lambda: "binder@18" in {row.name for row in here.status().workers})
        nodes: set[str] = set()
        while "binder@18" not in nodes:
            ended = here.run(STOW, timeout_s=LIMIT_S)
            assert ended.outcome.kind is OutcomeKind.SUCCEEDED
            both = here.run_many([STOW, "STOW LEFT-ARM"], timeout_s=LIMIT_S)
            assert {one.outcome.kind for one in both} == {OutcomeKind.SUCCEEDED}
            nodes |= {note.node for one in (ended, *both) for note in here.trace(one.command).notes}


def test_a_killed_worker_from_elsewhere_is_missed_at_once(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(run_dir) as here:
        with worker(new_key("worker"), 18) as process:
            wait_for(lambda: "binder@18" in {row.name for row in here.status().workers})
            process.send_signal(signal.SIGKILL)
        wait_for(lambda: "binder@18" not in {row.name for row in here.status().workers})


def test_a_late_result_of_an_earlier_connection_is_refused_and_counted(
    new_key: Callable[[str], Path], run_dir: Path, context: zmq.Context[Any]
) -> None:
    """A worker takes a job and loses its connection; the job is done by another worker, and then its result comes."""
    key = KeyFile.load(new_key("worker"))
    hello = m.WorkerHello(protocol=VERSION, name="binder@18", node=18, kind=m.WorkerKind.BINDER, pid=1)
    first = Peer(context, key, "workers")
    first.send(hello)
    with Client(run_dir) as here:
        wait_for(lambda: "binder@18" in {row.name for row in here.status().workers})
        before = here.status().counters
        commands, job = [], None
        while job is None:  # the cluster's own binder takes what it can
            if "binder@18" not in {row.name for row in here.status().workers}:
                first.send(hello)  # a busy machine made it silent for too long
            commands += [here.submit(STOW), here.submit("STOW LEFT-ARM")]
            job = first.job()
        first.close()
        for command in commands:
            assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        lost = [n for n in here.trace(job.id.partition("/")[0]).notes if n.kind is m.NoteKind.WORKER_LOST]
        assert [one.about for one in lost] == ["binder@18"]

        late = m.JobRefused(id=job.id, attempt=job.attempt, refusal=Refusal(reason=RefusalReason.STATE, message="late"))
        second = Peer(context, key, "workers")
        second.send(m.ResultBatch(name=hello.name, results=[late]))  # at once after the reconnection
        second.send(hello)
        second.send(m.ResultBatch(name=hello.name, results=[late]))
        for where in ("dropped_gate_stale", "dropped_results"):
            wait_for(lambda where=where: here.status().counters.get(where, 0) == before.get(where, 0) + 1)


def test_a_worker_gets_no_node_that_is_taken(new_key: Callable[[str], Path]) -> None:
    with worker(new_key("worker"), 2) as process:
        assert process.wait(LIMIT_S) == 1
        assert b"rejects binder@2" in process.stderr.read()


def test_a_worker_without_an_address_shows_its_engine_that_it_is_ready_and_ends_as_ordered(
    new_key: Callable[[str], Path], run_dir: Path, tmp_path: Path
) -> None:
    """All replicas of an engine have the same line."""
    key, health = new_key("worker"), tmp_path / "health"
    with sockets.socket(sockets.AF_UNIX, sockets.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(LIMIT_S)
        shown = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        with worker(key, None, "--health", str(health), kind="parser", environment=shown) as first:
            assert b"READY=1" in systemd.recv(1000)
            assert systemd.recv(1000) == b"WATCHDOG=1"
            with worker(key, None, kind="parser"), Client(run_dir) as here:
                addresses = {"parser@16", "parser@20"}
                wait_for(lambda: addresses <= {row.name for row in here.status().workers})
                probe = [sys.executable, "-P", "-m", "workers.runtime.health", str(health)]
                assert subprocess.run(probe, stdout=subprocess.DEVNULL, check=False).returncode == 0

                first.send_signal(signal.SIGTERM)
                assert first.wait(LIMIT_S) == 0
                wait_for(lambda: len(addresses & {row.name for row in here.status().workers}) == 1)
                assert subprocess.run(probe, stdout=subprocess.DEVNULL, check=False).returncode == 1
                assert here.run(STOW, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def test_a_worker_whose_cluster_has_ended_ends_by_itself(tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_ports()}"
    with contextlib.ExitStack() as cluster:
        path = cluster.enter_context(own_cluster(mcm="kinematic", listen=address))
        KeyRing(path).new("w1", Role.WORKER, address, tmp_path / "w1.key")
        with worker(tmp_path / "w1.key", None, "--lost-after", "3", kind="parser") as process:
            with Client(path) as here:
                wait_for(lambda: "parser@16" in {row.name for row in here.status().workers})
            assert process.poll() is None
            cluster.close()
            assert process.wait(LIMIT_S) == 1
            assert b"the broker has not answered parser@16 for 3 s" in process.stderr.read()


def test_a_worker_whose_key_is_revoked_or_unknown_ends_at_once_with_the_reason(
    new_key: Callable[[str], Path], run_dir: Path
) -> None:
    key, patient = new_key("worker"), ("--lost-after", str(LIMIT_S * 10))
    with worker(key, None, *patient, kind="parser") as process, Client(run_dir) as here:
        wait_for(lambda: any(row.key == key.stem and row.joined for row in here.status().hosts))
        KeyRing(run_dir).revoke(key.stem)
        assert process.wait(LIMIT_S) == 1
        assert b"or it was revoked" in process.stderr.read()
        late = new_key("worker")
        wait_for(lambda: any(row.key == late.stem for row in here.status().hosts))
        KeyRing(run_dir).revoke(late.stem)
        words = [sys.executable, "-P", "-c", SLOW_WORKER, "--kind", "parser", "--with", str(late), *patient]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            try:
                wait_for(lambda: any(row.key == late.stem and row.refused for row in here.status().hosts))
                _, errors = process.communicate(b"\n", LIMIT_S)
            finally:
                process.kill()
        assert process.returncode == 1
        assert b"does not know this key" in errors


#: a worker that is still being prepared when its key is refused, which is reported once
SLOW_WORKER = """
import sys
from workers import __main__ as workers
from workers.runtime import start
from rtc.protocol.versions import VERSION
made = start.WorldClient
start.WorldClient = lambda *given, **more: sys.stdin.readline() and made(*given, **more)
workers.main()
"""


@contextlib.contextmanager
def worker(
    key: Path, node: int | None, *options: str, kind: str = "binder", environment: dict[str, str] | None = None
) -> Iterator[Any]:
    where = [] if node is None else ["--node", str(node)]
    command = [sys.executable, "-P", "-m", "workers", "--kind", kind, *where, "--with", str(key), *options]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=os.environ | (environment or {})
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


def test_a_subsystem_comes_under_the_name_of_its_key_alone(
    new_key: Callable[..., Path], run_dir: Path, context: zmq.Context[Any]
) -> None:
    endpoint = Peer(context, KeyFile.load(new_key("subsystem", "TOOLS")), "subsystems")
    with Client(run_dir) as here:
        endpoint.send(m.SubsystemHello(protocol=VERSION, name="MCM", pid=1, performers=["LEFT-ARM"]))
        endpoint.send(m.SubsystemHello(protocol=VERSION, name="OTHER", pid=1, performers=[]))
        endpoint.send(m.SubsystemHello(protocol=VERSION, name="TOOLS", pid=1, performers=["CAMERA-4"]))
        wait_for(lambda: "TOOLS" in {row.name for row in here.status().subsystems})

        names = {row.name: row.performers for row in here.status().subsystems}
        assert "OTHER" not in names
        assert len(names["MCM"]) == 2
        assert here.run("STOW LEFT-ARM", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


# --- strangers -----------------------------------------------------------------------------------------


class Peer:
    """A bare peer at one endpoint: with a key, with an unknown key, or in plain tcp."""

    def __init__(self, context: zmq.Context[Any], key: KeyFile, endpoint: str, *, plain: bool = False) -> None:
        self._socket = context.socket(zmq.SUB if endpoint in ("events", "telemetry") else zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 0)
        if endpoint in ("events", "telemetry"):
            self._socket.subscribe(b"")
        if not plain:
            key.secure(self._socket)
        self._socket.connect(endpoint_address(key.address, endpoint))

    def send(self, message: Any, flags: int = 0) -> None:
        self._socket.send_multipart(wire.frames(message), flags)

    def job(self) -> m.Job | None:
        """The first job that arrives soon."""
        for _ in range(5):  # the gateway probes workers all the time
            if (parts := self.recv()) is None:
                break
            message = wire.reader(m.BrokerToWorker)(parts)
            if isinstance(message, m.JobBatch) and message.jobs:
                return message.jobs[0]
        return None

    def close(self) -> None:
        self._socket.close()

    def recv(self, limit_ms: int = QUIET_MS) -> list[bytes] | None:
        return self._socket.recv_multipart() if self._socket.poll(limit_ms) else None


@pytest.mark.parametrize("plain", [True, False], ids=["without any key", "with an unknown key"])
def test_a_stranger_gets_nothing_at_any_endpoint(
    run_dir: Path, context: zmq.Context[Any], tmp_path: Path, plain: bool
) -> None:
    ring = KeyRing(tmp_path)  # of another cluster
    stranger = ring.new("eve", Role.OPERATOR, address_of(run_dir), tmp_path / "eve.key")
    stranger = KeyFile(**{**as_dict(stranger), "cluster": KeyRing(run_dir).cluster().public})
    peers = {endpoint: Peer(context, stranger, endpoint, plain=plain) for endpoint in TCP_ENDPOINTS}
    for name in ("front", "halt", "estop"):
        for message in (*FRONT_WORDS, m.HaltOrder(halt="H-eve")):
            with contextlib.suppress(zmq.Again):  # once its key is refused, there is no connection to wait for
                peers[name].send(message, zmq.NOBLOCK)

    with Client(run_dir) as here:
        before = here.status()
        answers = {name: endpoint.recv() for name, endpoint in peers.items()}
        after = here.status()

    assert answers == dict.fromkeys(TCP_ENDPOINTS)
    assert (after.commands_accepted, after.halts) == (before.commands_accepted, before.halts)


def as_dict(key: KeyFile) -> dict[str, Any]:
    return {field: getattr(key, field) for field in key.__struct_fields__}


def test_the_refusal_of_an_unknown_key_has_advice(
    run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "eve.key"
    known = KeyRing(run_dir).new("eve", Role.OPERATOR, address_of(run_dir), path)
    KeyRing(run_dir).revoke("eve")
    with pytest.raises(NoCluster, match="does not know this key"):
        Client(key=path)
    monkeypatch.setattr(halt, "FAR_CONNECT_S", 0.3)  # nothing will answer
    with Client(key=path, need_broker=False) as rtc, pytest.raises(ClusterError, match="halt not sent"):
        rtc.halt()

    other = KeyRing(tmp_path).new("eve", Role.OPERATOR, known.address, tmp_path / "wrong.key")
    assert other.cluster != known.cluster
    with pytest.raises(NoCluster, match="not the cluster of this key file"):
        Client(key=tmp_path / "wrong.key")
    other = KeyRing(tmp_path).new("bob", Role.OPERATOR, f"tcp://127.0.0.1:{free_ports()}", tmp_path / "unknown.key")
    monkeypatch.setattr(core, "REMOTE_HELLO_S", 0.3)  # nothing listens
    with pytest.raises(NoCluster, match="no answer from"):
        Client(key=tmp_path / "unknown.key")


def test_a_revoked_key_is_cut_off_in_the_middle_of_its_work(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(run_dir) as here, Client(key=new_key("observer")) as other:
        with Client(key=new_key("operator")) as rtc:
            command = rtc.submit("HOLD LEFT-ARM")
            samples = rtc.telemetry(silence_s=1.0)
            next(samples)
            KeyRing(run_dir).revoke("operator-1")
            with pytest.raises(NoCluster, match="does not know this key"):
                command.wait(LIMIT_S)
            assert len(list(samples)) < 10_000  # it ends
            halts = here.status().halts.called
            with contextlib.suppress(ClusterError):
                assert not rtc.halt(timeout_s=0.5).confirmed
            assert here.status().halts.called == halts
        assert here.trace(command.number).phase is m.Phase.EXECUTING  # any client may halt what it began
        assert here.halt(timeout_s=LIMIT_S).confirmed
        wait_for(lambda: other.status().commands_live == 0)  # the others are there again


# --- harm ----------------------------------------------------------------------------------------------


def test_random_bytes_at_every_port_hurt_no_one(run_dir: Path, new_key: Callable[[str], Path]) -> None:
    rng, before = random.Random(SEED), pids(run_dir)
    address = address_of(run_dir)
    with Client(key=new_key("operator")) as rtc:
        for _ in range(5):
            for endpoint in TCP_ENDPOINTS:
                stream_garbage(endpoint_address(address, endpoint), rng)
            assert rtc.halt(timeout_s=LIMIT_S).confirmed

    assert pids(run_dir) == before


def stream_garbage(address: str, rng: random.Random) -> None:
    """Bytes of a peer without ZeroMQ, or one that stops in the middle of it, or that has another mechanism."""
    host, port = urlsplit(address).hostname, urlsplit(address).port
    for mechanism in (b"CURVE", b"NULL", b"PLAIN", b""):
        greeting = b"\xff" + bytes(8) + b"\x7f\x03\x00" + mechanism.ljust(20, b"\0") + bytes(32)
        hello = b"\x04\xc8\x05HELLO\x01\x00" + rng.randbytes(192)
        endless = b"\x02" + (1 << 62).to_bytes(8, "big")
        for garbage in (rng.randbytes(500), greeting[:20], greeting + rng.randbytes(300), greeting + hello + endless):
            with contextlib.suppress(OSError), sockets.create_connection((host, port), timeout=1.0) as line:
                line.sendall(garbage)


@pytest.mark.parametrize("endpoint", ["front", "halt", "estop", "world", "workers", "subsystems"])
def test_nonsense_from_one_who_has_a_key_hurts_no_one(
    run_dir: Path, new_key: Callable[[str], Path], context: zmq.Context[Any], endpoint: str
) -> None:
    role = {"workers": "worker", "subsystems": "subsystem"}.get(endpoint, "operator")
    before, others = pids(run_dir), Others(run_dir)
    rng = random.Random(SEED)
    peer = Peer(context, KeyFile.load(new_key(role)), endpoint)
    for _ in range(300):
        peer._socket.send_multipart([rng.randbytes(rng.choice((0, 4, 300))) for _ in range(rng.choice((1, 2, 5)))])
        peer._socket.send_multipart([wire.PROTOCOL, rng.randbytes(30)])
    peer.send(m.TraceQuery(request="r", command="C-1"))
    wait_for(lambda: int(others.rtc.status().counters.get("dropped_gate_unreadable", 0)) >= 600)

    noticed = others.notice(0.3)
    others.close()
    assert not noticed.wrong
    assert pids(run_dir) == before


def pids(run_dir: Path) -> dict[str, int]:
    """Of all but those who come and go by themselves."""
    return {name: row.pid for name, row in processes(run_dir).items() if "template" not in name and "@" not in name}


def test_a_killed_gateway_is_back_and_what_was_open_is_answered(new_key: Callable[[str], Path], run_dir: Path) -> None:
    with Client(run_dir) as here, Client(key=new_key("operator")) as rtc:
        command = rtc.submit("HOLD LEFT-ARM")
        os.kill(pids(run_dir)["gate"], signal.SIGKILL)
        assert here.halt(command.number, timeout_s=LIMIT_S).confirmed
        assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED
        assert rtc.halt(timeout_s=LIMIT_S).confirmed
