"""Answers in words, to sentences that ask: what is, and what a name means. Pure.

A step `do: answer` has its answer made here, by the `name` of the step: `state` is what the world has of a name,
`meaning` what the programs and the cell say of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from rtc.language import dictionary
from rtc.model.cells import parts, taught
from rtc.programs.schema import ElaboratorProgram, ScriptFile, ScriptPiece
from rtc.protocol.messages import Fact, Script
from rtc.protocol.sentence import BOTH_ARMS
from rtc.spatial import geometry
from rtc.world import spread
from rtc.world.facts import TRUSTED
from workers.planning import suggestions
from workers.tasks import command_fields, strategies
from workers.tasks.data_sentence import DataSentence

RESOURCES = "RESOURCES"
ENTRY, SCRIPT = "-ENTRY", "-SCRIPT"  # GRASP-ENTRY: the entry of the dictionary; INSERT-SCRIPT: the script


def script(question: DataSentence) -> Script:
    """The script whose only step has the answer. Raises Refused for an unknown name."""
    command_fields.refuse_unused_field(question.parsed, question.file.script, question.file.uses)
    (step,) = question.file.steps
    return question.script(ANSWERS[step.name](question))


# --- what is ---------------------------------------------------------------------------------------------


def state(question: DataSentence) -> str:
    """What the world has of this name now."""
    query, name, cell = question.query, question.name, question.query.cell
    if name == RESOURCES:
        return _resources(question)
    if name == BOTH_ARMS:
        return "; ".join(_arm(question, arm) for arm in cell.arms)
    shown = [_arm(question, arm) for arm in cell.arms if arm.name == name]
    shown += [_object(question, thing) for thing in cell.objects if thing.name == name]
    shown += [_seat(question, seat) for seat in cell.seats if seat.name == name]
    if shown:
        return shown[0]
    own = {
        key: fact
        for key, fact in query.world.facts.items()
        if key.rpartition(".")[0] == name and fact.value is not None  # None: a place that was forgotten
    }
    if own:
        return f"{name}: " + "; ".join(_fact(question, key.rpartition(".")[2], fact) for key, fact in own.items())
    known = [part.name for group in (cell.arms, cell.objects, cell.seats) for part in group]
    raise suggestions.unknown("object, seat or arm", name, [*known, RESOURCES])


def _resources(question: DataSentence) -> str:
    cell, owners = question.query.cell, question.owners
    all_ = [part.name for group in (cell.arms, cell.cameras, cell.objects, cell.seats) for part in group]
    used = [f"{name} by {owners[name]}" for name in all_ if name in owners]
    free = [name for name in all_ if name not in owners]
    return f"in use: {', '.join(used) or 'nothing'}; free: {', '.join(free) or 'nothing'}"


def _fact(question: DataSentence, attribute: str, fact: Fact) -> str:
    """A fact without a meaning of its own, or the posture of a taught place."""
    arm = next((arm for arm in question.query.cell.arms if arm.name == taught.arm_of(attribute)), None)
    says = f"{attribute} {fact.value}" if arm is None else f"{arm.name} with {_joints(arm, fact.value)}"
    return says if fact.validity in TRUSTED else f"{says} (in doubt)"


def _joints(arm: parts.Arm, values: Sequence[float]) -> str:
    slides = [isinstance(value, str) for value in arm.home_deg]
    shown = (f"{x:.3f} m" if slide else f"{math.degrees(x):.1f}" for x, slide in zip(values, slides, strict=True))
    return f"joints {' '.join(shown)} deg"


def _arm(question: DataSentence, arm: parts.Arm) -> str:
    query, name = question.query, arm.name
    doubt = "" if query.trusts(f"{name}.joints") else " (in doubt)"
    where = _pose(query.tcp(name))
    hand = f"{arm.end_effector} is open {1000 * query.hand_width(name):.0f} mm"
    holds = f"holds {query.holding(name)}" if query.holding(name) else "holds nothing"
    coupled = _coupled(question, name)
    return (
        f"{name}: {_joints(arm, query.joints(name))}{doubt}; tcp {where}; {coupled}{hand} and {holds}; "
        f"{_use(question, name)}"
    )


def _coupled(question: DataSentence, arm: str) -> str:
    """What an arm with a coupler has in it; empty: it has no coupler."""
    hand = question.query.hand_planned_with(arm)
    if hand is None:
        return ""
    doubt = "" if question.query.trusts(f"{arm}.hand") else " (in doubt)"
    return f"{hand or 'no hand'} in its coupler{doubt}; "


def _object(question: DataSentence, thing: parts.Object) -> str:
    query, name = question.query, thing.name
    doubt = "" if query.trusts(f"{name}.frame") else ", in doubt"
    known = query.spread(f"{name}.frame")
    within = f", known within {spread.in_words(known)}" if any(known) else ""
    angle = f", open by {math.degrees(query.angle(name)):.1f} deg" if thing.hinge is not None else ""
    inside = f"in {query.seat(name)}" if query.seat(name) else "in no seat"
    held = f"held by {query.held_by(name)}" if query.held_by(name) else "not held"
    held = next((f"in the coupler of {arm.name}" for arm in query.cell.arms if query.hand(arm.name) == name), held)
    return f"{name}: {_pose(query.frame(name))}{angle}{within}{doubt}; {inside}, {held}; {_use(question, name)}"


def _seat(question: DataSentence, seat: parts.Seat) -> str:
    query = question.query
    inside = query.inside(seat.name)
    return f"{seat.name}: {_pose(query.seat_frame(seat.name))}; holds {', '.join(inside) or 'nothing'}"


def _use(question: DataSentence, name: str) -> str:
    return f"in use by {question.owners[name]}" if name in question.owners else "free"


def _pose(pose: geometry.Array) -> str:
    at = " ".join(f"{100 * x:.1f}" for x in pose[:3])
    turned = " ".join(f"{round(float(x), 1) + 0:g}" for x in np.degrees(geometry.to_rpy(pose)))
    return f"at {at} cm, {turned} deg"


# --- what a name means -----------------------------------------------------------------------------------


def meaning(question: DataSentence) -> str:
    """What a script, a piece, an entry of the dictionary or a part of the cell is."""
    program, name, cell = question.program, question.name, question.query.cell
    if name.endswith(ENTRY) and name.removesuffix(ENTRY) in dictionary.verbs():
        return str(dictionary.entry(name.removesuffix(ENTRY)))
    if (found := _script_named(program, name)) is not None:
        return _script(found, program)
    for piece in program.pieces:
        if piece.skill.upper() == name:
            return f"{name} is a piece of AND TRY: {piece.about}; {_steps(piece)}"
    described: dict[str, str] = {}
    described |= {arm.name: _describe_arm(arm) for arm in cell.arms}
    described |= {thing.name: _describe_object(thing) for thing in cell.objects}
    described |= {seat.name: _describe_seat(seat) for seat in cell.seats}
    described |= {place.name: f"a place of {', '.join([*place.poses, *place.joints_deg])}" for place in cell.places}
    described |= {region.name: f"a region of {_sizes(region.size_m)}" for region in cell.regions}
    described |= {
        camera.name: "a camera" + f" in the hand of {camera.arm}" * bool(camera.arm) for camera in cell.cameras
    }
    if name in described:
        return f"{name} is {described[name]}"
    scripts = [f"{one.script.upper()}{SCRIPT}" for one in program.scripts]
    entries = [f"{verb}{ENTRY}" for verb in dictionary.verbs()]
    raise suggestions.unknown("name to describe", name, [*described, *scripts, *entries])


def _script_named(program: ElaboratorProgram, name: str) -> ScriptFile | None:
    """The script of this name; with -SCRIPT, that of a verb too."""
    short = name.removesuffix(SCRIPT)
    scripts = {one.script: one for one in program.scripts}
    if short.lower() in scripts:
        return scripts[short.lower()]
    rows = [row for row in program.decision_tree if strategies.is_strategy(short, row.verb, row.script)]
    if not rows and short != name:
        rows = program.branches.get(short, [])
    return scripts[max(rows, key=lambda row: row.likelihood).script] if rows else None


def _script(found: ScriptFile, program: ElaboratorProgram) -> str:
    kind = "a skill" if found.case > 2 else "an action"
    verbs = dict.fromkeys(row.verb for row in program.decision_tree if row.script == found.script)
    trims = ", ".join(f"{entry.n} {entry.skill} ({entry.then})" for entry in found.trimming_stack)
    needs = f"; needs {', '.join(found.needs)}" if found.needs else ""
    about = f"{found.script} is {kind} (case {found.case}) of {', '.join(verbs) or 'no verb'}: {found.about}"
    return f"{about}{needs}; {_steps(found)}" + (f"; trims: {trims}" if trims else "")


def _steps(found: ScriptFile | ScriptPiece) -> str:
    labels = (re.sub(r"\{(\w+)\}", lambda word: word[1].upper(), step.label) for step in found.steps)
    return "steps: " + ", ".join(f"{n} {label}" for n, label in enumerate(labels, 1))


def _describe_arm(arm: parts.Arm) -> str:
    most_mm, most_n = 1000 * arm.gripper.max_opening_m, arm.gripper.max_force_n
    hand = f"{arm.end_effector} opens to {most_mm:g} mm and grips with {most_n:g} N"
    return f"an arm with {len(arm.joints)} joints that carries {arm.payload_kg:g} kg; {hand}"


def _describe_object(thing: parts.Object) -> str:
    fixed = "fixed, " if thing.fixed else ""
    points = ", ".join(f"{point.name} ({1000 * point.width_m:g} mm)" for point in thing.grasp_points)
    hinge = ""
    if thing.hinge is not None:
        hinge = f"; it turns from {thing.hinge.range_deg[0]:g} to {thing.hinge.range_deg[1]:g} deg"
    return f"a {thing.kind}, {fixed}{thing.mass_kg:g} kg; grasp points: {points or 'none'}{hinge}"


def _describe_seat(seat: parts.Seat) -> str:
    catch = f", with a catch of {seat.detent_n:g} N" if seat.detent_n else ""
    return f"a {seat.kind}, {100 * seat.depth_m:g} cm deep{catch}"


def _sizes(size_m: tuple[float, ...]) -> str:
    return " x ".join(f"{100 * side:g}" for side in size_m) + " cm"


ANSWERS: dict[str, Callable[[DataSentence], str]] = {"state": state, "meaning": meaning}
