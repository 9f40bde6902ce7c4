"""Messages of subsystems: hello, start and end of primitives, answers to halts, periodic reports."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from broker.decisions import reporting
from broker.decisions.events import (
    AnswerWasRefused,
    ArmStrayed,
    HaltConfirmed,
    PrimitiveEnded,
    PrimitivePaced,
    PrimitiveStarted,
    SubsystemConnected,
)
from broker.decisions.state import LinkState
from broker.router.core import Core, name_of, peer_of
from broker.router.egress import Egress
from broker.router.halt_intake import HaltIntake
from broker.router.health import Health
from broker.router.shutdown import ClusterShutdown
from broker.router.supervisor_messages import count_dropped
from rtc.protocol import messages as m
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason, WireError
from rtc.protocol.primitive_id import command_of
from rtc.protocol.spelling import unknown
from rtc.protocol.versions import ARRAYS
from rtc.runtime.allowance import Allowance
from rtc.runtime.process import send

DROP_COUNTERS = ("estop", "bench")  # of the MCM's own sockets


class SubsystemMessages:
    def __init__(
        self, core: Core, egress: Egress, halts: HaltIntake, health: Health, shutdown: ClusterShutdown
    ) -> None:
        self._core, self._egress, self._halts, self._health, self._shutdown = core, egress, halts, health, shutdown
        self._of_cell = {core.given.identity(one.name): one.name for one in core.settings.subsystems}
        self._forwarded = Allowance(reporting.MAX_PER_S)  # periodic reports, to each client

    def receive(self, peer: bytes, message: Any, now: float) -> None:
        """Raises WireError for a message in the name of another subsystem."""
        name = self._name_of_sender(peer, message, now)
        if isinstance(message, m.SubsystemHello) or name in self._core.state.subsystems:
            self._health.subsystem_seen_s[name] = now
        HANDLERS[type(message)](self, name, peer, message, now)

    def _name_of_sender(self, peer: bytes, message: Any, now: float) -> str:
        """The name of the subsystem. Raises WireError for a name that the cell does not have, and for a stranger with
        the name of one of the cluster's own: its identity lacks the token. Its hello is answered with a refusal."""
        name = name_of(peer)
        if own := self._of_cell.get(name):
            return own
        bare, of_cell = name.removesuffix(f"@{self._core.given.token}"), self._of_cell.values()
        if bare not in of_cell and isinstance(message, m.HaltOrder):
            return bare  # it only stops
        if isinstance(message, m.SubsystemHello):
            ours = self._core.state.subsystems.get(bare)
            words = f"this cluster has its own {bare}" + (f", pid {ours.pid}" if ours else "")
            clears = "use another name"
            if bare not in of_cell:
                words, clears = unknown("subsystem", bare, of_cell), "add it to `subsystems` of the cell"
            refusal = Refusal(reason=RefusalReason.NOT_ALLOWED, message=words, clears=by_person(clears))
            self._core.refused_peers.refuse("subsystems", peer, message, refusal, now)
            send(self._core.sockets["subsystems"], m.Declined(request=bare, refusal=refusal), peer)
        raise WireError(f"a stranger uses the name {bare}")

    def _connect(self, name: str, peer: bytes, message: m.SubsystemHello, now: float) -> None:
        _check_name(name, message.name)
        self._egress.subsystems.set_arrays(peer, ARRAYS in message.abilities)
        known = self._core.state.subsystems.get(name)
        if known is None or known.pid != message.pid:
            self._core.strayed.pop(name, None)
        self._core.me.log.info("%.80r is connected, pid %d, %.200s", name, message.pid, message.performers)
        for order in self._halts.unanswered(message, now):
            self._egress.subsystems.send_now(peer, order)
        self._core.enqueue(SubsystemConnected(at_s=now, hello=message))

    def _mark_alive(self, name: str, peer: bytes, message: m.Heartbeat, now: float) -> None:
        known = self._core.state.subsystems.get(name)
        if message.own_s and known is not None:  # the number of known ones is bounded
            self._core.timers.set_own_time(name, message.own_s)
        if known is None or known.link is not LinkState.CONNECTED:
            send(self._core.sockets["subsystems"], m.HelloWanted(), peer)

    def _started(self, name: str, peer: bytes, message: m.Started, now: float) -> None:
        self._core.enqueue(PrimitiveStarted(at_s=now, subsystem=name, start=message))

    def _paced(self, name: str, peer: bytes, message: m.PauseChanged, now: float) -> None:
        self._core.enqueue(PrimitivePaced(at_s=now, subsystem=name, change=message))

    def _ended(self, name: str, peer: bytes, message: m.EndReport, now: float) -> None:
        self._core.enqueue(PrimitiveEnded(at_s=now, subsystem=name, report=message))

    def _call_halt(self, name: str, peer: bytes, message: m.HaltOrder, now: float) -> None:
        self._halts.enqueue(name, message, now)

    def _halt_started(self, name: str, peer: bytes, message: m.HaltStarted, now: float) -> None:
        _check_name(name, message.subsystem)
        self._halts.answer(message)
        if self._halts.moves(name):
            self._shutdown.record_motion(message)

    def _confirm_rest(self, name: str, peer: bytes, message: m.HaltAtRest, now: float) -> None:
        _check_name(name, message.subsystem)
        self._halts.answer(message)
        self._core.enqueue(HaltConfirmed(at_s=now, answer=message))

    def _injected(self, name: str, peer: bytes, message: m.Injected, now: float) -> None:
        if name in self._core.state.subsystems or self._core.given.protects(name):  # their number is bounded
            self._core.injected[name] = message.active

    def _strayed(self, name: str, peer: bytes, message: m.Strayed, now: float) -> None:
        subsystem = self._core.state.subsystems.get(name)
        if subsystem is None:
            return
        known = self._core.strayed.get(name, {})
        arms = {arm: how for arm, how in message.arms.items() if arm in subsystem.performers}
        for arm in arms.keys() - known.keys():
            self._core.me.log.warning("%s: %s %s", name, arm, arms[arm])
            self._core.enqueue(ArmStrayed(at_s=now, subsystem=name, arm=arm, how=arms[arm]))
        self._core.strayed[name] = arms

    def _answer_refused(self, name: str, peer: bytes, message: m.AnswerRefused, now: float) -> None:
        command = self._core.state.commands.get(command_of(message.primitive))
        if command is not None and command.subsystem == name:
            refused = AnswerWasRefused(at_s=now, primitive=message.primitive, message=message.message)
            self._core.enqueue(refused)

    def _count_dropped(self, name: str, peer: bytes, message: m.UnreadableMessages, now: float) -> None:
        count_dropped(self._core, message, DROP_COUNTERS)

    def _forward_report(self, name: str, peer: bytes, report: m.ProgressReport, now: float) -> None:
        """Send a report of EVERY or WHEN to the command's client, without an event or a journal entry."""
        command = self._core.state.commands.get(command_of(report.primitive))
        if command is None or not reporting.wants(command, report, name):
            return
        if not self._forwarded.take(now, command.client):
            self._core.dropped["reports"] += 1
            return
        note = reporting.note_of(command, report, now)
        self._core.reports.keep(note)
        if not self._egress.answer(peer_of(command.client), note):
            self._core.dropped["reports"] += 1


def _check_name(sender: str, stated: str) -> None:
    if stated != sender:
        raise WireError(f"{sender!r:.80} speaks for {stated!r:.80}")


HANDLERS: dict[type, Callable[[SubsystemMessages, str, bytes, Any, float], None]] = {
    m.SubsystemHello: SubsystemMessages._connect,
    m.Heartbeat: SubsystemMessages._mark_alive,
    m.Started: SubsystemMessages._started,
    m.PauseChanged: SubsystemMessages._paced,
    m.EndReport: SubsystemMessages._ended,
    m.HaltOrder: SubsystemMessages._call_halt,
    m.HaltStarted: SubsystemMessages._halt_started,
    m.HaltAtRest: SubsystemMessages._confirm_rest,
    m.Injected: SubsystemMessages._injected,
    m.Strayed: SubsystemMessages._strayed,
    m.AnswerRefused: SubsystemMessages._answer_refused,
    m.UnreadableMessages: SubsystemMessages._count_dropped,
    m.ProgressReport: SubsystemMessages._forward_report,
}
