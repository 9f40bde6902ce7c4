"""Elaborator worker function: (program, parsed command, world) -> script, or a refusal with the cause.

It looks up the verb in the decision tree, resolves arm or camera, object and grasp point, and ranks the options. It
plans the bindings of each option backwards from the goal until one is feasible, and returns its steps with their trims.
The other options are not tried once the script is executed (R75). The program alone defines the verbs and their
scripts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import msgspec

from rtc.language.hands import hand_in_words
from rtc.programs import attributes, expressions, named_algorithms
from rtc.programs.extension_names import CAMERA
from rtc.programs.loader import decode
from rtc.programs.recovery import RESERVE
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.programs.splice import spliced
from rtc.protocol.advice import Advice, Alternative, sentences_of
from rtc.protocol.causes import Changing, Collides, Distrusted, OutOfReach, TooUncertain
from rtc.protocol.messages import ElaboratorInput, LookStep, SavedWorld, Script, Step, Validity, WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.protocol.primitive_id import seed_of
from rtc.protocol.sentence import ParsedCommand
from rtc.world.model import World, location
from rtc.world.spread import EXACT
from workers.conditions import installed_phases, reflexes
from workers.elaborator import (
    answers,
    arm_candidates,
    as_tested,
    exact_arms,
    in_turn,
    make_way,
    no_script,
    other_motion,
    sentences_instead,
    tested_advice,
    what_is_left,
)
from workers.elaborator.backtrack import Planned
from workers.elaborator.figures import with_figures
from workers.elaborator.script_checks import (
    CHECKS,
    a_look_makes_room,
    after_a_look,
    why_uncertain,
    why_unsure_grasp,
    why_unsure_place,
)
from workers.elaborator.script_options import ScriptOption, in_words, only_looks, ranked
from workers.elaborator.script_steps import (
    FIRST_SKILL,
    Compiled,
    by_operator,
    context_for,
    lost_arms,
    names_by_role,
    names_of,
    sensed_first,
    step_for,
    through_places,
    trims_for,
    with_seats,
)
from workers.mechanisms import each, joined, refuse_missing
from workers.planning import trust
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery
from workers.tasks import command_fields, object_attributes, strategies
from workers.tasks.candidate import AskedTask, TaskCandidate
from workers.tasks.data_sentence import DataSentence
from workers.tasks.sentence_of import sentence_of

WRITES_OF_RESERVE = ("active_arm", "active_object", "its_seat")  # what a piece of script may find out

#: role in the resources of a script -> its candidates, if no arm works for it
CANDIDATES = joined(lambda mechanism: mechanism.candidates)
#: what makes the script of stated facts; attribute -> its facts
STATES, STATED = each(lambda mechanism: mechanism.states), joined(lambda mechanism: mechanism.stated)
NOTED = each(lambda mechanism: mechanism.noted)

INPUT = ElaboratorInput
NEEDS_WORLD = True
NEEDS_CELL = True


def compile(program: bytes) -> Compiled:
    """Check and index the program. Raises ProgramError."""
    document = spliced(decode(program, ElaboratorProgram))
    named_algorithms.refuse_missing(document)
    refuse_missing(document)
    pieces = {piece.skill: piece for piece in document.pieces}
    used = {s.script: attributes.of_script(s, pieces) for s in document.scripts}
    return Compiled(document, {s.script: s for s in document.scripts}, pieces, used)


def run(
    compiled: Compiled, cell: CellModel | None, world: World | None, data: ElaboratorInput, *, advise: bool = True
) -> Script | Refusal:
    """Choose and plan the script for a command. `advise`: search a sentence for an arm in the way of a refused one."""
    assert cell is not None
    assert world is not None
    query = WorldQuery(cell, world, seed_of(data.command), data.moving, compiled.program)
    try:
        as_tested.refuse_stale(data.rests_on, world)
        if data.saved is not None:
            command_fields.refuse_saved(data.parsed)
        script = _elaborated(compiled, query, data.parsed, data.owners, data.saved, advise=advise).script
        exact_arms.refuse(script, data.rigid)
        return installed_phases.applied(compiled.program.phases, data, script)
    except Refused as refused:
        return _advised(compiled, query, data.parsed, refused.refusal, data.rigid) if advise else refused.refusal


class Chosen(NamedTuple):
    """The script of a sentence, and what its success changes in the world, as predicted; None: that is not known."""

    script: Script
    changes: list[WorldChange] | None


def _advised(
    compiled: Compiled, query: WorldQuery, asked: ParsedCommand, refusal: Refusal, rigid: Collection[str]
) -> Refusal:
    """The refusal, without the sentences of its advice, and the other arms, that would be refused as well; with one
    that is accepted instead if none is left."""

    def other_arms() -> Advice:
        """If the sentence names no arm, all were candidates; if it is about the hand itself, another one is no help."""
        arms = [arm.name for arm in query.cell.arms]
        others = arms if asked.hand in arms and (asked.object or asked.place) else []
        changed = {arm: msgspec.structs.replace(asked, hand=arm) for arm in others if arm != asked.hand}
        able = [(arm, parsed) for arm, parsed in changed.items() if why(parsed) is None]
        sentences = [(sentence_of(parsed), arm) for arm, parsed in able]
        return [
            Alternative(
                sentences=[one] if one else [], words="" if one else f"the same with {hand_in_words(arm)}", instead=True
            )
            for one, arm in sentences
        ]

    why = _Why(compiled, query, rigid)
    refusal = _of_what_remains(compiled, query, asked, refusal, rigid)
    test = tested_advice.AdviceTest(why, other_arms, asked)
    advised = tested_advice.without_infeasible(refusal, test)
    return sentences_instead.added(compiled, advised, asked, query, test)


class _Why:
    """The refusal of a sentence in this world; None if it is accepted. Each is computed once. `rigid`: exact arms."""

    def __init__(self, compiled: Compiled, query: WorldQuery, rigid: Collection[str]) -> None:
        self._compiled, self._query, self._rigid = compiled, query, rigid
        self._known: dict[bytes, Refusal | Chosen] = {}

    def __call__(self, parsed: ParsedCommand) -> Refusal | None:
        found = self._found(parsed)
        return found if isinstance(found, Refusal) else None

    def after(self, parsed: ParsedCommand) -> _Why | None:
        found = self._found(parsed)
        return None if isinstance(found, Refusal) or found.changes is None else self._in(found.changes)

    def stated(self, keys: Iterable[str]) -> _Why:
        spread = trust.stated_spread(self._query.cell.numbers)
        return self._in(
            WorldChange(key=key, keep_value=True, validity=Validity.VALID, spread=spread)
            for one in keys
            for key in (one, *([f"{location(one)}.grasp"] if self._query.held_by(location(one)) else []))
        )

    def _in(self, changes: Iterable[WorldChange]) -> _Why:
        return _Why(self._compiled, self._query.after(changes), self._rigid)

    def _found(self, parsed: ParsedCommand) -> Refusal | Chosen:
        key = msgspec.json.encode(parsed)
        if key not in self._known:
            self._known[key] = self._elaborated(parsed)
        return self._known[key]

    def _elaborated(self, parsed: ParsedCommand) -> Refusal | Chosen:
        try:
            chosen = _elaborated(self._compiled, self._query, parsed, {}, advise=False)
            exact_arms.refuse(chosen.script, self._rigid)
            return chosen
        except Refused as why:
            return _of_what_remains(self._compiled, self._query, parsed, why.refusal, self._rigid)


def _of_what_remains(
    compiled: Compiled, query: WorldQuery, asked: ParsedCommand, refusal: Refusal, rigid: Collection[str]
) -> Refusal:
    """The refusal of a doubt about a pose in the hand. A way that the arm lacks, or that the object blocks where it is
    believed to be, is stated in its place: what clears the doubt makes none. If the pose would be too uncertain even
    without the doubt, its advice is that for the greater demand, which clears both: a check by fingers makes no pose
    better known."""
    doubt = refusal.cause
    if not isinstance(doubt, Distrusted | Changing | TooUncertain) or not doubt.fact.endswith(".grasp"):
        return refusal
    sure = WorldChange(key=doubt.fact, keep_value=True, validity=Validity.VALID)
    exact = msgspec.structs.replace(sure, spread=EXACT)
    remains = _Why(compiled, query.after([exact]), rigid)(asked)
    if remains is not None and remains.reason is RefusalReason.INFEASIBLE:
        return remains
    if isinstance(doubt, TooUncertain):
        return refusal
    why = _Why(compiled, query.after([sure]), rigid)
    remains = why(asked)
    if remains is None or not isinstance(remains.cause, TooUncertain):
        return refusal
    clears = tested_advice.without_infeasible(remains, tested_advice.AdviceTest(why)).clears
    return msgspec.structs.replace(refusal, clears=clears)


def _elaborated(
    compiled: Compiled,
    query: WorldQuery,
    parsed: ParsedCommand,
    owners: Mapping[str, str],
    saved: SavedWorld | None = None,
    *,
    advise: bool = True,
) -> Chosen:
    """The first feasible script of those that the decision tree has for this sentence. Raises Refused."""
    program, scripts = compiled.program, compiled.scripts
    branches = [branch for branch in program.branches.get(parsed.verb, []) if branch.enabled]
    if not branches:
        raise no_script.refused_verb(program, parsed)
    asked = parsed
    parsed, branches = strategies.via(program, scripts, parsed, branches, query)
    command_fields.refuse_unsupported(program, parsed)
    command_fields.refuse_report_interval(parsed)
    command_fields.refuse_report_items(parsed)
    limits = command_fields.limits(program, parsed, query.cell)
    command_fields.refuse_longer_than_limit(parsed, limits)
    _refuse_unmeasured(parsed, query)
    if parsed.kind == "data":
        return Chosen(_of_data(DataSentence(program, scripts[branches[0].script], parsed, query, owners, saved)), None)
    branches = [branch for branch in branches if command_fields.fits_sentence(branch, parsed)] or branches
    candidates: list[TaskCandidate] = []
    asked_for = AskedTask(program, scripts, parsed, limits, query)
    for by_camera in sorted({only_looks(scripts[branch.script]) for branch in branches}):
        if by_camera:
            candidates += map(with_figures, CANDIDATES[CAMERA](asked_for))
        else:
            candidates += arm_candidates.candidates(asked_for)
    unstated: list[Refusal] = []
    options = ranked(branches, candidates, scripts, unstated)
    if not options and unstated:
        raise Refused(unstated[0])
    if not options and parsed is not asked:
        every = [row for row in program.branches[parsed.verb] if row.enabled]
        fitting = ranked(every, candidates, scripts, [])
        raise strategies.refused(asked, strategies.names([one.branch for one in fitting]))
    if not options:
        hinged = parsed.object is not None and query.hinge(parsed.object) is not None
        raise no_script.refused_form(parsed, branches, hinged=hinged)
    notes = [f"not generated: {why.message}; {', '.join(sentences_of(why.clears))}" for why in unstated]
    return _first_feasible(compiled, options, notes, advise=advise)


def _of_data(sentence: DataSentence) -> Script:
    """The script of a sentence that states or asks facts. Raises Refused."""
    if any(step.do == "answer" for step in sentence.file.steps):
        return answers.script(sentence)
    return next(states(sentence, STATED) for states in STATES)


def _refuse_unmeasured(parsed: ParsedCommand, query: WorldQuery) -> None:
    """Refuse conditions that nothing measures, and actions that no reflex performs."""
    if not parsed.conditions:
        return
    joints = max(len(arm.joints) for arm in query.cell.arms)
    for reflex in parsed.reflexes:
        reflexes.refuse_unsupported(reflex, parsed.object is not None, joints)
    if parsed.until is not None:
        reflexes.refuse_condition(parsed.until, parsed.object is not None, joints, "UNTIL")
    for condition in parsed.report.when if parsed.report else ():
        reflexes.refuse_condition(condition, parsed.object is not None, joints, "REPORT WHEN")


# --- choose the script -----------------------------------------------------------------------------------


def _first_feasible(compiled: Compiled, options: list[ScriptOption], notes: list[str], *, advise: bool) -> Chosen:
    """The script of the first feasible option. Raises the most informative refusal, with the number of options.

    `notes`: on scripts that are no options; those of this choice are added."""
    refused: list[tuple[Refusal, ScriptOption]] = []
    unasked: list[ScriptOption] = []
    for option in options:
        try:
            chosen = _script(compiled, option, options, notes)
        except Refused as problem:
            notes.append(f"generated {option.name}; tested: {problem}")
            refused.append((problem.refusal, option))
            continue
        if not refused:
            return chosen
        if not other_motion.is_unasked(compiled.scripts, options[0], option):
            why, (script, changes) = refused[0][0], chosen
            return Chosen(other_motion.stated(script, compiled.scripts, options[0], option, why), changes)
        notes.append(f"generated {option.name}; tested: free, but another kind of motion, which is not asked for")
        unasked.append(option)
    first = _most_informative(compiled, refused, options, advise=advise)
    if unasked:
        first = other_motion.offered(first, options[0], unasked[0])
    if first.reason is RefusalReason.INFEASIBLE:
        candidate = options[0].candidate
        first = first.offering(by_operator(compiled, candidate))
    if len(options) == 1 or _PRECEDENCE[first.reason] == 0 or first.reason is RefusalReason.NO_SCRIPT:
        raise Refused(first)
    others = "; ".join(notes[1:4]) if len(notes) > 1 else ""
    message = f"{first.message} ({len(options)} candidates tried)"
    first = msgspec.structs.replace(first, message=message)
    raise Refused(first.after(candidates=len(options), others=others[:600]))


def _most_informative(
    compiled: Compiled, refused: list[tuple[Refusal, ScriptOption]], options: list[ScriptOption], *, advise: bool
) -> Refusal:
    """The refusal of the lowest rank. An arm in the way that could leave is only named if a sentence for it was found
    that clears the command; else the refusal names the obstacle that remains.

    An arm that starts so near to a body that it may touch it leaves on one fixed way, and no other is searched for.
    Then the other arm is not the cause."""
    first, its = min(refused, key=lambda each: _rank(each[0]))
    if not advise or _is_leaving(first) or first.reason is RefusalReason.SUSPECT:  # the last is waited for
        return first
    other = first.in_the_way
    if not other or not make_way.may_leave(its.candidate.query, other):
        return first

    def can_be_planned(candidate: TaskCandidate) -> bool:
        try:
            _script(compiled, ScriptOption(its.branch, candidate), options, [])
        except Refused:
            return False
        return True

    advised = make_way.advise(first, its.candidate, other, can_be_planned)
    if advised is not None:
        return advised
    same_rank = [one for one, _ in refused if _PRECEDENCE[one.reason] == _PRECEDENCE[first.reason]]
    return next((one for one in same_rank if not one.in_the_way), first)


def _is_leaving(refusal: Refusal) -> bool:
    return isinstance(refusal.cause, Collides) and bool(refusal.cause.leaving)


#: If several options fail, the refusal with the lowest rank is returned.
_PRECEDENCE = dict.fromkeys(RefusalReason, 1) | {
    RefusalReason.NAME: 0,
    RefusalReason.SUSPECT: 0,
    RefusalReason.STATE: 0,
    RefusalReason.PROGRAM: 2,
    RefusalReason.NO_SCRIPT: 3,
}


def _rank(refusal: Refusal) -> tuple[int, bool, bool]:
    """A refusal that another arm causes is the best of its rank: it may be cleared by waiting. What is out of reach is
    the last one: another candidate has come farther."""
    return _PRECEDENCE[refusal.reason], not refusal.in_the_way, isinstance(refusal.cause, OutOfReach)


# --- the script ------------------------------------------------------------------------------------------


def _script(compiled: Compiled, option: ScriptOption, options: list[ScriptOption], notes: list[str]) -> Chosen:
    """The planned script of one option. Raises Refused with the first problem."""
    candidate, script = option.candidate, compiled.scripts[option.branch.script]
    chosen = any("performer" in check.equals for check in option.branch.when)
    command_fields.refuse_unused_field(candidate.parsed, script.script, script.uses, performer=chosen)
    for check in CHECKS:
        check(script, candidate)
    used = compiled.attributes[script.script]
    object_attributes.refuse_unstated(compiled.program, candidate.query, candidate.thing, used)
    try:
        return _planned(compiled, option, options, notes)
    except expressions.ExpressionError as error:
        raise no_script.wrong_program(f"{script.script}: {error}", script.script) from error


def _sighted(candidate: TaskCandidate) -> list[WorldChange] | None:
    """What a camera's look for the body of a sentence changes, if it finds that where it is believed to be."""
    query, body = candidate.query, candidate.body
    if candidate.camera is None or not query.placed(body):
        return None
    spread = trust.last_look(query, body) or [*EXACT]
    attributes = ("frame", "grasp") if query.held_by(body) else ("frame",)
    return [
        WorldChange(key=f"{body}.{one}", keep_value=True, validity=Validity.VALID, spread=spread) for one in attributes
    ]


def _with_bindings(script: ScriptFile, steps: list[Step], candidate: TaskCandidate | None) -> Planned:
    """The plan of the steps; without an arm there is none. Raises Refused."""
    assert candidate is not None
    return in_turn.plan(script, steps, candidate) if candidate.hand else Planned.nothing()


def _planned(compiled: Compiled, option: ScriptOption, options: list[ScriptOption], notes: list[str]) -> Chosen:
    """The script of an option that has passed the checks. Raises Refused and ExpressionError."""
    candidate = option.candidate
    script = through_places(compiled.scripts[option.branch.script], candidate)
    entries, left_out = trims_for(compiled, script, candidate)
    nominal = [step_for(step, candidate, entries, nominal=True) for step in script.steps]
    nominal = what_is_left.noted(script, nominal, candidate)
    for noted in NOTED:
        nominal = noted(nominal, candidate)
    held = candidate.query.holding(candidate.arm.name) if candidate.hand else ""
    seen = after_a_look(candidate)
    lacks, still_lacks = why_uncertain(nominal, candidate), seen is None or why_uncertain(nominal, seen) is not None
    doubt = lacks or why_unsure_grasp(script, candidate)
    if doubt is not None and still_lacks:
        raise Refused(doubt)
    in_hand = [held] if doubt is not None else []
    try:
        planned = _with_bindings(script, nominal, seen if in_hand else candidate)
    except Refused as refused:
        if in_hand or still_lacks or not a_look_makes_room(refused.refusal, script, candidate):
            raise
        in_hand = [held]
        planned = _with_bindings(script, nominal, seen)
    for index, way in planned.ways.items():
        nominal[index] = msgspec.structs.replace(nominal[index], way=way)
    looked_for = [candidate.body] if why_unsure_place(script, candidate) is not None else []
    doubtful = list(dict.fromkeys([*in_hand, *planned.doubtful, *looked_for]))
    others = lost_arms(script, candidate)
    steps = [*sensed_first(compiled, candidate, doubtful, others), *nominal]
    looking = [*steps, *(step for entry in entries for step in entry.steps)]
    cameras = [name for step in looking if isinstance(step, LookStep) for name in step.cameras]
    case = script.case if script.case >= FIRST_SKILL else 1 if len(options) == 1 and not planned.chosen else 2
    stands_for = names_by_role(candidate)
    in_reserve = any(entry.n > RESERVE for entry in entries)
    own = (*option.notes, *planned.notes)
    writes = [*script.writes, *(WRITES_OF_RESERVE if in_reserve else ())]
    made = Script(
        context=context_for(compiled, script, option, candidate, entries),
        case=case,
        steps=steps,
        trims=entries,
        bindings=planned.bindings,
        resources=list(dict.fromkeys([*names_of(script.resources, stands_for, held), *others, *cameras])),
        writes=list(dict.fromkeys([*names_of(writes, stands_for, held), *others, *with_seats(candidate, doubtful)])),
        reads=[key.rpartition(".")[0] for key in planned.relies_on],
        notes=[*notes, *(f"{option.name}: {note}" for note in own), *left_out, *in_words(options)],
    )
    return Chosen(made, planned.changes if candidate.hand else _sighted(candidate))
