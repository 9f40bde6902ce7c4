"""Refusals about a held object with a hinge: its hand turns it between the stops, or lets it go. Pure."""

from __future__ import annotations

import math

from rtc.programs import expressions
from rtc.programs.schema import ScriptFile
from rtc.protocol.outcomes import Refusal, RefusalReason
from workers.conditions import reflexes
from workers.elaborator.task_candidate import TaskCandidate

SPACE = "move_circle"  # of a step that turns an object about its hinge
SLACK_RAD = 0.1  # a compliant hand is commanded beyond the angle that it reaches
MIN_RAD = math.radians(0.1)  # minimum turn; the angle of a door is not known better


def refuse_other_motion(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal if the script moves the arm while its hand holds another object, which has a hinge."""
    held = candidate.query.holding(candidate.arm.name)
    if not held or candidate.query.hinge(held) is None or not any(step.to for step in script.steps):
        return None
    if candidate.thing is not None and candidate.thing.name == held:
        return None
    clears = candidate.program.needs.get("hinge_held", "").replace("{held}", held)
    message = f"{candidate.arm.name} holds {held}, which only turns about its hinge"
    return Refusal(reason=RefusalReason.STATE, message=message, clears=clears)


def refuse_turn_of_hand(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal of a TURN condition if the hand keeps its attitude in all motions of the script.

    TURN of a joint is accepted.
    """
    moves = [step for step in script.steps if step.do == "move"]
    if not moves or not all(step.space == SPACE and step.args.get("hand_turn") == 0.0 for step in moves):
        return None
    parsed = candidate.parsed
    asked = [item.condition for item in parsed.reflexes] + (parsed.report.when if parsed.report else [])
    turn = next((c for c in asked if c.measure == "TURN" and not (c.along or "").startswith(reflexes.JOINT)), None)
    if turn is None:
        return None
    return Refusal(
        reason=RefusalReason.NO_SCRIPT,
        message=f"{turn.words}: TURN is the turn of the hand, which keeps its attitude on this path",
        where="TURN",
        clears=f"{parsed.verb} {candidate.body} BY the angle at which it should stop; or leave out {turn.words}",
    )


def refuse_beyond_stops(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal if a step turns the object of the command beyond a stop of its hinge, or by no angle."""
    thing = candidate.thing
    if thing is None or thing.hinge is None:
        return None
    least, most = thing.hinge.range_rad
    angle = candidate.query.angle(thing.name)
    for step in script.steps:
        if step.space != SPACE:
            continue
        try:
            turn = expressions.number(step.args.get("by_rad", 0.0), candidate.figures)
            ends = expressions.number(step.args.get("turn_rad", math.inf), candidate.figures)
        except expressions.ExpressionError:
            return Refusal(
                reason=RefusalReason.SENTENCE,
                message=f"{candidate.parsed.verb} {thing.name}: an angle is wanted",
                clears="an amount in DEG or RAD",
            )
        if abs(turn) < MIN_RAD:
            at = f"{math.degrees(angle):g} deg"
            clears = candidate.program.needs.get("hinge_there", "")
            return Refusal(
                reason=RefusalReason.STATE,
                message=f"{thing.name} is at {at}: nothing to turn",
                clears=clears.replace("{at}", at).replace("{held}", thing.name),
            )
        before, angle = angle, angle + turn
        if not least - SLACK_RAD <= angle <= most + SLACK_RAD:
            now = math.degrees(candidate.query.angle(thing.name))
            wanted = before + math.copysign(min(abs(turn), ends), turn)  # without the lag of a compliant hand
            return Refusal(
                reason=RefusalReason.INFEASIBLE,
                message=f"{thing.name} turns from {math.degrees(least):g} deg to {math.degrees(most):g} deg, "
                f"and not to {math.degrees(wanted):.4g} deg; it is at {now:.4g} deg",
                clears=f"an angle from {math.degrees(least):g} to {math.degrees(most):g} deg",
                detail={"cause": "stop", "value_rad": wanted, "least_rad": least, "most_rad": most},
            )
    return None
