"""Elaborator worker function: (program, parsed command, world) -> script, or a refusal with the cause.

It looks up the verb in the decision tree, resolves arm or camera, object and grasp point, and ranks the options. It
plans the bindings of each option backwards from the goal until one is feasible, and returns its steps with their trims.
The other options are not tried once the script is executed (R75). The program alone defines the verbs and their
scripts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import msgspec

from rtc.programs import expressions
from rtc.programs.loader import decode
from rtc.programs.schema import Branch, BranchCondition, ElaboratorProgram, ScriptFile, ScriptPiece, ScriptStep
from rtc.protocol.messages import ElaboratorInput, Script, ScriptContext, Step, Trim
from rtc.protocol.outcomes import IN_THE_WAY, Refusal, RefusalReason, Refused
from rtc.protocol.primitive_id import seed_of
from rtc.protocol.sentence import ParsedCommand
from rtc.world.model import World
from rtc.world.spread import in_words
from workers.conditions import reflexes
from workers.conditions.looking import CAMERA, FURTHER, cameras_of
from workers.elaborator import (
    anchors,
    arm_candidates,
    command_fields,
    hinged,
    look,
    make_way,
    no_script,
    preconditions,
    set_fact,
    two_hands,
)
from workers.elaborator.backtrack import FRAME, GRASP, Planned, can_be_seen, plan
from workers.elaborator.task_candidate import TaskCandidate
from workers.planning import certainty, suggestions
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

INPUT = ElaboratorInput
NEEDS_WORLD = True
NEEDS_CELL = True

FIRST_SKILL = 3  # cases 1 and 2 are actions, cases 3 and 4 are skills (R76)


@dataclass(frozen=True)
class Compiled:
    program: ElaboratorProgram
    scripts: dict[str, ScriptFile]
    pieces: dict[str, ScriptPiece]


@dataclass(frozen=True)
class ScriptOption:
    branch: Branch
    candidate: TaskCandidate

    @property
    def name(self) -> str:
        point = self.candidate.point.name if self.candidate.point else ""
        return " ".join(filter(None, (self.branch.script, *self.candidate.roles.values(), point)))


def compile(program: bytes) -> Compiled:
    """Check and index the program. Raises ProgramError."""
    document = decode(program, ElaboratorProgram)
    return Compiled(document, {s.script: s for s in document.scripts}, {p.skill: p for p in document.pieces})


def run(compiled: Compiled, cell: CellModel | None, world: World | None, data: ElaboratorInput) -> Script | Refusal:
    """Choose and plan the script for a command."""
    assert cell is not None
    assert world is not None
    try:
        return _elaborated(
            compiled, WorldQuery(cell, world, data.at_s, seed_of(data.command), data.moving), data.parsed
        )
    except Refused as refused:
        return refused.refusal


def _elaborated(compiled: Compiled, query: WorldQuery, parsed: ParsedCommand) -> Script:
    """The first feasible script of those that the decision tree has for this sentence. Raises Refused."""
    program, scripts = compiled.program, compiled.scripts
    branches = [branch for branch in program.decision_tree if branch.verb == parsed.verb and branch.enabled]
    if not branches:
        raise no_script.refused_verb(program, parsed)
    cameras = any("camera" in scripts[branch.script].resources for branch in branches)
    command_fields.refuse_unsupported(program, parsed, cameras=cameras)
    command_fields.refuse_report_interval(parsed)
    command_fields.refuse_report_items(parsed)
    limits = command_fields.limits(program, parsed, query.cell)
    command_fields.refuse_longer_than_limit(parsed, limits)
    _refuse_unmeasured(parsed, query)
    if parsed.kind == "data":
        return set_fact.script(program, scripts[branches[0].script], parsed, query)
    branches = [branch for branch in branches if _fits_sentence(branch, parsed)] or branches
    candidates: list[TaskCandidate] = []
    for looks in sorted({_looks(scripts[branch.script]) for branch in branches}):
        find = look.candidates if looks else arm_candidates.candidates
        candidates += find(program, scripts, parsed, limits, query)
    options = _ranked(branches, candidates, scripts)
    if not options:
        hinged = parsed.object is not None and query.hinge(parsed.object) is not None
        raise no_script.refused_form(parsed, branches, hinged=hinged)
    return _first_feasible(compiled, options)


def _refuse_unmeasured(parsed: ParsedCommand, query: WorldQuery) -> None:
    """Refuse conditions that nothing measures, and actions that no reflex performs."""
    joints = max(len(arm.joints) for arm in query.cell.arms)
    for reflex in parsed.reflexes:
        reflexes.refuse_unsupported(reflex, parsed.object is not None, joints)
    for condition in parsed.report.when if parsed.report else ():
        reflexes.refuse_condition(condition, parsed.object is not None, joints, "REPORT WHEN")


# --- choose the script -----------------------------------------------------------------------------------


def _ranked(
    branches: list[Branch], candidates: list[TaskCandidate], scripts: Mapping[str, ScriptFile]
) -> list[ScriptOption]:
    """All pairs of branch and candidate whose conditions hold: the likeliest first, then the nearest."""
    options = []
    for branch in branches:
        looks = _looks(scripts[branch.script])
        for candidate in (one for one in candidates if (one.hand is None) == looks):
            try:
                if all(_holds(check, candidate) for check in branch.when):
                    options.append(ScriptOption(branch, candidate))
            except expressions.ExpressionError as error:
                message = f"the decision tree for {branch.verb} ({branch.script}): {error}"
                clears = "LOAD a row of command_object_table that has that figure"
                raise _wrong_program(message, "decision_tree", clears) from error
    return sorted(options, key=lambda c: -c.branch.likelihood)


def _looks(script: ScriptFile) -> bool:
    """Whether only a camera works for this script."""
    return "camera" in script.resources and "active_arm" not in script.resources


def _fits_sentence(branch: Branch, parsed: ParsedCommand) -> bool:
    """Whether the conditions on the sentence alone hold."""
    return all(_holds_for(check, parsed) for check in branch.when)


def _holds_for(check: BranchCondition, parsed: ParsedCommand) -> bool:
    if check.given and command_fields.field(parsed, check.given) is None:
        return False
    if check.missing and command_fields.field(parsed, check.missing) is not None:
        return False
    if any(command_fields.field(parsed, path) != value for path, value in check.equals.items()):
        return False
    return not any(command_fields.field(parsed, path) == value for path, value in check.differs.items())


def _holds(check: BranchCondition, candidate: TaskCandidate) -> bool:
    if not _holds_for(check, candidate.parsed):
        return False
    if check.of is None:
        return True
    value = expressions.number(check.of, candidate.figures)
    least = check.at_least is None or value >= expressions.number(check.at_least, candidate.figures) - 1e-9
    return least and (check.at_most is None or value <= expressions.number(check.at_most, candidate.figures) + 1e-9)


def _first_feasible(compiled: Compiled, options: list[ScriptOption]) -> Script:
    """The script of the first feasible option. Raises the most informative refusal, with the number of options."""
    refused: list[tuple[Refusal, ScriptOption]] = []
    notes: list[str] = []
    for option in options:
        try:
            return _script(compiled, option, options, notes)
        except Refused as problem:
            notes.append(f"generated {option.name}; tested: {problem}")
            refused.append((problem.refusal, option))
    first = _most_informative(compiled, refused, options)
    if len(options) == 1 or _PRECEDENCE[first.reason] == 0 or first.reason is RefusalReason.NO_SCRIPT:
        raise Refused(first)
    others = "; ".join(notes[1:4]) if len(notes) > 1 else ""
    message = f"{first.message} ({len(options)} candidates tried)"
    detail = {**first.detail, "candidates": float(len(options)), "others": others[:600]}
    raise Refused(msgspec.structs.replace(first, message=message, detail=detail))


def _most_informative(
    compiled: Compiled, refused: list[tuple[Refusal, ScriptOption]], options: list[ScriptOption]
) -> Refusal:
    """The refusal of the lowest rank. An arm in the way that could leave is only named if a sentence for it was found
    that clears the command; else the refusal names the obstacle that remains."""
    first, its = min(refused, key=lambda each: _rank(each[0]))
    other = first.detail.get(IN_THE_WAY)
    if not isinstance(other, str) or not make_way.may_leave(its.candidate.query, other):
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
    return next((one for one in same_rank if IN_THE_WAY not in one.detail), first)


#: If several options fail, the refusal with the lowest rank is returned.
_PRECEDENCE = dict.fromkeys(RefusalReason, 1) | {
    RefusalReason.NAME: 0,
    RefusalReason.SUSPECT: 0,
    RefusalReason.STATE: 0,
    RefusalReason.PROGRAM: 2,
    RefusalReason.NO_SCRIPT: 3,
}


def _rank(refusal: Refusal) -> tuple[int, bool]:
    """A refusal that another arm causes is the best of its rank: it may be cleared by waiting."""
    return _PRECEDENCE[refusal.reason], IN_THE_WAY not in refusal.detail


# --- the script ------------------------------------------------------------------------------------------


def _script(compiled: Compiled, option: ScriptOption, options: list[ScriptOption], notes: list[str]) -> Script:
    """The planned script of one option. Raises Refused with the first problem."""
    candidate, script = option.candidate, compiled.scripts[option.branch.script]
    chosen = any("performer" in check.equals for check in option.branch.when)
    command_fields.refuse_unused_field(candidate.parsed, script.script, script.uses, performer=chosen)
    for check in CHECKS:
        check(script, candidate)
    try:
        return _planned(compiled, option, options, notes)
    except expressions.ExpressionError as error:
        raise _wrong_program(f"{script.script}: {error}", script.script) from error


def _planned(compiled: Compiled, option: ScriptOption, options: list[ScriptOption], notes: list[str]) -> Script:
    """The script of an option that has passed the checks. Raises Refused and ExpressionError."""
    candidate, script = option.candidate, compiled.scripts[option.branch.script]
    entries, left_out = _trims(compiled, script, candidate)
    nominal = [_step(step, candidate, entries, nominal=True) for step in script.steps]
    held = candidate.query.holding(candidate.arm.name) if candidate.hand else ""
    lacks = _why_uncertain(nominal, candidate)
    if lacks is not None and not can_be_seen(lacks.where, candidate):
        raise Refused(lacks)
    in_hand = [held] if lacks is not None or _why_unsure_grasp(script, candidate) is not None else []
    planned = plan(script, nominal, candidate, in_hand) if candidate.hand else Planned.nothing()
    for index, way in planned.ways.items():
        nominal[index] = msgspec.structs.replace(nominal[index], way=way)
    looked_for = [candidate.body] if _why_unsure_place(script, candidate) is not None else []
    doubtful = list(dict.fromkeys([*in_hand, *planned.doubtful, *looked_for]))
    others = _lost_arms(script, candidate)
    steps = [*_sensed_first(compiled, candidate, doubtful, others), *nominal]
    looking = [*steps, *(step for entry in entries for step in entry.steps)]
    cameras = [name for step in looking if step.who == CAMERA for name in cameras_of(step)]
    case = script.case if script.case >= FIRST_SKILL else 1 if len(options) == 1 and not planned.chosen else 2
    return Script(
        context=_context(option, candidate, entries),
        case=case,
        steps=steps,
        trims=entries,
        bindings=planned.bindings,
        resources=list(dict.fromkeys([*_names(script.resources, candidate, held), *others, *cameras])),
        writes=list(
            dict.fromkeys([*_names(script.writes, candidate, held), *others, *_with_seats(candidate, doubtful)])
        ),
        reads=[key.rpartition(".")[0] for key in planned.relies_on],
        notes=[*notes, *(f"{option.name}: {note}" for note in planned.notes), *left_out],
    )


def _why_unsure_place(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal of a script for which the pose of the object is too uncertain; None if it is certain enough."""
    if script.unsure_if is None or candidate.thing is None or not _holds(script.unsure_if, candidate):
        return None
    name, query, clears = candidate.thing.name, candidate.query, candidate.program.clears
    spread = in_words(query.spread(f"{name}.frame"))
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"{name} is known within {spread} only, and no camera finds it: too uncertain for {script.script}",
        where=f"{name}.frame",
        clears=clears.get("spread", "sense {location} again").replace("{location}", name),
        detail={"cause": "spread", "spread": spread},
    )


def _why_uncertain(steps: list[Step], candidate: TaskCandidate) -> Refusal | None:
    """The refusal of a script if the held object will be too uncertain for one of its steps when that step begins."""
    if candidate.hand is None:
        return None
    query, ahead_s = candidate.query, 0.0
    motion_s = certainty.motion_time_s(query, candidate.limits)
    for step in steps:
        lacks = certainty.why_uncertain(query, candidate.arm.name, step.args, candidate.program.clears, ahead_s)
        if lacks is not None:
            return lacks
        ahead_s += motion_s if step.do == "move" else 0.0
    return None


def _context(option: ScriptOption, candidate: TaskCandidate, entries: list[Trim]) -> ScriptContext:
    return ScriptContext(
        verb=candidate.parsed.verb,
        script=option.branch.script,
        arm=candidate.hand.name if candidate.hand else "",
        partner=candidate.partner.name if candidate.partner else "",
        object=candidate.body,
        grasp_point=candidate.point.name if candidate.point else "",
        target=candidate.target.name if candidate.target else "",
        limits=candidate.limits,
        guarded=candidate.parsed.guarded,
        reflexes=candidate.parsed.reflexes,
        report=candidate.parsed.report,
        fits={entry.n: entry.fits for entry in entries if entry.fits},
    )


def _names(roles: list[str], candidate: TaskCandidate, held: str) -> list[str]:
    """The names that the roles stand for; includes the held object, because it moves with the arm."""
    query, thing = candidate.query, candidate.thing.name if candidate.thing else ""
    stands_for = {name: [role] for name, role in candidate.roles.items()}
    stands_for["its_seat"] = [query.seat(thing)] if thing else []
    stands_for["its_holder"] = [query.held_by(thing)] if thing else []
    stands_for["its_content"] = [
        one.name
        for one in query.cell.objects
        if candidate.seat is not None and query.seat(one.name) == candidate.seat.name
    ]
    found = [name for role in roles for name in stands_for.get(role, [role])]
    return list(dict.fromkeys(name for name in (*found, held) if name))


def _with_seats(candidate: TaskCandidate, doubtful: list[str]) -> list[str]:
    """These objects with the seats that they are in, and these seats with what is in them."""
    query = candidate.query
    inside = [thing.name for thing in query.cell.objects if query.seat(thing.name) in doubtful]
    return [name for body in doubtful for name in (body, query.seat(body)) if name] + inside


def _step(step: ScriptStep, candidate: TaskCandidate, entries: list[Trim], nominal: bool, body: str = "") -> Step:
    """The step for this candidate, with evaluated figures and filled-in words. `body`: what a camera looks for; empty:
    the object."""
    known = {entry.n for entry in entries}
    index, count = step.trim
    asked = [] if not nominal else [n for n in range(index, index + count) if n in known]
    own = [entry.n for entry in entries if nominal and entry.n > MAX_ENTRIES]
    figures: dict[str, float | str] = {n: expressions.number(e, candidate.figures) for n, e in step.args.items()}
    words = {name: candidate.fill_in(word) for name, word in step.words.items()}
    camera, body = look.camera_for(step, candidate, body), body or candidate.body
    further = look.further_cameras(step, candidate, body, camera) if camera is not None else []
    if camera is not None:
        figures |= {"camera": camera.name, "body": body}
        figures |= {FURTHER: " ".join(further)} if further else {}
    in_words = " and ".join([camera.name, *further]) if camera is not None else ""
    return Step(
        do=step.do,
        label=candidate.fill_in(step.label.replace("{body}", body).replace("{camera}", in_words)),
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
        args={**figures, **{name: word for name, word in words.items() if word or name != "through"}},
    )


def _lost_arms(script: ScriptFile, candidate: TaskCandidate) -> list[str]:
    """The other arms whose joints are not trusted, with what they hold: a motion cannot be planned beside them."""
    query = candidate.query
    if candidate.hand is None or not any(step.do == "move" for step in script.steps):
        return []
    moving = {arm for primitive in query.moving for arm in primitive.paths}
    others = [arm.name for arm in query.cell.arms if arm.name not in {candidate.arm.name, *moving}]
    lost = [arm for arm in others if not query.trusts(f"{arm}.joints")]
    return [name for arm in lost for name in (arm, query.holding(arm)) if name]


def _sensed_first(compiled: Compiled, candidate: TaskCandidate, doubtful: list[str], others: list[str]) -> list[Step]:
    """Steps that sense untrusted facts of the arms, and what the plan relies on; they precede the steps of the script.
    `doubtful`: bodies that a camera can see. `others`: names of `_lost_arms`."""
    if candidate.hand is None:
        return []
    senses, pieces, trusts = compiled.program.senses, compiled.pieces, candidate.query.trusts
    of_arm = [name for name in senses if name not in (FRAME, GRASP)]
    steps = []
    for arm in (candidate.arm, *(arm for arm in candidate.query.cell.arms if arm.name in others)):
        unknown = [name for name in of_arm if not trusts(f"{arm.name}.{name}")]
        of_it = replace(candidate, hand=arm)
        steps += [
            _performed_by(arm.name, candidate, _step(step, of_it, [], nominal=False))
            for name in unknown
            for step in pieces[senses[name]].steps
        ]
    for body in doubtful:
        piece = pieces[senses[GRASP if candidate.query.held_by(body) else FRAME]]
        steps += [_step(step, candidate, [], nominal=False, body=body) for step in piece.steps]
    return steps


def _performed_by(arm: str, candidate: TaskCandidate, step: Step) -> Step:
    """The step, with the arm that performs it if it is not that of the command."""
    return step if arm == candidate.arm.name else msgspec.structs.replace(step, args={**step.args, "arm": arm})


MAX_ENTRIES = 100  # maximum size of a trimming stack; trims of the sentence (AND TRY) have higher numbers


def _trims(compiled: Compiled, script: ScriptFile, candidate: TaskCandidate) -> tuple[list[Trim], list[str]]:
    """The trimming stack, and notes about entries without a piece of script, which are left out."""
    entries: list[Trim] = []
    left_out: list[str] = []
    for entry in script.trimming_stack:
        piece = compiled.pieces.get(entry.skill)
        label = f"{entry.skill} {candidate.roles.get(entry.who, entry.who)}"
        if piece is None:
            left_out.append(f"trim {entry.n} ({label}) is left out: there is no piece of script for {entry.skill}")
            continue
        if any(step.who == CAMERA for step in piece.steps) and candidate.camera is None:
            left_out.append(f"trim {entry.n} ({label}) is left out: no camera can see {candidate.body}")
            continue
        steps = [_step(step, candidate, [], nominal=False) for step in piece.steps]
        entries.append(Trim(n=entry.n, label=label, steps=steps, then=entry.then, fits=entry.fits))
    for n, reflex in enumerate((r for r in candidate.parsed.reflexes if r.trim), MAX_ENTRIES + 1):
        name = (reflex.trim or "").lower()
        piece = compiled.pieces.get(name)
        if piece is None or script.case < FIRST_SKILL:
            raise _cannot_try(name.upper(), compiled, script)
        reason = reflexes.reason_of(reflex.condition)
        steps = [_step(step, candidate, [], nominal=False) for step in piece.steps]
        entries.append(Trim(n=n, label=f"TRY {name.upper()}", steps=steps, fits=[reason] if reason else []))
    return entries, left_out


# --- refusals --------------------------------------------------------------------------------------------


def _cannot_try(name: str, compiled: Compiled, script: ScriptFile) -> Refused:
    if script.case < FIRST_SKILL and name.lower() in compiled.pieces:
        message = f"AND TRY {name}: {script.script} is an action, and only skills are corrected on the way"
        return Refused(Refusal(reason=RefusalReason.NO_SCRIPT, message=message, where=name, clears="leave out AND TRY"))
    return suggestions.unknown("piece of script to TRY", name, [piece.upper() for piece in compiled.pieces])


def _wrong_program(message: str, where: str, clears: str = "") -> Refused:
    return Refused(Refusal(reason=RefusalReason.PROGRAM, message=message, where=where, clears=clears))


def _refuse_unmet(script: ScriptFile, candidate: TaskCandidate) -> None:
    for need in script.needs:
        preconditions.refuse_if_unmet(need, candidate)


def _refuse_unknown_place(_: ScriptFile, candidate: TaskCandidate) -> None:
    if (place := candidate.parsed.place) is not None and place.name:
        anchors.place(candidate.query, place.name)


def _refuse_unsure_grasp(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move a held object whose grasp is suspect (R151), and that no camera can sense before."""
    unsure = _why_unsure_grasp(script, candidate)
    if unsure is not None and not can_be_seen(unsure.where, candidate):
        raise Refused(unsure)


def _refuse_unsure_place(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a script for which the pose of the object is too uncertain, and that no camera finds before."""
    unplaced = _why_unsure_place(script, candidate)
    if unplaced is not None and not candidate.query.finds(candidate.body):
        raise Refused(unplaced)


def _why_unsure_grasp(script: ScriptFile, candidate: TaskCandidate) -> Refusal | None:
    """The refusal to move a held object whose grasp is suspect; None if it is not.

    Scripts that move only the fingers are allowed, and scripts with `despite_grasp`: backing off and letting go.
    """
    held = candidate.query.holding(candidate.hand.name) if candidate.hand else ""
    if not held or script.despite_grasp or not any(step.to for step in script.steps):
        return None
    return candidate.query.distrusted(f"{held}.grasp", candidate.program.clears)


def _refuse_nothing_held(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a condition about a held object that can never become true."""
    if candidate.hand is None:
        return
    parsed, arm = candidate.parsed, candidate.hand.name
    asked = [item.condition for item in parsed.reflexes] + (parsed.report.when if parsed.report else [])
    holding, closes = bool(candidate.query.holding(arm)), any(step.op == "close" for step in script.steps)
    for condition in asked:
        reflexes.refuse_without_grip(condition, arm, holding, closes)


def _refuse_too_tight(_: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a grip force that the hand does not have, before any motion."""
    grip_n, arm = candidate.limits.grip_force_n, candidate.hand
    if grip_n is None or arm is None or grip_n <= arm.gripper.max_force_n:
        return
    most_n = arm.gripper.max_force_n
    refusal = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"GRIP-FORCE {grip_n:g} N is asked for; {arm.end_effector} grips with {most_n:g} N at most",
        clears=f"GRIP-FORCE of at most {most_n:g} N",
        detail={"cause": "grip force", "value_n": grip_n, "limit_n": most_n, "arm": arm.name},
    )
    raise Refused(refusal)


#: The order of the checks of an option; the first one that fails is the reason. What is wrong with the sentence comes
#: first, then what the state of the world does not allow, then what is in doubt.
CHECKS: tuple[Callable[[ScriptFile, TaskCandidate], None], ...] = (
    command_fields.refuse_without_effect,
    _refuse_too_tight,
    _refuse_nothing_held,
    _refuse_unmet,
    _refuse_unknown_place,
    _refuse_unsure_grasp,
    hinged.refuse_other_motion,
    hinged.refuse_turn_of_hand,
    hinged.refuse_beyond_stops,
    two_hands.refuse_moving_alone,
    _refuse_unsure_place,
)
