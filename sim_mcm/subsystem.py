"""The MCM as one subsystem: several arms, one broker to report to, and whoever calls a halt. Pure.

    hear(message, sender, now_s) -> [(sender, message), ...]      tick(now_s) -> [(sender, message), ...]

A sender is who said it and who is answered: BROKER, or the identity of a caller at the estop socket. Trusted soldier
(R58): between a primitive and its end report nothing is needed from the broker; reports are kept, and said again,
until they are acknowledged. No primitive is executed twice (its id is remembered).

Every halt brakes what is in its scope first, and is answered afterwards. Earlier halts are remembered for one purpose:
a halt that is received twice (from the caller and from the broker) is answered with the same figures, as long as
nothing in its scope has moved in between. A halt that was called past the broker is passed on to it under a number of
its own, and said again with every hello; until the broker has answered that number, nothing in its scope begins, so a
broker that was dead or blind meanwhile cannot start what was halted.
"""

from __future__ import annotations

import re
from collections import Counter, OrderedDict
from collections.abc import Mapping

import msgspec

from rtc import messages as m
from rtc import wire
from rtc.halt_admission import HaltRateLimiter
from rtc.outcomes import Refusal, RefusalReason, StopReason
from rtc.primitive_id import LONGEST, is_name
from sim_mcm.arm import Arm
from sim_mcm.executor import Executor
from sim_mcm.reports import not_begun

BROKER = b""  # no caller at the estop socket has this identity
REPEAT_S = 0.5  # an end report is said again until it is acknowledged
REMEMBERED = 2_000  # ended primitives, and halts
# Halts that wait for rest: of one caller at the estop socket, and of the broker, who has many. Each costs time in every
# tick, and answers. One more is obeyed like any other, and declined in words.
OPEN_HALTS = 8
OPEN_HALTS_OF_BROKER = 64
CALLERS_OF_A_HALT = 16  # that are answered with the same figures; one more gets an answer of its own
MAX_FENCES = 64  # scopes; with more of them, nothing at all begins until the broker has answered
REST_LIMIT_S = 2.0  # after a halt: no rest by then is told as such

COMMAND = re.compile(r"C-\d+", re.ASCII)

Outgoing = list[tuple[bytes, m.Message]]


class InvalidOrder(msgspec.Struct, frozen=True):
    """An order to execute something that is not a primitive, with what can be read of it."""

    primitive: str  # its id
    performer: str
    pid: int
    why: str


class Halt(msgspec.Struct):
    """One halt that was called, and who wants to hear of it."""

    order: m.HaltOrder
    received_at_s: float
    performers: list[str]
    moving: list[str]
    begun: list[int]  # primitives that each performer had begun when it was called
    callers: list[tuple[bytes, str]]  # sender, and the number of the order there
    started: m.HaltStarted | None = None
    ended: m.HaltAtRest | None = None

    def to_callers(self, message: m.HaltStarted | m.HaltAtRest) -> Outgoing:
        return [(sender, msgspec.structs.replace(message, call=call)) for sender, call in self.callers]


class Subsystem:
    def __init__(self, arms: Mapping[str, Arm], name: str = "MCM", pid: int = 0) -> None:
        self.name = name
        self.pid = pid
        self.executors = {arm: Executor(part) for arm, part in arms.items()}
        self._kept: dict[str, tuple[m.EndReport, float]] = {}  # not acknowledged; when to say it again
        self._ended: OrderedDict[str, m.EndReport] = OrderedDict()  # all, for repeated orders
        self._content_hashes: dict[str, int] = {}  # primitive -> hash of the whole primitive that bore this id
        self._begun: Counter[str] = Counter()  # primitives, by performer
        self._halts: OrderedDict[tuple[str, str], Halt] = OrderedDict()  # by name and scope
        self._calls = 0  # halts passed on to the broker so far
        self._open_halts: list[Halt] = []
        self._halt_limiter = HaltRateLimiter()
        self._fences: dict[str, m.HaltOrder] = {}  # scope -> halt that the broker has not shown to know of

    # --- what is asked of it ---------------------------------------------------------------------------

    @property
    def outstanding(self) -> list[str]:
        running = [e.primitive_id for e in self.executors.values() if e.primitive]
        return running + [primitive for primitive in self._kept if primitive not in running]

    @property
    def at_rest(self) -> bool:
        return all(map(_rests, self.executors.values()))

    @property
    def idle(self) -> bool:
        return all(e.primitive is None for e in self.executors.values())

    def handle(
        self, message: m.Execute | m.HaltOrder | m.ReportAck | InvalidOrder, sender: bytes, now_s: float
    ) -> Outgoing:
        if isinstance(message, m.HaltOrder):
            return self._halt(message, sender, now_s)
        if isinstance(message, m.ReportAck):
            if not message.primitive:  # of nothing: a broker that does not know us asks who we are
                return self.hello()
            self._kept.pop(message.primitive, None)
            return []
        if isinstance(message, InvalidOrder):
            return self._refuse(message, now_s)
        return self._execute(message, now_s)

    def brake(self) -> None:
        """Stop everything, for nobody in particular: the process is to end."""
        for executor in self.executors.values():
            executor.halt()

    def hello(self) -> Outgoing:
        """To a broker that has just been found: who we are, what is under way, and what it has not acknowledged:
        end reports, and halts that were called past it."""
        hello = m.SubsystemHello(
            name=self.name,
            pid=self.pid,
            performers=list(self.executors),
            outstanding=self.outstanding,
            at_rest=self.at_rest,
            arrays=True,
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
                if isinstance(message, m.EndReport):
                    out += self._end(message, now_s)
                else:
                    out.append((BROKER, message))
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
        if order.pid not in (0, self.pid):  # meant for the process before us, or for somebody who took our name
            return self.hello()
        whole = hash(wire.encode(primitive))
        if self._content_hashes.setdefault(primitive.id, whole) != whole:
            why = f"{self.name} knows another primitive of the id {primitive.id}; not begun"
            return [(BROKER, not_begun(primitive.id, primitive.performer, why, at_s=now_s))]
        if (ended := self._ended.get(primitive.id)) is not None:
            return [(BROKER, ended)]
        if not is_name(primitive.id):  # a halt of its command would not find it
            why = "its id is not the name of a primitive, such as C-3.1"
            return self._end(not_begun(primitive.id[:LONGEST], primitive.performer, why, at_s=now_s), now_s)
        executor = self.executors.get(primitive.performer)
        if executor is None:
            why = f"{self.name} has no {primitive.performer}; it has {', '.join(self.executors)}"
            return self._end(not_begun(primitive.id, primitive.performer, why, at_s=now_s), now_s)
        if executor.primitive_id == primitive.id:
            return []  # it is being done
        if (halt := self._halted_before(order)) is not None:
            why = f"sent in ignorance of halt {halt}; not begun"
            pose = executor.arm.tcp_pose(executor.sample.joints)
            report = not_begun(
                primitive.id,
                primitive.performer,
                why,
                at_s=now_s,
                reason=StopReason.HALT,
                sample=executor.sample,
                tcp_pose=pose,
            )
            return self._end(report, now_s)
        out: Outgoing = []
        for message in executor.accept(primitive, now_s):
            self._begun[executor.name] += isinstance(message, m.Started)
            out += self._end(message, now_s) if isinstance(message, m.EndReport) else [(BROKER, message)]
        return out

    def _refuse(self, order: InvalidOrder, now_s: float) -> Outgoing:
        """The broker waits for an answer, whatever it has sent."""
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
        return [(BROKER, report)]

    def _repeat_reports(self, now_s: float) -> Outgoing:
        due = [report for report, at_s in self._kept.values() if now_s >= at_s]
        for report in due:
            self._kept[report.primitive] = (report, now_s + REPEAT_S)
        return [(BROKER, report) for report in due]

    def _halted_before(self, order: m.Execute) -> str | None:
        """The halt, called past the broker, that the broker had not heard of when it sent this."""
        for scope, halt in self._fences.items():
            if _in_scope(scope, order.primitive.performer, order.primitive.id):
                return halt.halt
        return None

    # --- halts -----------------------------------------------------------------------------------------

    def _halt(self, order: m.HaltOrder, sender: bytes, now_s: float) -> Outgoing:
        """Brake now what is in scope, whatever the halt is called and whoever calls it; then answer."""
        if sender != BROKER and not self._knows_scope(order.scope):
            words = f"nothing here is called {order.scope}; there are ALL, {', '.join(self.executors)}"
            refusal = Refusal(reason=RefusalReason.NAME, message=words, expected=["ALL", *self.executors])
            return [(sender, m.Declined(request=order.halt, refusal=refusal))]
        reached = [e for e in self.executors.values() if _in_scope(order.scope, e.name, e.primitive_id)]
        moving = [e.name for e in reached if e.halt()]
        if sender == BROKER:  # what comes on this socket from here on, the broker has sent knowing of the halt
            self._fences = {scope: seen for scope, seen in self._fences.items() if not _acknowledges(order, seen)}
            return self._answer(order, sender, reached, moving, now_s)
        passed_on = self._numbered(order)
        if self._halt_limiter.exceeds(sender, now_s):
            merged = self._halt_limiter.merge(passed_on)
            if merged.scope == "ALL":  # in place of those that have been merged into it
                self._fences.clear()
            self._fence(merged)
            return [(sender, _overload(order, "you call too often"))]
        self._fence(passed_on)
        return [(BROKER, passed_on), *self._answer(order, sender, reached, moving, now_s)]

    def _numbered(self, order: m.HaltOrder) -> m.HaltOrder:
        """As it is passed on: two halts may have one name, and the broker may know of only one of them."""
        self._calls += 1
        return msgspec.structs.replace(order, call=f"{self.pid}-{self._calls}")

    def _answer(
        self, order: m.HaltOrder, sender: bytes, reached: list[Executor], moving: list[str], now_s: float
    ) -> Outgoing:
        """What became of a halt that has been obeyed: at once, or when all in its scope rest."""
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
            return [] if sender == BROKER else [(sender, _overload(order, "earlier ones still wait for rest"))]
        self._halts[order.halt, order.scope] = halt
        self._halts.move_to_end((order.halt, order.scope))
        if len(self._halts) > REMEMBERED:
            self._halts.popitem(last=False)
        self._open_halts.append(halt)
        return [] if moving else self._follow_halts(now_s)  # nothing moves: no tick need pass

    def _is_still_true(self, halt: Halt, reached: list[Executor]) -> bool:
        """Whether an earlier halt says of those `reached` now what is so now: none of them has begun anything since,
        and if it said that they rest, they do."""
        if len(halt.callers) >= CALLERS_OF_A_HALT or not {e.name for e in reached} <= set(halt.performers):
            return False
        if halt.begun != self._begun_by(halt.performers):
            return False
        return halt.ended is None or (halt.ended.at_rest and all(_rests(self.executors[n]) for n in halt.performers))

    def _begun_by(self, performers: list[str]) -> list[int]:
        return [self._begun[name] for name in performers]

    def _knows_scope(self, scope: str) -> bool:
        """Whether a scope is one of ours, or a command, of which only the broker knows whether it is there."""
        return scope == "ALL" or scope in self.executors or COMMAND.fullmatch(scope) is not None

    def _fence(self, order: m.HaltOrder) -> None:
        """Until the broker has answered with this halt, nothing in its scope begins."""
        if len(self._fences) >= MAX_FENCES:
            self._fences = {"ALL": order}
        else:
            self._fences[order.scope] = order

    def _follow_halts(self, now_s: float) -> Outgoing:
        """Called in the tick whose command brakes, and every tick until rest."""
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
    """It stands still and has said how its primitive ended: whoever hears of rest has heard the report before, and
    can give it something new at once."""
    return executor.at_rest and executor.primitive is None


def _acknowledges(order: m.HaltOrder, seen: m.HaltOrder) -> bool:
    """Whether the broker has sent this order knowing of that halt."""
    return order.call == seen.call if order.call else order.halt == seen.halt


def _overload(order: m.HaltOrder, why: str) -> m.Declined:
    message = f"obeyed; but rest is not told: {why}"
    return m.Declined(request=order.halt, refusal=Refusal(reason=RefusalReason.OVERLOAD, message=message))


def _in_scope(scope: str, performer: str, primitive: str) -> bool:
    return scope in ("ALL", performer) or primitive.startswith(f"{scope}.")
