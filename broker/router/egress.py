"""Egress: the effects of decisions and the assigned jobs, sent as messages or performed on timers and queues."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from broker.decisions import effects as do
from broker.decisions.events import ListenersChanged
from broker.router import part_loads
from broker.router.core import Core, peer_of
from broker.router.event_stream import EventStream
from broker.router.outbox import Outbox
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.primitive import Primitive
from rtc.runtime.allowance import Allowance
from rtc.runtime.process import send
from rtc.world.lease import sign

REFUSALS_PER_S = 100  # maximum number of refused requests published per second; others are counted as dropped
NOTES_PER_S = 3_000  # published per second; commands accepted after that publish none until the next second
TEXT_SHOWN = 200  # characters of a refused sentence


class Egress:
    def __init__(self, core: Core) -> None:
        self._core = core
        self._now = core.clock()  # time of the batch that is performed
        self._refusals, self._notes = Allowance(REFUSALS_PER_S), Allowance(NOTES_PER_S)
        self._crowded = False  # NOTES_PER_S are published in this second
        self.topics: set[bytes] = set()  # prefixes that the subscribers of the event stream want
        self.clients = Outbox(lambda: core.sockets["front"])
        self.subsystems = Outbox(lambda: core.sockets["subsystems"])
        self.stream = EventStream(lambda: core.sockets["events"])
        self._perform = {kind: perform.__get__(self) for kind, perform in PERFORM.items()}

    def perform(self, effects: Iterable[do.Effect]) -> None:
        """Perform effects in order. Their events must be in the journal."""
        self._now, perform = self._core.clock(), self._perform
        if self._crowded and self._notes.take(self._now, cost=0):
            self._set_crowded(False)
        for effect in effects:
            perform[type(effect)](effect)
        self.clients.flush()
        self.subsystems.flush()

    def assign_jobs(self, now: float) -> None:
        """Send queued jobs to workers that have room."""
        core = self._core
        for worker, jobs in core.registry.assign(now):
            batch = [
                m.Job(
                    id=job.job,
                    attempt=job.attempt,
                    program=job.program,
                    programs=job.programs,
                    cell=job.cell,
                    input=job.input,
                    lease=None if not job.locations else sign(core.given.lease_key, job.job, job.locations),
                    doubt=job.doubt,
                )
                for job in jobs
            ]
            if not send(core.sockets["workers"], m.JobBatch(jobs=batch), peer_of(worker)):
                core.lose_jobs(worker, core.registry.remove(worker), "its connection is gone", now)

    def decline(self, peer: bytes, request: str, refusal: Refusal, text: str = "") -> None:
        """Decline a client's request at once. `text`: its sentence."""
        self.clients.send_now(peer, m.Declined(request=request, refusal=refusal))
        self._publish_refusal(request, refusal, text)

    def answer(self, peer: bytes, message: m.BrokerToClient) -> bool:
        """Answer a client at once, after what it was sent before. False: it is gone, or its queue is full."""
        return self.clients.send_now(peer, message)

    def send_supervisor(self, message: m.BrokerToSupervisor) -> None:
        send(self._core.sockets["supervisor"], message, self._core.supervisor_peer)

    def set_topics(self, topics: set[bytes], now: float) -> None:
        """Replace the subscribed prefixes. The Decision Unit writes notes only while there are subscribers."""
        changed = bool(topics) is not bool(self.topics)
        self.topics = topics
        if changed:
            self._crowded = False
            self._core.enqueue(ListenersChanged(at_s=now, listening=bool(topics)))

    # --- one method per effect ------------------------------------------------------------------------

    def _dispatch_job(self, effect: do.DispatchJob) -> None:
        self._core.registry.submit(effect, self._now)

    def _load_part(self, effect: do.LoadPart) -> None:
        part_loads.begin(self._core, effect, self._now)

    def _cancel_job(self, effect: do.CancelJob) -> None:
        if worker := self._core.registry.cancel(effect.job):
            send(self._core.sockets["workers"], m.CancelJobs(jobs=[effect.job]), peer_of(worker))

    def _send_primitive(self, effect: do.SendPrimitive) -> None:
        message = m.Execute(primitive=wire.opaque(effect.primitive, Primitive), pid=effect.pid)
        self.subsystems.put(self._core.subsystem_peer(effect.subsystem), message)

    def _send_pace(self, effect: do.SendPace) -> None:
        order = m.SetPaused(primitive=effect.primitive, paused=effect.paused)
        self.subsystems.put(self._core.subsystem_peer(effect.subsystem), order)

    def _send_answer(self, effect: do.SendAnswer) -> None:
        self.subsystems.put(self._core.subsystem_peer(effect.subsystem), effect.answer)

    def _send_halt(self, effect: do.SendHalt) -> None:
        self.subsystems.send_now(self._core.subsystem_peer(effect.subsystem), effect.order)

    def _acknowledge_report(self, effect: do.AcknowledgeReport) -> None:
        self.subsystems.put(self._core.subsystem_peer(effect.subsystem), m.ReportAck(primitive=effect.primitive))

    def _start_timer(self, effect: do.StartTimer) -> None:
        self._core.timers.start(effect.timer, effect.at_s, self._now, effect.subsystems)

    def _stop_timer(self, effect: do.StopTimer) -> None:
        self._core.timers.stop(effect.timer)

    def _send_client(self, effect: do.TellClient) -> None:
        self.clients.put(peer_of(effect.client), effect.message)
        if type(effect.message) is m.Declined:
            self._publish_refusal(effect.message.request, effect.message.refusal)

    def _publish_note(self, effect: do.PublishNote) -> None:
        if effect.client:
            self.clients.put(peer_of(effect.client), effect.note)
        if self.topics:
            self.stream.put(effect.note)
            if not self._notes.take(self._now):
                self._set_crowded(True)

    def _set_crowded(self, crowded: bool) -> None:
        """Let the Decision Unit write no notes of new commands, or notes again."""
        if crowded is not self._crowded:
            self._crowded = crowded
            self._core.enqueue(ListenersChanged(at_s=self._now, listening=True, crowded=crowded))

    def _report_end(self, effect: do.ReportEnd) -> None:
        kept = self._core.state.ended.get(effect.ended.command)
        message = kept.message if kept else effect.ended  # encoded already, if it is kept
        self.clients.put(peer_of(effect.client), message)
        if self.topics:
            self.stream.put(message)

    def _decline_halt(self, effect: do.DeclineHalt) -> None:
        refusal = Refusal(reason=RefusalReason.NAME, message=effect.message)
        send(self._core.sockets["halt"], m.Declined(request=effect.halt, refusal=refusal), peer_of(effect.client))

    def _publish_halt(self, effect: do.PublishHalt) -> None:
        if self.topics:
            self.stream.send_now(effect.halt)

    def _publish_refusal(self, request: str, refusal: Refusal, text: str = "") -> None:
        """Publish a request that did not become a command. A flood of them must not displace events of commands."""
        if not self.topics:
            return
        now = self._core.clock()
        if not self._refusals.take(now):
            self._core.dropped["refusals"] += 1
            return
        self.stream.put(m.RequestRefused(at_s=now, request=request, refusal=refusal, text=text[:TEXT_SHOWN]))


PERFORM: dict[type[do.Effect], Callable[[Egress, Any], None]] = {
    do.DispatchJob: Egress._dispatch_job,
    do.LoadPart: Egress._load_part,
    do.CancelJob: Egress._cancel_job,
    do.SendPrimitive: Egress._send_primitive,
    do.SendPace: Egress._send_pace,
    do.SendAnswer: Egress._send_answer,
    do.SendHalt: Egress._send_halt,
    do.AcknowledgeReport: Egress._acknowledge_report,
    do.StartTimer: Egress._start_timer,
    do.StopTimer: Egress._stop_timer,
    do.TellClient: Egress._send_client,
    do.PublishNote: Egress._publish_note,
    do.ReportEnd: Egress._report_end,
    do.DeclineHalt: Egress._decline_halt,
    do.PublishHalt: Egress._publish_halt,
}
