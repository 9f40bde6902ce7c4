"""The halt line: the same order to the broker's halt socket and to the MCM's estop socket, at once.

It shares nothing with the front door: own sockets, own thread lock, connected in advance, so that a halt never waits
behind anything else and works when the broker is dead, stopped or busy. (Only whether there ever was a command of which
nothing moves is asked there, afterwards.) Latency is measured by two clocks that are
one: CLOCK_MONOTONIC when the operator called, and when the first joint began to decelerate. Two machines have two
clocks: over tcp it is measured here, until the news of it has come, so it holds the way there and back.
"""

from __future__ import annotations

import math
import re
import threading
import time
import uuid
from collections.abc import Collection

import msgspec
import zmq

from rtc import messages as m
from rtc.front_door import FrontDoor
from rtc.keys import Doors
from rtc.language.fastpath import EVERYTHING, halt_scope
from rtc.outcomes import ClusterError, RefusalReason, WireError
from rtc.wire import frames, reader

CONNECT_S, FAR_CONNECT_S = 0.5, 3.0  # longest wait for a first connection, here and over tcp
UNNAMED_S, FAR_UNNAMED_S = (
    0.1,
    0.5,
)  # a subsystem that has nothing in scope is at rest; for so long the broker may know no such name
ASK_S, FAR_ASK_S = 1.0, 3.0  # for the broker to say whether there is such a command
LONGEST_S = 3600.0  # that anybody waits for rest, whatever number was given
RETRY_S = 0.02  # how often the order is offered to a door that was closed
HALT_ENDPOINTS = ("halt", "estop")  # of the broker, of the MCM
COMMAND = re.compile(r"C-\d+", re.ASCII)  # a scope that means something to the broker alone

_read = reader(m.FromHalt)


class SubsystemHalt(msgspec.Struct, kw_only=True):
    """What one subsystem said."""

    name: str
    latency_s: float | None = None  # call -> first decelerating tick
    moving: list[str] = []  # performers that were in motion
    at_rest: bool | None = None  # None: it has not said
    performers: list[str] = []  # that were in scope, in motion or not
    rest_s: float | None = None  # call -> rest


class HaltResult(msgspec.Struct, kw_only=True):
    """What became of one halt."""

    halt: str
    scope: str
    latency_s: float | None  # the first decelerating tick of all; None: no subsystem answered
    confirmed: bool  # every subsystem that answered is at rest, and one did
    told: list[str]  # the sockets that took the order: "halt" (broker), "estop" (MCM)
    subsystems: list[SubsystemHalt]
    message: str = ""  # why it is not confirmed
    declined: bool = False  # nothing is called so: nobody was asked to stop

    @property
    def reached(self) -> bool:
        """Somebody was in its scope, in motion or not."""
        return _reached(self.subsystems)

    @property
    def moving(self) -> list[str]:
        return sorted({name for sub in self.subsystems for name in sub.moving})


class HaltLine:
    """Thread-safe: `halt` may be called from any thread, one call after the other."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], doors: Doors) -> None:
        self._context, self._all_doors = context, doors
        self._far = doors.far
        self._connect_s, self._unnamed_s = (FAR_CONNECT_S, FAR_UNNAMED_S) if self._far else (CONNECT_S, UNNAMED_S)
        self._lock = threading.Lock()
        self._poller = zmq.Poller()
        self._doors: dict[str, zmq.Socket[bytes]] = {}
        for door in HALT_ENDPOINTS:
            socket = context.socket(zmq.DEALER)  # without an identity: nobody else can have the same one
            doors.secure(socket)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.IMMEDIATE, 1)  # never kept for later: a stale halt would stop what comes after it
            socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms
            socket.connect(doors.endpoint(door))
            self._doors[door] = socket
            self._poller.register(socket, zmq.POLLIN)

    def halt(self, scope: str = "ALL", timeout_s: float = 2.0) -> HaltResult:
        """Send the order, wait for rest (LONGEST_S at most: no number holds a halt up, nor breaks it). Raises
        ClusterError when neither the broker nor the MCM could be told."""
        timeout_s = min(LONGEST_S, timeout_s)  # in this order nan is the longest too
        with self._lock:
            called_at_s = time.monotonic()
            scope = halt_scope(f"HALT {scope}") or scope.upper()
            order = m.HaltOrder(halt=f"H-{uuid.uuid4().hex[:12]}", scope=scope, called_at_s=called_at_s)
            told = self._tell(order, self._doors)
            if not told:
                told = self._tell_whoever_comes(order, called_at_s + self._connect_s)
            if not told:
                who = (
                    "the cluster's gate does not answer, or does not know our key"
                    if self._far
                    else "neither the broker nor the MCM answers"
                )
                raise ClusterError(f"halt not sent: {who}; use the emergency stop")
            return self._await_rest(order, told, called_at_s + timeout_s)

    def ready(self, timeout_s: float | None = None) -> bool:
        """True when both doors are connected. Benchmarks ask, so that the first figure is like the others."""
        with self._lock:
            limit_s = time.monotonic() + (self._connect_s if timeout_s is None else timeout_s)
            return all(socket.poll(_ms(limit_s - time.monotonic()), zmq.POLLOUT) for socket in self._doors.values())

    def close(self) -> None:
        for socket in self._doors.values():
            socket.close()

    def _tell(self, order: m.HaltOrder, doors: dict[str, zmq.Socket[bytes]]) -> list[str]:
        parts, told = frames(order), []
        for name, socket in doors.items():
            try:
                socket.send_multipart(parts, flags=zmq.NOBLOCK)
                told.append(name)
            except zmq.Again:  # not connected now
                continue
        return told

    def _tell_whoever_comes(self, order: m.HaltOrder, limit_s: float) -> list[str]:
        poller = zmq.Poller()
        for socket in self._doors.values():
            poller.register(socket, zmq.POLLOUT)
        while (left_s := limit_s - time.monotonic()) > 0:
            if poller.poll(_ms(left_s)) and (told := self._tell(order, self._doors)):
                return told
        return []

    def _await_rest(self, order: m.HaltOrder, told: list[str], limit_s: float) -> HaltResult:
        """Hear both doors until rest is confirmed and the broker has been told, so that nothing queued starts."""
        subsystems: dict[str, SubsystemHalt] = {}
        declined = ""
        while (left_s := limit_s - time.monotonic()) > 0:
            if _at_rest(subsystems.values()) and "halt" in told:
                if order.scope == EVERYTHING or COMMAND.fullmatch(order.scope) or _reached(subsystems.values()):
                    break
                limit_s = min(limit_s, order.called_at_s + self._unnamed_s)
            untold = {name: socket for name, socket in self._doors.items() if name not in told}
            ready = self._poller.poll(_ms(min(left_s, RETRY_S) if untold else left_s))
            told += self._tell(order, untold)
            for socket, _ in ready:
                declined = self._hear(socket, order, subsystems) or declined
            if declined and not _reached(subsystems.values()) and len(told) == len(HALT_ENDPOINTS):
                break
        doubt = ""
        if COMMAND.fullmatch(order.scope) and not declined and not _reached(subsystems.values()):
            declined, doubt = self._ask_for(order.scope, "halt" in told)
        return _result(order, told, list(subsystems.values()), declined, doubt)

    def _ask_for(self, command: str, broker_was_told: bool) -> tuple[str, str]:
        """Whether there ever was a command of which nothing moves: (the broker's no, why nobody knows), both empty
        when there was. A number that was mistyped must not pass for a halt."""
        answer = self._trace(command) if broker_was_told else None
        if isinstance(answer, m.TraceReply):
            return "", ""
        if isinstance(answer, m.Declined) and answer.refusal.reason is RefusalReason.NAME:
            return answer.refusal.message, ""
        return "", f"whether there is a {command} only the broker knows, and it does not answer"

    def _trace(self, command: str) -> m.BrokerToClient | None:
        """A door of our own for one question: nobody may be kept waiting, and `halt` is called from any thread."""
        name = f"asks-{uuid.uuid4().hex[:12]}"  # the one before may not have been forgotten yet
        query = m.TraceQuery(request=name, command=command)
        limit_s = time.monotonic() + (FAR_ASK_S if self._far else ASK_S)
        front = FrontDoor(self._context, self._all_doors, name)
        try:
            front.ask(query.request, query)
            while (left_s := limit_s - time.monotonic()) > 0:
                answer = front.hear(left_s)
                if isinstance(answer, m.TraceReply | m.Declined):
                    return answer
            return None
        finally:
            front.close()

    def _hear(self, socket: zmq.Socket[bytes], order: m.HaltOrder, subsystems: dict[str, SubsystemHalt]) -> str:
        """Take in one answer; the words of a refusal, if it was one."""
        try:
            answer: m.FromHalt = _read(socket.recv_multipart())
        except WireError:
            return ""
        if isinstance(answer, m.Declined):
            return answer.refusal.message if answer.request in ("", order.halt) else ""
        if answer.halt != order.halt:
            return ""  # late news of an earlier halt
        said = subsystems.setdefault(answer.subsystem, SubsystemHalt(name=answer.subsystem))
        if isinstance(answer, m.HaltStarted):
            if said.latency_s is None:
                said.latency_s = self._at(answer.decelerating_at_s) - order.called_at_s
                said.moving = answer.moving
        else:
            said.at_rest, said.performers = answer.at_rest, answer.performers
            said.rest_s = self._at(answer.at_s) - order.called_at_s
        return ""

    def _at(self, time_there_s: float) -> float:
        """When it was, by our clock; at the latest, if theirs is another."""
        return time.monotonic() if self._far else time_there_s


def _ms(seconds: float) -> int:
    return math.ceil(1000 * max(0.0, min(LONGEST_S, seconds)))


def _at_rest(subsystems: Collection[SubsystemHalt]) -> bool:
    return bool(subsystems) and all(sub.at_rest for sub in subsystems)


def _reached(subsystems: Collection[SubsystemHalt]) -> bool:
    return any(sub.moving or sub.performers for sub in subsystems)


def _result(
    order: m.HaltOrder, told: list[str], subsystems: list[SubsystemHalt], declined: str, doubt: str
) -> HaltResult:
    latencies = [sub.latency_s for sub in subsystems if sub.latency_s is not None]
    nothing = bool(declined) and not _reached(subsystems)  # at rest is then not what was meant
    confirmed = _at_rest(subsystems) and not nothing and not doubt
    message = ""
    if not confirmed:
        silent = [sub.name for sub in subsystems if not sub.at_rest]
        message = (
            declined
            or (doubt if _at_rest(subsystems) else "")
            or (f"{', '.join(silent)} has not come to rest in time" if silent else "no subsystem answered in time")
        )
    return HaltResult(
        halt=order.halt,
        scope=order.scope,
        latency_s=min(latencies) if latencies else None,
        confirmed=confirmed,
        told=sorted(told),
        subsystems=sorted(subsystems, key=lambda sub: sub.name),
        message=message,
        declined=nothing,
    )
