"""Messages of workers: hello, results, signs of life, requests for programs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from broker.decisions.events import Event, JobDeclined, JobFinished, JobLost
from broker.dispatch.worker_registry import LostJob
from broker.router.core import Core, name_of
from rtc.protocol import messages as m
from rtc.protocol.outcomes import WireError
from rtc.runtime.process import send


class WorkerMessages:
    def __init__(self, core: Core) -> None:
        self._core = core

    def receive(self, peer: bytes, message: Any, now: float) -> None:
        """Raises WireError for a message in the name of another worker."""
        HANDLERS[type(message)](self, peer, message, now)

    def _take_results(self, peer: bytes, message: m.ResultBatch, now: float) -> None:
        name, core = name_of(peer), self._core
        answered, events = core.registry.answered, core.events
        known = core.registry.mark_alive(name, now)
        for result in message.results:
            # False for an answer from a worker that does not have this attempt of the job now.
            took_s = 0.0 if isinstance(result, m.JobCrashed) else result.took_s
            if answered(name, result.id, result.attempt, took_s, now):
                events.append(RESULTS[type(result)](name, result, now))
            else:
                core.count_late_result(name)
        if not known:
            self._request_hello(peer)

    def _mark_alive(self, peer: bytes, message: m.Heartbeat, now: float) -> None:
        if not self._core.registry.mark_alive(name_of(peer), now, message.own_s, message.inside):
            self._request_hello(peer)
        elif message.at_s:
            send(self._core.sockets["workers"], m.Heartbeat(name=message.name, at_s=message.at_s), peer)

    def _register(self, peer: bytes, message: m.WorkerHello, now: float) -> None:
        name = name_of(peer)
        if message.name != name:
            raise WireError(f"{name!r:.80} introduces itself as {message.name!r:.80}")
        if message.node is None:
            raise WireError(f"{name!r:.80} has no address")
        queue = m.REHEARSER if message.rehearses else message.kind
        lost = self._core.registry.register(name, message.node, queue, message.pid, now, message.abilities)
        self._core.lose_jobs(name, lost, "its process was replaced", now)

    def _remove(self, peer: bytes, message: m.WorkerGone, now: float) -> None:
        name = name_of(peer)
        if message.name != name:
            raise WireError(f"{name!r:.80} reports that {message.name!r:.80} is gone")
        lost = self._core.registry.remove(name)
        if message.in_order:
            lost = [LostJob(one.job, in_hand=False) for one in lost]
        why = "it ended in order" if message.in_order else "its connection was lost"
        self._core.lose_jobs(name, lost, why, now)

    def _send_program(self, peer: bytes, message: m.ProgramWanted, now: float) -> None:
        body = self._core.store.body(message.digest)
        send(self._core.sockets["workers"], m.ProgramBody(digest=message.digest, body=body), peer)

    def _request_hello(self, peer: bytes) -> None:
        send(self._core.sockets["workers"], m.HelloWanted(), peer)


def _finished(node: str, result: m.JobDone, now: float) -> Event:
    return JobFinished(
        at_s=now,
        job=result.id,
        attempt=result.attempt,
        node=node,
        product=result.product,
        took_s=result.took_s,
        world=result.world,
    )


def _declined(node: str, result: m.JobRefused, now: float) -> Event:
    return JobDeclined(
        at_s=now, job=result.id, attempt=result.attempt, node=node, refusal=result.refusal, world=result.world
    )


def _crashed(node: str, result: m.JobCrashed, now: float) -> Event:
    return JobLost(at_s=now, job=result.id, attempt=result.attempt, node=node, evidence=result.evidence)


#: result of a job -> its event
RESULTS: dict[type, Callable[[str, Any, float], Event]] = {
    m.JobDone: _finished,
    m.JobRefused: _declined,
    m.JobCrashed: _crashed,
}

HANDLERS: dict[type, Callable[[WorkerMessages, bytes, Any, float], None]] = {
    m.ResultBatch: WorkerMessages._take_results,
    m.Heartbeat: WorkerMessages._mark_alive,
    m.WorkerHello: WorkerMessages._register,
    m.WorkerGone: WorkerMessages._remove,
    m.ProgramWanted: WorkerMessages._send_program,
}
