"""The MCM as one subsystem: several arms, one broker, several callers of halts. Pure.

    handle(message, sender, now_s) -> [(receiver, message), ...]      tick(now_s) -> [(receiver, message), ...]

Sender and receiver are BROKER or the identity of a caller at the estop socket. The MCM works without the broker between
the start of a primitive and its end report (trusted soldier, R58). It keeps each end report and repeats it until the
broker acknowledges it. It remembers primitive ids, so it executes no primitive twice.

Every halt first brakes the arms in its scope; the answer follows. The same halt may arrive from the caller and from the
broker. Both get the same figures if nothing in scope has moved in between; earlier halts are remembered only for this.
A halt from the estop socket is forwarded to the broker with a call number, and repeated with every hello. It is a
fence: nothing in its scope starts until the broker has sent that number back. So a broker that was down during the halt
cannot start what was halted.
"""

from __future__ import annotations

import re
from collections import Counter, OrderedDict
from collections.abc import Mapping

import msgspec

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import FAULT_SCOPE, FaultScope, Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import Primitive, StartAfter
from rtc.protocol.primitive_id import LONGEST, is_name
from rtc.runtime.halt_admission import HaltRateLimiter
from sim_mcm.arms.arm import TICK_S, ArmInterface
from sim_mcm.control.executor import Executor
from sim_mcm.control.pairs import Pairs
from sim_mcm.control.reports import not_begun

BROKER = b""  # not a possible identity of a caller at the estop socket
REPEAT_S = 0.5  # period of repeating an end report that is not acknowledged
REMEMBERED = 2_000  # maximum number of remembered ended primitives; also of halts
# Maximum numbers of halts that wait for rest: per caller at the estop socket; of the broker, which has many clients.
# Each costs time in every tick. Above the maximum arms still stop, but the caller gets Declined, not a confirmation.
OPEN_HALTS = 8
OPEN_HALTS_OF_BROKER = 64
CALLERS_OF_A_HALT = 16  # maximum number that share one set of figures; a further caller gets its own
MAX_FENCES = 64  # maximum number of fenced scopes; above it one fence covers ALL
REST_LIMIT_S = 2.0  # an arm not at rest this long after a halt is reported as not at rest

COMMAND = re.compile(r"C-\d+", re.ASCII)

Outgoing = list[tuple[bytes, m.Message]]


class InvalidOrder(msgspec.Struct, frozen=True):
    """An Execute whose primitive does not decode, with the fields that could be read."""

    primitive: str  # its id
    performer: str
    pid: int
    why: str


class Halt(msgspec.Struct):
    """One halt and the callers that wait for its answers."""

    order: m.HaltOrder
    received_at_s: float
    performers: list[str]
    moving: list[str]
    begun: list[int]  # number of primitives that each performer had started at the time of the call
    callers: list[tuple[bytes, str]]  # identity, and the call number of its order
    started: m.HaltStarted | None = None
    ended: m.HaltAtRest | None = None

    def to_callers(self, message: m.HaltStarted | m.HaltAtRest) -> Outgoing:
        return [(sender, msgspec.structs.replace(message, call=call)) for sender, call in self.callers]


class Pending(msgspec.Struct):
    """An order that waits for its start condition: another arm must leave the space that it needs."""

    order: m.Execute
    ticks: int = 0  # waited so far, without pauses
    paused: bool = False  # it does not start until it is to go on


class McmSubsystem:
    def __init__(self, arms: Mapping[str, ArmInterface], name: str = "MCM", pid: int = 0) -> None:
        self.name = name
        self.pid = pid
        self.executors = {arm: Executor(part) for arm, part in arms.items()}
        self._pairs = Pairs(self.executors)
        self._kept: dict[
            str, tuple[m.EndReport, float]
        ] = {}  # unacknowledged end reports: primitive -> (report, time of the next repetition)
        self._ended: OrderedDict[str, m.EndReport] = OrderedDict()  # the last end reports; they answer repeated orders
        self._reached_s: dict[str, float] = {}  # how far each of them came along its trajectory
        self._pending: dict[str, Pending] = {}  # by performer
        self._content_hashes: dict[str, int] = {}  # primitive id -> hash of the whole primitive
        self._begun: Counter[str] = Counter()  # number of started primitives, by performer
        self._halts: OrderedDict[tuple[str, str], Halt] = OrderedDict()  # by name and scope
        self._calls = 0  # number of halts forwarded to the broker
        self._open_halts: list[Halt] = []
        self._halt_limiter = HaltRateLimiter()
        self._fences: dict[str, m.HaltOrder] = {}  # halt scope -> order that the broker has not acknowledged

    # --- public interface -------------------------------------------------------------------------------

    @property
    def outstanding(self) -> list[str]:
        running = list(dict.fromkeys(e.primitive_id for e in self.executors.values() if e.primitive))
        running += [pending.order.primitive.id for pending in self._pending.values()]
        return running + [primitive for primitive in self._kept if primitive not in running]

    @property
    def at_rest(self) -> bool:
        return all(map(_rests, self.executors.values()))

    @property
    def idle(self) -> bool:
        return not self._pending and all(e.primitive is None for e in self.executors.values())

    def handle(
        self, message: m.Execute | m.Pace | m.HaltOrder | m.ReportAck | InvalidOrder, sender: bytes, now_s: float
    ) -> Outgoing:
        if isinstance(message, m.HaltOrder):
            return self._halt(message, sender, now_s)
        if isinstance(message, m.ReportAck):
            if not message.primitive:  # without an id: the broker asks for a hello
                return self.hello()
            self._kept.pop(message.primitive, None)
            return []
        if isinstance(message, m.Pace):
            self._pace(message)
            return []
        if isinstance(message, InvalidOrder):
            return self._refuse(message, now_s)
        return self._execute(message, now_s)

    def brake(self) -> None:
        """Stop every arm without a halt to answer: the process ends."""
        self._pending.clear()
        for executor in self.executors.values():
            executor.halt()

    def hello(self) -> Outgoing:
        """To a newly connected broker: name, arms and outstanding primitives, then all unacknowledged end reports and
        halts."""
        hello = m.SubsystemHello(
            name=self.name,
            pid=self.pid,
            performers=list(self.executors),
            outstanding=self.outstanding,
            at_rest=self.at_rest,
            arrays=True,
            pauses=True,
            paused=self._paused,
        )
        halts = self._fences.values()
        return [
            (BROKER, hello),
            *((BROKER, report) for report, _ in self._kept.values()),
            *((BROKER, h) for h in halts),
        ]

    def tick(self, now_s: float) -> Outgoing:
        """One servo tick of every arm."""
        out: Outgoing = []
        for executor in self.executors.values():
            for message in executor.tick(now_s):
                if not isinstance(message, m.EndReport):
                    if not isinstance(message, m.Paced) or (BROKER, message) not in out:  # of two arms once
                        out.append((BROKER, message))
                elif (whole := self._pairs.whole(message)) is not None:
                    self._reached_s[whole.primitive] = executor.path_s
                    out += self._end(whole, now_s)
            if executor.trip is not None and FAULT_SCOPE[executor.trip.reason] is FaultScope.SUBSYSTEM:
                out += self._stop_all(executor.trip.reason, executor.trip.message, now_s)
        self._pairs.couple()
        if self._pending:
            out += self._follow_pending(now_s)
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
            return self._end(not_begun(primitive.id[:LONGEST], primitive.performer, why, at_s=now_s), now_s)
        executor = self.executors.get(primitive.performer)
        if executor is None:
            why = f"{self.name} has no {primitive.performer}; it has {', '.join(self.executors)}"
            return self._end(not_begun(primitive.id, primitive.performer, why, at_s=now_s), now_s)
        pending = self._pending.get(executor.name)
        if primitive.id in (executor.primitive_id, pending and pending.order.primitive.id):
            return []  # it is being executed, or waits for its start
        if why := self._busy(primitive):
            return self._end(self._not_begun(primitive, StopReason.REFUSED, why, now_s), now_s)
        if (halt := self._halted_before(order)) is not None:
            why = f"the broker had not yet acknowledged halt {halt} when it sent this; not started"
            return self._end(self._not_begun(primitive, StopReason.HALT, why, now_s), now_s)
        if primitive.start_after:
            self._pending[executor.name] = Pending(order)
            return self._follow_pending(now_s)
        return self._begin(executor, primitive, now_s)

    def _busy(self, primitive: Primitive) -> str:
        """Why an arm of this primitive is not free, apart from what its executor checks; else empty."""
        for name in primitive.performers:
            if name not in self.executors:
                return f"{self.name} has no {name}; it has {', '.join(self.executors)}"
            for pending in self._pending.values():
                if name in pending.order.primitive.performers:
                    return f"{name} is busy with {pending.order.primitive.id}, which waits for its start"
        return ""

    def _begin(self, executor: Executor, primitive: Primitive, now_s: float) -> Outgoing:
        out: Outgoing = []
        paired = primitive.partner is not None
        for message in self._pairs.begin(primitive, now_s) if paired else executor.accept(primitive, now_s):
            for name in primitive.performers:
                self._begun[name] += isinstance(message, m.Started)
            out += self._end(message, now_s) if isinstance(message, m.EndReport) else [(BROKER, message)]
        return out

    def _follow_pending(self, now_s: float) -> Outgoing:
        """Begin the orders whose start conditions are met; end those whose conditions cannot be met any more."""
        out: Outgoing = []
        paused = self._paused
        for name, pending in list(self._pending.items()):
            primitive, waited_s = pending.order.primitive, pending.ticks * TICK_S
            if pending.paused:
                continue
            pending.ticks += not any(condition.primitive in paused for condition in primitive.start_after)
            whys = [self._why_not(condition, waited_s) for condition in primitive.start_after]
            if None in whys:
                continue
            del self._pending[name]
            if why := next(filter(None, whys), ""):
                out += self._end(self._not_begun(primitive, StopReason.BLOCKED, why, now_s), now_s)
            else:
                out += self._begin(self.executors[name], primitive, now_s)
        return out

    def _why_not(self, condition: StartAfter, waited_s: float) -> str | None:
        """Empty: the condition is met. None: it may be met later. Otherwise the reason why it cannot be met."""
        name = condition.primitive
        running = next((e for e in self.executors.values() if e.primitive_id == name), None)
        waiting = any(pending.order.primitive.id == name for pending in self._pending.values())
        reached_s = running.path_s if running is not None else self._reached_s.get(name, 0.0)
        if reached_s >= condition.path_s and (running is not None or name in self._reached_s):
            return ""
        if running is None and not waiting:
            return f"{name} has ended before it left the space that this needs"
        if waited_s > condition.within_s:
            return f"{name} has not left the space that this needs within {condition.within_s:.3g} s"
        return None

    def _pace(self, order: m.Pace) -> None:
        """Pause a primitive, or let it go on. One that has ended ignores it: its report is on the way."""
        arms = [executor for executor in self.executors.values() if executor.primitive_id == order.primitive]
        ramp_s = max((executor.ramp_s for executor in arms), default=0.0)  # two arms on one object stay together
        for executor in arms:
            executor.pace(order.paused, ramp_s)
        for pending in self._pending.values():
            if pending.order.primitive.id == order.primitive:
                pending.paused = order.paused

    @property
    def _paused(self) -> list[str]:
        """Primitives that were ordered to pause."""
        found = [executor.primitive_id for executor in self.executors.values() if executor.paused]
        found += [pending.order.primitive.id for pending in self._pending.values() if pending.paused]
        return list(dict.fromkeys(found))

    def _stop_all(self, reason: StopReason, words: str, now_s: float) -> Outgoing:
        """Stop every arm for a fault that concerns all of them."""
        for executor in self.executors.values():
            if executor.primitive is not None and executor.trip is None:
                executor.halt(reason, words)
        return self._drop_pending("ALL", reason, words, now_s)

    def _drop_pending(self, scope: str, reason: StopReason, why: str, now_s: float) -> Outgoing:
        out: Outgoing = []
        for name, pending in list(self._pending.items()):
            primitive = pending.order.primitive
            if any(_in_scope(scope, performer, primitive.id) for performer in primitive.performers):
                del self._pending[name]
                out += self._end(self._not_begun(pending.order.primitive, reason, why, now_s), now_s)
        return out

    def _not_begun(self, primitive: Primitive, reason: StopReason, why: str, now_s: float) -> m.EndReport:
        executor = self.executors[primitive.performer]
        pose = executor.arm.tcp_pose(executor.sample.joints)
        return not_begun(
            primitive.id, executor.name, why, at_s=now_s, reason=reason, sample=executor.sample, tcp_pose=pose
        )

    def _refuse(self, order: InvalidOrder, now_s: float) -> Outgoing:
        """Answer an invalid order with an end report, because the broker waits for one."""
        if order.pid not in (0, self.pid):
            return self.hello()
        if (ended := self._ended.get(order.primitive)) is not None:
            return [(BROKER, ended)]
        executor = self.executors.get(order.performer)
        if executor is None:
            return self._end(not_begun(order.primitive, order.performer, order.why, at_s=now_s), now_s)
        sample, pose = executor.sample, executor.arm.tcp_pose(executor.sample.joints)
        report = not_begun(order.primitive, order.performer, order.why, at_s=now_s, sample=sample, tcp_pose=pose)
        return self._end(report, now_s)

    def _end(self, report: m.EndReport, now_s: float) -> Outgoing:
        self._kept[report.primitive] = (report, now_s + REPEAT_S)
        self._ended[report.primitive] = report
        if len(self._ended) > REMEMBERED:
            oldest, _ = self._ended.popitem(last=False)
            self._content_hashes.pop(oldest, None)
            self._reached_s.pop(oldest, None)
        return [(BROKER, report)]

    def _repeat_reports(self, now_s: float) -> Outgoing:
        due = [report for report, at_s in self._kept.values() if now_s >= at_s]
        for report in due:
            self._kept[report.primitive] = (report, now_s + REPEAT_S)
        return [(BROKER, report) for report in due]

    def _halted_before(self, order: m.Execute) -> str | None:
        """The fence that stops this order: a halt in scope that the broker had not acknowledged when it sent the
        order."""
        for scope, halt in self._fences.items():
            if any(_in_scope(scope, name, order.primitive.id) for name in order.primitive.performers):
                return halt.halt
        return None

    # --- halts -----------------------------------------------------------------------------------------

    def _halt(self, order: m.HaltOrder, sender: bytes, now_s: float) -> Outgoing:
        """Brake the arms in scope at once, for any caller and any halt id; then answer."""
        if sender != BROKER and not self._knows_scope(order.scope):
            words = f"unknown scope {order.scope}; known scopes are ALL, {', '.join(self.executors)}"
            refusal = Refusal(reason=RefusalReason.NAME, message=words, expected=["ALL", *self.executors])
            return [(sender, m.Declined(request=order.halt, refusal=refusal))]
        reached = [e for e in self.executors.values() if _in_scope(order.scope, e.name, e.primitive_id)]
        moving = [e.name for e in reached if e.halt()]
        dropped = self._drop_pending(order.scope, StopReason.HALT, "halted before its start", now_s)
        return [*dropped, *self._answer_halt(order, sender, reached, moving, now_s)]

    def _answer_halt(
        self, order: m.HaltOrder, sender: bytes, reached: list[Executor], moving: list[str], now_s: float
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
            return [(sender, _overload(order, "too many calls in a short time"))]
        self._fence(passed_on)
        return [(BROKER, passed_on), *self._answer(order, sender, reached, moving, now_s)]

    def _numbered(self, order: m.HaltOrder, now_s: float) -> m.HaltOrder:
        """The order with its time of receipt and a unique call number: two halts may share an id, and the broker may
        know only one of them."""
        self._calls += 1
        return msgspec.structs.replace(order, call=f"{self.pid}-{self._calls}", received_at_s=now_s)

    def _answer(
        self, order: m.HaltOrder, sender: bytes, reached: list[Executor], moving: list[str], now_s: float
    ) -> Outgoing:
        """Answer a halt that has been obeyed, at once or when all arms in its scope rest."""
        halt, caller = self._halts.get((order.halt, order.scope)), (sender, order.call)
        if halt is not None and self._is_still_true(halt, reached):
            if caller not in halt.callers:
                halt.callers.append(caller)
            known = [message for message in (halt.started, halt.ended) if message is not None]
            return [(sender, msgspec.structs.replace(message, call=order.call)) for message in known]
        performers = [e.name for e in reached]
        halt = Halt(order, now_s, performers, moving, self._begun_by(performers), [caller])
        open_halts = sum(other.callers[0][0] == sender for other in self._open_halts)
        if open_halts >= (OPEN_HALTS_OF_BROKER if sender == BROKER else OPEN_HALTS):
            return (
                []
                if sender == BROKER
                else [(sender, _overload(order, "earlier halts of this caller still wait for rest"))]
            )
        self._halts[order.halt, order.scope] = halt
        self._halts.move_to_end((order.halt, order.scope))
        if len(self._halts) > REMEMBERED:
            self._halts.popitem(last=False)
        self._open_halts.append(halt)
        return [] if moving else self._follow_halts(now_s)  # nothing moves, so the answer needs no tick

    def _is_still_true(self, halt: Halt, reached: list[Executor]) -> bool:
        """Whether the answers to an earlier halt still hold: no arm in `reached` has started a primitive since, and
        arms reported at rest are at rest."""
        if len(halt.callers) >= CALLERS_OF_A_HALT or not {e.name for e in reached} <= set(halt.performers):
            return False
        if halt.begun != self._begun_by(halt.performers):
            return False
        return halt.ended is None or (halt.ended.at_rest and all(_rests(self.executors[n]) for n in halt.performers))

    def _begun_by(self, performers: list[str]) -> list[int]:
        return [self._begun[name] for name in performers]

    def _knows_scope(self, scope: str) -> bool:
        """Whether a scope is ALL, one of our arms, or a command id (only the broker knows which commands exist)."""
        return scope == "ALL" or scope in self.executors or COMMAND.fullmatch(scope) is not None

    def _fence(self, order: m.HaltOrder) -> None:
        """Let nothing in the scope start until the broker has acknowledged this halt."""
        if len(self._fences) >= MAX_FENCES:
            self._fences = {"ALL": order}
        else:
            self._fences[order.scope] = order

    def _follow_halts(self, now_s: float) -> Outgoing:
        """Answer open halts: HaltStarted in the first braking tick, HaltAtRest later. Runs in every tick until then."""
        out: Outgoing = []
        resting = {name for name, executor in self.executors.items() if _rests(executor)}
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
            at_rest = resting.issuperset(halt.performers)
            if at_rest or now_s - halt.received_at_s > REST_LIMIT_S:
                halt.ended = m.HaltAtRest(
                    halt=halt.order.halt,
                    subsystem=self.name,
                    at_s=now_s,
                    at_rest=at_rest,
                    performers=halt.performers,
                )
                out += halt.to_callers(halt.ended)
                self._open_halts.remove(halt)
        return out


def _rests(executor: Executor) -> bool:
    """The arm stands still and its end report is out. So the report arrives before the confirmation of rest, and the
    arm is free for the next primitive."""
    return executor.at_rest and executor.primitive is None


def _acknowledges(order: m.HaltOrder, seen: m.HaltOrder) -> bool:
    """Whether this order of the broker acknowledges that fence."""
    return order.call == seen.call if order.call else order.halt == seen.halt


def _overload(order: m.HaltOrder, why: str) -> m.Declined:
    message = f"the halt was obeyed, but rest will not be confirmed: {why}"
    return m.Declined(request=order.halt, refusal=Refusal(reason=RefusalReason.OVERLOAD, message=message))


def _in_scope(scope: str, performer: str, primitive: str) -> bool:
    return scope in ("ALL", performer) or primitive.startswith(f"{scope}.")
