"""Splicing: a step of a script that names a piece is replaced by the steps of that piece. Pure.

`{do: piece, name: vision, trim: [1, 2]}`: the steps of the piece get the pair of trims of the step. Pieces may name
pieces, but not themselves. A program is stored unspliced; who reads its steps splices it once, when it compiles it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import msgspec

from rtc.programs.schema import ElaboratorProgram, ScriptPiece, ScriptStep
from rtc.protocol.spelling import unknown

PIECE = "piece"


def spliced(program: ElaboratorProgram) -> ElaboratorProgram:
    """The program without steps that name pieces. It must have passed the checks: no piece contains itself."""
    pieces = {piece.skill: piece for piece in program.pieces}
    return msgspec.structs.replace(
        program,
        scripts=[msgspec.structs.replace(one, steps=list(flat(one.steps, pieces))) for one in program.scripts],
        pieces=[msgspec.structs.replace(one, steps=list(flat(one.steps, pieces))) for one in program.pieces],
    )


def flat(steps: list[ScriptStep], pieces: Mapping[str, ScriptPiece]) -> Iterator[ScriptStep]:
    for step in steps:
        if step.do != PIECE:
            yield step
            continue
        for own in flat(pieces[step.name].steps, pieces):
            yield msgspec.structs.replace(own, trim=step.trim) if step.trim != (0, 0) else own


def problems(program: ElaboratorProgram) -> Iterator[tuple[str, str]]:
    """(place, problem): steps that name no piece, say more than its name, or lack a label; pieces within themselves."""
    pieces = {piece.skill: piece for piece in program.pieces}
    for place, step in _placed(program):
        if step.do != PIECE:
            if not step.label:
                yield place, "Object missing required field `label`"
        elif step.name not in pieces:
            yield f"{place}.name", unknown("piece", step.name, pieces)
        elif step != ScriptStep(do=PIECE, name=step.name, trim=step.trim):
            yield place, f"the steps are those of {step.name}: besides do and name only trim has an effect"
    for name in _circles(pieces):
        yield "pieces", f"{name} contains itself"


def _placed(program: ElaboratorProgram) -> Iterator[tuple[str, ScriptStep]]:
    items = {f"scripts[{n}]": script.steps for n, script in enumerate(program.scripts)}
    items |= {f"pieces[{n}]": piece.steps for n, piece in enumerate(program.pieces)}
    for place, steps in items.items():
        yield from ((f"{place}.steps[{m}]", step) for m, step in enumerate(steps))


def _circles(pieces: Mapping[str, ScriptPiece]) -> Iterator[str]:
    """The pieces that contain themselves, directly or through others."""
    inner = {name: {step.name for step in piece.steps if step.do == PIECE} for name, piece in pieces.items()}
    for name in inner:
        reached, waiting = set[str](), [name]
        while waiting:
            found = inner.get(waiting.pop(), set()) - reached
            reached |= found
            waiting += found
        if name in reached:
            yield name
