"""The elaborator: (scripts, parsed command, world) -> the script for it, or a refusal that says why there is none.

It looks a verb up in the decision tree, sees which arm, object and point are meant, ranks the candidates, decides the
bindings of each backwards from the goal until one can be done, and hands out the steps with their trims. Once that is
executed, the others are not tried (R75). Which verbs there are, and what is done for each, is all in the program.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

import msgspec

from rtc import cell as cells
from rtc import expressions, geometry
from rtc.language.record import ParsedCommand
from rtc.messages import ElaboratorInput, Limits, Script, ScriptContext, Step, Trim
from rtc.outcomes import Refusal, RefusalReason
from rtc.program import decode
from rtc.program_schema import Branch, Check, ElaboratorProgram, Piece, ScriptFile, ScriptStep
from rtc.world.model import World
from workers import enough, naming, needs, reflexes, sentence, telling
from workers.backtrack import plan
from workers.belief import Belief
from workers.cell_model import CellModel
from workers.situation import Situation, figures_of

INPUT = ElaboratorInput
NEEDS_WORLD = True
NEEDS_CELL = True

FIRST_SKILL = 3  # cases 1 and 2 are actions, 3 and 4 skills (R76)


@dataclass(frozen=True)
class Compiled:
    program: ElaboratorProgram
    scripts: dict[str, ScriptFile]
    pieces: dict[str, Piece]


@dataclass(frozen=True)
class Candidate:
    branch: Branch
    at: Situation

    @property
    def name(self) -> str:
        point = self.at.point.name if self.at.point else ""
        return " ".join(filter(None, (self.branch.script, *self.at.roles.values(), point)))


def compile(program: bytes) -> Compiled:
    """The program, checked. Raises ProgramError."""
    document = decode(program, ElaboratorProgram)
    return Compiled(document, {s.script: s for s in document.scripts}, {p.skill: p for p in document.pieces})


def run(compiled: Compiled, cell: CellModel | None, world: World | None, data: ElaboratorInput) -> Script | Refusal:
    """The script for a command."""
    assert cell is not None
    assert world is not None
    program, parsed = compiled.program, data.parsed
    branches = [b for b in program.decision_tree if b.verb == parsed.verb and b.enabled]
    if not branches:
        return _no_script(program, parsed)
    limits = sentence.limits(program, parsed, cell.cell)
    problem = sentence.unsaid(program, parsed) or sentence.report(parsed)
    if isinstance(limits, Refusal) or problem is not None:
        return problem or limits  # type: ignore[return-value]
    for reflex in parsed.reflexes:
        problem = reflexes.unrealised(reflex, parsed.object is not None)
        if problem is not None:
            return problem
    if parsed.kind == "data":
        return telling.script(program, compiled.scripts[branches[0].script], parsed, Belief(cell, world))
    situations = _situations(compiled, parsed, limits, Belief(cell, world))
    if isinstance(situations, Refusal):
        return situations
    candidates = _ranked(branches, situations)
    if isinstance(candidates, Refusal):
        return candidates
    if not candidates:
        return _none_fits(parsed, branches)
    return _first_feasible(compiled, candidates)


# --- what is meant -----------------------------------------------------------------------------------------


def _situations(compiled: Compiled, parsed: ParsedCommand, limits: Limits, belief: Belief) -> list[Situation] | Refusal:
    """Every arm and grasp point the sentence leaves open, nearest first."""
    cell, program = belief.cell, compiled.program
    thing: cells.Object | None = None
    if parsed.object is not None:
        found = _part(cell.objects, parsed.object, "object")
        if isinstance(found, Refusal):
            return _or_a_hand(found, compiled, parsed, cell)
        thing = found
    target: cells.Seat | None = None
    if parsed.target is not None:
        seat = _part(cell.seats, parsed.target, "seat")
        if isinstance(seat, Refusal):
            return seat
        target = seat
    arms = _arms(parsed, belief, thing)
    points = arms if isinstance(arms, Refusal) else _points(compiled, parsed, thing)
    if isinstance(arms, Refusal) or isinstance(points, Refusal):
        return arms if isinstance(arms, Refusal) else points  # type: ignore[return-value]
    situations = []
    for arm in arms:
        for point in points:
            figures = figures_of(program, parsed, belief, arm, thing, point, target)
            if isinstance(figures, Refusal):
                return figures
            situations.append(Situation(belief, program, parsed, limits, arm, thing, point, target, figures))
    return sorted(situations, key=_far)


def _or_a_hand(unknown: Refusal, compiled: Compiled, parsed: ParsedCommand, cell: cells.Cell) -> Refusal:
    """No such object; where the verb takes a hand without an object, an arm may have been meant."""
    takers = [row for row in compiled.program.decision_tree if row.verb == parsed.verb]
    hands = any(check.missing == "object" for row in takers for check in row.when)
    if parsed.hand is not None or not hands:
        return unknown
    known = [*unknown.expected, *(name for arm in cell.arms for name in (arm.name, arm.end_effector))]
    return naming.unknown("object or hand", parsed.object or "", known)


def _far(at: Situation) -> float:
    """From the arm's base to where its hand shall be: the first guess which arm, and which point, is meant."""
    if at.thing is None:
        return 0.0
    frame = at.belief.frame(at.thing.name)
    goal = geometry.compose(frame, at.point.frame.pose) if at.point else frame
    return geometry.distance(at.arm.base.pose, goal)


def _arms(parsed: ParsedCommand, belief: Belief, thing: cells.Object | None) -> list[cells.Arm] | Refusal:
    """The arm that is named; else the one that holds the object; else all."""
    cell = belief.cell
    if parsed.hand is not None:
        if parsed.hand == "BOTH-ARMS":
            message = "two arms in one command are not done yet"
            return Refusal(reason=RefusalReason.NO_SCRIPT, message=message, clears="name one arm")
        found = _part(cell.arms, parsed.hand, "arm")
        return found if isinstance(found, Refusal) else [found]
    holder = belief.held_by(thing.name) if thing else ""
    return [arm for arm in cell.arms if not holder or arm.name == holder]


def _points(
    compiled: Compiled, parsed: ParsedCommand, thing: cells.Object | None
) -> list[cells.GraspPoint | None] | Refusal:
    """The one that is named; else all; none when no script of the verb takes hold anywhere."""
    scripts = [compiled.scripts[b.script] for b in compiled.program.decision_tree if b.verb == parsed.verb]
    if thing is None or not any("grasp_point" in script.uses for script in scripts):
        return [None]
    if parsed.grasp_point is None:
        return [*thing.grasp_points] or [None]
    found = _part(thing.grasp_points, parsed.grasp_point, f"grasp point of {thing.name}")
    return found if isinstance(found, Refusal) else [found]


T = TypeVar("T", cells.Arm, cells.Object, cells.Seat, cells.GraspPoint)


def _part(parts: list[T], name: str, what: str) -> T | Refusal:
    found = next((part for part in parts if part.name == name), None)
    return found or naming.unknown(what, name, [part.name for part in parts])


# --- which script ------------------------------------------------------------------------------------------


def _ranked(branches: list[Branch], situations: list[Situation]) -> list[Candidate] | Refusal:
    """Every branch whose conditions hold, for every situation: the likeliest first, then the nearest."""
    candidates = []
    for branch in branches:
        for at in situations:
            try:
                if all(_holds(check, at) for check in branch.when):
                    candidates.append(Candidate(branch, at))
            except expressions.ExpressionError as error:
                return Refusal(
                    reason=RefusalReason.PROGRAM,
                    message=f"the decision tree for {branch.verb} ({branch.script}): {error}",
                    where="decision_tree",
                    clears="LOAD a row of command_object_table that has that figure",
                )
    return sorted(candidates, key=lambda c: -c.branch.likelihood)


def _holds(check: Check, at: Situation) -> bool:
    said = at.parsed
    if check.given and sentence.field(said, check.given) is None:
        return False
    if check.missing and sentence.field(said, check.missing) is not None:
        return False
    if any(sentence.field(said, path) != value for path, value in check.equals.items()):
        return False
    if any(sentence.field(said, path) == value for path, value in check.differs.items()):
        return False
    if check.of is None:
        return True
    value = expressions.number(check.of, at.figures)
    least = check.at_least is None or value >= expressions.number(check.at_least, at.figures) - 1e-9
    return least and (check.at_most is None or value <= expressions.number(check.at_most, at.figures) + 1e-9)


def _first_feasible(compiled: Compiled, candidates: list[Candidate]) -> Script | Refusal:
    """The best candidate that can be done. None: what is wrong with the best, and how many were tried."""
    first: Refusal | None = None
    notes: list[str] = []
    for candidate in candidates:
        made = _script(compiled, candidate, candidates, notes)
        if isinstance(made, Script):
            return made
        notes.append(f"generated {candidate.name}; tested: {made.message}")
        if first is None or _PRECEDENCE[made.reason] < _PRECEDENCE[first.reason]:
            first = made
    assert first is not None
    if len(candidates) == 1 or _PRECEDENCE[first.reason] == 0 or first.reason is RefusalReason.NO_SCRIPT:
        return first
    others = "; ".join(notes[1:4]) if len(notes) > 1 else ""
    return msgspec.structs.replace(
        first,
        message=f"{first.message} ({len(candidates)} candidates tried)",
        detail={**first.detail, "candidates": float(len(candidates)), "others": others[:600]},
    )


#: when several candidates fail, the reason that tells most goes up
_PRECEDENCE = dict.fromkeys(RefusalReason, 1) | {
    RefusalReason.NAME: 0,
    RefusalReason.SUSPECT: 0,
    RefusalReason.STATE: 0,
    RefusalReason.PROGRAM: 2,
    RefusalReason.NO_SCRIPT: 3,
}


# --- the script --------------------------------------------------------------------------------------------


def _script(
    compiled: Compiled, candidate: Candidate, candidates: list[Candidate], notes: list[str]
) -> Script | Refusal:
    at, script = candidate.at, compiled.scripts[candidate.branch.script]
    problem = sentence.misplaced(at.parsed, script.script, script.uses)
    problem = problem or sentence.without_effect(at.program, at.parsed, script)
    for need in script.needs:
        problem = problem or needs.lacking(need, at)
    problem = problem or _unsure_grasp(script, at)
    if problem is not None:
        return problem
    planned = plan(script, at)
    if isinstance(planned, Refusal):
        return planned
    try:
        trims = _trims(compiled, script, at)
        if isinstance(trims, Refusal):
            return trims
        entries, left_out = trims
        steps = [*_sensed_first(compiled, at), *(_step(step, at, entries, nominal=True) for step in script.steps)]
    except expressions.ExpressionError as error:
        return Refusal(reason=RefusalReason.PROGRAM, message=f"{script.script}: {error}", where=script.script)
    for step in steps:
        lacks = enough.lacking(at.belief, at.arm.name, step.args, at.program.clears)
        if lacks is not None:
            return lacks
    held = at.belief.holding(at.arm.name)
    case = script.case if script.case >= FIRST_SKILL else 1 if len(candidates) == 1 and not planned.chosen else 2
    return Script(
        context=_context(candidate, at, entries),
        case=case,
        steps=steps,
        trims=entries,
        bindings=planned.bindings,
        resources=_names(script.resources, at, held),
        writes=_names(script.writes, at, held),
        reads=[key.rpartition(".")[0] for key in planned.relies_on],
        candidates=[candidate.name, *(c.name for c in candidates if c is not candidate)],
        notes=[*notes, *(f"{candidate.name}: {note}" for note in planned.notes), *left_out],
    )


def _context(candidate: Candidate, at: Situation, entries: list[Trim]) -> ScriptContext:
    return ScriptContext(
        verb=at.parsed.verb,
        script=candidate.branch.script,
        arm=at.arm.name,
        object=at.thing.name if at.thing else "",
        grasp_point=at.point.name if at.point else "",
        target=at.target.name if at.target else "",
        limits=at.limits,
        guarded=at.parsed.guarded,
        reflexes=at.parsed.reflexes,
        fits={entry.n: entry.fits for entry in entries if entry.fits},
    )


def _names(roles: list[str], at: Situation, held: str) -> list[str]:
    """What the roles stand for; what the arm holds goes where the arm goes."""
    stands_for = {**at.roles, "its_seat": at.belief.seat(at.thing.name) if at.thing else ""}
    return list(dict.fromkeys(name for name in (*(stands_for.get(role, role) for role in roles), held) if name))


def _step(step: ScriptStep, at: Situation, entries: list[Trim], nominal: bool) -> Step:
    """The step for this situation: its figures worked out, its words filled in."""
    there = {entry.n for entry in entries}
    index, count = step.trim
    asked = [] if not nominal else [n for n in range(index, index + count) if n in there]
    own = [entry.n for entry in entries if nominal and entry.n > MOST_ENTRIES]
    figures: dict[str, float | str] = {n: expressions.number(e, at.figures) for n, e in step.args.items()}
    report = at.parsed.report
    if report is not None and report.every_s is not None:
        figures["report_every_s"] = report.every_s
    return Step(
        do=step.do,
        label=at.say(step.label),
        name=step.name,
        who=step.who,
        to=step.to,
        stop=step.stop,
        space=step.space,
        value=step.value,
        op=step.op,
        expect=step.expect,
        keep=step.keep,
        trims=[*asked, *own],
        args={**figures, **{name: at.say(word) for name, word in step.words.items()}},
    )


def _sensed_first(compiled: Compiled, at: Situation) -> list[Step]:
    """What is not known of the arm and can be sensed is, before anything rests on it."""
    senses = compiled.program.senses
    unknown = [piece for attribute, piece in senses.items() if not at.belief.trusts(f"{at.arm.name}.{attribute}")]
    return [_step(step, at, [], nominal=False) for piece in unknown for step in compiled.pieces[piece].steps]


MOST_ENTRIES = 100  # of a trimming stack; the trims that a sentence itself names (AND TRY) are numbered above


def _trims(compiled: Compiled, script: ScriptFile, at: Situation) -> tuple[list[Trim], list[str]] | Refusal:
    """The trimming stack, and notes about entries that were left out because nothing does them yet."""
    entries: list[Trim] = []
    left_out: list[str] = []
    for entry in script.trimming_stack:
        piece = compiled.pieces.get(entry.skill)
        label = f"{entry.skill} {at.roles.get(entry.who, entry.who)}"
        if piece is None:
            left_out.append(f"trim {entry.n} ({label}) is left out: no piece of script does {entry.skill} yet")
            continue
        steps = [_step(step, at, [], nominal=False) for step in piece.steps]
        entries.append(Trim(n=entry.n, label=label, steps=steps, then=entry.then, fits=entry.fits))
    for n, reflex in enumerate((r for r in at.parsed.reflexes if r.trim), MOST_ENTRIES + 1):
        name = (reflex.trim or "").lower()
        piece = compiled.pieces.get(name)
        if piece is None or script.case < FIRST_SKILL:
            return _cannot_try(name.upper(), compiled, script)
        reason = reflexes.reason_of(reflex.condition)
        steps = [_step(step, at, [], nominal=False) for step in piece.steps]
        entries.append(Trim(n=n, label=f"TRY {name.upper()}", steps=steps, fits=[reason] if reason else []))
    return entries, left_out


# --- refusals ----------------------------------------------------------------------------------------------


def _no_script(program: ElaboratorProgram, parsed: ParsedCommand) -> Refusal:
    scripted = sorted(verbs(program))
    instead = program.instead.get(parsed.verb, "")
    load = "" if "rtc load" in instead else f"load a script for {parsed.verb}: rtc load FILE INTO elaborator"
    return Refusal(
        reason=RefusalReason.NO_SCRIPT,
        message=f"there is no script for {parsed.verb} yet",
        where=parsed.verb,
        expected=scripted,
        clears="; or ".join(filter(None, (instead, load))),
    )


def _none_fits(parsed: ParsedCommand, branches: list[Branch]) -> Refusal:
    return Refusal(
        reason=RefusalReason.NO_SCRIPT,
        message=f"{parsed.verb} has no script for this form of the sentence",
        where=parsed.verb,
        clears="; or ".join(dict.fromkeys(f"{parsed.verb} {_wants(branch)}" for branch in branches)),
    )


def _wants(branch: Branch) -> str:
    """What a branch asks of the sentence, in words."""
    words = sentence.in_words
    said = [f"with {words(check.given)}" for check in branch.when if check.given]
    unsaid = [f"without {words(check.missing)}" for check in branch.when if check.missing]
    values = [f"with {words(path)} {value}" for check in branch.when for path, value in check.equals.items()]
    others = [
        f"with {words(path)} other than {value}" for check in branch.when for path, value in check.differs.items()
    ]
    return ", ".join([*said, *unsaid, *values, *others]) or "with an object whose figures fit"


def _cannot_try(name: str, compiled: Compiled, script: ScriptFile) -> Refusal:
    if script.case < FIRST_SKILL and name.lower() in compiled.pieces:
        message = f"AND TRY {name}: {script.script} is an action, and only skills are corrected on the way"
        return Refusal(reason=RefusalReason.NO_SCRIPT, message=message, where=name, clears="leave out AND TRY")
    return naming.unknown("piece of script to TRY", name, [piece.upper() for piece in compiled.pieces])


def _unsure_grasp(script: ScriptFile, at: Situation) -> Refusal | None:
    """What the hand holds goes where it goes: no motion is planned round it while it is in doubt how it is held (R151).
    Fingers may press or open, and a script that says so may move: to back off from what was touched, to let go."""
    held = at.belief.holding(at.arm.name)
    if not held or script.despite_grasp or not any(step.to for step in script.steps):
        return None
    return at.belief.distrusted(f"{held}.grasp", at.program.clears)


def verbs(program: ElaboratorProgram) -> Iterator[str]:
    """Every verb that has a script."""
    yield from dict.fromkeys(branch.verb for branch in program.decision_tree if branch.enabled)
