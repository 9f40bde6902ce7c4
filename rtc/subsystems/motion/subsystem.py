"""The MCM as a subsystem (`rtc.subsystems.base`): its performers are arms, each with an executor. Pure.

Beyond one arm: primitives of two arms (`pairs`), orders that wait until another arm has left the space that they need,
and faults that stop every arm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.outcomes import FAULT_SCOPE, FaultScope, StopReason
from rtc.protocol.primitive import Primitive, StartAfter
from rtc.protocol.subsystems import ARMS
from rtc.protocol.versions import ARRAYS, PAUSES, RIGID
from rtc.subsystems.base.report_items import Measure, measured
from rtc.subsystems.base.subsystem import BROKER, BaseSubsystem, Outgoing, Report, Reports, in_scope
from rtc.subsystems.motion.arm import TICK_S, ArmInterface
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.two_arms import Pairs


class Pending(msgspec.Struct):
    """An order that waits for its start condition: another arm must leave the space that it needs."""

    order: m.Execute
    ticks: int = 0  # waited so far, without pauses
    paused: bool = False  # it does not start until it is to go on


class Following(msgspec.Struct):
    """A motion that has begun and has conditions on its way."""

    primitive: Primitive
    ticks: int  # waited so far, with those before its start
    stage: dict[str, int] = {}  # primitive of a condition -> how many of those on the way are met


class McmSubsystem(BaseSubsystem[Executor]):
    """`measure`: the values of report items of packages."""

    def __init__(
        self, arms: Mapping[str, ArmInterface], name: str = ARMS.name, pid: int = 0, measure: Measure = measured
    ) -> None:
        super().__init__({arm: Executor(part, measure) for arm, part in arms.items()}, name, pid)
        self._pairs = Pairs(self.executors)
        self._reached_s: dict[str, float] = {}  # how far each ended primitive came along its trajectory
        self._pending: dict[str, Pending] = {}  # by performer
        self._following: dict[str, Following] = {}  # by performer
        self._paced: list[m.PauseChanged] = []  # reported in this tick
        self._ticks = 0

    @property
    def executors(self) -> dict[str, Executor]:
        return self.performers

    @property
    def idle(self) -> bool:
        return not self._pending and all(executor.primitive is None for executor in self._all)

    def brake(self) -> None:
        self._pending.clear()
        self._following.clear()
        super().brake()

    def hello(self) -> Outgoing:
        return super().hello() + ([(BROKER, self._strayed())] if any(one.strayed for one in self._all) else [])

    def _strayed(self) -> m.Strayed:
        return m.Strayed(arms={executor.name: executor.strayed for executor in self._all if executor.strayed})

    def _hello(self) -> m.SubsystemHello:
        rigid = [RIGID] if any(executor.arm.traits.rigid for executor in self._all) else []
        return msgspec.structs.replace(super()._hello(), abilities=[ARRAYS, PAUSES, *rigid], paused=self._paused)

    # --- of one arm --------------------------------------------------------------------------------------

    def _primitives(self, performer: Executor) -> list[str]:
        pending = self._pending.get(performer.name)
        waiting = [pending.order.primitive.id] if pending else []
        return [performer.primitive_id, *waiting] if performer.primitive else waiting

    def _is_reached(self, scope: str, name: str, performer: Executor) -> bool:
        return in_scope(scope, name, performer.primitive_id)

    def _accept(self, performer: Executor, primitive: Primitive, now_s: float) -> Reports:
        strayed = any(executor.strayed for executor in self._all)
        begun = performer.accept(primitive, now_s) if primitive.partner is None else self._pairs.begin(primitive, now_s)
        return [*begun, self._strayed()] if strayed else begun

    def _tick(self, performer: Executor, now_s: float) -> Outgoing:
        reports = performer.tick(now_s)
        if not reports and performer.trip is None:  # in nearly every tick
            return []
        messages: list[Report] = []
        for message in reports:
            if isinstance(message, m.PauseChanged):
                if message not in self._paced:  # of two arms once
                    self._paced.append(message)
                    messages.append(message)
            elif isinstance(message, m.Strayed):
                messages.append(self._strayed())
            elif not isinstance(message, m.EndReport):
                messages.append(message)
            elif (whole := self._pairs.whole(message)) is not None:
                self._reached_s[whole.primitive] = performer.path_s
                messages.append(whole)
        out = self._sent(messages, now_s)
        if performer.trip is not None and FAULT_SCOPE[performer.trip.reason] is FaultScope.SUBSYSTEM:
            out += self._stop_all(performer.trip.reason, performer.trip.message, now_s)
        return out

    def _stop(self, performer: Executor, scope: str) -> bool:
        return performer.halt()

    def _rests(self, performer: Executor, scope: str) -> bool:
        return performer.at_rest and performer.primitive is None

    def _measured(self, performer: Executor, report: m.EndReport) -> m.EndReport:
        sample = performer.sample
        return msgspec.structs.replace(
            report,
            joints=sample.joints,
            tcp_pose=performer.arm.tcp_pose(sample.joints).tolist(),
            wrench=sample.wrench,
            hand_width_m=sum(sample.fingers),
            hand_force_n=min(sample.finger_forces),
        )

    def _forget(self, primitive: str) -> None:
        super()._forget(primitive)
        self._reached_s.pop(primitive, None)

    # --- of the operator ---------------------------------------------------------------------------------

    def operate(self, wanted: m.Operate, caller: bytes, now_s: float) -> m.OperateReply:
        """Follow the hand of an operator; `caller`: the identity of the connection."""
        executor = next((one for one in self._all if one.primitive_id == wanted.primitive != ""), None)
        if executor is not None:
            refused = executor.operate(wanted, caller, now_s)
        elif wanted.primitive:
            refused = f"{wanted.primitive} has ended, or is of another subsystem: its grant is no more"
        else:
            refused = "it is of no grant"
        cut = executor.operated.cut if executor is not None and executor.operated is not None else ""
        return m.OperateReply(primitive=wanted.primitive, at_s=now_s, refused=refused, cut=cut)

    def _answer_of_operator(self, answer: m.OperatorAnswer) -> Outgoing:
        """End what the operator does. An answer to what has ended changes nothing: its end report is on the way."""
        executor = next((one for one in self._all if one.primitive_id == answer.primitive), None)
        if executor is None or executor.trip is not None:
            return []
        if executor.operated is None:
            why = f"{answer.primitive} is not performed by the operator"
        else:
            why = executor.answer(answer)
        return [(BROKER, m.AnswerRefused(primitive=answer.primitive, message=f"{executor.name}: {why}"))] if why else []

    # --- of several arms ---------------------------------------------------------------------------------

    def _busy(self, primitive: Primitive) -> str:
        for name in primitive.performers:
            if name not in self.executors:
                return f"{self.name} has no {name}; it has {', '.join(self.executors)}"
            for pending in self._pending.values():
                if name in pending.order.primitive.performers:
                    return f"{name} is busy with {pending.order.primitive.id}, which waits for its start"
        return ""

    def _start(self, performer: Executor, order: m.Execute, now_s: float) -> Outgoing:
        if not order.primitive.start_after:
            return self._begin(performer, order.primitive, now_s)
        self._pending[performer.name] = Pending(order)
        return self._follow_pending(now_s)

    def _own_s(self, now_s: float) -> float:
        return self._ticks * TICK_S

    def _between(self, now_s: float) -> Outgoing:
        self._ticks += 1
        if self._paced:
            self._paced.clear()
        if self._pairs.exist:
            self._pairs.couple()
        if self._following:
            self._follow()
        return self._follow_pending(now_s) if self._pending else []

    def _follow_pending(self, now_s: float) -> Outgoing:
        """Begin the orders whose start conditions are met; end those whose conditions cannot be met any more."""
        out: Outgoing = []
        paused = self._standing
        for name, pending in list(self._pending.items()):
            primitive, waited_s = pending.order.primitive, pending.ticks * TICK_S
            if pending.paused:
                continue
            pending.ticks += not any(condition.primitive in paused for condition in primitive.start_after)
            whys = [self._why_not(condition, condition.path_s, waited_s) for condition in primitive.start_after]
            if None in whys:
                continue
            del self._pending[name]
            if why := next(filter(None, whys), ""):
                out += self._refuse_to_begin(primitive, StopReason.BLOCKED, why, now_s)
            else:
                out += self._begin(self.executors[name], primitive, now_s)
                if any(condition.further for condition in primitive.start_after):
                    self._following[name] = Following(primitive, pending.ticks)
        return out

    def _follow(self) -> None:
        """Keep each motion with conditions on its way before the first one that is not met. Stop a motion whose
        conditions cannot be met any more."""
        for name, following in list(self._following.items()):
            executor, waited_s = self.executors[name], following.ticks * TICK_S
            if executor.primitive_id != following.primitive.id or executor.trip is not None:
                del self._following[name]
                continue
            before_s, awaited, why = math.inf, [], ""
            for condition in following.primitive.start_after:
                for own_s, path_s in condition.further[following.stage.get(condition.primitive, 0) :]:
                    found = self._why_not(condition, path_s, waited_s)
                    if found == "":
                        following.stage[condition.primitive] = following.stage.get(condition.primitive, 0) + 1
                        continue
                    why = why or found or ""
                    before_s = min(before_s, own_s)
                    awaited.append(condition.primitive)
                    break
            if why:
                executor.halt(StopReason.BLOCKED, why)
                continue
            executor.keep_before(before_s)
            if not awaited and not executor.held_back:
                del self._following[name]
            waits = executor.held_back and not executor.paused
            following.ticks += waits and not any(other in self._standing for other in awaited)

    def _why_not(self, condition: StartAfter, path_s: float, waited_s: float) -> str | None:
        """Empty: the other primitive has come to `path_s`. None: it may come there. Otherwise the reason why it cannot
        come there any more, or not in time."""
        name = condition.primitive
        running = next((e for e in self.executors.values() if e.primitive_id == name), None)
        waiting = any(pending.order.primitive.id == name for pending in self._pending.values())
        reached_s = running.path_s if running is not None else self._reached_s.get(name, 0.0)
        if reached_s >= path_s and (running is not None or name in self._reached_s):
            return ""
        if running is None and not waiting:
            return f"{name} has ended before it left the space that this needs"
        if waited_s > condition.within_s:
            return f"{name} has not left the space that this needs within {condition.within_s:.3g} s"
        return None

    def _pace(self, order: m.SetPaused) -> None:
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

    @property
    def _standing(self) -> list[str]:
        """Primitives that do not go on for a time: those that were ordered to pause, and those that wait on their way.
        A wait for them does not count."""
        return self._paused + [executor.primitive_id for executor in self._all if executor.held_back]

    def _stop_all(self, reason: StopReason, words: str, now_s: float) -> Outgoing:
        """Stop every arm for a fault that concerns all of them."""
        for executor in self.executors.values():
            if executor.primitive is not None and executor.trip is None:
                executor.halt(reason, words)
        return self._drop_pending("ALL", reason, words, now_s)

    def _drop(self, scope: str, now_s: float) -> Outgoing:
        return self._drop_pending(scope, StopReason.HALT, "halted before its start", now_s)

    def _drop_pending(self, scope: str, reason: StopReason, why: str, now_s: float) -> Outgoing:
        out: Outgoing = []
        for name, pending in list(self._pending.items()):
            primitive = pending.order.primitive
            if any(in_scope(scope, performer, primitive.id) for performer in primitive.performers):
                del self._pending[name]
                out += self._refuse_to_begin(primitive, reason, why, now_s)
        return out
