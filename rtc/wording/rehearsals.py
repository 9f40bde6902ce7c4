"""A rehearsal in lines for people: what `rtc test`, `rtc do "TEST ..."` and the shell print."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rtc.protocol.outcomes import StopReason
from rtc.protocol.rehearsal import FaultBranch, Rehearsal, RehearsedStep, Repair
from rtc.protocol.units import in_words


def in_lines(rehearsal: Rehearsal, *, full: bool) -> Iterator[str]:
    """A rehearsal for people. `full`: with its steps, ends and facts."""
    if full:
        yield from map(_step, rehearsal.steps)
        for arm, pose in rehearsal.ends.items():
            held = rehearsal.holding.get(arm)
            yield f"{arm} ends at {_position(pose)}" + (f" and holds {held}" if held else "")
        if rehearsal.resources:
            yield f"resources: {', '.join(rehearsal.resources)}"
    for name, owner in rehearsal.in_use.items():
        yield f"{name} is in use by {owner} now: the sentence would wait"
    if full:
        yield from (f"assumed: {words}" for words in rehearsal.assumes)
    yield from _faults(rehearsal.faults)
    yield from map(_repair, rehearsal.repairs)
    if full and rehearsal.digest:
        yield f"digest {rehearsal.digest}"


def _step(step: RehearsedStep) -> str:
    takes = "until stopped" if step.until_stopped else f"{step.predicted_s:.1f} s"
    takes = "until DONE" if step.reason == StopReason.OPERATOR_DONE else takes
    figures = {
        "carries": (step.carried_kg, "kg"),
        "grips with": (step.grip_n, "N"),
        "presses with": (step.press_n, "N"),
    }
    about = [f"{word} {in_words(value, unit)}" for word, (value, unit) in figures.items() if value is not None]
    about += [f"stops at {in_words(step.stops_at_n, 'N')}"] if step.stops_at_n is not None else []
    trim = f"trim {step.trim}: " if step.trim else ""
    return f"{trim}{step.label}: {takes}" + (f" ({', '.join(about)})" if about else "")


def _position(pose: Sequence[float]) -> str:
    return "x {:.3f} y {:.3f} z {:.3f} m".format(*pose[:3])


def _faults(branches: Sequence[FaultBranch]) -> Iterator[str]:
    """The branches of each step: those that its trims recover, and those without a recovery."""
    for step in dict.fromkeys(branch.step for branch in branches):
        own = [branch for branch in branches if branch.step == step]
        for trims in dict.fromkeys(tuple(branch.trims) for branch in own if branch.recovered):
            reasons = [one.reason for one in own if one.recovered and tuple(one.trims) == trims]
            yield f"step {step}: {', '.join(reasons)}: recovered by {', then '.join(trims) or 'nothing more'}"
        if lost := [branch.reason for branch in own if not branch.recovered]:
            yield f"step {step}: NO RECOVERY from {', '.join(lost)}"


def _repair(repair: Repair) -> str:
    return f"tested instead ({repair.changes}, {repair.predicted_s:.1f} s): {'; then '.join(repair.sentences)}"
