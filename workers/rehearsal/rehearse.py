"""Rehearsal worker function: (programs, a TEST sentence, world) -> what the sentence is expected to do, or why not.

Pure. The sentence is performed on an overlay of the world: nothing is written, and nothing reaches a subsystem. The
overlay goes on to the next sentence of the same list.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import msgspec

from rtc.protocol.messages import Paper, RehearsalInput, Rehearsed, WorkerKind, WorldChange
from rtc.protocol.outcomes import Refusal, Refused
from rtc.protocol.primitive import Primitive
from rtc.protocol.rehearsal import FaultBranch, PredictedFact, Rehearsal, Repair
from rtc.protocol.sentence import ParsedCommand
from rtc.spatial import geometry
from rtc.world.model import World
from workers.analyzer import analyze
from workers.binder import bind
from workers.elaborator import elaborate
from workers.parser import parse
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery
from workers.rehearsal import assumed_faults, in_order, repairs
from workers.rehearsal.paper_world import PaperWorld, on_paper
from workers.rehearsal.performance import Performance, Programs

TEST = re.compile(r"^(?:\s*(?:TEST|SIMULATE)\b)+", re.IGNORECASE)
ASSUMED = re.compile(r"\s+ASSUMING\s+[\w-]+\s*\.?\s*$", re.IGNORECASE)

INPUT = RehearsalInput
NEEDS_WORLD = True
NEEDS_CELL = True
#: a rehearsal uses the programs of all kinds
COMPILERS: dict[WorkerKind, Callable[[bytes], Any]] = {
    WorkerKind.PARSER: parse.compile,
    WorkerKind.ELABORATOR: elaborate.compile,
    WorkerKind.BINDER: bind.compile,
    WorkerKind.ANALYZER: analyze.compile,
}


def run(programs: Programs, cell: CellModel | None, world: World | None, data: RehearsalInput) -> Rehearsed:
    """Rehearse one sentence in the world after those before it."""
    assert cell is not None
    assert world is not None
    before = data.before or Paper(at_s=data.at_s)
    parsed = msgspec.structs.replace(data.parsed, test=False, assuming=None)
    paper = settled(cell, on_paper(world, before.facts), data.moving)
    done = Performance(programs, cell, paper, before.at_s, data.command, rigid=data.rigid, pictures=data.pictures)
    faults: list[FaultBranch] = []
    feasible = False
    try:
        in_order.refuse_unknown(parsed, before, data.live)
        if parsed.kind == "control":
            done.assumes.append("it concerns what is in progress when it is given; on paper it stops and moves nothing")
            return _answer(done, data, parsed, in_order.stopped(before, parsed, data.label))
        done.run(parsed)
        in_order.refuse_lasting(done, before)
        feasible = done.refusal is None
        if data.parsed.assuming and feasible:
            faults = assumed_faults.branches(done, data.parsed.assuming)
    except Refused as refused:
        done.refusal = refused.refusal
    if done.refusal is not None:
        offered: list[Repair] = []
        if not feasible:  # another sentence does not mend an ASSUMING that does not fit
            query = WorldQuery(cell, paper)
            failed = repairs.Infeasible(plain(data.text), parsed, done.refusal, query)
            rehearser = _rehearser(done, paper, before.at_s)
            offered = repairs.tested(failed, programs[WorkerKind.ELABORATOR].program, rehearser)
        return _answer(done, data, parsed, before, repairs=offered)
    return _answer(done, data, parsed, in_order.begun(before, done, data.label), faults=faults)


def settled(cell: CellModel, world: PaperWorld, moving: Iterable[Primitive]) -> PaperWorld:
    """The world when the motions of live commands have ended at their goals. A predicted place of an arm is later."""
    for primitive in moving:
        for arm, path in primitive.paths.items():
            key = f"{arm}.joints"
            if key in world.given:
                continue
            world.get(key)  # the motion may end elsewhere: then what was tested is stale
            query = WorldQuery(cell, world)
            changes = [WorldChange(key=key, value=path.positions[-1])]
            held = query.holding(arm)
            frame = query.in_hand(held, cell.arms[arm].fk(path.positions[-1])) if held else None
            if frame is not None and query.held_by(held) == arm:
                fact = world.get(f"{held}.frame")
                changes.append(
                    WorldChange(
                        key=f"{held}.frame",
                        value=geometry.normalise(frame).tolist(),
                        spread=fact.spread if fact else None,
                    )
                )
            world = world.overlay(changes, primitive.id)
    return world


def plain(text: str) -> str:
    """The sentence of a TEST: without TEST, and without the fault that it assumes."""
    return ASSUMED.sub("", TEST.sub("", text)).strip()


def _rehearser(first: Performance, world: PaperWorld, at_s: float) -> repairs.Rehearse:
    """Sentences in the world of a refused one -> how long they take; None: one of them is not feasible, or the first is
    in vain."""

    def rehearse(sentences: list[str], in_vain: repairs.InVain) -> float | None:
        # A record of its own: what a repair reads is nothing that the refusal rests on.
        here, now_s, total_s = on_paper(world, world.predicted()), at_s, 0.0
        for text in sentences:
            parsed = parse.parse_job(first.programs[WorkerKind.PARSER], text)
            if isinstance(parsed, Refusal) or parsed.kind != "task":
                return None
            done = Performance(
                first.programs,
                first.model,
                here,
                now_s,
                first.command,
                advise=False,
                rigid=first.rigid,
                pictures=first.pictures,
            ).run(parsed)
            if done.refusal is not None or (text is not sentences[-1] and in_vain(done.world)):
                return None
            here, now_s, total_s = done.world, done.now_s, total_s + done.predicted_s
        return total_s

    return rehearse


def _answer(
    done: Performance,
    data: RehearsalInput,
    parsed: ParsedCommand,
    after: Paper,
    faults: Sequence[FaultBranch] = (),
    repairs: Sequence[Repair] = (),
) -> Rehearsed:
    script, query = done.script, done.query()
    resources = script.resources if script else []
    arms = [arm.name for arm in done.model.cell.arms if arm.name in resources]
    known = {fact.key: fact for fact in (data.before.facts if data.before else [])}
    rehearsal = Rehearsal(
        script=script.context.script if script else "",
        steps=done.steps,
        predicted_s=done.predicted_s,
        ends={arm: query.tcp(arm).tolist() for arm in arms},
        holding={arm: query.holding(arm) for arm in arms},
        resources=resources,
        relies_on=dict(sorted(done.world.read.items())),
        foreseen=sorted(done.world.foreseen),
        remark=done.remark if done.refusal is None else "",
        assumes=list(dict.fromkeys(done.assumes)),
        changes=[
            PredictedFact(key=fact.key, value=fact.value, validity=fact.validity.value, spread=done.spread_of(fact))
            for fact in after.facts
            if known.get(fact.key) != fact
        ],
        faults=[*faults],
        repairs=[*repairs],
    )
    refusal = done.refusal
    return Rehearsed(
        rehearsal=rehearsal,
        parsed=parsed,
        after=after,
        refusal=refusal,
        step=done.step if refusal else "",
    )
