"""Which breakpoints a command can reach, from the programs and the cell in use. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import msgspec

from rtc.programs import checks
from rtc.programs.schema import ElaboratorProgram
from rtc.programs.splice import spliced
from rtc.protocol.advice import by_person
from rtc.protocol.messages import Breakpoint
from rtc.protocol.outcomes import Refusal, RefusalReason

MAX_WORDS = 300  # of a refusal


class ProgramBodies(NamedTuple):
    """Of the programs in use; empty bodies are not known."""

    parser: bytes
    elaborator: bytes
    cell: bytes


class _Sensed(msgspec.Struct):
    """Of the document of a cell: what may be sensed."""

    arms: list[msgspec.Raw] = []
    objects: list[msgspec.Raw] = []
    seats: list[msgspec.Raw] = []


def refusal_of(points: Sequence[Breakpoint], bodies: ProgramBodies) -> Refusal | None:
    """The refusal of breakpoints of which a command cannot reach one: it would be accepted without effect."""
    verbs = checks.verbs(bodies.parser.decode())
    if unknown := [str(one) for one in points if one.verb not in verbs]:
        words = f"{', '.join(unknown)}: no sentence begins so"
        return _refusal(words, f"one of {', '.join(sorted(verbs))}")
    longest, before = _steps(bodies.elaborator, bodies.cell)
    for one in points:
        if one.step > longest.get(one.verb, 0) + (before if one.verb in longest else 0):
            last = longest.get(one.verb, 0)
            words = f"no {one.verb} has a step {one.step}: its longest script has {last} steps"
            words += f", and at most {before} that sense come before them" if last else ""
            return _refusal(words, f"a step from 1 to {last}" if last else "a verb with a script")
    return None


def _refusal(words: str, clears: str) -> Refusal:
    return Refusal(reason=RefusalReason.NAME, message=words[:MAX_WORDS], clears=by_person(clears))


@lru_cache(maxsize=1)
def _steps(elaborator: bytes, cell: bytes) -> tuple[dict[str, int], int]:
    """The most steps of a script of each verb, and the most that can come before them: each arm, object and seat is
    sensed once."""
    program = spliced(msgspec.json.decode(elaborator, type=ElaboratorProgram))
    steps = {script.script: len(script.steps) for script in program.scripts}
    longest: dict[str, int] = {}
    for row in program.decision_tree:
        longest[row.verb] = max(longest.get(row.verb, 0), steps[row.script])
    sensing = {piece.skill: len(piece.steps) for piece in program.pieces}
    most = max((sensing[name] for name in program.senses.values()), default=0)
    known = msgspec.json.decode(cell, type=_Sensed) if cell else _Sensed()
    return longest, most * (len(known.arms) * len(program.senses) + len(known.objects) + len(known.seats))
