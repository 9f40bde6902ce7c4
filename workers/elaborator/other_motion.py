"""A script that stands in for the first one of a sentence, because that cannot be planned. Pure.

A hand that should go straight and goes through joint space may swing. So a sentence that watches its motion, or an arm
with a load, gets no script with another kind of motion: the refusal states the sentence that asks for it. In other
cases the result says what is done instead, and why.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from rtc.programs.schema import ScriptFile
from rtc.protocol.advice import fill_in
from rtc.protocol.messages import Script
from rtc.protocol.outcomes import Refusal
from workers.elaborator.script_options import ScriptOption
from workers.tasks.command_fields import fits_sentence
from workers.tasks.sentence_of import PATHS, sentence_of

Scripts = Mapping[str, ScriptFile]


def is_unasked(scripts: Scripts, first: ScriptOption, other: ScriptOption) -> bool:
    """Whether the other option has a kind of motion that the first one lacks, which the sentence or a load forbids."""
    if _spaces(scripts[other.branch.script]) <= _spaces(scripts[first.branch.script]):
        return False
    parsed, candidate = other.candidate.parsed, other.candidate
    watched = parsed.guarded or bool(parsed.reflexes) or parsed.until is not None
    return watched or (candidate.hand is not None and bool(candidate.query.holding(candidate.hand.name)))


def _spaces(script: ScriptFile) -> set[str]:
    return {step.space for step in script.steps if step.to and step.space}


def offered(refusal: Refusal, first: ScriptOption, other: ScriptOption) -> Refusal:
    """The refusal with the sentence that asks for the other option, which was tested, as its first advice."""
    sentence = asking_for(first, other)
    row = other.candidate.program.clears.get("other_motion", []) if sentence else []
    return msgspec.structs.replace(refusal, clears=[*fill_in(row, {"sentence": sentence}), *refusal.clears])


def asking_for(first: ScriptOption, other: ScriptOption) -> str:
    """The sentence that the other option fits and the first one does not; empty if no word of a path tells them
    apart."""
    parsed = other.candidate.parsed
    for path in PATHS:
        asked = msgspec.structs.replace(parsed, path=path)
        if fits_sentence(other.branch, asked) and not fits_sentence(first.branch, asked):
            return sentence_of(asked)
    return ""


def stated(script: Script, scripts: Scripts, first: ScriptOption, chosen: ScriptOption, why: Refusal) -> Script:
    """The script, whose result says in what it differs from the first option, and `why`."""
    says = f"{_difference(scripts, first, chosen)}: {why.message}"
    *before, last = script.steps
    noted = msgspec.structs.replace(last, says="; ".join(filter(None, (says, last.says))))
    return msgspec.structs.replace(script, steps=[*before, noted])


def _difference(scripts: Scripts, first: ScriptOption, chosen: ScriptOption) -> str:
    if chosen.branch.script != first.branch.script:
        ours, others = scripts[chosen.branch.script].about, scripts[first.branch.script].about
        return f"{ours}, not {others}"
    roles, theirs = chosen.candidate.roles, first.candidate.roles
    names = [(roles[role], theirs[role]) for role in roles if roles[role] != theirs[role]]
    ours, other = (one.candidate.point.name if one.candidate.point else "" for one in (chosen, first))
    return ", ".join(f"{name}, not {instead}" for name, instead in names or [(ours, other)])
