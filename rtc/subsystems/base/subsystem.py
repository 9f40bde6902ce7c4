"""A subsystem: several performers, one broker, several callers of halts. Pure.

    handle(message, sender, now_s) -> [(receiver, message), ...]      tick(now_s) -> [(receiver, message), ...]

Sender and receiver are BROKER or the identity of a caller at the subsystem's own halt socket. A subsystem works without
the broker between the start of a primitive and its end report (trusted soldier, R58). It keeps each end report and
repeats it until the broker acknowledges it. It remembers primitive ids, so it executes no primitive twice.

Every halt first stops the performers in its scope; the answer follows. The same halt may arrive from the caller and
from the broker. Both get the same figures if nothing in scope has moved in between; earlier halts are remembered only
for this. A halt from a caller is forwarded to the broker with a call number, and repeated with every hello. It is a
fence: nothing in its scope starts until the broker has sent that number back. So a broker that was down during the halt
cannot start what was halted.

A subclass defines what a performer does: the methods at the end of `BaseSubsystem`.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

import msgspec

from rtc.plugins import guard
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Measured, Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import Primitive
from rtc.protocol.primitive_id import MAX_CHARACTERS, is_name
from rtc.protocol.spelling import unknown
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.runtime.halt_admission import HaltRateLimiter, overload

BROKER = b""  # not a possible identity of a caller at a halt socket
REPEAT_S = 0.5  # period of repeating an end report that is not acknowledged
REMEMBERED = 2_000  # maximum number of remembered ended primitives; also of halts
# Maximum numbers of halts that wait for rest: per caller at the halt socket; of the broker, which has many clients.
# Each costs time in every tick. Above it performers still stop, but the caller gets Declined, not a confirmation.
OPEN_HALTS = 8
OPEN_HALTS_OF_BROKER = 64
CALLERS_OF_A_HALT = 16  # maximum number that share one set of figures; a further caller gets its own
MAX_FENCES = 64  # maximum number of fenced scopes; above it one fence covers ALL
REST_LIMIT_S = 2.0  # a performer not at rest this long after a halt, by own time, is reported as not at rest

KEPT_WORDS = 1000  # of the message of a report that is too large

COMMAND = re.compile(r"C-\d+", re.ASCII)

Outgoing = list[tuple[bytes, m.Message]]
Report = m.Started | m.PauseChanged | m.ProgressReport | m.EndReport | m.Strayed
Reports = Sequence[Report]


class InvalidOrder(msgspec.Struct, frozen=True):
    """An Execute whose primitive does not decode, with the fields that could be read."""

    primitive: str  # its id
    performer: str
    pid: int
    why: str


Order = m.Execute | m.SetPaused | m.OperatorAnswer | m.HaltOrder | m.ReportAck | m.HelloWanted | InvalidOrder


class Halt(msgspec.Struct):
    """One halt and the callers that wait for its answers."""

    order: m.HaltOrder
    received_at_s: float
    own_s: float  # when it was received, by the subsystem's own time
    performers: list[str]
    moving: list[str]
    begun: list[int]  # number of primitives that each performer had started at the time of the call
    callers: list[tuple[bytes, str]]  # identity, and the call number of its order
    started: m.HaltStarted | None = None
    ended: m.HaltAtRest | None = None

    def to_callers(self, message: m.HaltStarted | m.HaltAtRest) -> Outgoing:
        return [(sender, msgspec.structs.replace(message, call=call)) for sender, call in self.callers]


Performer = TypeVar("Performer")


class BaseSubsystem(ABC, Generic[Performer]):
    """`queues`: a performer takes several primitives at once and serves them in turn."""

    def __init__(self, performers: Mapping[str, Performer], name: str, pid: int = 0, *, queues: bool = False) -> None:
        self.name = name
        self.pid = pid
        self.performers = dict(performers)
        self._all = list(self.performers.values())
        self._queues = queues
        self._kept: dict[
            str, tuple[m.EndReport, float]
        ] = {}  # unacknowledged end reports: primitive -> (report, time of the next repetition)
        self._ended: OrderedDict[str, m.EndReport] = OrderedDict()  # the last end reports; they answer repeated orders
        self._content_hashes: dict[str, int] = {}  # primitive id -> hash of the whole primitive
        self._asked: set[str] = set()  # primitives whose sentence asks for a reading
        self._begun: Counter[str] = Counter()  # number of started primitives, by performer
        self._halts: OrderedDict[tuple[str, str], Halt] = OrderedDict()  # by name and scope
        self._calls = 0  # number of halts forwarded to the broker
        self._open_halts: list[Halt] = []
        self._halt_limiter = HaltRateLimiter()
        self._fences: dict[str, m.HaltOrder] = {}  # halt scope -> order that the broker has not acknowledged

    # --- public interface -------------------------------------------------------------------------------

    @property
    def outstanding(self) -> list[str]:
        running = [primitive for performer in self.performers.values() for primitive in self._primitives(performer)]
        running = list(dict.fromkeys(running))  # several performers may have one primitive
        return running + [primitive for primitive in self._kept if primitive not in running]

    @property
    def at_rest(self) -> bool:
        return all(self._rests(performer, "ALL") for performer in self.performers.values())

    @property
    def idle(self) -> bool:
        return not any(map(self._primitives, self.performers.values()))

    def handle(self, message: Order, sender: bytes, now_s: float) -> Outgoing:
        if isinstance(message, m.HaltOrder):
            return self._halt(message, sender, now_s)
        if isinstance(message, m.ReportAck):
            self._kept.pop(message.primitive, None)
            return []
        if isinstance(message, m.HelloWanted):
            return self.hello()
        if isinstance(message, m.SetPaused):
            self._pace(message)
            return []
        if isinstance(message, m.OperatorAnswer):
            return self._answer_of_operator(message)
        if isinstance(message, InvalidOrder):
            return self._refuse(message, now_s)
        return self._execute(message, now_s)

    def brake(self) -> None:
        """Stop every performer without a halt to answer: the process ends."""
        for performer in self.performers.values():
            self._stop(performer, "ALL")

    def hello(self) -> Outgoing:
        """To a newly connected broker: what it is and executes; then unacknowledged reports and halts."""
        halts = self._fences.values()
        return [
            (BROKER, self._hello()),
            *((BROKER, report) for report, _ in self._kept.values()),
            *((BROKER, h) for h in halts),
        ]

    def _hello(self) -> m.SubsystemHello:
        return m.SubsystemHello(
            name=self.name,
            pid=self.pid,
            performers=list(self.performers),
            queues=list(self.performers) if self._queues else [],
            outstanding=self.outstanding,
            at_rest=self.at_rest,
            protocol=VERSION,
            abilities=[ARRAYS],
        )

    def tick(self, now_s: float) -> Outgoing:
        """One tick of every performer."""
        out: Outgoing = []
        for performer in self._all:
            if messages := self._tick(performer, now_s):
                out += messages
        if messages := self._between(now_s):
            out += messages
        if self._open_halts:
            out += self._follow_halts(now_s)
        if (merged := self._halt_limiter.due(now_s)) is not None:
            out.append((BROKER, merged))
        if self._kept:
            out += self._repeat_reports(now_s)
        return out

    # --- primitives ------------------------------------------------------------------------------------

    def _execute(self, order: m.Execute, now_s: float) -> Outgoing:
        primitive = order.primitive
        if order.pid not in (0, self.pid):  # addressed to another process with this name, such as our predecessor
            return self.hello()
        whole = hash(wire.encode(primitive))
        if self._content_hashes.setdefault(primitive.id, whole) != whole:
            why = f"{self.name} already knows a different primitive with the id {primitive.id}; not started"
            return [(BROKER, not_begun(primitive.id, primitive.performer, why, at_s=now_s))]
        if (ended := self._ended.get(primitive.id)) is not None:
            return [(BROKER, ended)]
        if not is_name(primitive.id):  # a halt of its command could not match it
            why = "its id is not a valid primitive name; a valid one is, for example, C-3.1"
            return self._end(not_begun(primitive.id[:MAX_CHARACTERS], primitive.performer, why, at_s=now_s), now_s)
        performer = self.performers.get(primitive.performer)
        if performer is None:
            why = f"{self.name} has no {primitive.performer}; it has {', '.join(self.performers)}"
            return self._end(not_begun(primitive.id, primitive.performer, why, at_s=now_s), now_s)
        if primitive.id in self._primitives(performer):
            return []  # it is being executed, or waits
        if why := self._busy(primitive):
            return self._refuse_to_begin(primitive, StopReason.REFUSED, why, now_s)
        if (halt := self._halted_before(order)) is not None:
            why = f"the broker had not yet acknowledged halt {halt} when it sent this; not started"
            return self._refuse_to_begin(primitive, StopReason.HALT, why, now_s)
        if primitive.reporting.items:
            self._asked.add(primitive.id)
        return self._start(performer, order, now_s)

    def _refuse_to_begin(self, primitive: Primitive, reason: StopReason, why: str, now_s: float) -> Outgoing:
        report = not_begun(primitive.id, primitive.performer, why, at_s=now_s, reason=reason)
        return self._end(self._measured(self.performers[primitive.performer], report), now_s)

    def _begin(self, performer: Performer, primitive: Primitive, now_s: float) -> Outgoing:
        messages = self._accept(performer, primitive, now_s)
        for name in primitive.performers:
            self._begun[name] += sum(isinstance(message, m.Started) for message in messages)
        return self._sent(messages, now_s)

    def _sent(self, messages: Reports, now_s: float) -> Outgoing:
        """Messages to the broker; end reports are kept until they are acknowledged."""
        out: Outgoing = []
        for message in map(sendable, messages):
            out += self._end(message, now_s) if isinstance(message, m.EndReport) else [(BROKER, message)]
        return out

    def _refuse(self, order: InvalidOrder, now_s: float) -> Outgoing:
        """Answer an invalid order with an end report, because the broker waits for one."""
        if order.pid not in (0, self.pid):
            return self.hello()
        if (ended := self._ended.get(order.primitive)) is not None:
            return [(BROKER, ended)]
        report = not_begun(order.primitive, order.performer, order.why, at_s=now_s)
        performer = self.performers.get(order.performer)
        return self._end(report if performer is None else self._measured(performer, report), now_s)

    def _end(self, report: m.EndReport, now_s: float) -> Outgoing:
        if report.primitive in self._asked and report.sighting is not None and report.reading is None:
            seen = Measured(
                arm=report.performer, sighting=report.sighting
            )  # a camera of a user need not state it twice
            report = msgspec.structs.replace(report, reading=seen)
        self._asked.discard(report.primitive)
        self._kept[report.primitive] = (report, now_s + REPEAT_S)
        self._ended[report.primitive] = report
        if len(self._ended) > REMEMBERED:
            self._forget(self._ended.popitem(last=False)[0])
        return [(BROKER, report)]

    def _forget(self, primitive: str) -> None:
        self._content_hashes.pop(primitive, None)

    def _repeat_reports(self, now_s: float) -> Outgoing:
        due = [report for report, at_s in self._kept.values() if now_s >= at_s]
        for report in due:
            self._kept[report.primitive] = (report, now_s + REPEAT_S)
        return [(BROKER, report) for report in due]

    def _halted_before(self, order: m.Execute) -> str | None:
        """The fence that stops this order: a halt in scope that the broker had not acknowledged when it sent the
        order."""
        for scope, halt in self._fences.items():
            if any(in_scope(scope, name, order.primitive.id) for name in order.primitive.performers):
                return halt.halt
        return None

    # --- halts -----------------------------------------------------------------------------------------

    def _halt(self, order: m.HaltOrder, sender: bytes, now_s: float) -> Outgoing:
        """Stop the performers in scope at once, for any caller and any halt id; then answer."""
        if sender != BROKER and not self._knows_scope(order.scope):
            words = unknown("scope", order.scope, ["ALL", *self.performers])
            refusal = Refusal(reason=RefusalReason.NAME, message=words, expected=["ALL", *self.performers])
            return [(sender, m.Declined(request=order.halt, refusal=refusal))]
        reached = [name for name, one in self.performers.items() if self._is_reached(order.scope, name, one)]
        moving = [name for name in reached if self._stop(self.performers[name], order.scope)]
        return [*self._drop(order.scope, now_s), *self._answer_halt(order, sender, reached, moving, now_s)]

    def _answer_halt(
        self, order: m.HaltOrder, sender: bytes, reached: list[str], moving: list[str], now_s: float
    ) -> Outgoing:
        if sender == BROKER:  # the broker knows this halt in every later message on this socket
            self._fences = {scope: seen for scope, seen in self._fences.items() if not _acknowledges(order, seen)}
            return self._answer(order, sender, reached, moving, now_s)
        passed_on = self._numbered(order, now_s)
        if self._halt_limiter.exceeds(sender, now_s):
            merged = self._halt_limiter.merge(passed_on)
            if merged.scope == "ALL":  # it replaces the fences that have been merged into it
                self._fences.clear()
            self._fence(merged)
            return [(sender, overload(order, "too many calls in a short time"))]
        self._fence(passed_on)
        return [(BROKER, passed_on), *self._answer(order, sender, reached, moving, now_s)]

    def _is_reached(self, scope: str, name: str, performer: Performer) -> bool:
        return scope in ("ALL", name) or any(in_scope(scope, name, one) for one in self._primitives(performer))

    def _numbered(self, order: m.HaltOrder, now_s: float) -> m.HaltOrder:
        """The order with its time of receipt and a unique call number. Two halts may share an id, and the broker may
        know only one of them."""
        self._calls += 1
        return msgspec.structs.replace(order, call=f"{self.pid}-{self._calls}", received_at_s=now_s)

    def _answer(
        self, order: m.HaltOrder, sender: bytes, reached: list[str], moving: list[str], now_s: float
    ) -> Outgoing:
        """Answer a halt that has been obeyed, at once or when all performers in its scope rest."""
        halt, caller = self._halts.get((order.halt, order.scope)), (sender, order.call)
        if halt is not None and self._is_still_true(halt, reached):
            if caller not in halt.callers:
                halt.callers.append(caller)
            known = [message for message in (halt.started, halt.ended) if message is not None]
            return [(sender, msgspec.structs.replace(message, call=order.call)) for message in known]
        halt = Halt(order, now_s, self._own_s(now_s), reached, moving, self._begun_by(reached), [caller])
        open_halts = sum(other.callers[0][0] == sender for other in self._open_halts)
        if open_halts >= (OPEN_HALTS_OF_BROKER if sender == BROKER else OPEN_HALTS):
            return (
                []
                if sender == BROKER
                else [(sender, overload(order, "earlier halts of this caller still wait for rest"))]
            )
        self._halts[order.halt, order.scope] = halt
        self._halts.move_to_end((order.halt, order.scope))
        if len(self._halts) > REMEMBERED:
            self._halts.popitem(last=False)
        self._open_halts.append(halt)
        return [] if moving else self._follow_halts(now_s)  # nothing moves, so the answer needs no tick

    def _is_still_true(self, halt: Halt, reached: list[str]) -> bool:
        """True while the answers to an earlier halt still hold. No performer in `reached` has started a primitive
        since, and those reported at rest are at rest."""
        if len(halt.callers) >= CALLERS_OF_A_HALT or not set(reached) <= set(halt.performers):
            return False
        if halt.begun != self._begun_by(halt.performers):
            return False
        return halt.ended is None or (halt.ended.at_rest and self._all_rest(halt))

    def _all_rest(self, halt: Halt) -> bool:
        return all(self._rests(self.performers[name], halt.order.scope) for name in halt.performers)

    def _begun_by(self, performers: list[str]) -> list[int]:
        return [self._begun[name] for name in performers]

    def _knows_scope(self, scope: str) -> bool:
        """Whether a scope is ALL, a performer, or a command id (only the broker knows which commands exist)."""
        return scope == "ALL" or scope in self.performers or COMMAND.fullmatch(scope) is not None

    def _fence(self, order: m.HaltOrder) -> None:
        """Let nothing in the scope start until the broker has acknowledged this halt."""
        if len(self._fences) >= MAX_FENCES:
            self._fences = {"ALL": order}
        else:
            self._fences[order.scope] = order

    def _follow_halts(self, now_s: float) -> Outgoing:
        """Answer open halts: HaltStarted in the first braking tick, HaltAtRest later. Runs in every tick until then."""
        out: Outgoing = []
        for halt in list(self._open_halts):
            if halt.started is None:
                halt.started = m.HaltStarted(
                    halt=halt.order.halt,
                    subsystem=self.name,
                    received_at_s=halt.received_at_s,
                    decelerating_at_s=now_s,
                    moving=halt.moving,
                )
                out += halt.to_callers(halt.started)
            at_rest, took_s = self._all_rest(halt), self._own_s(now_s) - halt.own_s
            if at_rest or took_s > REST_LIMIT_S:
                halt.ended = m.HaltAtRest(
                    halt=halt.order.halt,
                    subsystem=self.name,
                    at_s=now_s,
                    at_rest=at_rest,
                    performers=halt.performers,
                    own_s=took_s,
                )
                out += halt.to_callers(halt.ended)
                self._open_halts.remove(halt)
        return out

    def _own_s(self, now_s: float) -> float:
        """The time that limits what performers do: of a simulator its own, which a busy machine slows down."""
        return now_s

    # --- of one performer --------------------------------------------------------------------------------

    @abstractmethod
    def _primitives(self, performer: Performer) -> list[str]:
        """Ids of the primitives that it executes or has queued."""

    def _busy(self, primitive: Primitive) -> str:
        """Why a performer of this primitive is not free, apart from what it checks itself; else empty."""
        return ""

    def _start(self, performer: Performer, order: m.Execute, now_s: float) -> Outgoing:
        """Begin an order that has been admitted, or let it wait for its start condition."""
        return self._begin(performer, order.primitive, now_s)

    @abstractmethod
    def _accept(self, performer: Performer, primitive: Primitive, now_s: float) -> Reports:
        """Start or queue a primitive, or refuse it with an end report."""

    @abstractmethod
    def _tick(self, performer: Performer, now_s: float) -> Outgoing: ...

    def _between(self, now_s: float) -> Outgoing:
        """What concerns several performers, once in every tick."""
        return []

    def _pace(self, order: m.SetPaused) -> None:
        """Pause a primitive, or let it go on. A subsystem without `pauses` in its hello gets no such order."""

    def _answer_of_operator(self, answer: m.OperatorAnswer) -> Outgoing:
        """End what the operator performs with DONE or CANNOT, or refuse the DONE."""
        why = f"{self.name} has nothing that an operator performs"
        return [(BROKER, m.AnswerRefused(primitive=answer.primitive, message=why))]

    def _drop(self, scope: str, now_s: float) -> Outgoing:
        """End the orders in the scope of a halt that wait for their start."""
        return []

    @abstractmethod
    def _stop(self, performer: Performer, scope: str) -> bool:
        """Stop its primitives in the scope of a halt. True: it was executing one."""

    @abstractmethod
    def _rests(self, performer: Performer, scope: str) -> bool:
        """Nothing in the scope moves, and the end reports are out. So they arrive before the confirmation of rest, and
        the performer is free for the next primitive."""

    def _measured(self, performer: Performer, report: m.EndReport) -> m.EndReport:
        """The report of a primitive that was not begun, with the performer's present state if it has one."""
        return report


def not_begun(
    primitive: str, performer: str, why: str, *, at_s: float, reason: StopReason = StopReason.REFUSED
) -> m.EndReport:
    """The end report of a primitive that was never started, without any measurement."""
    return m.EndReport(primitive=primitive, performer=performer, reason=reason, at_s=at_s, duration_s=0.0, message=why)


def sendable(report: Report) -> Report:
    """The report, or one without its reading if it cannot be sent: the broker waits for an end report, and a message
    beyond the limit of a frame would cost the connection."""
    if not isinstance(report, m.EndReport | m.ProgressReport) or report.reading is None:
        return report
    try:
        size = len(wire.encode(report))
        if size <= wire.MAX_BATCH_BYTES:
            return report
        why = f"it has {size} bytes, and {wire.MAX_BATCH_BYTES} is the limit"
    except Exception as error:  # a value of a kind that no message can have
        why = guard.in_words(error)
    words = f"not sent: {why}"
    if isinstance(report, m.ProgressReport):
        return msgspec.structs.replace(report, reading=Measured(arm=report.reading.arm, others={"REPORT": words}))
    message = f"{report.message[:KEPT_WORDS]}; the reading is {words}".removeprefix("; ")
    partner = msgspec.structs.replace(report.partner, reading=None) if report.partner is not None else None
    return msgspec.structs.replace(report, message=message, reading=None, partner=partner)


def _acknowledges(order: m.HaltOrder, seen: m.HaltOrder) -> bool:
    """Whether this order of the broker acknowledges that fence."""
    return order.call == seen.call if order.call else order.halt == seen.halt


def in_scope(scope: str, performer: str, primitive: str) -> bool:
    return scope in ("ALL", performer) or primitive.startswith(f"{scope}.")
