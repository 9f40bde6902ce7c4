"""Queries: answers to `rtc status` and `rtc trace`, made from the state of the broker, which they only read."""

from __future__ import annotations

from collections.abc import Callable, Collection

from broker.decisions import journal_loss, program_rollout
from broker.decisions.command.nominal import read_primitive
from broker.decisions.state import ArmMotion, Command, State, Surrender
from broker.dispatch.worker_registry import Worker
from broker.router.core import Core
from broker.router.hosts import hosts, requests_for_more
from rtc.protocol import messages as m
from rtc.protocol.messages import Phase
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.versions import VERSION

COMMANDS_SHOWN = 200
TEXT_SHOWN = 200  # characters of a sentence


def status(core: Core, now: float) -> m.Status:
    state, registry = core.state, core.registry
    return m.Status(
        cluster=core.settings.run,
        run_dir=core.settings.run_dir,
        protocol=VERSION,
        refused=core.refused_peers.rows(now),
        uptime_s=now - (state.began_at_s or core.began_s),
        broker_uptime_s=now - core.began_s,
        seq=state.seq,
        processes=list(core.processes),
        supervisor_silent_s=now - core.processes_at_s,
        workers=[_worker(w) for w in sorted(registry.workers.values(), key=lambda w: w.node)],
        hosts=hosts(registry, core.processes, core.peers, core.late_results, now),
        asked_for=[requests_for_more(one, registry, core.processes, now) for one in core.asked],
        gateway_silent_s=now - core.peers_at_s if core.settings.listen else 0.0,
        queues={str(name): len(queue) for name, queue in registry.queues.items()},
        resources=_resources(state),
        commands=[_command(c, state, now) for c in list(state.commands.values())[:COMMANDS_SHOWN]],
        commands_live=len(state.commands),
        motions=[_motion(arm, motion, now) for arm, motion in state.motions.items()],
        commands_accepted=state.accepted,
        subsystems=_subsystems(core),
        surrenders=[_surrender(name, one) for name, one in state.surrenders.items()],
        breakpoints=list(state.breakpoints),
        halts=m.HaltCount(called=state.counts.get("halts", 0)),
        counters={
            **state.counts,
            **{f"dropped_{name}": n for name, n in {**core.dropped, **core.reported_drops}.items()},
        },
        decision_ms=_spread_ms(core.loop_times_s),
        programs=dict(state.programs),
        program_files={
            kind: m.ProgramFile(file=found.file, age_s=now - found.at_s)
            for kind, name in state.programs.items()
            if (found := program_rollout.taken(state, kind, name)) is not None and found.file
        },
        rolled_back={kind: rollout.why for kind, rollout in state.rollouts.items() if rollout.why},
    )


def _worker(worker: Worker) -> m.WorkerRow:
    return m.WorkerRow(
        name=worker.name,
        node=worker.node,
        kind=str(worker.queue),
        pid=worker.pid,
        abilities=worker.abilities,
        busy_with=next(iter(worker.assigned), ""),
        queued=max(0, len(worker.assigned) - 1),
        done=worker.done,
        mean_ms=worker.mean_s * 1e3 if worker.done else None,
    )


def _resources(state: State) -> list[m.ResourceRow]:
    resources = state.resources
    names = dict.fromkeys([*resources.holders, *resources.lines, *resources.quarantine])
    return [
        m.ResourceRow(
            name=name,
            owner=", ".join(resources.holders.get(name, {})) or (f"quarantine: {closed}" if closed else ""),
            owners=list(resources.holders.get(name, {})),
            quarantine=closed,
            exclusive=any(resources.holders.get(name, {}).values()),
            waiting=list(resources.lines.get(name, {})),
        )
        for name in names
        for closed in [resources.quarantine[name].subsystem if name in resources.quarantine else ""]
    ]


def _command(command: Command, state: State, now: float) -> m.CommandRow:
    held = state.resources.held.get(command.id, {})
    return m.CommandRow(
        command=command.id,
        text=command.text[:TEXT_SHOWN],
        phase=command.shown_phase,
        step=command.shown_step,
        resources=sorted(name for name, alone in held.items() if alone),
        age_s=now - command.accepted_at_s,
    )


def _subsystems(core: Core) -> list[m.SubsystemRow]:
    executing = [c for c in core.state.commands.values() if c.phase in (Phase.EXECUTING, Phase.HALTING)]
    return [
        m.SubsystemRow(
            name=name,
            state=subsystem.link.value,
            pid=subsystem.pid,
            performers=subsystem.performers,
            executing=[c.primitive for c in executing if c.subsystem == name],
            injected=list(core.injected.get(name, ())),
            strayed=[f"{arm} {how}" for arm, how in core.strayed.get(name, {}).items()],
        )
        for name, subsystem in core.state.subsystems.items()
    ]


def _surrender(name: str, one: Surrender) -> m.SurrenderRow:
    return m.SurrenderRow(
        command=name,
        arms=one.arms,
        cause=one.cause,
        sentence=one.sentence,
        waiting=one.waiting,
    )


def _motion(arm: str, motion: ArmMotion, now: float) -> m.MotionRow:
    path = read_primitive(motion.body).paths[arm]
    return m.MotionRow(
        arm=arm,
        command=motion.command,
        primitive=motion.primitive,
        started_ago_s=now - motion.started_s if motion.started_s else None,
        time_s=path.time_s,
        positions=list(path.positions),
        velocities=list(path.velocities),
        accelerations=list(path.accelerations),
    )


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
            case=live.case,
        )
        return m.TraceReply(request=query.request, record=record)
    if (kept := ended(query.command)) is not None:
        return m.TraceReply(request=query.request, record=kept)
    if state.lost and 0 < journal_loss.number_of(query.command) <= state.accepted:
        words = f"{query.command} is not in the journal: {state.lost}"
    else:
        last = f"the last one accepted is C-{state.accepted}" if state.accepted else "none was accepted yet"
        words = f"there is no command {query.command}; {last}"
    return m.Declined(request=query.request, refusal=Refusal(reason=RefusalReason.NAME, message=words))
