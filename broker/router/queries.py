"""Queries: answers to `rtc status` and `rtc trace`, made from a read-only view of the broker.

The status consists of plain JSON types (layout: docs/protocol.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from broker.decisions.command.nominal import read_primitive
from broker.decisions.state import ArmMotion, Command, State
from broker.dispatch.worker_registry import Worker, WorkerRegistry
from broker.persistence.journal import number
from broker.router.hosts import hosts, requests_for_more
from broker.router.peer_versions import PeerVersions
from rtc.protocol import messages as m
from rtc.protocol.messages import Phase
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.versions import VERSION
from rtc.runtime.settings import Settings

COMMANDS_SHOWN = 200
TEXT_SHOWN = 200  # characters of a sentence


@dataclass(frozen=True)
class BrokerView:
    """What a query may read of the broker. Times are those of the broker's clock, in seconds."""

    settings: Settings
    state: State
    registry: WorkerRegistry
    began_s: float  # start of this broker process
    loop_times_s: Collection[float]  # durations of the latest loop iterations
    processes: Sequence[Mapping[str, Any]]  # the supervisor's latest process table
    processes_at_s: float  # time of that table
    dropped: Mapping[str, int]  # dropped messages by socket, of this and other processes
    asked: Collection[m.WorkerRequest]  # requests for more workers
    peers: Sequence[m.PeerRow]  # the gateway's latest report
    peers_at_s: float  # time of that report
    late_results: Mapping[str, int]  # by worker
    injected: Mapping[str, Sequence[str]]  # faults in simulated subsystems
    strayed: Mapping[str, Mapping[str, str]]  # arms that moved without a primitive, by subsystem
    versions: PeerVersions


def status(view: BrokerView, now: float) -> dict[str, Any]:
    state, registry = view.state, view.registry
    return {
        "cluster": view.settings.run,
        "run_dir": view.settings.run_dir,
        "protocol": VERSION,
        "refused": view.versions.rows(now),
        "uptime_s": now - (state.began_at_s or view.began_s),
        "broker_uptime_s": now - view.began_s,
        "seq": state.seq,
        "processes": list(view.processes),
        "supervisor_silent_s": now - view.processes_at_s,
        "workers": [_worker(w) for w in sorted(registry.workers.values(), key=lambda w: w.node)],
        "hosts": hosts(registry, view.processes, view.peers, view.late_results, now),
        "asked_for": [requests_for_more(one, registry, view.processes, now) for one in view.asked],
        "gateway_silent_s": now - view.peers_at_s if view.settings.listen else 0.0,
        "queues": {kind.value: len(queue) for kind, queue in registry.queues.items()},
        "resources": _resources(state),
        "commands": [_command(c, state, now) for c in list(state.commands.values())[:COMMANDS_SHOWN]],
        "commands_live": len(state.commands),
        "motions": [_motion(arm, motion, now) for arm, motion in state.motions.items()],
        "commands_accepted": state.accepted,
        "subsystems": _subsystems(view),
        "halts": {"called": state.counts.get("halts", 0)},
        "counters": {**state.counts, **{f"dropped_{name}": n for name, n in view.dropped.items()}},
        "decision_ms": _spread_ms(view.loop_times_s),
        "programs": dict(state.programs),
        "program_files": {
            kind: {"file": found[0], "age_s": now - found[1]}
            for kind, name in state.programs.items()
            if (found := state.program_files.get(name)) is not None
        },
        "rolled_back": {kind: rollout.why for kind, rollout in state.rollouts.items() if rollout.why},
    }


def _worker(worker: Worker) -> dict[str, Any]:
    return {
        "name": worker.name,
        "node": worker.node,
        "kind": worker.kind.value,
        "pid": worker.pid,
        "busy_with": next(iter(worker.assigned), ""),
        "queued": max(0, len(worker.assigned) - 1),
        "done": worker.done,
        "mean_ms": worker.mean_s * 1e3 if worker.done else None,
    }


def _resources(state: State) -> list[dict[str, Any]]:
    resources = state.resources
    names = dict.fromkeys([*resources.holders, *resources.lines, *resources.quarantine])
    return [
        {
            "name": name,
            "owner": ", ".join(resources.holders.get(name, {}))
            or (f"quarantine: {resources.quarantine[name].subsystem}" if name in resources.quarantine else ""),
            "exclusive": any(resources.holders.get(name, {}).values()),
            "waiting": list(resources.lines.get(name, {})),
        }
        for name in names
    ]


def _command(command: Command, state: State, now: float) -> dict[str, Any]:
    held = state.resources.held.get(command.id, {})
    return {
        "command": command.id,
        "text": command.text[:TEXT_SHOWN],
        "phase": command.shown_phase.value,
        "step": command.shown_step,
        "resources": sorted(name for name, alone in held.items() if alone),
        "age_s": now - command.accepted_at_s,
    }


def _subsystems(view: BrokerView) -> list[dict[str, Any]]:
    executing = [c for c in view.state.commands.values() if c.phase in (Phase.EXECUTING, Phase.HALTING)]
    return [
        {
            "name": name,
            "state": subsystem.link.value,
            "pid": subsystem.pid,
            "performers": subsystem.performers,
            "executing": [c.primitive for c in executing if c.subsystem == name],
            "injected": list(view.injected.get(name, ())),
            "strayed": [f"{arm} {how}" for arm, how in view.strayed.get(name, {}).items()],
        }
        for name, subsystem in view.state.subsystems.items()
    ]


def _motion(arm: str, motion: ArmMotion, now: float) -> dict[str, Any]:
    path = read_primitive(motion.body).paths[arm]
    return {
        "arm": arm,
        "command": motion.command,
        "primitive": motion.primitive,
        "started_ago_s": now - motion.started_s if motion.started_s else None,
        "time_s": path.time_s,
        "positions": path.positions,
    }


def _spread_ms(times_s: Collection[float]) -> dict[str, float]:
    """Percentiles of the time from a message to its effects, in milliseconds, over the latest batches."""
    if not times_s:
        return {}
    ordered = sorted(times_s)
    return {
        "p50": ordered[len(ordered) // 2] * 1e3,
        "p99": ordered[int(len(ordered) * 0.99)] * 1e3,
        "max": ordered[-1] * 1e3,
    }


def trace(
    state: State, ended: Callable[[str], m.CommandRecord | None], query: m.TraceQuery
) -> m.TraceReply | m.Declined:
    """The record of a live or ended command. `ended` finds the record of an ended one in the journal."""
    if (live := state.commands.get(query.command)) is not None:
        record = m.CommandRecord(
            command=live.id,
            text=live.text,
            source=live.source,
            request=live.request,
            accepted_at_s=live.accepted_at_s,
            phase=live.shown_phase,
            notes=live.notes,
        )
        return m.TraceReply(request=query.request, record=record)
    if (kept := ended(query.command)) is not None:
        return m.TraceReply(request=query.request, record=kept)
    if state.lost and 0 < number(query.command) <= state.accepted:
        words = f"{query.command} is not in the journal: {state.lost}"
    else:
        last = f"the last one accepted is C-{state.accepted}" if state.accepted else "none was accepted yet"
        words = f"there is no command {query.command}; {last}"
    return m.Declined(request=query.request, refusal=Refusal(reason=RefusalReason.NAME, message=words))
