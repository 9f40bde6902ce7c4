"""The core of the broker process: state, journal, sockets, queued events and counters, shared by all its parts.

Must not know any message. The parts around it receive (ingress), send (egress), watch (health) and run (loop).
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence

import msgspec
import zmq

from broker.decisions.events import Event, JobLost
from broker.decisions.state import State
from broker.dispatch.timers import Timers
from broker.dispatch.worker_registry import LostJob, WorkerRegistry
from broker.persistence.journal import Journal
from broker.persistence.program_loads import Check, InProcessCheck, ProgramLoads
from broker.persistence.program_store import ProgramStore
from broker.router.recent_reports import RecentReports
from broker.router.refused_peers import RefusedPeers
from rtc.programs import sandbox
from rtc.protocol.messages import PeerRow, ProcessRow, WorkerRequest
from rtc.runtime.handover import Handover
from rtc.runtime.process import Process
from rtc.runtime.settings import BOUNDS, NO_HANDOVER, Settings

LATE_KEPT = 1_000  # maximum number of workers whose late results are counted
LOOP_TIMES_KEPT = 4096  # durations of the latest loop iterations, for `rtc status`


class Core:
    """`clock`: CLOCK_MONOTONIC in seconds, or the clock of a simulated cluster."""

    def __init__(
        self,
        me: Process,
        settings: Settings,
        journal: Journal,
        state: State,
        store: ProgramStore,
        given: Handover,
        clock: Callable[[], float] = time.monotonic,
        start_check: Callable[[sandbox.CheckRequest], Check] = InProcessCheck,
    ) -> None:
        self.me, self.settings, self.journal, self.state = me, settings, journal, state
        self.store, self.given, self.clock = store, given, clock
        self.refused_peers = RefusedPeers()
        self.loads = ProgramLoads(store, start_check)
        self.registry = WorkerRegistry()
        self.timers = Timers(state.timeout_scale)
        self.events: list[Event] = []  # received in this iteration, not decided yet
        self.began_s = clock()
        self.loop_times_s: deque[float] = deque(maxlen=LOOP_TIMES_KEPT)
        self.dropped: Counter[str] = Counter()  # unreadable or forbidden messages, by socket
        self.reported_drops: dict[str, int] = {}  # the same at sockets of other processes, as they report it
        self.supervisor_peer = peer_of(given.identity("supervisor"))
        self.supervised = False  # the supervisor has sent a message
        self.processes: list[ProcessRow] = []  # the supervisor's latest process table
        self.processes_at_s = self.began_s  # time of that table
        self.asked: Sequence[WorkerRequest] = ()  # requests for more workers, from the same table
        self.peers: Sequence[PeerRow] = ()  # the gateway's latest report
        self.peers_at_s = self.began_s  # time of that report
        self.reports = RecentReports()
        self.late_results: Counter[str] = Counter()  # results of attempts that a worker does not have now, by worker
        self.injected: dict[str, list[str]] = {}  # active faults of simulated subsystems, in words
        self.strayed: dict[str, dict[str, str]] = {}  # subsystem -> arm that moved without a primitive -> how
        self._subsystem_peers: dict[str, bytes] = {}  # of the subsystems in the state
        self.sockets: dict[str, zmq.Socket[bytes]] = {}
        for name in ("halt", "subsystems", "supervisor", "workers", "front"):
            self.sockets[name] = me.socket(
                zmq.ROUTER, settings.endpoint(name), bind=True, bounds=BOUNDS[name], handover=name not in NO_HANDOVER
            )
        self.sockets["events"] = me.socket(zmq.XPUB, settings.endpoint("events"), bind=True, bounds=BOUNDS["events"])

    def enqueue(self, event: Event) -> None:
        """Add an event; it is decided in this loop iteration."""
        self.events.append(event)

    def lose_jobs(self, worker: str, lost: Iterable[LostJob], why: str, now: float, called: str = "") -> None:
        """Enqueue the loss of the jobs that a lost worker had. `called`: code of a package that it has announced."""
        for job, in_hand, inside in lost:
            loss = JobLost(at_s=now, job=job.job, attempt=job.attempt, node=worker, evidence=why, blamed=in_hand)
            self.enqueue(msgspec.structs.replace(loss, inside=(called or inside) if in_hand else ""))

    def count_late_result(self, worker: str) -> None:
        """Count a result that was not accepted. The workers with such results are bounded in number."""
        self.dropped["results"] += 1
        if worker in self.late_results or len(self.late_results) < LATE_KEPT:
            self.late_results[worker] += 1

    def subsystem_peer(self, name: str) -> bytes:
        """The routing identity of a subsystem; that of the cluster's own subsystems contains a token."""
        peer = self._subsystem_peers.get(name)
        if peer is None:
            peer = peer_of(self.given.identity(name))
            if name in self.state.subsystems:  # their number is bounded
                self._subsystem_peers[name] = peer
        return peer


def name_of(peer: bytes) -> str:
    """A routing identity as text; `peer_of` reverses it for any bytes."""
    return peer.decode("latin-1")


def peer_of(name: str) -> bytes:
    return name.encode("latin-1")
