"""Objects with a hinge in a script: figures, the anchor on the hinge, a stated angle, and what is refused. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rtc.model.cells import parts
from rtc.programs import expressions
from rtc.programs.schema import ElaboratorProgram, ScriptFile, ScriptStep
from rtc.protocol import causes
from rtc.protocol.advice import by_person, fill_in
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry, hinges
from workers.conditions import reflexes
from workers.mechanisms.hinges.advice import SHARE_OF_RANGE
from workers.mechanisms.mechanism import Thing
from workers.planning.world_query import WorldQuery
from workers.tasks.anchor import Anchor, refused
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import UnmetPrecondition

SPACE = "move_circle"  # of a step that turns an object about its hinge
SLACK_RAD = 0.1  # a compliant hand is commanded beyond the angle that it reaches
MIN_RAD = math.radians(0.1)  # minimum turn; the angle of a door is not known better


def figures(candidate: TaskCandidate) -> dict[str, float]:
    """Whether the object has a hinge, its angle and stops, and how its grasp point moves when it turns."""
    thing, between = candidate.thing, candidate.between
    if thing is None or thing.hinge is None:
        return {} if thing is None else {"hinged": 0.0}
    least, most = thing.hinge.range_rad
    found = {"hinge_rad": candidate.query.angle(thing.name), "hinge_least_rad": least, "hinge_most_rad": most}
    if between is not None:
        arc = np.cross(thing.hinge.axis, between.frame.xyz)  # way of the grasp point per radian, object's axes
        away = float(arc @ geometry.rotate(between.frame.pose, (0.0, 0.0, 1.0)))
        found |= {"hinge_lever_m": float(np.linalg.norm(arc)), "hinge_push": math.copysign(1.0, away)}
    return {"hinged": 1.0, **found}


def object_hinged(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The object has a hinge."""
    thing = candidate.thing
    assert thing is not None
    return None if thing.hinge is not None else UnmetPrecondition(f"{thing.name} has no hinge", thing.name)


def hinge(candidate: TaskCandidate) -> Anchor:
    """A pose on the hinge of the object, in the object's frame: its z is the axis."""
    assert candidate.thing is not None
    name, its = candidate.thing.name, candidate.thing.hinge
    if its is None:
        raise refused(f"{name} has no hinge", "an object that has a hinge")
    pose = hinges.frame(geometry.IDENTITY, its.axis).tolist()
    return Anchor(pose=pose, frame=name, relies_on=(f"{name}.frame", f"{name}.angle"))


def stated_angle(_: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """The pose of an object with a hinge at this angle."""
    its = thing.hinge if isinstance(thing, parts.Object) else None
    if its is None:
        raise Refused.because(RefusalReason.STATE, f"{thing.name} has no hinge", clears="an object with one")
    least, most = its.range_rad
    if not least <= values[0] <= most:
        between = "from {:g} to {:g} deg".format(*its.range_deg)
        message = f"{thing.name} turns {between}, not to {math.degrees(values[0]):g} deg"
        cause = causes.BeyondStop(value_rad=values[0], least_rad=least, most_rad=most)
        raise Refused.because(RefusalReason.INFEASIBLE, message, clears=f"an angle {between}", cause=cause)
    return {f"{thing.name}.frame": hinges.turned(query.hinge_home(thing.name), its.axis, values[0]).tolist()}


def strains(steps: Sequence[ScriptStep], candidate: TaskCandidate) -> bool:
    """Whether these steps would move a held object with a hinge otherwise than about it."""
    hinged = candidate.thing is not None and candidate.thing.hinge is not None
    return hinged and steps[0].op != "open" and any(step.space == "move_task" for step in steps)


def refuse_other_motion(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a script that moves the arm while its hand holds another object, which has a hinge."""
    held = candidate.query.holding(candidate.hand.name) if candidate.hand else ""
    if not held or candidate.query.hinge(held) is None or not any(step.to for step in script.steps):
        return
    if candidate.thing is not None and candidate.thing.name == held:
        return
    clears = fill_in(candidate.program.needs.get("hinge_held", []), {"held": held})
    message = f"{candidate.arm.name} holds {held}, which only turns about its hinge"
    cause = causes.NeedUnmet(need="hinge_held", by=held)
    raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=cause)


def refuse_turn_of_hand(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a TURN condition if the hand keeps its attitude in all motions of the script.

    TURN of a joint is accepted.
    """
    moves = [step for step in script.steps if step.do == "move"]
    if not moves or not all(step.space == SPACE and step.args.get("hand_turn") == 0.0 for step in moves):
        return
    parsed = candidate.parsed
    turn = next(
        (c for c in parsed.conditions if c.measure == "TURN" and not (c.along or "").startswith(reflexes.JOINT)), None
    )
    if turn is None:
        return
    raise Refused.because(
        RefusalReason.NO_SCRIPT,
        f"{turn.words}: TURN is the turn of the hand, which keeps its attitude on this path",
        where="TURN",
        clears=f"{parsed.verb} {candidate.body} BY 30 DEG, or the angle at which it should stop, without {turn.words}",
    )


def refuse_beyond_stops(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a step that turns the object of the command beyond a stop of its hinge, or by no angle."""
    thing = candidate.thing
    if thing is None or thing.hinge is None:
        return
    least, most = thing.hinge.range_rad
    start = angle = candidate.query.angle(thing.name)
    for step in script.steps:
        if step.space != SPACE:
            continue
        turn, ends = _turn(step, candidate, thing.name)
        if abs(turn) < MIN_RAD:
            raise _there(candidate, thing.name, angle)
        before, angle = angle, angle + turn
        if not least - SLACK_RAD <= angle <= most + SLACK_RAD:
            wanted = before + math.copysign(min(abs(turn), ends), turn)  # without the lag of a compliant hand
            raise _beyond(candidate, thing.hinge, wanted, start)


def _turn(step: ScriptStep, candidate: TaskCandidate, thing: str) -> tuple[float, float]:
    """The turn that a step commands, and that at which it ends (rad)."""
    try:
        turn = expressions.number(step.args.get("by_rad", 0.0), candidate.figures)
        return turn, expressions.number(step.args.get("turn_rad", math.inf), candidate.figures)
    except expressions.ExpressionError:
        message = f"{candidate.parsed.verb} {thing}: an angle is wanted"
        clears = "an amount in DEG or RAD"
        raise Refused.because(RefusalReason.SENTENCE, message, clears=clears) from None


def _there(candidate: TaskCandidate, thing: str, angle: float) -> Refused:
    at = f"{round(math.degrees(angle), 2) + 0.0:g} deg"
    clears = fill_in(candidate.program.needs.get("hinge_there", []), {"at": at.upper(), "held": thing})
    message = f"{thing} is at {at}: nothing to turn"
    cause = causes.NeedUnmet(need="hinge_there", by=thing)
    return Refused.because(RefusalReason.STATE, message, clears=clears, cause=cause)


def _beyond(candidate: TaskCandidate, hinge: parts.Hinge, wanted: float, now: float) -> Refused:
    """The refusal to turn the object to `wanted` (rad), beyond a stop."""
    least, most = hinge.range_rad
    thing = candidate.body
    row = candidate.program.needs.get("hinge_shut" if wanted < least else "hinge_far", [])
    turn = fill_in(row, {"far": f"{SHARE_OF_RANGE * math.degrees(most):.0f}", "held": thing})
    angles = f"an angle from {math.degrees(least):g} to {math.degrees(most):g} deg"
    return Refused.because(
        RefusalReason.INFEASIBLE,
        (
            f"{thing} turns from {math.degrees(least):g} deg to {math.degrees(most):g} deg, "
            f"and not to {math.degrees(wanted):.4g} deg; it is at {round(math.degrees(now), 2) + 0.0:g} deg"
        ),
        clears=[*turn, *by_person(angles)],
        cause=causes.BeyondStop(value_rad=wanted, least_rad=least, most_rad=most),
    )
