"""Checks of a script for a candidate before it is planned: the sentence, the world, and facts in doubt. Pure."""

from __future__ import annotations

from collections.abc import Callable

from rtc.programs.schema import ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import fill_in
from rtc.protocol.messages import Step
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.world.spread import in_words
from workers.conditions import reflexes
from workers.elaborator import preconditions
from workers.elaborator.backtrack import can_be_seen
from workers.elaborator.script_options import holds
from workers.mechanisms import MECHANISMS
from workers.planning import trust
from workers.planning.scenes import clearance_of
from workers.tasks import anchor, command_fields
from workers.tasks.candidate import TaskCandidate


def _refuse_too_tight(_: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a grip force that the hand does not have, before any motion."""
    grip_n, arm = candidate.limits.grip_force_n, candidate.hand
    if grip_n is None or arm is None or grip_n <= arm.gripper.max_force_n:
        return
    most_n = arm.gripper.max_force_n
    raise Refused.because(
        RefusalReason.INFEASIBLE,
        f"GRIP-FORCE {grip_n:g} N is asked for; {arm.end_effector} grips with {most_n:g} N at most",
        clears=f"GRIP-FORCE of at most {most_n:g} N",
        cause=causes.GripForceExceeded(value_n=grip_n, limit_n=most_n, arm=arm.name),
    )


def _refuse_nothing_held(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a condition about a held object that can never become true."""
    if candidate.hand is None:
        return
    parsed, arm = candidate.parsed, candidate.hand.name
    holding, closes = bool(candidate.query.holding(arm)), any(step.op == "close" for step in script.steps)
    for condition in parsed.conditions:
        reflexes.refuse_without_grip(condition, arm, holding, closes)


def _refuse_unmet(script: ScriptFile, candidate: TaskCandidate) -> None:
    preconditions.refuse_if_done(script, candidate)
    for need in script.needs:
        preconditions.refuse_if_unmet(need, candidate)


def _refuse_unknown_place(_: ScriptFile, candidate: TaskCandidate) -> None:
    if (place := candidate.parsed.place) is not None and place.name:
        anchor.place(candidate.query, place.name)


def _refuse_unsure_grasp(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move a held object whose grasp is suspect (R151), and that no camera can sense before."""
    unsure = why_unsure_grasp(script, candidate)
    if unsure is not None and not can_be_seen(unsure.where, candidate):
        raise Refused(unsure)


def _refuse_unsure_place(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a script for which the pose of the object is too uncertain, and that no camera finds before."""
    unplaced = why_unsure_place(script, candidate)
    if unplaced is not None and not candidate.query.finds(candidate.body):
        raise Refused(unplaced)


def why_unsure_grasp(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal to move a held object whose grasp is suspect; None if it is not.

    Scripts that move only the fingers are allowed, and scripts with `despite_grasp`: backing off and letting go.
    """
    held = candidate.query.holding(candidate.hand.name) if candidate.hand else ""
    if not held or script.despite_grasp or not any(step.to for step in script.steps):
        return None
    return trust.distrusted(candidate.query, f"{held}.grasp", candidate.program.clears)


def a_look_makes_room(refusal: Refusal, script: ScriptFile, candidate: TaskCandidate) -> bool:
    """Whether the held object lacks room on its way only because its pose in the hand is uncertain, and a camera can
    see it before."""
    held = candidate.query.holding(candidate.hand.name) if candidate.hand else ""
    cause = refusal.cause
    if not held or script.despite_grasp or not isinstance(cause, causes.Collides) or held not in cause.owners:
        return False
    query, key = candidate.query, f"{held}.grasp"
    # as much as by the last look, if there was one
    narrower_m = trust.off_m(query, held, query.spread(key)) - trust.seen_within_m(query, held)
    room = cause.distance_m >= max(clearance_of(candidate.limits), cause.margin_m - narrower_m)
    return room and can_be_seen(key, candidate)


def why_unsure_place(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal of a script for which the pose of the object is too uncertain; None if it is certain enough."""
    if script.unsure_if is None or candidate.thing is None or not holds(script.unsure_if, candidate):
        return None
    name, query, clears = candidate.thing.name, candidate.query, candidate.program.clears
    spread = in_words(query.spread(f"{name}.frame"))
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"{name} is known within {spread} only, and no camera finds it: too uncertain for {script.script}",
        where=f"{name}.frame",
        clears=fill_in(clears.get("spread", []), {"location": name}),
        cause=causes.TooUncertain(fact=f"{name}.frame"),
    )


def why_uncertain(steps: list[Step], candidate: TaskCandidate) -> Refusal | None:
    """The refusal of a script if the held object will be too uncertain for one of its steps when that step begins."""
    if candidate.hand is None or not candidate.query.holding(candidate.hand.name):
        return None
    query, ahead_s = candidate.query, 0.0
    motion_s = trust.motion_time_s(query, candidate.limits)
    for step in steps:
        if step.arm:  # of the second arm, whose hand is empty
            continue
        lacks = trust.why_uncertain(query, candidate.arm.name, step, candidate.program.clears, ahead_s)
        if lacks is not None:
            return lacks
        ahead_s += motion_s if step.do == "move" else 0.0
    return None


#: The order of the checks of an option; the first one that fails is the reason. What is wrong with the sentence comes
#: first, then what the state of the world does not allow, then what is in doubt.
CHECKS: tuple[Callable[[ScriptFile, TaskCandidate], None], ...] = (
    command_fields.refuse_without_effect,
    _refuse_too_tight,
    _refuse_nothing_held,
    _refuse_unmet,
    _refuse_unknown_place,
    *(check for mechanism in MECHANISMS for check in mechanism.checks),
    _refuse_unsure_grasp,
    _refuse_unsure_place,
)
