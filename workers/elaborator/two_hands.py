"""Commands about an object that two hands hold: the arms of BOTH-ARMS, and refusals to move one of them alone. Pure."""

from __future__ import annotations

from rtc.language.hands import hand_in_words
from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand
from workers.conditions import sharing
from workers.elaborator.task_candidate import TaskCandidate
from workers.planning import shared_hold
from workers.planning.world_query import WorldQuery


def both_arms(program: ElaboratorProgram, parsed: ParsedCommand, query: WorldQuery) -> parts.Arm:
    """The leading arm of two that hold one object: the one that the facts of the object refer to. Raises Refused."""
    rows = program.decision_tree
    able = [row.verb for row in rows if any(check.equals.get("hand") == BOTH_ARMS for check in row.when)]
    if parsed.verb not in able:
        message = f"{parsed.verb} has no script for two arms"
        clears = f"name one arm; {', '.join(dict.fromkeys(able))} can take {BOTH_ARMS}"
        raise Refused.because(RefusalReason.NO_SCRIPT, message, clears=clears)
    if any(reflex.action != "stop" for reflex in parsed.reflexes):
        message = f"{BOTH_ARMS} can only stop when an UNLESS becomes true: another reflex would pull at the object"
        raise Refused.because(RefusalReason.NO_SCRIPT, message, clears="THEN STOP")
    sharing = [arm for arm in query.cell.arms if query.sharers(arm.name)]
    leading = next((arm for arm in sharing if query.held_by(query.holding(arm.name)) == arm.name), None)
    if leading is None:
        raise _unshared(program, query)
    return leading


def _unshared(program: ElaboratorProgram, query: WorldQuery) -> Refused:
    """The refusal of BOTH-ARMS without a common object; it states the sentence that makes the second hand take it."""
    held = {arm.name: query.holding(arm.name) for arm in query.cell.arms}
    message = f"{BOTH_ARMS} must hold one object; " + ", ".join(
        f"{arm} holds {thing or 'nothing'}" for arm, thing in held.items()
    )
    clears = program.needs.get("both_hands", "")
    first = next((thing for thing in held.values() if thing), "")
    empty = next((arm for arm in query.cell.arms if not held[arm.name]), None)
    free = shared_hold.free_points(query, first) if first else []
    if free and empty is not None:
        clears = program.needs.get("second_hand", "").replace("{held}", first).replace("{free}", free[0])
        clears = clears.replace("{hand}", hand_in_words(empty.name))
    return Refused.because(RefusalReason.STATE, message, clears=clears)


def partner(query: WorldQuery, arm: parts.Arm) -> parts.Arm | None:
    """The second arm that holds the object of this one; None if there is none."""
    return next((query.cell.arm(name) for name in query.sharers(arm.name)), None)


def free_points(
    query: WorldQuery, parsed: ParsedCommand, thing: parts.Object | None, points: list[parts.GraspPoint | None]
) -> list[parts.GraspPoint | None]:
    """The grasp points where no hand holds the object, unless there are none or the sentence names one."""
    if thing is None or parsed.grasp_point is not None:
        return points
    free = shared_hold.free_points(query, thing.name)
    return [point for point in points if point is None or point.name in free] or points


def lets_go_first(script: ScriptFile) -> bool:
    """Whether the hand of the script opens before the arm moves."""
    return next((step.op == "open" for step in script.steps if step.op or step.to), False)


def refuse_moving_alone(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move one arm whose object another arm holds too. An arm that lets go of it first may move."""
    if candidate.hand is None or lets_go_first(script) or not any(step.to for step in script.steps):
        return
    second = candidate.partner.name if candidate.partner else ""
    sharing.refuse_alone(candidate.query, candidate.arm.name, second, candidate.program.clears)
