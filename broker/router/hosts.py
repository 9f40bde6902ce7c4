"""Rows of `rtc status` about hosts: workers asked for, joined, lost and refused, with their round-trip times.

Made from the reports of gateway and supervisor and from the worker registry. Layout: docs/protocol.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence

import msgspec

from broker.dispatch.more_workers import far_of, joined
from broker.dispatch.worker_registry import Worker, WorkerRegistry
from rtc.protocol.messages import HostRow, MoreWorkersRow, PeerRow, ProcessRow, RemoteWorker, WorkerRequest
from rtc.protocol.roles import Role
from rtc.runtime.keys import LINK_LIMIT_S

HERE = "this machine"
QUIET_S = 1.5  # three heartbeats: a host silent for longer is shown as silent
GONE = ("failed", "ended", "ending")  # states of local processes that are not expected to join


def hosts(
    registry: WorkerRegistry,
    processes: Sequence[ProcessRow],
    peers: Iterable[PeerRow],
    late: Mapping[str, int],
    now: float,
) -> list[HostRow]:
    """One row for this machine and one per key and host. `asked` and `missing` are those of the key on all hosts.

    `late`: late results by worker.
    """
    rows = [_here(registry, processes, late), *(_row(peer, registry, late, now) for peer in peers)]
    joined = Counter[str]()
    for row in rows:
        joined[row.key] += row.joined
    return [msgspec.structs.replace(row, missing=max(0, row.asked - joined[row.key])) for row in rows]


def requests_for_more(
    asked: WorkerRequest, registry: WorkerRegistry, processes: Sequence[ProcessRow], now: float
) -> MoreWorkersRow:
    """The latest request for more workers of a kind: how many were asked for, how many have joined since."""
    workers = [worker for worker in registry.workers.values() if worker.queue == asked.kind]
    return MoreWorkersRow(
        kind=asked.kind.value,
        asked=asked.count,
        joined=joined(asked, far_of(workers, {row.name for row in processes})),
        ago_s=now - asked.at_s,
        running=asked.running,
        failed=asked.failed,
        output=asked.output,
    )


def _here(registry: WorkerRegistry, processes: Sequence[ProcessRow], late: Mapping[str, int]) -> HostRow:
    names = [row.name for row in processes if "@" in row.name]
    asked = [row for row in processes if "@" in row.name and row.state not in GONE]
    workers = sorted(name for name in names if name in registry.workers)
    return HostRow(
        host=HERE,
        key="",
        role=Role.WORKER.value,
        asked=len(asked),
        joined=len(workers),
        workers=workers,
        refused=0,
        late_results=_late(names, late),
        state="ready" if workers else "no worker",
    )


def _row(peer: PeerRow, registry: WorkerRegistry, late: Mapping[str, int], now: float) -> HostRow:
    names = [worker.name for worker in peer.workers]
    there = [registry.workers[name] for name in names if name in registry.workers]
    trip = min((one for one in peer.workers if one.round_trip_s is not None), key=_trip_s, default=None)
    return HostRow(
        host=peer.host,
        key=peer.key,
        role=peer.role,
        asked=peer.asked,
        joined=len(there),
        workers=[worker.name for worker in there],
        lost={name: now - at_s for name, at_s in peer.lost.items()},
        connections=peer.connections,
        refused=peer.refused,
        refusal=peer.refusal,
        refused_ago_s=now - peer.refused_at_s if peer.refused else None,
        late_results=_late((*names, *peer.lost), late),
        round_trip_ms=1e3 * _trip_s(trip) if trip else None,
        round_trip_ago_s=now - trip.round_trip_at_s if trip else None,
        last_message_ago_s=now - peer.last_message_at_s if peer.last_message_at_s else None,
        state=_state(peer, there, now),
    )


def _state(peer: PeerRow, there: Collection[Worker], now: float) -> str:
    """The state of the link, in words."""
    if peer.revoked:
        return "key revoked"
    if not peer.connections:
        if peer.lost:
            return "lost"
        return "not connected" if peer.last_message_at_s else "refused" if peer.refused else "not used yet"
    if not peer.workers:
        return "connected"
    silent_s = now - max(worker.last_message_at_s for worker in peer.workers)
    if silent_s < QUIET_S:
        return "ready" if there else "registering"
    if any(worker.assigned for worker in there):  # a worker is silent during a job
        return "busy"
    if not there:
        return f"silent for {silent_s:.1f} s; jobs go to other workers"  # stopped: its kernel still answers
    return f"silent for {silent_s:.1f} s, limit {LINK_LIMIT_S:g} s"


def _late(names: Iterable[str], late: Mapping[str, int]) -> int:
    return sum(late.get(name, 0) for name in names)


def _trip_s(worker: RemoteWorker) -> float:
    return worker.round_trip_s or 0.0
