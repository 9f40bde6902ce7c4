"""Halts and the end of a cluster, judged by telemetry: what the joints do, never what is reported of them.

Real processes, the exact arm in real time. The messages are those of docs/protocol.md; plain sockets stand for clients
of others.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import pytest
import zmq

from deploy import cluster
from rtc.client.client import Client
from rtc.client.handle import CommandHandle
from rtc.protocol.outcomes import NoCluster, OutcomeKind
from rtc.runtime import process_table
from rtc.runtime.settings import ENDPOINTS

pytestmark = pytest.mark.slow

LIMIT_S = 90.0
REST_RAD_S = 0.005


class Running:
    """A cluster, a client, and what telemetry shows."""

    def __init__(self, run_dir: Path, mcm: str = "kinematic") -> None:
        self.run_dir = run_dir
        command = [sys.executable, "-m", "rtc.apps.cli.entry", "up", "--mcm", mcm, "--run-dir", str(run_dir)]
        self.supervisor = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
        assert self.supervisor.stdout is not None
        assert any(line.startswith("ready in") for line in self.supervisor.stdout), "it did not come up"
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._telemetry = self.context.socket(zmq.SUB)
        self._telemetry.subscribe(b"")
        self._telemetry.connect(self._endpoint("telemetry"))
        self.client = Client(run_dir)
        self._way = 1

    def _endpoint(self, name: str) -> str:
        return f"ipc://{self.run_dir / ENDPOINTS[name]}"

    def endpoint(self, name: str, identity: str = "") -> zmq.Socket[bytes]:
        """A socket, as any client opens it."""
        made = self.context.socket(zmq.DEALER)
        if identity:
            made.setsockopt(zmq.IDENTITY, identity.encode())
        made.connect(self._endpoint(name))
        return made

    def speed(self) -> float:
        """Of the fastest joint, in the next sample that is not old. Raises AssertionError when there is none."""
        asked_s = time.monotonic()
        while self._telemetry.poll(2000):
            rest = msgpack.unpackb(self._telemetry.recv_multipart()[-1])
            if rest["at_s"] >= asked_s:
                return fastest(rest)
        raise AssertionError("no telemetry")

    def last_speed(self) -> float:
        """In the last sample before telemetry ended."""
        last = None
        while self._telemetry.poll(2000):
            last = msgpack.unpackb(self._telemetry.recv_multipart()[-1])
        assert last is not None
        return fastest(last)

    def processes(self) -> list[int]:
        """A pidfd of each that the supervisor has started."""
        return [os.pidfd_open(row.pid) for row in process_table.processes(self.run_dir).values() if row.pid]

    def moving(self) -> CommandHandle:
        """Begin a motion that takes ten seconds; the command, once a joint moves."""
        self._way = -self._way
        command = self.client.submit(f"MOVE RIGHT-ARM BY {20 * self._way} CM ALONG X MAINTAIN SPEED 2 CM/S")
        until(lambda: self.speed() > 0.03)
        return command

    def close(self) -> None:
        self.client.close()
        self.context.destroy(linger=0)
        with contextlib.suppress(NoCluster):
            cluster.down(self.run_dir)
        self.supervisor.wait(LIMIT_S)
        assert self.supervisor.stdout is not None
        self.supervisor.stdout.close()


def all_ended(pidfds: list[int]) -> bool:
    return set(select.select(pidfds, [], [], 0.0)[0]) == set(pidfds)


def fastest(rest: dict) -> float:
    return max(abs(v) for arm in rest["arms"].values() for v in arm["velocities"])


def until(done: Callable[[], bool], limit_s: float = 20.0) -> None:
    end_s = time.monotonic() + limit_s
    while not done():
        assert time.monotonic() < end_s, "it does not come to that"


def send(endpoint: zmq.Socket[bytes], **message: object) -> None:
    endpoint.send_multipart([b"RTC1", msgpack.packb(message)])


def recv(endpoint: zmq.Socket[bytes], limit_s: float = 3.0) -> dict | None:
    return msgpack.unpackb(endpoint.recv_multipart()[-1]) if endpoint.poll(limit_s * 1000) else None


def recv_rest(endpoint: zmq.Socket[bytes]) -> dict:
    """The last answer to one halt."""
    while (answer := recv(endpoint)) is not None:
        if answer["type"] in ("HaltAtRest", "Declined"):
            return answer
    raise AssertionError("no answer")


@pytest.fixture(scope="module")
def running(tmp_path_factory) -> Iterator[Running]:
    made = Running(tmp_path_factory.mktemp("h"))
    yield made
    made.close()


def stops(running: Running, press: Callable[[], None]) -> None:
    """Given a motion, when it is halted, the arm stands still soon, and its command ends halted."""
    command = running.moving()
    press()
    until(lambda: running.speed() < REST_RAD_S, limit_s=1.0)
    assert command.wait(20).outcome.kind is OutcomeKind.HALTED


@pytest.mark.parametrize("endpoints", [["estop"], ["halt"], ["halt", "estop"]], ids="+".join)
def test_a_button_that_always_says_the_same_stops_the_arm_at_every_press(
    running: Running, endpoints: list[str]
) -> None:
    opened = [running.endpoint(name) for name in endpoints]

    def press() -> None:
        for endpoint in opened:
            send(endpoint, type="HaltOrder", halt="THE-BUTTON", scope="ALL", called_at_s="soon")
        for endpoint in opened:
            rest = recv_rest(endpoint)
            assert running.speed() < REST_RAD_S or not rest["at_rest"]
            assert set(rest["performers"]) == {"RIGHT-ARM", "LEFT-ARM"}

    for _ in range(3):
        stops(running, press)


def test_a_paused_motion_stands_on_its_path_and_goes_on(running: Running) -> None:
    """By sentences, in the only step of a command; a halt of a paused motion ends it."""
    command = running.moving()
    assert running.client.run("PAUSE RIGHT-ARM", timeout_s=20).outcome.kind is OutcomeKind.SUCCEEDED
    until(lambda: running.speed() < REST_RAD_S)
    (mcm,) = [row for row in running.client.status().subsystems if row.name == "MCM"]
    assert [name.partition("@")[0] for name in mcm.executing] == [f"{command}.1"]
    assert running.client.run("RESUME RIGHT-ARM", timeout_s=20).outcome.kind is OutcomeKind.SUCCEEDED
    until(lambda: running.speed() > 0.03)
    assert running.client.run(f"PAUSE {command}", timeout_s=20).outcome.kind is OutcomeKind.SUCCEEDED
    until(lambda: running.speed() < REST_RAD_S)
    running.client.halt()
    assert command.wait(20).outcome.kind is OutcomeKind.HALTED


def test_two_clients_of_one_name_are_each_served_and_answered(running: Running) -> None:
    with Client(running.run_dir, name="panel") as first:
        with Client(running.run_dir, name="panel") as second:
            assert first.status().cluster == second.status().cluster
            stops(running, lambda: second.halt())
            stops(running, lambda: first.halt())
        assert first.status().commands_live == 0
        stops(running, lambda: first.halt())


def test_a_client_whose_identity_another_takes_is_still_answered(running: Running) -> None:
    first, second = (running.endpoint("front", identity="panel"), running.endpoint("front", identity="panel"))
    for rest in range(3):
        send(first, type="StatusQuery", request=str(rest))
        answer = recv(first)
        assert answer is not None
        assert answer["request"] == str(rest)
        send(second, type="ClientHello", client="panel")
        if rest == 1:
            second.close(linger=0)
            second = running.endpoint("front")
    first.close(linger=0)
    until(lambda: _welcome(running))  # its bearer has gone


def _welcome(running: Running) -> bool:
    """A new connection each time: one that comes while the identity is still in use is never accepted."""
    endpoint = running.endpoint("front", identity="panel")
    send(endpoint, type="ClientHello", client="panel")
    answer = recv(endpoint, 0.2)
    endpoint.close(linger=0)
    return answer is not None


@pytest.mark.parametrize("endpoint", ["halt", "estop"])
def test_who_takes_an_identity_that_is_in_use_does_not_silence_its_bearer(running: Running, endpoint: str) -> None:
    first = running.endpoint(endpoint, identity="panel")
    send(first, type="HaltOrder", halt="1", scope="LEFT-ARM", called_at_s=0.0)
    assert recv_rest(first)["at_rest"]
    second = running.endpoint(endpoint, identity="panel")
    send(second, type="HaltOrder", halt="1", scope="LEFT-ARM", called_at_s=0.0)
    for _ in range(2):
        stops(running, lambda: send(first, type="HaltOrder", halt=uuid.uuid4().hex, scope="ALL", called_at_s=0.0))
        second.close(linger=0)
    first.close(linger=0)


def test_rtc_halt_needs_nothing_but_the_two_sockets(running: Running, tmp_path: Path) -> None:
    for endpoint in ("halt", "estop"):
        (tmp_path / ENDPOINTS[endpoint]).symlink_to(running.run_dir / ENDPOINTS[endpoint])

    def press() -> None:
        command = [sys.executable, "-P", "-m", "rtc.apps.cli.main", "halt", "--run-dir", str(tmp_path)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "RIGHT-ARM decelerating" in done.stdout

    stops(running, press)


# --- the end of a cluster ------------------------------------------------------------------------------

ENDS = {
    "down": lambda running: print(cluster.down(running.run_dir)[1]),  # sends SIGTERM
    "SIGINT": lambda running: running.supervisor.send_signal(signal.SIGINT),
    "SIGKILL": lambda running: running.supervisor.kill(),
}


@pytest.mark.parametrize("how", ENDS)
def test_a_cluster_that_ends_brakes_its_arms_and_tells_its_clients(how: str, tmp_path_factory, capsys) -> None:
    running = Running(tmp_path_factory.mktemp("e"))
    command = running.moving()
    waiting = running.client.submit("MOVE RIGHT-ARM BY 1 CM ALONG X")
    ended: list[OutcomeKind] = []

    def wait() -> None:
        for one in (command, waiting):
            ended.append(one.wait(20).outcome.kind)

    client = threading.Thread(target=wait, daemon=True)
    client.start()
    processes = running.processes()
    ENDS[how](running)
    assert running.last_speed() < REST_RAD_S
    client.join(20)
    assert ended == [OutcomeKind.HALTED] * 2
    if how == "down":
        assert capsys.readouterr().out == f"halted: {command}, {waiting}; stopped: RIGHT-ARM\n"
    assert running.supervisor.wait(LIMIT_S) == (-signal.SIGKILL if how == "SIGKILL" else 0)
    assert all_ended(processes)
    for process in processes:
        os.close(process)
    running.close()


def test_a_cluster_that_ends_brakes_in_physics_too(tmp_path_factory) -> None:
    running = Running(tmp_path_factory.mktemp("b"), mcm="bullet")
    running.moving()
    button = running.endpoint("estop")
    for _ in range(2):
        send(button, type="HaltOrder", halt="THE-BUTTON", scope="ALL", called_at_s=True)
        assert recv_rest(button)["at_rest"]
        assert running.speed() < 0.02
        running.moving()
    os.kill(running.supervisor.pid, signal.SIGTERM)
    assert running.last_speed() < 0.02
    running.close()
