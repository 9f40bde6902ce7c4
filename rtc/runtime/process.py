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
Logs go to stderr, which the supervisor writes to a file in the run directory. Stdout carries `ready` once, then `alive`
every second while the loop runs, `note` lines with messages for people, and `calls` lines with code of packages that
may end the process. From these the supervisor knows which
processes are ready and which one hangs. The parent calls `die_with_parent` in each child that it forks, so that the
kernel kills the child with its parent. A process with arms to stop or outcomes to send calls `Process.end_with_parent`
instead. This module knows neither messages nor kinds of processes.
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
from typing import Any, NoReturn, TypedDict, Unpack

import zmq

from rtc.protocol import wire
from rtc.runtime import time_limit
from rtc.runtime.priority import may_be_real_time
from rtc.runtime.settings import SocketBounds

READY, ALIVE, NOTE, CALLS = b"ready", b"alive", b"note ", b"calls "
BEAT_S = 1.0
IPC = "ipc://"
QUEUE_LENGTH = (
    10_000  # messages per peer that ZeroMQ queues; then it drops (ROUTER, PUB) or refuses (DEALER) further ones
)
LINGER_MS = 200  # time limit for sending the rest of the queues at the end
RECONNECT_MS, RECONNECT_MAX_MS = 10, 30  # interval of connecting again to a restarted peer
# Plain numbers, and frames sent one by one: pyzmq's multipart calls and flag enums cost several times as much.
AT_ONCE, MORE = int(zmq.NOBLOCK), int(zmq.NOBLOCK | zmq.SNDMORE)
EVENTS, READABLE = int(zmq.EVENTS), int(zmq.POLLIN)
OPEN_LIMIT_S = 0.2
ORPHANED = signal.SIGCONT  # it continues a stopped process, which could not end otherwise
PR_SET_PDEATHSIG, PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 1, 15, 36
CLOCK_TICKS_HZ = os.sysconf("SC_CLK_TCK")
Secure = Callable[[zmq.Socket[Any]], None] | None  # sets the keys of a socket before it binds or connects
_libc = ctypes.CDLL(None)  # opened at import: between fork and exec little may be done


class SocketOptions(TypedDict, total=False):
    """How to open a socket; none need be stated."""

    bind: bool  # else it connects
    identity: str
    queue_length: int
    bounds: SocketBounds | None  # limits per peer of a bound socket
    secure: Secure  # called with the socket before it binds or connects
    # A ROUTER gives an identity to the newest peer that uses it, so a restarted process is served at once (the
    # default); if False, the older peer keeps the identity.
    handover: bool


class Process:
    """Sockets, wake-up pipe and stop flag of one process. Made by `start`; directly only in tests."""

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
        # bound socket -> endpoint, inode of its file, inode of its directory
        self._bound: dict[zmq.Socket[bytes], tuple[str, int, int]] = {}
        self._watched = zmq.Poller()  # holds our stdout if it is a pipe to a supervisor

    def socket(
        self, kind: int, endpoint: str, *, poll: bool = True, **options: Unpack[SocketOptions]
    ) -> zmq.Socket[bytes]:
        """A socket of `open_socket`, polled by `wait` unless `poll` is False."""
        made = open_socket(self.context, kind, endpoint, **options)
        if poll:
            self.poller.register(made, zmq.POLLIN)
        if options.get("bind") and endpoint.startswith(IPC):
            self._bound[made] = (endpoint, _inode(endpoint), _inode(os.path.dirname(endpoint)))
        return made

    def _rebind_lost(self) -> None:
        """Bind an endpoint again if its file was deleted or replaced. Existing connections stay.

        Not if the directory was replaced. The new one belongs to another cluster, and a socket of ours in it would keep
        `rtc up` from using it.
        """
        if self.stopping:  # the endpoints may already belong to the successor
            return
        for socket, (endpoint, inode, directory) in self._bound.items():
            if socket.closed or _inode(endpoint) == inode or _inode(os.path.dirname(endpoint)) != directory:
                continue
            with contextlib.suppress(zmq.ZMQError):  # the directory is gone: the supervisor acts on that
                socket.bind(endpoint)
                self._bound[socket] = (endpoint, _inode(endpoint), directory)
                self.log.warning("the file of %s was deleted or replaced: bound again", endpoint)

    def reopen(
        self, old: zmq.Socket[bytes], endpoint: str, bounds: SocketBounds | None = None, handover: bool = True
    ) -> zmq.Socket[bytes]:
        """A new, empty bound socket of the same kind in place of `old`; its peers reconnect by themselves.

        Raises `zmq.ZMQError` when the endpoint cannot be bound again within `OPEN_LIMIT_S`.
        """
        kind = int(old.getsockopt(zmq.TYPE))
        self.poller.unregister(old)
        self._bound.pop(old, None)
        old.unbind(endpoint)
        limit_s = now_s() + OPEN_LIMIT_S
        # The old listener removes its file when it closes, in a thread of its own; it must not be the new one's.
        while (path := Path(endpoint.removeprefix("ipc://"))).exists() and now_s() < limit_s:
            time.sleep(0.0002)
        old.close(linger=0)
        path.unlink(missing_ok=True)
        return self.socket(kind, endpoint, bind=True, bounds=bounds, handover=handover)

    def wait(self, timeout_s: float | None = None) -> list[Any]:
        """The readable sockets, in the order of their creation.

        Empty after `timeout_s`, at a signal, or when the next heartbeat to the supervisor is due.
        """
        if self._watched.sockets:
            self.beat(now := now_s())
            left_s = self._beat.left_s(now)
            timeout_s = left_s if timeout_s is None else min(timeout_s, left_s)
        timeout_ms = None if timeout_s is None else max(0, int(timeout_s * 1000 + 0.999))
        readable = dict(self.poller.poll(timeout_ms))
        if readable.pop(self.wake_fd, 0):
            self.clear_wake_up()
        return [socket for socket, _ in self.poller.sockets if socket in readable]

    def clear_wake_up(self) -> None:
        """Empty the wake-up pipe, after a poll that found `wake_fd` readable."""
        with contextlib.suppress(BlockingIOError):
            while self._wake_end.recv(4096):
                pass

    def stop(self) -> None:
        """Ask the loop to end and wake it. Safe in a signal handler and from another thread."""
        self.stopping = True
        with contextlib.suppress(OSError):
            self._wake_start.send(b"\0")

    def end_with_parent(self, limit_s: float) -> None:
        """When the parent dies, stop in order instead of being killed; the kernel ends the process `limit_s` later.

        For a process that must first stop arms or send outcomes.
        """
        parent = os.getppid()
        signal.signal(ORPHANED, lambda *_: self._stop_orphaned(parent, limit_s))
        _libc.prctl(PR_SET_PDEATHSIG, ORPHANED, 0, 0, 0)

    def _stop_orphaned(self, parent: int, limit_s: float) -> None:
        if os.getppid() == parent:  # continued by a person; or the parent's threads end, and the last one signals again
            return
        end_within(limit_s)  # an orphan that hangs has no supervisor to kill it
        self.orphaned = True
        self.stop()

    def ready(self) -> None:
        """Report to the supervisor, once, that the sockets exist and work can begin."""
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.write(f"{READY.decode()}\n")
            sys.stdout.flush()
            if stat.S_ISFIFO(os.fstat(sys.stdout.fileno()).st_mode):
                self._watched.register(sys.stdout.fileno(), zmq.POLLOUT)
        self.log.info("ready")

    def note(self, words: str) -> None:
        """Show one line about this process to people, through the supervisor and `rtc status`."""
        self.log.warning("%s", words)
        with contextlib.suppress(OSError):
            os.write(sys.stdout.fileno(), NOTE + words.replace("\n", " ").encode() + b"\n")

    def calls(self, name: str) -> None:
        """Tell the supervisor what code of an installed package is about to run: it may end the process at once."""
        if self._watched.poll(0):
            with contextlib.suppress(OSError):
                os.write(sys.stdout.fileno(), CALLS + name.encode() + b"\n")

    def beat(self, now: float) -> None:
        """Report to the supervisor, every second, that the loop runs. Never blocks: skipped if the pipe is full.

        `wait` calls it; a loop that does not `wait` calls it itself.
        """
        if not self._beat.due(now):
            return
        self._rebind_lost()
        if self._watched.poll(0):
            with contextlib.suppress(OSError):
                os.write(sys.stdout.fileno(), ALIVE + b"\n")

    def close(self) -> None:
        self.context.destroy(linger=LINGER_MS)
        self._wake_end.close()
        self._wake_start.close()


@contextlib.contextmanager
def start(name: str, run_dir: Path | str) -> Iterator[Process]:
    """Make this operating system process the cluster's process `name`, until the block ends.

    In a thread other than the main one the process belongs to another program, and keeps its signal handlers and its
    umask. `Process.stop` ends the loop.
    """
    log_to_stderr()
    me = Process(name, Path(run_dir))
    if threading.current_thread() is threading.main_thread():
        os.umask(0o077)  # sockets and files of a cluster are its owner's alone
        time_limit.install()
        faulthandler.enable()  # a crash inside a C++ library leaves its stack in the log
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
    context: zmq.Context[Any], kind: int, endpoint: str, **options: Unpack[SocketOptions]
) -> zmq.Socket[bytes]:
    """A socket with limits: length of its queues, size of a frame, time to linger, interval of reconnecting.

    Raises `zmq.ZMQError` when the endpoint cannot be bound.
    """
    made: zmq.Socket[bytes] = context.socket(kind)
    length = options.get("queue_length", QUEUE_LENGTH)
    bounds = options.get("bounds") or SocketBounds(wire.MAX_BYTES, length, length)
    made.setsockopt(zmq.MAXMSGSIZE, bounds.frame)
    made.setsockopt(zmq.RCVHWM, bounds.unread)
    made.setsockopt(zmq.SNDHWM, bounds.unsent)
    made.setsockopt(zmq.LINGER, LINGER_MS)
    made.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
    made.setsockopt(zmq.RECONNECT_IVL_MAX, RECONNECT_MAX_MS)
    if kind == zmq.ROUTER:
        made.setsockopt(zmq.ROUTER_HANDOVER, int(options.get("handover", True)))
    if identity := options.get("identity"):
        made.setsockopt(zmq.IDENTITY, identity.encode())
    if (secure := options.get("secure")) is not None:
        secure(made)
    if options.get("bind"):
        made.bind(endpoint)
    else:
        made.connect(endpoint)
    return made


def send(socket: zmq.Socket[bytes], message: Any, to: bytes | None = None) -> bool:
    """Queue a message for sending (to one peer of a ROUTER); never wait. False: the queue is full, or no such peer."""
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
    """Queue the messages of one batch for one peer of a ROUTER, as arrays; without room they are dropped."""
    for protocol, body in wire.together(messages):
        try:
            socket.send(to, MORE)
            socket.send(protocol, MORE)
            socket.send(body, AT_ONCE)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EAGAIN, zmq.EHOSTUNREACH):
                raise


def inbox(socket: zmq.Socket[bytes], limit: int = 1000) -> Iterator[Sequence[bytes]]:
    """The received messages, as frames; at most `limit`, so that one busy peer cannot block the loop."""
    for n in range(limit):
        if n and not int(socket.getsockopt(EVENTS)) & READABLE:  # cheaper than a receive without a message
            return
        try:
            first = socket.recv(AT_ONCE, copy=False)
        except zmq.Again:
            return
        yield _frames(socket, first)


def _frames(socket: zmq.Socket[bytes], part: zmq.Frame) -> list[bytes]:
    """All frames of a message whose first one has been read."""
    parts = [part.bytes]
    while part.more:
        part = socket.recv(AT_ONCE, copy=False)
        parts.append(part.bytes)
    return parts


def _inode(endpoint: str) -> int:
    """The inode of the file of an ipc endpoint, or of a directory; 0 if there is none."""
    try:
        return os.stat(endpoint.removeprefix(IPC)).st_ino
    except OSError:
        return 0


class Disconnections:
    """Detects that a bound socket has lost a peer. The event does not name the peer, and it is sent shortly before a
    send to that peer fails."""

    def __init__(self, me: Process, socket: zmq.Socket[bytes]) -> None:
        self._me, self._socket = me, socket
        self._monitor = socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        me.poller.register(self._monitor, zmq.POLLIN)

    def happened(self) -> bool:
        """True once after one or more disconnections."""
        return sum(1 for _ in inbox(self._monitor)) > 0

    def close(self) -> None:
        """Must be called before the socket is closed."""
        self._me.poller.unregister(self._monitor)
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
        """The time until the next call is due (s); never negative."""
        return max(0.0, self._next_s - now_s)


def now_s() -> float:
    """Time of CLOCK_MONOTONIC (s), used for all `_at_s` fields of messages."""
    return time.monotonic()


def usage(pid: int) -> tuple[str, float]:
    """State of a process (proc(5): R, S, T ...) and processor time of its main thread (s, in steps of 10 ms).

    Its I/O threads may work although it hangs. Raises OSError if it has ended.
    """
    fields = Path(f"/proc/{pid}/task/{pid}/stat").read_text().rpartition(") ")[2].split()
    return fields[0], (int(fields[11]) + int(fields[12])) / CLOCK_TICKS_HZ


def nice(by: int) -> bool:
    """Change the niceness of this process; a negative `by` needs permission. False if it is not permitted."""
    try:
        os.nice(by)
    except OSError:
        return False
    return True


def nice_session(by: int) -> bool:
    """The same for all processes of a session that begins with this process. A Linux with autogroups shares the
    processors among sessions, and then the niceness of a process counts only within its own."""
    if os.getsid(0) != os.getpid():
        return False
    try:
        Path("/proc/self/autogroup").write_text(str(by))
    except OSError:  # not permitted, or a system without them
        return False
    return True


def raise_priority(rank: int, niceness: int) -> str:
    """Raise the priority of this process: real-time with priority `rank`, or else `niceness`, if permitted.

    Children start without it. Returns the result as text.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(rank))
        return f"real-time, rank {rank}"
    return f"niceness {niceness}" if nice(niceness) else "a better priority is not permitted"


def lower_priority() -> bool:
    """Give up the real-time priority of `raise_priority`, which may be requested again. False: there was none."""
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_RR:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
    return True


def real_time_io(context: zmq.Context[Any], rank: int) -> bool:
    """Give the I/O threads of a ZeroMQ context, which has no socket yet, real-time priority `rank`.

    Linux schedules threads one by one. With normal priority an I/O thread waits behind busy processes for several
    milliseconds, and its messages with it. False if it is not permitted: libzmq would abort, so it is tried here first.
    """
    if not may_be_real_time(rank):
        return False
    context.set(zmq.THREAD_SCHED_POLICY, os.SCHED_RR)
    context.set(zmq.THREAD_PRIORITY, rank)
    return True


def freeze_heap() -> None:
    """Exclude all existing objects from garbage collection and make collections rare.

    Objects that a loop creates are freed by reference counting; few of them form cycles.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 50)


def adopt_orphans() -> None:
    """Become the parent of processes whose own parent, a child of ours, has ended, so that we can wait for them."""
    _libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def show_name(name: str) -> None:
    """Set the name of this process in `top` and `ps -o comm` (at most 15 bytes)."""
    _libc.prctl(PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(parent: int) -> None:
    """Let the kernel kill this process, just forked by `parent`'s main thread, when that dies. Survives exec."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # the parent died between fork and prctl
        os._exit(1)


def leave(status: int) -> NoReturn:
    """End a forked process with this exit status, without the clean-up of the process that forked it."""
    with contextlib.suppress(OSError):  # a full disk
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def end_within(limit_s: float) -> None:
    """Let the kernel end this process after `limit_s`, whatever it is doing then."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
