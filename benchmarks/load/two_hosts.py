"""Two hosts on one machine: network namespaces and a link between them with a delay of our own. Needs root.

    with two_hosts(delay_s=0.05, jitter_s=0.02) as hosts:
        with inside(hosts.near):
            ...a process that is started here listens at hosts.address...
        hosts.cut()

The link is a pair of tun devices. The process of this module passes packets from one to the other, so TCP runs from end
to end. Namespaces have no names: they and the link disappear with the processes that use them.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import random
import select
import signal
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import workers.__main__
from rtc.protocol.messages import WorkerKind
from rtc.protocol.roles import Role
from rtc.runtime.keys import KeyRing
from workers.runtime import lazy_import
from workers.runtime.preload import preload

ROOT = Path(__file__).parents[2]  # this package is not installed: it is found in the working directory only
CLONE_NEWNET = 0x40000000
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
TUN = "/dev/net/tun"
NEAR, FAR, PORT = "10.77.0.1", "10.77.0.2", 5555  # the same in each pair of namespaces
ADDRESS = f"tcp://{NEAR}:{PORT}"
DEVICE = "link0"
PACKET = 65_536  # bytes, maximum
HIGH_PRIORITY = -10  # niceness of the link: it stands for hardware
LOST_AFTER_S = 60.0  # a worker without its broker ends only then: no engine would start it again here
_libc = ctypes.CDLL(None, use_errno=True)


class Unavailable(Exception):
    """This process may not make network namespaces or tun devices; the text states the reason."""


@dataclass
class TwoHosts:
    """`near`, `far`: file descriptors of the namespaces."""

    near: int
    far: int
    address: str = ADDRESS
    workers: dict[str, int] = field(default_factory=dict)  # at the far host: name -> pid
    _processes: dict[int, subprocess.Popen[bytes]] = field(default_factory=dict)  # by pid; forked ones are not here
    _server: subprocess.Popen[bytes] | None = None  # forks workers at the far host

    def cut(self) -> None:
        """Cut the link: the far end goes down, the near end notices nothing."""
        with inside(self.far):
            _ip("link", "set", DEVICE, "down")

    def restore(self) -> None:
        with inside(self.far):
            _ip("link", "set", DEVICE, "up")

    def start_workers(self, run_dir: Path, nodes: Sequence[int]) -> list[str]:
        """Start a worker of the cluster in `run_dir` for each of these nodes on the far host; returns their names."""
        names = []
        for node in nodes:
            name = _name(node)
            with inside(self.far), open(run_dir / "far.log", "ab") as log:
                process = subprocess.Popen(
                    [sys.executable, "-P", "-m", "workers", *_options(node, self._key(run_dir))],
                    stdout=subprocess.DEVNULL,
                    stderr=log,
                )
            self.workers[name] = process.pid
            self._processes[process.pid] = process
            names.append(name)
        return names

    def fork_worker(self, run_dir: Path, node: int) -> str:
        """The same, forked from a process that has imported everything: much faster. Returns its name."""
        if self._server is None:
            command = [sys.executable, "-m", __name__, "workers", str(self._key(run_dir).absolute())]
            with inside(self.far), open(run_dir / "far.log", "ab") as log:
                pipe = subprocess.PIPE
                self._server = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=log, cwd=ROOT)
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(f"{node}\n".encode())
        self._server.stdin.flush()
        self.workers[_name(node)] = int(self._server.stdout.readline())
        return _name(node)

    def kill(self, name: str) -> float:
        """Kill a worker of the far host; returns the time (CLOCK_MONOTONIC).

        Its threads get real-time priority for their end, if permitted. Another host has cores of its own; here a dying
        process would wait for one before the kernel closes its connections.
        """
        pid = self.workers.pop(name)
        with contextlib.suppress(OSError):
            for thread in os.listdir(f"/proc/{pid}/task"):
                os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(1))
        at_s = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        if process := self._processes.pop(pid, None):
            process.wait()
        return at_s

    def close(self) -> None:
        """Kill all workers of the far host."""
        for name in list(self.workers):
            self.kill(name)
        if self._server is not None:
            self._server.communicate()  # closes its input, and it ends

    def _key(self, run_dir: Path) -> Path:
        key = run_dir / "far.key"
        if not key.exists():
            KeyRing(run_dir).new("far", Role.WORKER, self.address, key)
        return key


@contextlib.contextmanager
def two_hosts(delay_s: float = 0.0, jitter_s: float = 0.0) -> Iterator[TwoHosts]:
    """Two namespaces and their link, which delays each packet by `delay_s` +- `jitter_s` and keeps the order.

    Workers of the far host are killed at the end. Raises Unavailable."""
    with contextlib.ExitStack() as stack:
        near, far = (stack.enter_context(_namespace()) for _ in range(2))
        stack.enter_context(_link(near, far, delay_s, jitter_s))
        hosts = TwoHosts(near, far)
        try:
            yield hosts
        finally:
            hosts.close()


@contextlib.contextmanager
def inside(namespace: int) -> Iterator[None]:
    """Processes that this thread starts in the block are in the namespace. Files and Unix sockets are shared."""
    before = _current()
    try:
        _call(_libc.setns, namespace, CLONE_NEWNET)
        yield
    finally:
        _call(_libc.setns, before, CLONE_NEWNET)
        os.close(before)


@contextlib.contextmanager
def _namespace() -> Iterator[int]:
    """A new network namespace, as a file descriptor."""
    before = _current()
    try:
        _call(_libc.unshare, CLONE_NEWNET)
        made = _current()
        _ip("link", "set", "lo", "up")
    finally:
        _call(_libc.setns, before, CLONE_NEWNET)
        os.close(before)
    try:
        yield made
    finally:
        os.close(made)


@contextlib.contextmanager
def _link(near: int, far: int, delay_s: float, jitter_s: float) -> Iterator[None]:
    command = [sys.executable, "-m", __name__, "link", str(delay_s), str(jitter_s)]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, cwd=ROOT)
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        devices = process.stdout.readline().decode().split()
        if len(devices) != 2:
            why = process.stderr.read().decode().strip()
            if why.startswith(TUN):
                raise Unavailable(why)
            raise RuntimeError(f"the link between the hosts did not start: {why}")
        for device, namespace, address in zip(devices, (near, far), (NEAR, FAR), strict=True):
            _ip("link", "set", device, "netns", f"/proc/{os.getpid()}/fd/{namespace}", "name", DEVICE)
            with inside(namespace):
                _ip("address", "add", f"{address}/30", "dev", DEVICE)
                _ip("link", "set", DEVICE, "up")
        yield
    finally:
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout, process.stderr):
            stream.close()


def _current() -> int:
    return os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)


def _call(function: Any, *arguments: int) -> None:
    if function(*arguments) != 0:
        raise Unavailable(f"network namespaces: {os.strerror(ctypes.get_errno())}")


def _ip(*words: str) -> None:
    try:
        done = subprocess.run(["ip", *words], capture_output=True, text=True)
    except FileNotFoundError:
        raise Unavailable("the command `ip` (iproute2) is not installed") from None
    if done.returncode:
        raise Unavailable(f"ip {' '.join(words)}: {done.stderr.strip()}")


def _name(node: int) -> str:
    return f"{list(WorkerKind)[node & 3]}@{node}"


def _options(node: int, key: Path) -> list[str]:
    kind, lost_after = list(WorkerKind)[node & 3], f"{LOST_AFTER_S:g}"
    return ["--kind", kind, "--node", str(node), "--with", str(key), "--lost-after", lost_after]


# --- processes of this module --------------------------------------------------------------------------


def main() -> None:
    what, *given = sys.argv[1:]
    if what == "link":
        pass_packets(float(given[0]), float(given[1]))
    else:
        fork_workers(Path(given[0]))


def fork_workers(key: Path) -> None:
    """Fork a worker for each line of stdin, which is its node, and print its pid."""
    preload(WorkerKind, cell=None)
    for module in (*WorkerKind, "workers.planning.robot_models"):
        lazy_import.load(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel reaps
    for line in iter(sys.stdin.readline, ""):
        if (pid := os.fork()) == 0:
            sys.argv = ["workers", *_options(int(line), key)]
            os.dup2(os.open(os.devnull, os.O_RDWR), 0)
            os.dup2(0, 1)
            workers.__main__.main()
            os._exit(0)
        print(pid, flush=True)


def pass_packets(delay_s: float, jitter_s: float) -> None:
    """Pass packets between two new tun devices until stdin is closed."""
    with contextlib.suppress(OSError):
        os.nice(HIGH_PRIORITY)
    try:
        devices = [_tun(), _tun()]
    except OSError as error:
        raise SystemExit(f"{TUN}: {error.strerror}") from None
    (one, name), (other, other_name) = devices
    print(name, other_name, flush=True)
    relay(one, other, delay_s, jitter_s, random.Random(1))


def _tun() -> tuple[int, str]:
    """(file descriptor, name) of a new tun device."""
    device = os.open(TUN, os.O_RDWR | os.O_NONBLOCK)
    request = fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", b"rtc%d", IFF_TUN | IFF_NO_PI))
    return device, request[:16].rstrip(b"\0").decode()


def relay(one: int, other: int, delay_s: float, jitter_s: float, rng: random.Random) -> None:
    """Pass packets both ways, each after its delay and in order."""
    peer = {one: other, other: one}
    under_way: dict[int, deque[tuple[float, bytes]]] = {one: deque(), other: deque()}  # by receiver: (due, packet)
    while True:
        due = [packets[0][0] for packets in under_way.values() if packets]
        wait_s = max(0.0, min(due) - time.monotonic()) if due else None
        readable, _, _ = select.select([0, *peer], [], [], wait_s)
        if 0 in readable:
            return
        for device in readable:
            packets = under_way[peer[device]]
            with contextlib.suppress(OSError):
                while True:
                    packet = os.read(device, PACKET)
                    at_s = time.monotonic() + delay_s + rng.uniform(-jitter_s, jitter_s)
                    packets.append((max(at_s, packets[-1][0]) if packets else at_s, packet))
        for device, packets in under_way.items():
            while packets and packets[0][0] <= time.monotonic():
                with contextlib.suppress(OSError):  # a device that is down: the packet is lost
                    os.write(device, packets.popleft()[1])


if __name__ == "__main__":
    main()
