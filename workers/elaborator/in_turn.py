"""Plans of scripts in which two arms work in turn: each run of steps of one arm, in the world after the runs before.

The prediction is that of a success: the arm is at the end of its path with what it holds, and the object is taken or
let go as the steps say. So a second grasp that is not possible is refused before the first arm moves. Pure.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import msgspec
from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.programs.extension_names import PARTNER
from rtc.programs.schema import PlanLine, ScriptFile
from rtc.protocol.advice import Texts, fill_in
from rtc.protocol.messages import Binding, Step, WorldChange
from rtc.protocol.outcomes import Refusal, Refused
from rtc.spatial import geometry
from workers.elaborator import backtrack
from workers.elaborator.backtrack import Planned
from workers.elaborator.figures import of_partner
from workers.mechanisms import joined
from workers.planning import in_seat
from workers.planning.segments import BOTH
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import Changes
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import let_go

#: effect of a step -> what it changes for the steps and sentences after it
FORESEEN = joined(lambda mechanism: mechanism.foreseen)


def plan(script: ScriptFile, steps: Sequence[Step], candidate: TaskCandidate) -> Planned:
    """As `backtrack.plan`, for steps of one arm or of two in turn. Raises Refused."""
    stages = list(_stages(script, steps))
    if len(stages) == 1:
        found = backtrack.plan(script, steps, candidate)
        joint = any(step.space == BOTH for step in steps)  # `end` is that of one of two arms
        return found if joint else msgspec.structs.replace(found, changes=_predicted(steps, candidate, found))
    query, whole = candidate.query, Planned.nothing()
    for first, part in stages:
        part_steps = steps[first : first + len(part.steps)]
        now = _seen_by(part, candidate, query)
        try:
            found = backtrack.plan(part, part_steps, now)
        except Refused as refused:
            raise Refused(_of_stage(refused.refusal, candidate, now.arm.name)) from None
        query = query.after(_predicted(part_steps, now, found))
        ways = found.ways if not first else {}  # a later one begins where the arm will come to rest
        whole = Planned(
            {**whole.bindings, **_of_arm(now.arm.name, found.bindings)},
            list(dict.fromkeys((*whole.relies_on, *found.relies_on))),
            [*whole.notes, *(f"{now.arm.name}: {note}" for note in found.notes)],
            whole.chosen or found.chosen,
            {**whole.ways, **ways},
            list(dict.fromkeys((*whole.doubtful, *found.doubtful))),
            found.end,
        )
    return whole


def _of_arm(arm: str, bindings: Mapping[str, Binding]) -> dict[str, Binding]:
    """The bindings with their arm: no other one solves them again after a look."""
    return {name: msgspec.structs.replace(one, arm=arm) for name, one in bindings.items()}


def _of_stage(refusal: Refusal, candidate: TaskCandidate, arm: str) -> Refusal:
    """The refusal with its arm. An arm of the command itself does not leave the way: it holds the object elsewhere."""
    message = f"{arm}, {refusal.message}" if refusal.figures() else refusal.message
    refusal = msgspec.structs.replace(refusal, message=message)
    if refusal.in_the_way not in (candidate.arm.name, candidate.partner and candidate.partner.name):
        return refusal
    rows, thing = candidate.program.needs, candidate.body
    texts: Texts = {
        "let_go": let_go(rows, candidate.query, thing),
        "hand": hand_in_words(candidate.arm.name),
    }
    depth_m = max((seat.depth_m for seat in candidate.query.cell.seats), default=0.0)
    free_cm = f"{math.ceil(100.0 * (depth_m + in_seat.SPARE_M) - 0.05)}"
    clears = fill_in(rows.get("other_grasp", []), {**texts, "free_cm": free_cm, **candidate.texts})
    return msgspec.structs.replace(refusal, clears=clears, in_the_way="")


def _stages(script: ScriptFile, steps: Sequence[Step]) -> Iterator[tuple[int, ScriptFile]]:
    """The runs of steps of one arm, as scripts with the lines of the plan that they need, and their first index."""
    numbered = list(enumerate(script.steps))
    whole = all(not step.arm for step in steps)
    groups = [numbered] if whole else [list(g) for _, g in itertools.groupby(numbered, lambda one: steps[one[0]].arm)]
    for group in groups:
        own = [step for _, step in group]
        lines = script.plan if whole else _needed(script.plan, [step.to for step in own])
        yield group[0][0], msgspec.structs.replace(script, steps=own, plan=lines)


def _needed(plan: Sequence[PlanLine], names: Iterable[str]) -> list[PlanLine]:
    """The lines of these names, and those that they are computed from, in the order of the plan."""
    known, wanted, open_ = {line.name: line for line in plan}, set(), list(names)
    while open_:
        name = open_.pop()
        if name in known and name not in wanted:
            wanted.add(name)
            open_ += [known[name].at, known[name].near]
    return [line for line in plan if line.name in wanted]


def _seen_by(part: ScriptFile, candidate: TaskCandidate, query: WorldQuery) -> TaskCandidate:
    """The candidate as the arm of these steps sees it in this world; the other arm takes part in a common motion."""
    now = replace(candidate, query=query)
    now = of_partner(now) if any(step.who == PARTNER for step in part.steps) else now
    if not any(step.to in now.vias or "through" in step.words for step in part.steps):
        now = replace(now, parsed=msgspec.structs.replace(now.parsed, through=[]))
    return now if any(step.space == BOTH for step in part.steps) else replace(now, partner=None)


# --- the world after a run of steps ----------------------------------------------------------------------


def _predicted(steps: Sequence[Step], candidate: TaskCandidate, found: Planned) -> Changes:
    query, arm = candidate.query, candidate.arm.name
    changes: Changes = []
    if found.end is not None:
        changes.append(WorldChange(key=f"{arm}.joints", value=[float(q) for q in found.end]))
        held = query.holding(arm)
        keeps = held and query.held_by(held) == arm and not any(step.op == "open" for step in steps)
        frame = query.in_hand(held, query.model.arms[arm].fk(found.end)) if keeps else None
        if frame is not None:
            changes.append(WorldChange(key=f"{held}.frame", value=geometry.normalise(frame).tolist()))
    for step in steps:
        if effect := FORESEEN.get(step.effect):
            changes += effect(candidate, query.after(changes))
        if step.leaves_seat and (held := query.holding(arm)):
            changes.append(WorldChange(key=f"{held}.seat", value=""))
    return changes
