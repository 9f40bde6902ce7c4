"""Metrics from messages, and the Grafana board, which may name only metrics that exist."""

from __future__ import annotations

import json
import re
import socket
import threading
from contextlib import ExitStack
from pathlib import Path
from urllib.request import urlopen

import msgspec
import pytest
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from rtc.apps.observers import scrapes
from rtc.apps.observers.feed import Received
from rtc.apps.observers.metrics import STALE_S, Metrics
from rtc.protocol import messages as m
from tests.apps.observers.conftest import until
from tests.apps.observers.samples import DECLINED, STOWED, T0, note, received, telemetry

BOARD = Path(__file__).parents[3] / "docs" / "grafana.json"
STATUS = {
    "uptime_s": 12.0,
    "commands_live": 3,
    "commands_accepted": 7,
    "halts": {"called": 2},
    "counters": {"halts": 2, "dropped_front": 1, "dropped_MCM": 2},
    "processes": [{"name": "broker", "restarts": 1}, {"name": "MCM"}],
    "resources": [{"name": "LEFT-ARM", "owners": ["C-1"]}, {"name": "RIGHT-ARM"}],
    "workers": [{"kind": "binder"}, {"kind": "binder"}],
    "queues": {"binder": 4, "parser": 0},
    "decision_ms": {"p50": 0.5, "p99": 2.0},
}


class Clock:
    now_s = T0


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def metrics(clock):
    return Metrics(lambda: 5, lambda: clock.now_s)


def samples(metrics: Metrics) -> dict[tuple[str, ...], float]:
    """(name, label values ...) -> value, as a scrape shows them."""
    text = generate_latest(metrics.registry).decode()
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_commands_are_counted_by_outcome_and_phases_are_timed(metrics):
    for message in STOWED:
        metrics.take(received(message))
    found = samples(metrics)
    assert found["rtc_commands_total", "succeeded"] == 1
    assert found["rtc_commands_total", "refused"] == 1
    assert found["rtc_steps_total",] == 1
    assert found["rtc_command_duration_seconds_sum", "succeeded"] == pytest.approx(1.05)
    assert found["rtc_phase_duration_seconds_sum", "executing"] == pytest.approx(1.0)
    assert found["rtc_phase_duration_seconds_count", "parsing"] == 2
    assert found["rtc_job_duration_seconds_count", "parser"] == 2
    assert found["rtc_job_duration_seconds_sum", "elaborator"] == pytest.approx(0.02)
    assert found["rtc_events_lost_total",] == 5


def test_refused_requests_are_counted_by_reason(metrics):
    metrics.take(received(DECLINED))
    assert samples(metrics)["rtc_requests_refused_total", "state"] == 1


def test_a_note_that_repeats_its_process_counts_no_second_job(metrics):
    first = STOWED[2]
    metrics.take(received(first))
    metrics.take(received(note(4, 0.1, m.Phase.HELD, node=first.node, took_s=first.took_s)))
    assert samples(metrics)["rtc_job_duration_seconds_count", "elaborator"] == 1


def test_the_status_is_shown_while_it_is_fresh(metrics, clock):
    metrics.take(Received(T0, m.StatusReply(request="status", status=msgspec.convert(STATUS, m.Status))))
    found = samples(metrics)
    assert found["rtc_broker_up",] == 1
    assert found["rtc_commands_in_progress",] == 3
    assert found["rtc_halts_total",] == 2
    assert found["rtc_messages_dropped_total",] == 3
    assert found["rtc_process_restarts_total",] == 1
    assert found["rtc_resources_taken",] == 1
    assert found["rtc_workers", "binder"] == 2
    assert found["rtc_workers", "parser"] == 0
    assert found["rtc_jobs_waiting", "binder"] == 4
    assert found["rtc_broker_iteration_seconds", "p99"] == pytest.approx(0.002)
    clock.now_s = T0 + STALE_S
    found = samples(metrics)
    assert found["rtc_broker_up",] == 0
    assert ("rtc_commands_in_progress",) not in found


def test_workers_and_refusals_are_shown_by_key_over_all_its_hosts(metrics):
    rows = [
        {"key": "", "asked": 4, "joined": 3, "refused": 0, "late_results": 0},
        {"key": "w1", "asked": 8, "joined": 2, "refused": 1, "late_results": 2},
        {"key": "w1", "asked": 8, "joined": 5, "refused": 0, "late_results": 0},
    ]
    status = msgspec.convert({**STATUS, "hosts": rows}, m.Status)
    metrics.take(Received(T0, m.StatusReply(request="status", status=status)))
    found = samples(metrics)
    for name, here, far in (("workers_asked", 4, 8), ("workers_joined", 3, 7), ("peer_refusals", 0, 3)):
        assert (found[f"rtc_{name}", ""], found[f"rtc_{name}", "w1"]) == (here, far)


def test_every_metric_of_the_board_exists(metrics):
    for message in (*STOWED, DECLINED, telemetry(0.0, 0.1)):
        metrics.take(received(message))
    metrics.take(Received(T0, m.StatusReply(request="status", status=msgspec.convert(STATUS, m.Status))))
    exported = {name for name, *_ in samples(metrics)} | {"rtc_command_stops_total"}  # that one has no sample yet
    board = json.loads(BOARD.read_text())
    used = {name for panel in board["panels"] for t in panel["targets"] for name in re.findall(r"rtc_\w+", t["expr"])}
    assert len(used) > 15
    assert used - exported == set()


def test_half_open_requests_hold_a_limited_number_of_threads_and_scrapes_are_answered():
    metrics = Metrics(lost=lambda: 0, now=lambda: 0.0)
    port, threads = metrics.serve(0), threading.active_count()
    with ExitStack() as opened:
        try:
            for _ in range(4 * scrapes.MAX_OPEN):
                half = opened.enter_context(socket.create_connection(("127.0.0.1", port), 5))
                half.sendall(b"GET /metrics HTTP/1.1\r\nX: ")
            with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as answer:
                assert b"rtc_broker_up" in answer.read()
            until(lambda: threading.active_count() <= threads + scrapes.MAX_OPEN)
        finally:
            metrics.close()


def test_a_silent_connection_is_closed(monkeypatch):
    monkeypatch.setattr(scrapes._Handler, "timeout", 0.05)
    metrics = Metrics(lost=lambda: 0, now=lambda: 0.0)
    try:
        with socket.create_connection(("127.0.0.1", metrics.serve(0)), 5) as half:
            half.sendall(b"GET /metrics HTTP/1.1\r\nX: ")
            while half.recv(4096):
                pass
    finally:
        metrics.close()
