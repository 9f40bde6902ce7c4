"""Base of every process of a cluster: start, sockets, event loop, readiness, end.

    with process.start("world", run_dir) as me:
        requests = me.socket(zmq.ROUTER, settings.endpoint("world"), bind=True)
        me.ready()
        while not me.stopping:
            for socket in me.wait(timeout_s=0.5):
                for parts in inbox(socket):
                    ...

SIGTERM, SIGINT and SIGHUP only set `stopping` and wake `wait` (or any poll that holds `me.wake_fd`); the loop ends by
itself.
Logs go to stderr, which the supervisor keeps in the run directory; stdout carries `ready`, from then on, every second
that the loop turns, `alive`, and `note` with what people should know; so the supervisor knows who is there and does
nothing. That nothing outlives a killed supervisor is the business of the parent, who calls `die_with_parent` in the
child it forks (SIGKILL: whoever wants an orderly end sends SIGTERM first; a process that has arms to stop or outcomes
to send calls `Process.end_with_parent`). This file knows no message and no kind of process.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import logging
import os
import signal
import socket as sockets
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import zmq

from rtc.protocol import wire
from rtc.runtime.settings import Bounds

READY, ALIVE, NOTE = b"ready", b"alive", b"note "
BEAT_S = 1.0
IPC = "ipc://"
QUEUE_LENGTH = 10_000  # messages per peer that ZeroMQ holds before it drops (ROUTER, PUB) or says no (DEALER)
LINGER_MS = 200  # how long the last words of a process may take to leave it
RECONNECT_MS, RECONNECT_MAX_MS = 10, 30  # a restarted peer is found again within this
# As plain numbers, and frame by frame: pyzmq's own multipart calls cost several times as much as what they do.
AT_ONCE, MORE = int(zmq.NOBLOCK), int(zmq.NOBLOCK | zmq.SNDMORE)
OPEN_LIMIT_S = 0.2
ORPHANED = signal.SIGUSR1  # not SIGTERM: the dead parent may keep its pid for a moment, while its threads end
PR_SET_PDEATHSIG, PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 1, 15, 36
Secure = Callable[[zmq.Socket[Any]], None] | None  # what is done to a socket before it binds or connects
_libc = ctypes.CDLL(None)  # opened here: between fork and exec as little as can be is done


class Process:
    """One process's sockets, its wake-up call and whether it is to end. Made by `start`; by hand only in tests."""

    def __init__(self, name: str, run_dir: Path) -> None:
        self.name = name
        self.run_dir = run_dir
        self.log = logging.getLogger(name)
        self.stopping = False
        self.context = zmq.Context()
        self._wake_end, self._wake_start = sockets.socketpair()
        for end in (self._wake_end, self._wake_start):
            end.setblocking(False)
        self.wake_fd = self._wake_end.fileno()
        self.poller = zmq.Poller()
        self.poller.register(self.wake_fd, zmq.POLLIN)
        self._beat = Every(BEAT_S)
        self.orphaned = False  # the parent has died since `end_with_parent`
        # That we bind -> endpoint, inode of its file, inode of its directory.
        self._doors: dict[zmq.Socket[bytes], tuple[str, int, int]] = {}
        self._watched = zmq.Poller()  # holds our stdout, once somebody is known to listen there

    def socket(
        self,
        kind: int,
        endpoint: str,
        *,
        bind: bool = False,
        identity: str = "",
        queue_length: int = QUEUE_LENGTH,
        bounds: Bounds | None = None,
        poll: bool = True,
        secure: Secure = None,
        handover: bool = True,
    ) -> zmq.Socket[bytes]:
        """A bounded socket on `endpoint`, watched by `wait` unless `poll` is False. `bounds`: for one that is bound.

        A ROUTER hands an identity over to its newest bearer, so that a restarted process is heard at once; without
        `handover` it stays with the one who has it, and the newer peer is not heard. `secure` sees the socket before
        it binds or connects.
        Raises `zmq.ZMQError` when the endpoint cannot be bound.
        """
        made = open_socket(
            self.context,
            kind,
            endpoint,
            bind=bind,
            identity=identity,
            queue_length=queue_length,
            bounds=bounds,
            secure=secure,
            handover=handover,
        )
        if poll:
            self.poller.register(made, zmq.POLLIN)
        if bind and endpoint.startswith(IPC):
            self._doors[made] = (endpoint, _inode(endpoint), _inode(os.path.dirname(endpoint)))
        return made

    def _keep_doors(self) -> None:
        """Bind again what somebody has deleted, or has put another socket in the place of. Connections stay.

        Not in another directory of the same name: it is not ours, and what is left there keeps `rtc up` out of it.
        """
        if self.stopping:  # the endpoints may be the successor's by now
            return
        for door, (endpoint, inode, directory) in self._doors.items():
            if door.closed or _inode(endpoint) == inode or _inode(os.path.dirname(endpoint)) != directory:
                continue
            with contextlib.suppress(zmq.ZMQError):  # the directory is gone: that is the supervisor's business
                door.bind(endpoint)
                self._doors[door] = (endpoint, _inode(endpoint), directory)
                self.log.warning("%s was not ours any more: bound again", endpoint)

    def open_anew(
        self, old: zmq.Socket[bytes], endpoint: str, bounds: Bounds | None = None, handover: bool = True
    ) -> zmq.Socket[bytes]:
        """Another bound socket of the same kind in place of `old`, with nothing in it; peers come back by themselves.

        Raises `zmq.ZMQError` when the endpoint cannot be bound again within `OPEN_LIMIT_S`.
        """
        kind = int(old.getsockopt(zmq.TYPE))
        self.poller.unregister(old)
        self._doors.pop(old, None)
        old.unbind(endpoint)
        limit_s = now_s() + OPEN_LIMIT_S
        # The old listener removes its file when it closes, in a thread of its own; it must not be the new one's.
        while (path := Path(endpoint.removeprefix("ipc://"))).exists() and now_s() < limit_s:
            time.sleep(0.0002)
        old.close(linger=0)
        path.unlink(missing_ok=True)
        return self.socket(kind, endpoint, bind=True, bounds=bounds, handover=handover)

    def wait(self, timeout_s: float | None = None) -> list[Any]:
        """The sockets with something to read, in the order of their making; none: the time is up, a signal came, or
        another second has passed."""
        if self._watched.sockets:
            self.beat(now := now_s())
            left_s = self._beat.left_s(now)
            timeout_s = left_s if timeout_s is None else min(timeout_s, left_s)
        timeout_ms = None if timeout_s is None else max(0, int(timeout_s * 1000 + 0.999))
        readable = dict(self.poller.poll(timeout_ms))
        if readable.pop(self.wake_fd, 0):
            self.slept_enough()
        return [socket for socket, _ in self.poller.sockets if socket in readable]

    def slept_enough(self) -> None:
        """Empty the wake-up call; for a poll of one's own that found `wake_fd` readable."""
        with contextlib.suppress(BlockingIOError):
            while self._wake_end.recv(4096):
                pass

    def stop(self) -> None:
        """Ask the loop to end and wake it. Safe in a signal handler and from another thread."""
        self.stopping = True
        with contextlib.suppress(OSError):
            self._wake_start.send(b"\0")

    def end_with_parent(self, limit_s: float) -> None:
        """Stop when the parent dies, instead of being killed, and be ended by the kernel `limit_s` after that: for a
        process that has arms to stop or outcomes to send first."""
        signal.signal(ORPHANED, lambda *_: self._stop_orphaned(limit_s))
        _libc.prctl(PR_SET_PDEATHSIG, ORPHANED, 0, 0, 0)

    def _stop_orphaned(self, limit_s: float) -> None:
        end_within(limit_s)  # nobody kills an orphan that hangs
        self.orphaned = True
        self.stop()

    def ready(self) -> None:
        """Tell the supervisor, once, that the sockets are there and work can begin."""
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.write(f"{READY.decode()}\n")
            sys.stdout.flush()
            if stat.S_ISFIFO(os.fstat(sys.stdout.fileno()).st_mode):
                self._watched.register(sys.stdout.fileno(), zmq.POLLOUT)
        self.log.info("ready")

    def note(self, words: str) -> None:
        """Tell people, by the supervisor and `rtc status`, what they should know of this process. One line."""
        self.log.warning("%s", words)
        with contextlib.suppress(OSError):
            os.write(sys.stdout.fileno(), NOTE + words.replace("\n", " ").encode() + b"\n")

    def beat(self, now: float) -> None:
        """Tell the supervisor, every second, that the loop turns; for a loop that does not `wait`. Never blocks: what
        nobody reads is not said."""
        if not self._beat.due(now):
            return
        self._keep_doors()
        if self._watched.poll(0):
            with contextlib.suppress(OSError):
                os.write(sys.stdout.fileno(), ALIVE + b"\n")

    def close(self) -> None:
        self.context.destroy(linger=LINGER_MS)
        self._wake_end.close()
        self._wake_start.close()


@contextlib.contextmanager
def start(name: str, run_dir: Path | str) -> Iterator[Process]:
    """Make this operating system process the cluster's process `name`, until the block ends."""
    os.umask(0o077)  # sockets and files of a cluster are its owner's alone
    log_to_stderr()
    faulthandler.enable()  # a crash inside a C++ library leaves its stack in the log
    me = Process(name, Path(run_dir))
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # as nohup wants it
                signal.signal(number, lambda *_: me.stop())
        # A handler runs only between two bytecodes; the byte written here ends a poll that is under way.
        signal.set_wakeup_fd(me._wake_start.fileno(), warn_on_full_buffer=False)
    try:
        yield me
        me.log.info("ended in order")
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.set_wakeup_fd(-1)
        me.close()


def log_to_stderr(level: int = logging.INFO) -> None:
    """One line per event: time, process, level, text."""
    logging.basicConfig(
        level=level,
        stream=sys.stderr,
        format="%(asctime)s.%(msecs)03d %(name)s %(levelname)s %(message)s",
        datefmt="%H:%M:%S",
    )


def open_socket(
    context: zmq.Context[Any],
    kind: int,
    endpoint: str,
    *,
    bind: bool = False,
    identity: str = "",
    queue_length: int = QUEUE_LENGTH,
    bounds: Bounds | None = None,
    secure: Secure = None,
    handover: bool = True,
) -> zmq.Socket[bytes]:
    """A socket with our limits set: length of its queues, size of a frame, time to linger, pace of reconnecting."""
    made: zmq.Socket[bytes] = context.socket(kind)
    bounds = bounds or Bounds(wire.MAX_BYTES, queue_length, queue_length)
    made.setsockopt(zmq.MAXMSGSIZE, bounds.frame)
    made.setsockopt(zmq.RCVHWM, bounds.unread)
    made.setsockopt(zmq.SNDHWM, bounds.unsent)
    made.setsockopt(zmq.LINGER, LINGER_MS)
    made.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
    made.setsockopt(zmq.RECONNECT_IVL_MAX, RECONNECT_MAX_MS)
    if kind == zmq.ROUTER:
        made.setsockopt(zmq.ROUTER_HANDOVER, int(handover))
    if identity:
        made.setsockopt(zmq.IDENTITY, identity.encode())
    if secure is not None:
        secure(made)
    if bind:
        made.bind(endpoint)
    else:
        made.connect(endpoint)
    return made


def send(socket: zmq.Socket[bytes], message: Any, to: bytes | None = None) -> bool:
    """Put a message on its way (to one peer of a ROUTER), never wait. False: no room in the queue, or no such peer."""
    try:
        if to is not None:
            socket.send(to, MORE)
        socket.send(wire.PROTOCOL, MORE)
        socket.send(wire.encode(message), AT_ONCE)
    except zmq.ZMQError as error:
        if error.errno in (zmq.EAGAIN, zmq.EHOSTUNREACH):
            return False
        raise
    return True


def send_together(socket: zmq.Socket[bytes], messages: Sequence[Any], to: bytes) -> None:
    """Put the messages of one turn for one peer of a ROUTER on their way, as arrays; the peer reads these. What finds
    no room is dropped, as by `send`."""
    for protocol, body in wire.together(messages):
        try:
            socket.send(to, MORE)
            socket.send(protocol, MORE)
            socket.send(body, AT_ONCE)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EAGAIN, zmq.EHOSTUNREACH):
                raise


def inbox(socket: zmq.Socket[bytes], limit: int = 1000) -> Iterator[Sequence[bytes]]:
    """The messages that lie ready, as their frames; at most `limit`, so that no peer can keep a loop to itself."""
    for _ in range(limit):
        try:
            first = socket.recv(AT_ONCE, copy=False)
        except zmq.Again:
            return
        yield _frames(socket, first)


def _frames(socket: zmq.Socket[bytes], part: zmq.Frame) -> list[bytes]:
    """A message as its frames, of which the first has been read."""
    parts = [part.bytes]
    while part.more:
        part = socket.recv(AT_ONCE, copy=False)
        parts.append(part.bytes)
    return parts


def _inode(endpoint: str) -> int:
    """Of the file of an ipc endpoint, or of a directory in one; 0 when there is none."""
    try:
        return os.stat(endpoint.removeprefix(IPC)).st_ino
    except OSError:
        return 0


class Reconnections:
    """Tells when the peer of a connecting socket was found again: most likely it is a new process, and knows us not."""

    def __init__(self, me: Process, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket
        self._monitor = socket.get_monitor_socket(zmq.EVENT_HANDSHAKE_SUCCEEDED)
        self._first = True
        me.poller.register(self._monitor, zmq.POLLIN)

    def happened(self) -> bool:
        """True once after every time but the first."""
        found = sum(1 for _ in inbox(self._monitor))
        again, self._first = found > (1 if self._first else 0), self._first and not found
        return again

    def close(self) -> None:
        """Before the socket's context ends: the monitor would hold that up."""
        self._socket.disable_monitor()
        self._monitor.close(linger=0)


class Every:
    """A period: `due(now)` is true once per period, and never twice in a row to catch up."""

    def __init__(self, period_s: float, first_at_s: float = 0.0) -> None:
        self.period_s = period_s
        self._next_s = first_at_s

    def due(self, now_s: float) -> bool:
        if now_s < self._next_s:
            return False
        self._next_s = now_s + self.period_s
        return True

    def left_s(self, now_s: float) -> float:
        """How long to wait for the next time; never negative."""
        return max(0.0, self._next_s - now_s)


def now_s() -> float:
    """CLOCK_MONOTONIC, in which all `_at_s` of messages are given."""
    return time.monotonic()


def nice(by: int) -> bool:
    """Make this process yield more (by > 0) or less (by < 0, needs leave) than others. Best effort."""
    try:
        os.nice(by)
    except OSError:
        return False
    return True


def come_first(rank: int, niceness: int) -> str:
    """Be served before whoever may wait, as far as the system gives leave: with a real-time priority, or else a
    better niceness. Among those of real time a higher `rank` comes first. Children begin without it. In words."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(rank))
        return f"real-time, rank {rank}"
    return f"niceness {niceness}" if nice(niceness) else "no leave for a better priority"


def freeze_heap() -> None:
    """Take all that is imported and built so far out of the garbage collector's rounds, and make these rare: what a
    loop makes is freed when nobody refers to it any more, and seldom goes in circles."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def adopt_orphans() -> None:
    """Become the parent of processes that a child of ours forks away, so that we can wait for them."""
    _libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def show_name(name: str) -> None:
    """What `top` and `ps -o comm` call this process (15 bytes)."""
    _libc.prctl(PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(parent: int) -> None:
    """In a child just forked by `parent`'s main thread: let the kernel kill it when the parent dies. Survives exec."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it died between fork and prctl
        os._exit(1)


def end_within(limit_s: float) -> None:
    """Let the kernel end this process after `limit_s`, whatever it is doing then."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
