"""Checks of a script for a candidate before it is planned: the sentence, the world, and facts in doubt. Pure."""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.programs.schema import ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import Texts, fill_in
from rtc.protocol.messages import Step, Validity, WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.world.spread import EXACT, in_words
from workers.conditions import reflexes
from workers.elaborator.backtrack import can_be_seen
from workers.elaborator.script_options import holds
from workers.mechanisms import each, joined
from workers.planning import trust
from workers.planning.scenes import clearance_of
from workers.tasks import anchor, command_fields
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import let_go

NEEDS = joined(lambda mechanism: mechanism.needs)  # preconditions of scripts by name
DONE = each(lambda mechanism: mechanism.done)


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


def _refuse_done(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a sentence whose end is so before it begins, as that of a task that was halted while its hand backed off.

    What precedes in the script would be refused with advice that undoes the task: to take again what was put down."""
    thing = candidate.thing
    if thing is None or candidate.hand is None or not candidate.query.trusts(f"{thing.name}.held_by"):
        return
    for message, row in filter(None, (done(script, candidate) for done in DONE)):
        texts = {"hand": hand_in_words(candidate.arm.name), "place": [place.name for place in candidate.query.places]}
        clears = fill_in(candidate.program.needs.get(row, []), {**texts, **candidate.texts})
        raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=causes.AlreadyDone(object=thing.name))


def _refuse_unmet(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse the first unmet precondition, with the sentence that establishes it."""
    unmet = ((need, lack) for need in script.needs if (lack := NEEDS[need](candidate)) is not None)
    if (first := next(unmet, None)) is None:
        return
    need, lack = first
    rows = candidate.program.needs
    thing = lack.thing or lack.held
    row = lack.row or need
    if candidate.parsed.hand and f"{row}_by" in rows:  # with the hand of the sentence first
        row = f"{row}_by"
    texts: Texts = {"let_go": let_go(rows, candidate.query, thing), "hand": hand_in_words(candidate.arm.name)}
    clears = fill_in(rows.get(row, []), {**texts, **candidate.texts, "held": lack.held})
    doubt = (
        trust.distrusted(candidate.query, f"{candidate.thing.name}.held_by", {})
        if candidate.thing is not None
        else None
    )
    message = lack.message + (f", but {doubt.message}" if doubt else "")
    cause = causes.NeedUnmet(need=lack.row or need, by=lack.held, doubt=doubt.where if doubt else "")
    raise Refused.because(RefusalReason.STATE, message, clears=clears, cause=cause)


def _refuse_unknown_place(_: ScriptFile, candidate: TaskCandidate) -> None:
    if (place := candidate.parsed.place) is not None and place.name:
        anchor.place(candidate.query, place.name)


def _refuse_unsure(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move a held object whose grasp is suspect (R151), and a script for which the pose of the object is too
    uncertain; but not what a camera senses before."""
    grasp = why_unsure_grasp(script, candidate)
    if grasp is not None and not can_be_seen(grasp.where, candidate):
        raise Refused(grasp)
    place = why_unsure_place(script, candidate)
    if place is not None and not candidate.query.finds(candidate.body):
        raise Refused(place)


def why_unsure_grasp(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal to move a held object whose grasp is suspect; None if it is not.

    Scripts that move only the fingers are allowed, and scripts with `despite_grasp`: backing off and letting go.
    """
    held = candidate.query.holding(candidate.hand.name) if candidate.hand else ""
    if not held or script.despite_grasp or not any(step.to for step in script.steps):
        return None
    return trust.distrusted(candidate.query, f"{held}.grasp", candidate.program.clears)


def after_a_look(candidate: TaskCandidate) -> TaskCandidate | None:
    """The candidate after a camera has seen what its hand holds: as well known as by the last look from there, without
    one exactly. None: it holds nothing that a camera can see."""
    query = candidate.query
    held = query.holding(candidate.hand.name) if candidate.hand else ""
    key = f"{held}.grasp"
    if not held or not can_be_seen(key, candidate):
        return None
    spread = trust.last_look(query, held) or [*EXACT]
    seen = WorldChange(key=key, keep_value=True, validity=Validity.VALID, spread=spread)
    return replace(candidate, query=query.after([seen]))


def a_look_makes_room(refusal: Refusal, script: ScriptFile, candidate: TaskCandidate) -> bool:
    """Whether the held object lacks room on its way only because its pose in the hand is uncertain."""
    held = candidate.query.holding(candidate.hand.name) if candidate.hand else ""
    cause = refusal.cause
    if not held or script.despite_grasp or not isinstance(cause, causes.Collides) or held not in cause.owners:
        return False
    return cause.distance_m >= clearance_of(candidate.limits)


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
        ahead_s += motion_s if step.to else 0.0
    return None


#: The order of the checks of an option; the first one that fails is the reason. What is wrong with the sentence comes
#: first, then what the state of the world does not allow, then what is in doubt.
CHECKS: tuple[Callable[[ScriptFile, TaskCandidate], None], ...] = (
    command_fields.refuse_without_effect,
    _refuse_too_tight,
    _refuse_nothing_held,
    _refuse_done,
    _refuse_unmet,
    _refuse_unknown_place,
    *(check for checks in each(lambda mechanism: mechanism.checks) for check in checks),
    _refuse_unsure,
)
