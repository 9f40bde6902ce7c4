"""Prometheus metrics of one cluster, from its events, its telemetry and the status of its broker.

Units are in the names. Labels are few and have few values: outcome, phase, kind of worker, arm, stop reason.
"""

from __future__ import annotations

import math
from collections import Counter as Counts
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from rtc.apps.observers.feed import STATUS_S, Received
from rtc.apps.observers.scrapes import ScrapeServer
from rtc.protocol import messages as m
from rtc.protocol.messages import Phase

SHORT_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # of the work of a worker
LONG_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0)  # of phases and commands
STALE_S = 3 * STATUS_S  # age of the last status from which on the broker counts as silent
MAX_COMMANDS = 10_000  # commands in progress whose phase is remembered


class Metrics:
    """Counts what a feed receives. `lost`: number of events that did not arrive; `now`: CLOCK_MONOTONIC (s)."""

    def __init__(self, lost: Callable[[], int], now: Callable[[], float]) -> None:
        self.registry = CollectorRegistry()
        own: dict[str, Any] = {"registry": self.registry}
        self._commands = Counter("rtc_commands", "Ended commands", ["outcome"], **own)
        self._stops = Counter("rtc_command_stops", "Commands ended by a stop reason", ["reason"], **own)
        self._trims = Counter("rtc_trims", "Corrections used by ended commands", **own)
        self._steps = Counter("rtc_steps", "Successful steps of ended commands", **own)
        self._warnings = Counter("rtc_warnings", "Progress notes that need a person's attention", **own)
        self._took = Histogram("rtc_command_duration_seconds", "Acceptance to end", ["outcome"], buckets=LONG_S, **own)
        self._phase = Histogram("rtc_phase_duration_seconds", "Time in one phase", ["phase"], buckets=LONG_S, **own)
        self._job = Histogram("rtc_job_duration_seconds", "Dispatch to answer", ["kind"], buckets=SHORT_S, **own)
        self._refused = Counter("rtc_requests_refused", "Requests that did not become a command", ["reason"], **own)
        self._open: dict[str, m.ProgressNote] = {}  # command -> its last note
        self._since: dict[str, float] = {}  # command -> when it entered its phase
        self._last = _Last(lost, now)
        self._server: ScrapeServer | None = None
        self.registry.register(self._last)

    def take(self, received: Received) -> None:
        match received.message:
            case m.ProgressNote() as note if note.command and note.seq:
                self._take_note(note)
            case m.CommandEnded() as ended:
                self._take_end(ended)
            case m.RequestRefused(refusal=refusal):
                self._refused.labels(refusal.reason.value).inc()
            case m.StatusReply(status=status):
                self._last.status, self._last.status_at_s = status, received.at_s
            case m.Telemetry() as telemetry:
                self._last.telemetry[telemetry.subsystem] = telemetry

    def _take_note(self, note: m.ProgressNote) -> None:
        before = self._open.get(note.command)
        repeated = before is not None and (note.node, note.took_s) == (before.node, before.took_s)
        if "@" in note.node and not repeated:
            self._job.labels(note.node.partition("@")[0]).observe(note.took_s)
        self._warnings.inc(note.warning)
        if before is None or before.phase is not note.phase:
            if before is not None:
                self._phase.labels(before.phase.value).observe(note.at_s - self._since[note.command])
            self._since[note.command] = note.at_s
        self._open[note.command] = note
        if note.phase is Phase.ENDED or len(self._open) > MAX_COMMANDS:
            self._forget(note.command if note.phase is Phase.ENDED else next(iter(self._open)))

    def _forget(self, command: str) -> None:
        self._open.pop(command, None)
        self._since.pop(command, None)

    def _take_end(self, ended: m.CommandEnded) -> None:
        self._forget(ended.command)
        outcome = ended.outcome
        self._commands.labels(outcome.kind.value).inc()
        self._took.labels(outcome.kind.value).observe(ended.took_s)
        if outcome.stop is not None:
            self._stops.labels(outcome.stop.value).inc()
        self._trims.inc(len(outcome.trims))
        self._steps.inc(outcome.steps_done)

    def serve(self, port: int, host: str = "127.0.0.1") -> int:
        """Answer scrapes at http://HOST:PORT/metrics, in a thread of its own; the port, chosen if it was 0.

        Raises OSError for a used port.
        """
        self._server = ScrapeServer(self.registry, host, port)
        return self._server.server_port

    def close(self) -> None:
        """Stop answering scrapes."""
        if self._server is not None:
            self._server.close()


class _Last(Collector):
    """The latest status and telemetry as metrics. A scrape reads them in another thread."""

    def __init__(self, lost: Callable[[], int], now: Callable[[], float]) -> None:
        self._lost, self._now = lost, now
        self.status = m.Status()
        self.status_at_s = -math.inf
        self.telemetry: dict[str, m.Telemetry] = {}  # by subsystem

    def collect(self) -> Iterator[Metric]:
        yield CounterMetricFamily("rtc_events_lost", "Events that did not arrive here", self._lost())
        up = self._now() - self.status_at_s < STALE_S
        yield GaugeMetricFamily("rtc_broker_up", "1 while the broker answers", float(up))
        if up:
            yield from _of_status(self.status)
        if self.telemetry:
            yield from _of_telemetry(list(self.telemetry.values()))


def _of_status(status: m.Status) -> Iterator[Metric]:
    dropped = sum(n for name, n in status.counters.items() if name.startswith("dropped_"))
    restarts = sum(row.restarts for row in status.processes)
    yield GaugeMetricFamily("rtc_cluster_uptime_seconds", "Since the start of the run", status.uptime_s)
    yield GaugeMetricFamily("rtc_commands_in_progress", "Commands not ended", status.commands_live)
    yield CounterMetricFamily("rtc_commands_accepted", "Accepted sentences", status.commands_accepted)
    unwatched = status.counters.get("unwatched", 0)
    yield CounterMetricFamily("rtc_commands_unwatched", "Commands whose notes were not published", unwatched)
    yield CounterMetricFamily("rtc_halts", "Halts received", status.halts.called)
    yield CounterMetricFamily("rtc_messages_dropped", "Unreadable or excessive messages", dropped)
    yield CounterMetricFamily("rtc_process_restarts", "Restarts of all processes", restarts)
    taken = sum(1 for row in status.resources if row.owners or row.quarantine)
    yield GaugeMetricFamily("rtc_resources_taken", "Resources with an owner, or in quarantine", taken)
    kinds = [worker.kind for worker in status.workers]
    yield _labelled("rtc_workers", "Workers", "kind", {kind: kinds.count(kind) for kind in status.queues})
    yield from _of_hosts(status.hosts)
    yield _labelled("rtc_jobs_waiting", "Jobs without a worker", "kind", status.queues)
    times = {name: 1e-3 * value for name, value in status.decision_ms.items()}
    yield _labelled("rtc_broker_iteration_seconds", "Message to effects, recent iterations", "statistic", times)


def _of_hosts(rows: list[m.HostRow]) -> Iterator[Metric]:
    """Workers and refusals by the name of the key; an empty name stands for this machine and for unknown keys."""
    asked, joined, refused = (Counts[str]() for _ in range(3))
    for row in rows:
        asked[row.key] = max(asked[row.key], row.asked)
        joined[row.key] += row.joined
        refused[row.key] += row.refused + row.late_results
    yield _labelled("rtc_workers_asked", "Workers that are to use a key", "key", dict(asked))
    yield _labelled("rtc_workers_joined", "Workers that the broker knows", "key", dict(joined))
    yield _labelled("rtc_peer_refusals", "Refusals of the peers that rtc status shows", "key", dict(refused))


def _of_telemetry(latest: list[m.Telemetry]) -> Iterator[Metric]:
    ticks = CounterMetricFamily("rtc_mcm_ticks", "Control ticks of a subsystem of arms", labels=["subsystem"])
    late = CounterMetricFamily("rtc_mcm_late_ticks", "Control ticks that began late", labels=["subsystem"])
    for one in latest:
        ticks.add_metric([one.subsystem], one.ticks)
        late.add_metric([one.subsystem], one.late_ticks)
    yield from (ticks, late)
    arms = {name: arm for one in latest for name, arm in one.arms.items()}
    moving = {name: float(bool(arm.primitive)) for name, arm in arms.items()}
    yield _labelled("rtc_arm_moving", "1 while the arm executes a primitive", "arm", moving)
    forces = {name: math.hypot(*arm.wrench[:3]) for name, arm in arms.items()}
    yield _labelled("rtc_arm_force_newtons", "Force on the hand", "arm", forces)


def _labelled(name: str, words: str, label: str, values: Mapping[str, float]) -> Metric:
    family = GaugeMetricFamily(name, words, labels=[label])
    for key, value in values.items():
        family.add_metric([key], value)
    return family
