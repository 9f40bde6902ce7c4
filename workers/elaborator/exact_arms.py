"""Exact arms neither comply with a force nor turn bolts: a script that needs that is refused before anything moves.
Pure."""

from __future__ import annotations

from collections.abc import Collection

from rtc.protocol import messages as m
from rtc.protocol.causes import ExactArm
from rtc.protocol.messages import Script, ScriptContext, Step
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from workers.planning import segments

SKIP = "skip"  # of a trim: its steps stand in for the refused one
PHYSICS = "arms with physics do (rtc up --mcm bullet)"
#: steps that a stiffness of the sentence makes compliant
BY_SPRING = (m.MoveStep, m.CircleStep, m.PatternStep, m.HoldStep, m.TurnStep)


def refuse(script: Script, rigid: Collection[str]) -> None:
    """Refuse a script with a step that its arm cannot perform, and that no trim replaces. `rigid`: the exact arms."""
    for n, step in enumerate(script.steps, 1):
        arm = step.arm or script.context.arm
        if arm not in rigid:
            continue
        if asked := _asked(script.context, step):  # of each step that could stand in, too
            message = f"{arm} is exact and cannot comply; {PHYSICS}: {asked} asks for it"
            clears = f"leave out {asked}; or {PHYSICS}"
            raise _refused(arm, message, asked, clears)
        lacks = _lacks(step)
        if lacks and not _is_replaced(script, step):
            message = f"{arm} is exact and {lacks}; {PHYSICS}: step {n} needs it ({step.label})"
            raise _refused(arm, message, f"step {n}", PHYSICS)


def _refused(arm: str, message: str, where: str, clears: str) -> Refused:
    return Refused.because(RefusalReason.INFEASIBLE, message, where=where, clears=clears, cause=ExactArm(arm=arm))


def _asked(context: ScriptContext, step: Step) -> str:
    """The words of the sentence that make the arm comply in this step; empty if none do."""
    if context.limits.stiffness_n_m is not None and isinstance(step, BY_SPRING):
        return "MAINTAIN STIFFNESS"
    comply = any(reflex.action == "comply" for reflex in context.reflexes)
    return "THEN COMPLY" if comply and isinstance(step, m.ArmStep) else ""


def _lacks(step: Step) -> str:
    if isinstance(step, m.TurnStep):
        return "turns no bolts"
    complies = step.complies or step.space == segments.BOTH
    return "cannot comply" if complies else ""


def _is_replaced(script: Script, step: Step) -> bool:
    """Whether a trim does something else if the arm refuses the step."""
    fitting = (one for one in script.trims if one.n in step.trims and one.then == SKIP)
    return any(StopReason.REFUSED in one.fits for one in fitting)
