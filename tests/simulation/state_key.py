"""The identity of a state of the model check: a digest without values that only grow."""

from __future__ import annotations

import hashlib
from typing import Any

from broker.decisions import events
from broker.decisions.deferred_analysis import LIMIT_S
from broker.decisions.state import NIL, Command, JobKind
from tests.simulation.model import Model, at_work, deferred_at_work, encode


def key(model: Model) -> tuple[bytes, bytes]:
    """(what the state is, that and which faults may still happen), each as a digest. Left out is what only grows and
    changes nothing that can follow: times, counters in names, stories, what is remembered of the ended."""
    core = encode(_essence(model))
    faults = encode([model.faults, sorted(model.budget.items())])
    return hashlib.blake2b(core, digest_size=16).digest(), hashlib.blake2b(core + faults, digest_size=16).digest()


def _essence(model: Model) -> list[Any]:
    du, mcm = model.du, model.mcm
    return [
        [_of_command(model, command) for command in du.commands.values()],
        du.resources,
        [
            (c, len(left.job.deaths), left.job.kind is JobKind.SUSPECT, left.phase, left.job.id in model.timers)
            for c, left in du.deferred_analyses.items()
        ],
        deferred_at_work(model),
        [du.space_lines, [(arm, _name(model, motion.primitive)) for arm, motion in du.motions.items()]],
        [du.awaiting, du.joining, {c: r.succeeded for c, r in du.ended.items()}],
        [(name, request.unconfirmed) for name, request in du.halt_sentences.items()],
        [(s.pid, s.link, s.came_at_rest) for s in du.subsystems.values()],
        [du.programs, [(kind, rollout.phase) for kind, rollout in du.rollouts.items()]],
        [model.handed_in, sorted(model.timers), model.stopped, model.estopped],
        [
            (id_, halt.handed_in, halt.at_broker, halt.at_estop, halt.estops)
            for id_, halt in sorted(model.halts.items())
        ],
        [
            mcm.pid,
            mcm.alive,
            mcm.exit_reported,
            [_name(model, p) for p in mcm.arms.values()],
            mcm.braking,
            [_name(model, p) for p in mcm.paused],
            [_name(model, p) for p in mcm.kept],
            [(c.id, mcm.ended.get(c.primitive)) for c in du.commands.values()],
            mcm.open,
            mcm.fences,
            [_of_sent(model, outbox) for outbox in mcm.outbox],
        ],
    ]


def _of_command(model: Model, c: Command) -> list[Any]:
    actions = c.actions
    begun = sum(p.partition(".")[0] == c.id for p in model.begun)
    halted = [r for r, at_s in model.du.halted_at_s.items() if at_s > c.given_at_s]
    return [
        [c.id, c.phase, c.pause_wanted, c.pending_outcome, c.elaborations, c.at_rest, c.due_s > 0.0, c.programs],
        c.job
        and [c.job.worker, len(c.job.deaths), c.job.program, at_work(model, c), model.now - c.job.since_s > LIMIT_S],
        [c.head is not None, actions and [actions.refs, actions.step, actions.trims_used, len(actions.trim_labels)]],
        c.steps_done,
        [c.waits_for, [_name(model, name) for name in c.beside]],
        [
            now == seen
            for now, seen in zip((model.du.motions_begun, model.du.motions_ended), c.motions_seen, strict=True)
        ],
        model.du.spaces_mm[-since:] if (since := model.du.motions_begun - c.motions_seen[0]) else [],
        [bool(c.primitive), min(c.primitives, 2), c.primitive_body != NIL, c.performers],
        [c.primitives - begun, begun - model.goals.get(c.id, 0) - model.cut.get(c.id, 0), c.primitive in model.begun],
        halted,
    ]


def _name(model: Model, primitive: str) -> str:
    """Its number only matters as being the current one of its command, or not."""
    command = model.du.commands.get(primitive.partition(".")[0])
    return primitive if command is None or command.primitive != primitive else f"{command.id} now"


def _of_sent(model: Model, outbox: events.AnyEvent) -> list[Any]:
    match outbox:
        case events.PrimitiveEnded():
            return ["end", _name(model, outbox.report.primitive), outbox.report.reason]
        case events.SubsystemConnected():
            return [
                "hello",
                outbox.hello.pid,
                [_name(model, p) for p in outbox.hello.outstanding],
                outbox.hello.at_rest,
                [_name(model, p) for p in outbox.hello.paused],
            ]
        case events.HaltConfirmed():
            return ["rest", outbox.answer.halt, outbox.answer.performers]
        case events.HaltCalled():
            return ["halt", outbox.order.call]
    raise AssertionError(outbox)
