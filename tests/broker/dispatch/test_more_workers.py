"""The user's command line for more workers: when it runs, and that workers on their way are not asked for again."""

from __future__ import annotations

from typing import Any

import msgspec

from broker.decisions.effects import DispatchJob
from broker.dispatch.more_workers import FAILED_S, ORDER_S, PAUSE_S, WAITED_S, MoreWorkers
from broker.dispatch.worker_registry import WorkerRegistry
from rtc.protocol.messages import ProcessRow, RequestWorkers, WorkerKind, WorkerRequest

BINDER = WorkerKind.BINDER
OWN, FAR, WAIT_S = 2, 4, 60.0


class Cluster:
    """Two local binders, which is all this machine may have, and `far` ones; the jobs of `waiting` wait since 0 s."""

    def __init__(self, waiting: int = 20, own: int = OWN, far: int = 0, command: str = "ask {kind} {count}") -> None:
        self.registry = WorkerRegistry()
        self.more = MoreWorkers(command, OWN, FAR, WAIT_S)
        self.processes = [ProcessRow(name=f"binder@{n}", state="ready") for n in range(own)]
        self.asked: list[WorkerRequest] = []
        for n in (*range(own), *(100 + n for n in range(far))):
            self.registry.register(f"binder@{n}", n, BINDER, 1, 0.0)
        for n in range(waiting + own + far):
            body = msgspec.Raw(b"\xc0")
            job = DispatchJob(job=f"C-{n}/1", attempt=1, kind=BINDER, queue=BINDER, program="", cell="", input=body)
            self.registry.submit(job, 0.0)
        list(self.registry.assign(0.0))

    def join(self, count: int) -> None:
        """Workers on another machine register, and are busy at once."""
        for n in range(200, 200 + count):
            self.registry.register(f"binder@{n}", n, BINDER, 1, 0.0)

    def look(self, now: float) -> list[RequestWorkers]:
        return list(self.more.orders(self.registry, self.processes, self.asked, now))

    def record(self, order: RequestWorkers, now: float, **about: Any) -> None:
        """The supervisor has run the command."""
        self.asked = [
            WorkerRequest(
                kind=order.kind, count=order.count, registered_before=order.registered_before, at_s=now, **about
            )
        ]


def test_jobs_that_wait_at_the_own_maximum_are_asked_for_as_many_as_wait() -> None:
    it = Cluster(waiting=3)

    assert it.look(0.5 * WAITED_S) == []
    assert it.look(2 * WAITED_S) == [RequestWorkers(kind=BINDER, count=3, registered_before=0)]


def test_no_more_are_asked_for_than_the_maximum_elsewhere() -> None:
    assert Cluster(waiting=20, far=1).look(2.0) == [RequestWorkers(kind=BINDER, count=FAR - 1, registered_before=1)]
    assert Cluster(waiting=20, far=FAR).look(2.0) == []


def test_below_the_own_maximum_the_machine_helps_itself() -> None:
    assert Cluster(own=1).look(2.0) == []
    assert Cluster(own=1, far=1).look(2.0) != []  # they count: the broker starts no further local one


def test_without_a_command_nothing_is_asked_for() -> None:
    assert Cluster(command="").look(100.0) == []


def test_a_command_without_a_count_starts_one_per_run() -> None:
    assert Cluster(command="ask {kind}").look(2.0) == [RequestWorkers(kind=BINDER, count=1, registered_before=0)]


def test_an_order_is_not_repeated_before_the_supervisor_can_have_answered() -> None:
    it = Cluster()
    assert len(it.look(2.0)) == 1
    assert it.look(2.0 + 0.9 * ORDER_S) == []
    assert len(it.look(2.0 + 1.1 * ORDER_S)) == 1  # it was lost with the broker's connection


def test_while_a_run_is_in_progress_no_other_begins() -> None:
    it = Cluster()
    it.record(it.look(2.0)[0], 2.0, running=True)
    assert it.look(2.0 + 10 * WAIT_S) == []


def test_what_was_asked_for_and_has_not_joined_is_not_asked_for_again_before_its_time() -> None:
    it = Cluster()
    it.record(it.look(2.0)[0], 2.0)
    it.join(FAR - 1)

    assert it.look(2.0 + 0.9 * WAIT_S) == []
    assert it.look(2.0 + 1.1 * WAIT_S) == [RequestWorkers(kind=BINDER, count=1, registered_before=FAR - 1)]


def test_a_restarted_broker_does_not_ask_again_either() -> None:
    it = Cluster()
    it.record(it.look(2.0)[0], 2.0)
    it.more = MoreWorkers("ask {kind} {count}", OWN, FAR, WAIT_S)

    assert it.look(2.0 + 0.9 * WAIT_S) == []


def test_when_all_have_joined_more_are_asked_for_after_a_pause() -> None:
    it = Cluster(waiting=3)
    it.record(it.look(2.0)[0], 2.0)
    it.join(3)

    assert it.look(2.0 + 0.9 * PAUSE_S) == []
    assert it.look(2.0 + 1.1 * PAUSE_S) == [RequestWorkers(kind=BINDER, count=1, registered_before=3)]


def test_a_command_that_failed_is_tried_again_later() -> None:
    it = Cluster()
    it.record(it.look(2.0)[0], 2.0, failed="ended with status 1")

    assert it.look(2.0 + 0.9 * FAILED_S) == []
    assert len(it.look(2.0 + 1.1 * FAILED_S)) == 1
