"""Rows of `rtc status` about hosts: asked, joined, lost, refused, round trip, and the state of the link in words."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from broker.decisions.effects import DispatchJob
from broker.dispatch.worker_registry import WorkerRegistry
from broker.router.hosts import hosts, requests_for_more
from rtc.protocol.messages import PeerRow, ProcessRow, RemoteWorker, WorkerKind, WorkerRequest

NOW = 100.0
BINDER = WorkerKind.BINDER
LOCAL = [ProcessRow(name="broker", state="ready"), ProcessRow(name="binder@2", state="ready")]


def peer(**about: Any) -> PeerRow:
    return PeerRow(
        **{"key": "w1", "role": "worker", "host": "10.0.0.7", "connections": 1, "last_message_at_s": NOW, **about}
    )


def far(name: str = "binder@18", last_message_at_s: float = NOW, **about: Any) -> RemoteWorker:
    return RemoteWorker(name=name, last_message_at_s=last_message_at_s, **about)


@pytest.fixture
def registry() -> WorkerRegistry:
    made = WorkerRegistry()
    for node in (2, 18):
        made.register(f"binder@{node}", node, BINDER, 1, 0.0)
    return made


def row_of(registry: WorkerRegistry, one: PeerRow, late: dict[str, int] | None = None) -> dict[str, Any]:
    return hosts(registry, LOCAL, [one], late or {}, NOW)[1]


def test_this_machine_is_a_host_too(registry: WorkerRegistry) -> None:
    here = hosts(registry, [*LOCAL, ProcessRow(name="parser@0", state="starting")], [], {}, NOW)[0]
    assert (here.asked, here.joined, here.workers) == (2, 1, ["binder@2"])


def test_joined_are_the_workers_that_the_broker_knows(registry: WorkerRegistry) -> None:
    row = row_of(registry, peer(asked=8, workers=[far(), far("binder@22")]))
    assert (row.asked, row.joined, row.workers, row.state) == (8, 1, ["binder@18"], "ready")


def test_missing_are_those_that_have_joined_on_no_host(registry: WorkerRegistry) -> None:
    registry.register("binder@22", 22, BINDER, 1, 0.0)
    peers = [
        peer(asked=3, workers=[far()]),
        peer(asked=3, workers=[far("binder@22")], host="10.0.0.8"),
        peer(asked=1, key="w2"),
    ]
    rows = hosts(registry, LOCAL, peers, {}, NOW)
    assert [(row.joined, row.missing) for row in rows] == [(1, 0), (1, 1), (1, 1), (0, 1)]


def test_the_round_trip_has_its_age_and_is_the_shortest_of_the_host(registry: WorkerRegistry) -> None:
    workers = [far(round_trip_s=0.5, round_trip_at_s=99.9), far("binder@22", round_trip_s=0.05, round_trip_at_s=99.0)]
    row = row_of(registry, peer(workers=[*workers, far("binder@26")]))
    assert row.round_trip_ms == pytest.approx(50.0)
    assert row.round_trip_ago_s == pytest.approx(1.0)


def job(name: str) -> DispatchJob:
    return DispatchJob(job=name, attempt=1, kind=BINDER, queue=BINDER, program="", cell="", input=msgspec.Raw(b"\xc0"))


def test_a_silent_host_is_shown_with_its_limit_unless_its_worker_is_busy(registry: WorkerRegistry) -> None:
    silent = peer(workers=[far(last_message_at_s=NOW - 2.1)])
    assert row_of(registry, silent).state.startswith("silent for 2.1 s, limit ")
    for name in ("C-1/1", "C-2/1"):
        registry.submit(job(name), NOW)
    assert {worker for worker, _ in registry.assign(NOW)} == {"binder@2", "binder@18"}
    assert row_of(registry, silent).state == "busy"


def test_a_stopped_worker_that_the_broker_has_given_up_has_no_limit_any_more(registry: WorkerRegistry) -> None:
    """The kernel of its host still answers, so its connection is not lost."""
    stopped = peer(workers=[far("binder@30", last_message_at_s=NOW - 7.0)])
    assert row_of(registry, stopped).state == "silent for 7.0 s; jobs go to other workers"


@pytest.mark.parametrize(
    ("about", "state"),
    [
        ({"lost": {"binder@22": 88.0}}, "lost"),
        ({}, "not connected"),
        ({"last_message_at_s": 0.0, "refused": 1}, "refused"),
        ({"last_message_at_s": 0.0, "host": ""}, "not used yet"),
        ({"revoked": True}, "key revoked"),
        ({"connections": 2, "role": "operator"}, "connected"),
        ({"connections": 1, "workers": [far("binder@30")]}, "registering"),
    ],
)
def test_the_state_of_a_link_in_words(registry: WorkerRegistry, about: dict[str, Any], state: str) -> None:
    assert row_of(registry, peer(**{"connections": 0, **about})).state == state


def test_refusals_losses_and_late_results_have_their_ages_and_numbers(registry: WorkerRegistry) -> None:
    late = {"binder@18": 2, "binder@22": 1, "binder@2": 9}
    found = peer(workers=[far()], lost={"binder@22": 88.0}, refused=3, refusal="no such node", refused_at_s=99.0)
    row = row_of(registry, found, late)
    assert (row.refused, row.refusal, row.refused_ago_s) == (3, "no such node", 1.0)
    assert (row.lost, row.late_results) == ({"binder@22": 12.0}, 3)


def test_a_request_for_more_states_how_many_have_joined_since(registry: WorkerRegistry) -> None:
    asked = WorkerRequest(
        kind=BINDER, count=4, registered_before=0, at_s=88.0, failed="ended with status 1", output="no partition"
    )
    row = requests_for_more(asked, registry, LOCAL, NOW)
    assert (row.asked, row.joined, row.ago_s) == (4, 1, 12.0)
    assert (row.failed, row.output) == ("ended with status 1", "no partition")
