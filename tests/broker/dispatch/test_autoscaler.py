"""Pool sizes follow the queues."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions.effects import DispatchJob
from broker.dispatch.autoscaler import COMING_S, IDLE_S, WAIT_S, Autoscaler
from broker.dispatch.worker_registry import WorkerRegistry
from rtc.protocol.messages import ProcessRow, RetireWorker, SpawnWorker, WorkerKind

BINDER, PARSER = WorkerKind.BINDER, WorkerKind.PARSER


def job(n):
    return DispatchJob(
        job=f"C-{n}/1", attempt=1, kind=BINDER, queue=BINDER, program="", cell="", input=msgspec.Raw(b"\xc0")
    )


def row(name, state):
    return ProcessRow(name=name, state=state, pid=1)


class Cluster:
    """A worker registry, its autoscaler, and what the supervisor reported."""

    def __init__(self, *binders, least=1, most=3):
        self.registry, self.autoscaler = WorkerRegistry(), Autoscaler(least, most)
        self.processes = []
        for address in binders:
            self.hello(address, 0.0)
            self.processes.append(row(f"binder@{address}", "ready"))

    def hello(self, address, now):
        self.registry.register(f"binder@{address}", address, BINDER, 1, now)
        list(self.registry.assign(now))

    def submit(self, count, now):
        for n in range(count):
            self.registry.submit(job(n), now)
        return [list(jobs) for _, jobs in self.registry.assign(now)]

    def look(self, now):
        return list(self.autoscaler.orders(self.registry, self.processes, now))


def test_a_kind_without_workers_gets_one_as_soon_as_a_job_waits():
    it = Cluster()
    assert it.look(0.0) == []
    it.submit(1, 1.0)
    assert it.look(1.0) == [SpawnWorker(kind=BINDER)]


@pytest.mark.parametrize("state", ["pending", "starting", "restarting"])
def test_one_that_is_coming_back_is_waited_for(state):
    it = Cluster()
    it.processes = [row("binder@2", state), row("parser@0", "ready")]
    it.submit(1, 1.0)
    assert it.look(1.0) == []
    assert it.look(20.0) == []  # another would take the processor from it


@pytest.mark.parametrize("state", ["failed", "crash loop"])
def test_one_that_is_not_coming_back_is_replaced(state):
    it = Cluster()
    it.processes = [row("binder@2", state)]
    it.submit(1, 1.0)
    assert it.look(1.0) == [SpawnWorker(kind=BINDER)]


def test_a_pool_grows_one_by_one_while_jobs_wait_up_to_the_most():
    it = Cluster(2, most=3)
    it.submit(9, 1.0)
    assert it.look(1.0 + WAIT_S / 2) == []  # it may be only a moment
    assert it.look(1.01 + WAIT_S) == [SpawnWorker(kind=BINDER)]
    it.processes = [row("binder@6", "starting")]
    assert it.look(1.1 + WAIT_S) == []  # that one is on its way
    it.processes = [row("binder@6", "ready")]
    it.hello(6, 1.5)
    assert it.look(1.5) == [SpawnWorker(kind=BINDER)]
    it.processes = [row("binder@6", "ready"), row("binder@10", "ready")]
    it.hello(10, 1.6)
    assert it.look(99.0) == []


def test_until_the_one_asked_for_is_seen_no_other_is_asked_for():
    it = Cluster(2)
    it.submit(9, 0.0)
    assert it.look(1.0) == [SpawnWorker(kind=BINDER)]
    assert it.look(1.1) == []
    assert it.look(1.0 + COMING_S) == [SpawnWorker(kind=BINDER)]  # the message may be lost


def test_surplus_retires_the_highest_address_first_and_gets_no_more_jobs():
    it = Cluster(2, 6, least=1)
    assert it.look(IDLE_S / 2) == []
    assert it.look(IDLE_S + 1) == [RetireWorker(name="binder@6")]
    assert it.look(IDLE_S + 2) == []  # the cube's own stay
    it.submit(2, IDLE_S + 3)
    assert (list(it.registry.workers["binder@2"].assigned), it.registry.workers["binder@6"].assigned) == (["C-0/1"], {})


def test_no_worker_retires_while_jobs_wait_or_while_it_works():
    it = Cluster(2, 6, least=0)
    it.submit(3, 0.0)
    assert it.look(WAIT_S) == []
    it.registry.cancel("C-2/1")
    assert it.look(2 * IDLE_S) == []
    it.registry.answered("binder@6", "C-1/1", 1, 0.1, 2 * IDLE_S)
    assert it.look(3 * IDLE_S + 1) == [RetireWorker(name="binder@6")]


def test_with_a_least_of_none_the_last_retires_too():
    it = Cluster(2, least=0)
    assert it.look(IDLE_S + 1) == [RetireWorker(name="binder@2")]


def test_who_has_come_from_another_machine_is_neither_retired_nor_counted():
    it = Cluster(2, least=1)
    it.hello(18, 0.0)
    assert it.look(IDLE_S + 1) == []
