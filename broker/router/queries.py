"""The broker status for `rtc status`, in plain JSON types (layout: docs/protocol.md)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from rtc.protocol.messages import Phase
from rtc.protocol.wire import PROTOCOL

if TYPE_CHECKING:
    from broker.router.loop import Router

COMMANDS_SHOWN = 200
TEXT_SHOWN = 200  # characters of a sentence


def status(router: Router) -> dict[str, Any]:
    now, state, registry = time.monotonic(), router.state, router.registry
    resources = state.resources
    dropped = {**router.dropped, **router.told_dropped}
    names = [*dict.fromkeys([*resources.holders, *resources.lines, *resources.quarantine])]
    executing = [c for c in state.commands.values() if c.phase in (Phase.EXECUTING, Phase.HALTING)]
    return {
        "cluster": router.settings.run,
        "run_dir": router.settings.run_dir,
        "version": PROTOCOL.decode(),
        "uptime_s": now - (state.began_at_s or router.began_s),
        "broker_uptime_s": now - router.began_s,
        "seq": state.seq,
        "processes": router.processes,
        "supervisor_silent_s": now - router.processes_at_s,
        "workers": [
            {
                "name": w.name,
                "node": w.node,
                "kind": w.kind.value,
                "pid": w.pid,
                "busy_with": next(iter(w.assigned), ""),
                "queued": max(0, len(w.assigned) - 1),
                "done": w.done,
                "mean_ms": w.mean_s * 1e3 if w.done else None,
            }
            for w in sorted(registry.workers.values(), key=lambda w: w.node)
        ],
        "queues": {kind.value: len(queue) for kind, queue in registry.queues.items()},
        "resources": [
            {
                "name": name,
                "owner": ", ".join(resources.holders.get(name, {}))
                or (f"quarantine: {resources.quarantine[name].subsystem}" if name in resources.quarantine else ""),
                "exclusive": any(resources.holders.get(name, {}).values()),
                "waiting": list(resources.lines.get(name, {})),
            }
            for name in names
        ],
        "commands": [
            {
                "command": c.id,
                "text": c.text[:TEXT_SHOWN],
                "phase": c.phase.value,
                "step": c.step_words,
                "resources": sorted(name for name, alone in resources.held.get(c.id, {}).items() if alone),
                "age_s": now - c.accepted_at_s,
            }
            for c in list(state.commands.values())[:COMMANDS_SHOWN]
        ],
        "commands_live": len(state.commands),
        "commands_accepted": state.accepted,
        "subsystems": [
            {
                "name": name,
                "state": s.link.value,
                "pid": s.pid,
                "performers": s.performers,
                "executing": [c.primitive for c in executing if c.subsystem == name],
            }
            for name, s in state.subsystems.items()
        ],
        "halts": {"called": state.counts.get("halts", 0)},
        "counters": {**state.counts, **{f"dropped_{name}": n for name, n in dropped.items()}},
        "decision_ms": _spread_ms(router.turn_times_s),
        "programs": dict(state.programs),
        "program_files": {
            kind: {"file": found[0], "age_s": now - found[1]}
            for kind, name in state.programs.items()
            if (found := state.program_files.get(name)) is not None
        },
        "rolled_back": dict(state.rolled_back),
    }


def _spread_ms(times_s: Any) -> dict[str, float]:
    """Percentiles of the time from a message to its effects, in milliseconds, over the latest batches."""
    if not times_s:
        return {}
    ordered = sorted(times_s)
    return {
        "p50": ordered[len(ordered) // 2] * 1e3,
        "p99": ordered[int(len(ordered) * 0.99)] * 1e3,
        "max": ordered[-1] * 1e3,
    }
