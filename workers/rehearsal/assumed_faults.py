"""Faults on paper: each step of a rehearsal ends with another stop reason, and what follows is performed (N9). Pure.

The report is that of an arm stopped on half of its way, of a hand that closes on nothing, or of a camera that sees
nothing. The analyzer judges it as it would a real one.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from rtc.protocol.messages import BoundStep, EndReport
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.protocol.primitive import HandMotion, JointTrajectory, Look
from rtc.protocol.rehearsal import FaultBranch
from rtc.protocol.spelling import unknown
from workers.planning.world_query import WorldQuery
from workers.rehearsal.performance import BoundPrimitive, Performance, copied
from workers.rehearsal.predicted_report import end_report

EACH = "FAULTS"
#: stop reasons of a motion that its F need not name: the MCM adds their conditions, or does not begin
OF_ARMS = (StopReason.ARM_CONTACT, StopReason.OVERSPEED, StopReason.FOLLOWING_ERROR, StopReason.REFUSED)
#: of a process, not of the step; only on request
FROM_OUTSIDE = (StopReason.SUBSYSTEM_LOST,)
WHY = "assumed in a test"


def branches(done: Performance, assuming: str) -> list[FaultBranch]:
    """A branch for each step and each stop reason, or for the one that the sentence names. Raises Refused: no step can
    end with it."""
    wanted = None if assuming == EACH else _reason(assuming)
    found = [
        _branch(done, moment, reason)
        for moment in done.moments
        for reason in _reasons(moment.bound, wanted)
        if wanted in (None, reason)
    ]
    if not found and wanted is not None and done.moments:
        possible = {reason for moment in done.moments for reason in _reasons(moment.bound, wanted=None)}
        raise Refused.because(
            RefusalReason.NAME,
            f"no step of this sentence can end with {assuming}",
            where=assuming,
            expected=[_word(reason) for reason in StopReason if reason in possible],
            clears=f"ASSUMING one of those, or {EACH} for each",
        )
    return found


def _word(reason: StopReason) -> str:
    return reason.value.upper().replace("_", "-")


def _reason(word: str) -> StopReason:
    known = {_word(reason): reason for reason in StopReason}
    if word not in known:
        message = unknown("stop reason", word, known)
        raise Refused.because(RefusalReason.NAME, message, where=word, expected=[*known, EACH], clears="one of these")
    return known[word]


def _reasons(bound: BoundStep, wanted: StopReason | None) -> Iterator[StopReason]:
    """The stop reasons with which this step can end, other than expected."""
    made, evaluation = bound.primitive, bound.evaluation
    assert made is not None
    assert evaluation is not None
    possible = {stop.reason for stop in made.stop_functions}
    possible |= {StopReason.REFUSED} if isinstance(made.trajectory, Look) else set(OF_ARMS)
    if wanted in FROM_OUTSIDE:
        possible.add(wanted)
    if evaluation.no_contact_is_failure or _closes(bound):
        possible.add(StopReason.NO_CONTACT)
    expected = {*evaluation.step.expect, StopReason.GOAL}
    yield from (reason for reason in StopReason if reason in possible - expected)


def _closes(bound: BoundStep) -> bool:
    """Whether the step succeeds only with something between the fingers."""
    made, evaluation = bound.primitive, bound.evaluation
    assert made is not None
    least_m = evaluation.width_m[0] if evaluation is not None and evaluation.width_m else 0.0
    return isinstance(made.trajectory, HandMotion) and least_m > made.trajectory.width_m


def _report(query: WorldQuery, bound: BoundStep, now_s: float, reason: StopReason) -> EndReport:
    """The report of a step that ends with this reason; the absence of a touch is seen at its goal."""
    if reason is not StopReason.NO_CONTACT:
        return msgspec.structs.replace(end_report(query, bound, now_s, reason), message=WHY)
    made = bound.primitive
    assert made is not None
    report = end_report(query, bound, now_s, StopReason.GOAL)
    if isinstance(made.trajectory, HandMotion):
        report = msgspec.structs.replace(report, hand_width_m=made.trajectory.width_m, hand_force_n=0.0)
    at_goal = isinstance(made.trajectory, JointTrajectory | HandMotion)
    return report if at_goal else msgspec.structs.replace(report, reason=reason)


def _branch(done: Performance, moment: BoundPrimitive, reason: StopReason) -> FaultBranch:
    """What follows, as far as the step after the one that failed."""
    paper = Performance(
        programs=done.programs,
        model=done.model,
        world=moment.world,
        now_s=moment.now_s,
        command=done.command,
        script=done.script,
        actions=copied(moment.actions),
        rigid=done.rigid,
        pictures=done.pictures,
    )
    actions = paper.actions
    assert actions is not None
    step, left, used = paper.step, len(actions.refs), len(actions.trim_labels)
    try:
        judged = paper.judge(moment.bound, _report(paper.query(), moment.bound, moment.now_s, reason))
        if judged.verdict != "continue":
            after = paper.follow(judged)
            paper.go_on(left if after in ("retry_step", "restart_script", "skip") else 0)
    except Refused as refused:
        problem = refused.refusal
        return FaultBranch(
            step=step,
            reason=reason.value,
            trims=[*actions.trim_labels[used:]],
            message=problem.message,
            clears=problem.clears,
        )
    return FaultBranch(step=step, reason=reason.value, trims=[*actions.trim_labels[used:]], recovered=True)
