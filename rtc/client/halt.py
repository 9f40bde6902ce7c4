"""Client side of a halt: sends the same order to the broker's halt socket and to the MCM's estop socket at once.

It has its own sockets and lock, connected in advance. So a halt never waits behind other traffic, and works when the
broker is dead, stopped or busy. One query goes to the broker's front socket, after the halt: whether a command exists
of which nothing moves. Latency is the time from the call to the first decelerating tick, both of CLOCK_MONOTONIC of
one machine. Over TCP the clocks differ: the latency then ends with the arrival of the report and includes the network.
"""

from __future__ import annotations

import math
import re
import threading
import time
import uuid
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import msgspec
import zmq

from rtc.client.connection import BrokerConnection
from rtc.client.context import ClientContext
from rtc.client.core import Query
from rtc.client.first_order import RANK, Dealer, FirstOrder, NotConnected
from rtc.language.fastpath import EVERYTHING, named_scope
from rtc.protocol import messages as m
from rtc.protocol.outcomes import ClusterError, Refusal, RefusalReason, WireError
from rtc.protocol.wire import frames, reader
from rtc.runtime.keys import Endpoints
from rtc.runtime.priority import real_time
from rtc.runtime.process import real_time_io
from rtc.runtime.settings import Settings

CONNECT_S, FAR_CONNECT_S = 0.5, 3.0  # time limit of the first connection, local and over tcp
# Time in which the broker may decline an unknown scope, and in which both copies of an order are answered. The MCM
# reports rest at once, for an unknown scope too.
UNKNOWN_S, FAR_UNKNOWN_S = 0.1, 0.5
ASK_S, FAR_ASK_S = 1.0, 3.0  # time limit of the query whether a command exists, local and over tcp
MAX_S = 3600.0  # maximum wait for rest
RETRY_S = 0.02  # period of sending the order again to a socket that was not connected
HALT_ENDPOINTS = ("halt", "estop")  # of the broker, of the first subsystem of arms
COMMAND = re.compile(r"C-\d+", re.ASCII)  # a scope that only the broker can resolve

HaltSocket = zmq.Socket[bytes] | Dealer

_read = reader(m.FromHalt)


class SubsystemHalt(msgspec.Struct, kw_only=True):
    """The answer of one subsystem to a halt."""

    name: str
    latency_s: float | None = None  # call -> first decelerating tick
    receipt_s: float | None = None  # call -> the subsystem received it: the first part of `latency_s`
    moving: list[str] = []  # performers that were in motion
    at_rest: bool | None = None  # None: not reported yet
    performers: list[str] = []  # that were in scope, in motion or not
    rest_s: float | None = None  # call -> rest
    own_rest_s: float | None = None  # receipt -> rest by the subsystem's own clock, of a simulator simulated time


class HaltResult(msgspec.Struct, kw_only=True):
    """The result of one halt."""

    halt: str
    scope: str
    latency_s: float | None  # the first decelerating tick of all; None: no subsystem answered
    confirmed: bool  # every subsystem that answered is at rest, and one did
    sent_to: list[str]  # sockets that accepted it: "halt" (broker), "estop" (MCM)
    subsystems: list[SubsystemHalt]
    message: str = ""  # why it is not confirmed
    declined: bool = False  # it was refused: nothing was stopped
    unknown: str = ""  # the name that nothing has, or that only a silent broker knows: `scope` is then ALL
    called_at_s: float = 0.0  # CLOCK_MONOTONIC of the caller's machine; the times of `subsystems` begin with it

    @property
    def reached(self) -> bool:
        """True if a performer was in its scope, in motion or not."""
        return _reached(self.subsystems)

    @property
    def moving(self) -> list[str]:
        """Performers that were in motion, sorted."""
        return sorted({name for sub in self.subsystems for name in sub.moving})


def local_settings(run_dir: Path | str) -> Settings:
    """The settings of a cluster of this machine; without its file those of any, whose broker passes the halt on."""
    where = str(Path(run_dir).absolute())
    try:
        return msgspec.structs.replace(Settings.load(where), run_dir=where)
    except (OSError, msgspec.MsgspecError):
        return Settings(run_dir=where)


#: called with a subsystem that has confirmed rest while a halt of all waits for others, and the names of these
OnRest = Callable[[SubsystemHalt, list[str]], None]


class HaltLine:
    """Sends halts to one cluster. Thread-safe: calls from several threads run one after the other."""

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        endpoints: Endpoints,
        first: FirstOrder | None = None,
    ) -> None:
        """`first`: an order that has left this process already; `finish` waits for its answers on its sockets."""
        self._context, self._endpoints, self._first = context, endpoints, first
        self._far = endpoints.far
        self._connect_s, self._unknown_s = (FAR_CONNECT_S, FAR_UNKNOWN_S) if self._far else (CONNECT_S, UNKNOWN_S)
        self._lock = threading.Lock()
        self._poller = zmq.Poller()
        self._own_context = ClientContext()  # so that its I/O thread carries halts only
        self._rank = RANK if real_time_io(self._own_context, RANK) else 0
        estops = endpoints.addresses("estop")
        self._confirming = [name for name in estops if name]  # subsystems that confirm a halt of all
        addresses = {"halt": endpoints.endpoint("halt")}
        for name, address in estops.items():
            addresses[f"estop {name}" if len(addresses) > 1 else "estop"] = address
        self._sockets: dict[str, HaltSocket] = {}
        for name, address in addresses.items():
            sent = None if first is None else first.sent_to.get(address.rpartition("/")[2])
            self._sockets[name] = sent or self._connected(address)
            self._poller.register(self._sockets[name], zmq.POLLIN)

    def _connected(self, address: str) -> zmq.Socket[bytes]:
        socket = self._own_context.socket(zmq.DEALER)  # without an identity: another process could use the same
        self._endpoints.secure(socket)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.IMMEDIATE, 1)  # not queued: a stale halt would stop later commands
        socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms
        socket.connect(address)
        return socket

    def halt(
        self,
        scope: str = "ALL",
        timeout_s: float = 2.0,
        round_trip_s: float = 0.0,
        on_rest: OnRest | None = None,
    ) -> HaltResult:
        """Send the order and wait for rest, at most `timeout_s` (s) and at most MAX_S. `round_trip_s`: of the link.

        `scope`: ALL, a performer, a command C-n, or what commands in progress are about. ALL is halted for any other
        (decision 0174). Raises ClusterError if neither broker nor MCM could be reached.
        """
        timeout_s = min(MAX_S, timeout_s)  # in this order nan becomes MAX_S too
        with self._lock:
            called_at_s = time.monotonic()
            with real_time(self._rank):  # else the caller may wait behind busy processes before it has sent
                scope = named_scope(scope)
                order = m.HaltOrder(halt=f"H-{uuid.uuid4().hex[:12]}", scope=scope, called_at_s=called_at_s)
                sent_to = self._send(order, self._sockets)
            if not sent_to:
                sent_to = self._send_when_connected(order, called_at_s + self._connect_s)
            if not sent_to:
                who = (
                    "the cluster's gateway does not answer, or does not know this key"
                    if self._far
                    else "neither the broker nor a subsystem of arms answers"
                )
                raise ClusterError(f"halt not sent: {who}; use the emergency stop")
            unknown_s = self._unknown_s + round_trip_s
            found = self._await_rest(order, sent_to, called_at_s + timeout_s, called_at_s + unknown_s, on_rest)
            return self._halt_all(found, timeout_s, on_rest) if found.unknown else found

    def finish(self, timeout_s: float = 2.0, on_rest: OnRest | None = None) -> HaltResult:
        """Wait for the answers to the order that had left before, as `halt` does. The limit begins now: on a busy
        machine the imports between the order and this call take seconds."""
        first = self._first
        assert first is not None
        order = m.HaltOrder(halt=first.halt, scope=first.scope, called_at_s=first.called_at_s)
        sent_to = [name for name, socket in self._sockets.items() if isinstance(socket, Dealer)]
        now_s, timeout_s = time.monotonic(), min(MAX_S, timeout_s)
        found = self._await_rest(order, sent_to, now_s + timeout_s, now_s + self._unknown_s, on_rest)
        return self._halt_all(found, timeout_s, on_rest) if found.unknown else found

    def _halt_all(self, unknown: HaltResult, timeout_s: float, on_rest: OnRest | None) -> HaltResult:
        """Halt everything for a scope that nothing has: an arm may move, and its name was mistyped."""
        now_s = time.monotonic()  # it covers what was sent until now
        order = m.HaltOrder(halt=f"{unknown.halt}-ALL", scope=EVERYTHING, called_at_s=now_s)
        sent_to = self._send(order, self._sockets) or self._send_when_connected(order, now_s + self._connect_s)
        called = msgspec.structs.replace(order, called_at_s=unknown.called_at_s)  # the latency is that of the caller
        found = self._await_rest(called, sent_to, now_s + timeout_s, now_s + self._unknown_s, on_rest)
        return msgspec.structs.replace(found, unknown=unknown.unknown)

    def ready(self, timeout_s: float | None = None) -> bool:
        """Wait until both sockets are connected; False after `timeout_s`."""
        with self._lock:
            limit_s = time.monotonic() + (self._connect_s if timeout_s is None else timeout_s)
            return all(socket.poll(_ms(limit_s - time.monotonic()), zmq.POLLOUT) for socket in self._sockets.values())

    def close(self) -> None:
        """Close the sockets."""
        for socket in self._sockets.values():
            socket.close()
        self._own_context.term()

    def _send(self, order: m.HaltOrder, sockets: dict[str, HaltSocket]) -> list[str]:
        parts, sent_to = frames(order), []
        for name, socket in sockets.items():
            try:
                socket.send_multipart(parts, flags=zmq.NOBLOCK)
                sent_to.append(name)
            except (zmq.Again, NotConnected):
                continue
        return sent_to

    def _send_when_connected(self, order: m.HaltOrder, limit_s: float) -> list[str]:
        poller = zmq.Poller()
        for socket in self._sockets.values():
            poller.register(socket, zmq.POLLOUT)
        while (left_s := limit_s - time.monotonic()) > 0:
            if poller.poll(_ms(left_s)) and (sent_to := self._send(order, self._sockets)):
                return sent_to
        return []

    def _await_rest(
        self,
        order: m.HaltOrder,
        sent_to: list[str],
        limit_s: float,
        unknown_by_s: float,
        on_rest: OnRest | None,
    ) -> HaltResult:
        """Receive until rest is confirmed and both copies are answered, or until no one is left who will confirm it.

        The broker must have the order, so that no queued command starts. A copy under way would stop the caller's next
        command; so an unanswered copy is awaited too, for a short time.
        """
        subsystems: dict[str, SubsystemHalt] = {}
        unanswered = dict(self._sockets)
        refusals: dict[str, Refusal] = {}  # by socket
        stated: set[str] = set()
        while (left_s := limit_s - time.monotonic()) > 0:
            if self._complete(order, subsystems) and "halt" in sent_to:
                known = order.scope == EVERYTHING or COMMAND.fullmatch(order.scope) or _reached(subsystems.values())
                if known and not any(name in unanswered for name in sent_to):
                    break
                left_s = min(limit_s, unknown_by_s) - time.monotonic()
                if left_s <= 0:
                    break
            elif "halt" in unanswered and _all_refuse(sent_to, refusals):
                left_s = min(limit_s, unknown_by_s) - time.monotonic()
                if left_s <= 0:
                    break
            unsent = {name: socket for name, socket in self._sockets.items() if name not in sent_to}
            self._poller.poll(_ms(min(left_s, RETRY_S) if unsent else left_s))
            sent_to += self._send(order, unsent)
            for name, socket in self._sockets.items():
                for answer in self._answers(socket, order):
                    unanswered.pop(name, None)
                    if not isinstance(answer, m.Declined):
                        self._take(answer, order, subsystems)
                        continue
                    refusals[name] = answer.refusal
                    # A subsystem declines what is not one of its arms; the broker knows those of all.
                    if name == "halt" and not _is_obeyed(answer.refusal) and not _reached(subsystems.values()):
                        limit_s = 0.0
            if on_rest is not None and order.scope == EVERYTHING:
                self._state_rest(on_rest, subsystems, stated)
            if any(map(_is_obeyed, refusals.values())) and all(name in refusals for name in sent_to):
                break
        # The broker knows the names of all, and a subsystem those of its own.
        silent_broker = "halt" in unanswered and _all_refuse(sent_to, refusals)
        deciding = [one for name, one in refusals.items() if name == "halt" or silent_broker]
        refused = next((one for one in deciding if not _is_obeyed(one)), None)
        declined = "" if refused is None else refused.message
        doubt = "" if subsystems else next((one.message for one in refusals.values() if _is_obeyed(one)), "")
        if COMMAND.fullmatch(order.scope) and not refusals and not _reached(subsystems.values()):
            declined, doubt = self._check_exists(order.scope, "halt" in sent_to)
            doubt = doubt if subsystems else ""
        is_unknown = refused is not None and refused.reason is RefusalReason.NAME
        silent = [] if order.scope != EVERYTHING else [name for name in self._confirming if name not in subsystems]
        result = _result(order, sent_to, list(subsystems.values()), declined, doubt, silent)
        is_unknown = is_unknown and result.declined and order.scope != EVERYTHING
        return msgspec.structs.replace(result, unknown=order.scope) if is_unknown else result

    def _state_rest(self, on_rest: OnRest, subsystems: dict[str, SubsystemHalt], stated: set[str]) -> None:
        """State which arms' subsystems are at rest while others are not. `stated`: those that were stated already."""
        at_rest = [name for name in self._confirming if name in subsystems and subsystems[name].at_rest]
        awaited = [name for name in self._confirming if name not in at_rest]
        for name in at_rest if awaited else []:
            if name not in stated:
                stated.add(name)
                on_rest(subsystems[name], awaited)

    def _complete(self, order: m.HaltOrder, subsystems: dict[str, SubsystemHalt]) -> bool:
        """Whether rest is confirmed: by one subsystem, and for a halt of all by each that has arms."""
        wanted = self._confirming if order.scope == EVERYTHING else []
        return _at_rest(subsystems.values()) and all(name in subsystems for name in wanted)

    def _check_exists(self, command: str, sent_to_broker: bool) -> tuple[str, str]:
        """Check that a command exists of which nothing moves: a mistyped number must not pass for a halt.

        Returns (the broker's refusal, why it is not known); both are empty if the command exists.
        """
        answer = self._trace(command) if sent_to_broker else None
        if isinstance(answer, m.TraceReply):
            return "", ""
        if isinstance(answer, m.Declined) and answer.refusal.reason is RefusalReason.NAME:
            return answer.refusal.message, ""
        return "", f"only the broker knows whether {command} exists, and it does not answer"

    def _trace(self, command: str) -> m.BrokerToClient | None:
        """Query a command over a connection of its own, as any thread may call `halt`; None without an answer."""
        name = f"asks-{uuid.uuid4().hex[:12]}"  # unique: the broker may still know the one before
        query = Query(m.TraceQuery(request=name, command=command), m.TraceReply, FAR_ASK_S if self._far else ASK_S)
        limit_s = time.monotonic() + query.within_s
        front = BrokerConnection(self._context, self._endpoints, name)
        front.core.ask(query, time.monotonic())
        while query.answer is None and (left_s := limit_s - time.monotonic()) > 0:
            front.step(left_s)
        front.close()
        return query.answer

    def _answers(self, socket: HaltSocket, order: m.HaltOrder) -> Iterator[m.FromHalt]:
        """The answers that have arrived, without those that are invalid, or late and of an earlier halt."""
        while True:
            try:
                answer: m.FromHalt = _read(socket.recv_multipart(zmq.NOBLOCK))
            except WireError:
                continue
            except zmq.Again:
                return
            except NotConnected as none:
                if none.lost:  # the end of a stream stays readable
                    self._poller.unregister(socket)
                return
            halt = answer.request or order.halt if isinstance(answer, m.Declined) else answer.halt
            if halt == order.halt:
                yield answer

    def _take(
        self, answer: m.HaltStarted | m.HaltAtRest, order: m.HaltOrder, subsystems: dict[str, SubsystemHalt]
    ) -> None:
        found = subsystems.setdefault(answer.subsystem, SubsystemHalt(name=answer.subsystem))
        if isinstance(answer, m.HaltStarted):
            if found.latency_s is None:
                found.latency_s = self._at(answer.decelerating_at_s) - order.called_at_s
                found.receipt_s = self._at(answer.received_at_s) - order.called_at_s
                found.moving = answer.moving
        else:
            found.at_rest, found.performers = answer.at_rest, answer.performers
            found.rest_s, found.own_rest_s = self._at(answer.at_s) - order.called_at_s, answer.own_s

    def _at(self, time_there_s: float) -> float:
        """A time of the other process by this clock; over tcp the time of arrival, which is an upper bound."""
        return time.monotonic() if self._far else time_there_s


def _ms(seconds: float) -> int:
    return math.ceil(1000 * max(0.0, min(MAX_S, seconds)))


def _at_rest(subsystems: Collection[SubsystemHalt]) -> bool:
    return bool(subsystems) and all(sub.at_rest for sub in subsystems)


def _is_obeyed(refusal: Refusal) -> bool:
    """Whether the halt was obeyed, and only its rest will not be confirmed there."""
    return refusal.reason is RefusalReason.OVERLOAD


def _all_refuse(sent_to: list[str], refusals: dict[str, Refusal]) -> bool:
    """Whether every subsystem that has the order refuses it, and one has it."""
    estops = {name for name in sent_to if name != "halt"}
    return bool(estops) and estops <= refusals.keys()


def _reached(subsystems: Collection[SubsystemHalt]) -> bool:
    return any(sub.moving or sub.performers for sub in subsystems)


def _result(
    order: m.HaltOrder,
    sent_to: list[str],
    subsystems: list[SubsystemHalt],
    declined: str,
    doubt: str,
    absent: list[str],
) -> HaltResult:
    """`absent`: subsystems that have not answered a halt of all."""
    latencies = [sub.latency_s for sub in subsystems if sub.latency_s is not None]
    nothing = bool(declined) and not _reached(subsystems)  # rest then confirms nothing
    confirmed = _at_rest(subsystems) and not nothing and not doubt and not absent
    message = ""
    if not confirmed:
        moves = [sub.name for sub in subsystems if not sub.at_rest]
        silent = absent if subsystems else []
        words = [f"{', '.join(moves)} has not come to rest in time"] if moves else []
        words += [f"{', '.join(silent)} has not answered"] if silent else []
        rest = [sub.name for sub in subsystems if sub.at_rest]
        words += [f"{', '.join(rest)} rests"] if words and rest else []
        message = declined or "; ".join(words) or doubt or "no subsystem answered in time"
    return HaltResult(
        halt=order.halt,
        scope=order.scope,
        latency_s=min(latencies) if latencies else None,
        confirmed=confirmed,
        sent_to=sorted(sent_to),
        subsystems=sorted(subsystems, key=lambda sub: sub.name),
        message=message,
        declined=nothing,
        called_at_s=order.called_at_s,
    )
