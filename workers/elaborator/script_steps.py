"""The parts of a script for one candidate: steps with their figures, trims, context, names of resources. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import msgspec
from msgspec.structs import replace

from rtc.programs import expressions, step_kinds
from rtc.programs.extension_names import CAMERA, PARTNER
from rtc.programs.recovery import RESERVE
from rtc.programs.schema import ElaboratorProgram, ScriptFile, ScriptPiece, ScriptStep
from rtc.programs.step_kinds import kind_of, step_of
from rtc.protocol.messages import ScriptContext, Step, Trim, TrimOffer
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from workers.conditions import reflexes
from workers.elaborator.backtrack import FRAME, GRASP
from workers.elaborator.figures import of_partner
from workers.elaborator.script_checks import NEEDS
from workers.elaborator.script_options import ScriptOption
from workers.mechanisms import each, joined
from workers.planning import segments, suggestions
from workers.tasks.candidate import TaskCandidate


@dataclass(frozen=True)
class Compiled:
    program: ElaboratorProgram
    scripts: dict[str, ScriptFile]
    pieces: dict[str, ScriptPiece]
    attributes: dict[str, list[str]]  # that a script and its pieces use, by script


#: performer of a step -> the cameras that look for a body
PERFORMERS = joined(lambda mechanism: mechanism.performers)
INSTEAD = each(lambda mechanism: mechanism.instead)
FIRST_SKILL = 3  # cases 1 and 2 are actions, cases 3 and 4 are skills (R76)
FIGURES = {kind: step_kinds.figures_of(kind) for kind in get_args(Step)}
ENDS = "ends"  # word of a step that UNTIL ends; another one that watches it may end otherwise too
STRAINS = each(lambda mechanism: mechanism.strains)
MAX_ENTRIES = 100  # maximum size of a trimming stack; trims of the sentence (AND TRY) have higher numbers


def step_for(step: ScriptStep, candidate: TaskCandidate, entries: list[Trim], nominal: bool, body: str = "") -> Step:
    """The step for this candidate, with evaluated figures and filled-in words. `body`: what a camera looks for; empty:
    the object."""
    if step.who == PARTNER:
        made = step_for(msgspec.structs.replace(step, who="active_arm"), of_partner(candidate), entries, nominal, body)
        return msgspec.structs.replace(made, who=PARTNER, arm=of_partner(candidate).arm.name)
    known = {entry.n for entry in entries}
    index, count = step.trim
    asked = [] if not nominal else [n for n in range(index, index + count) if n in known]
    own = [entry.n for entry in entries if nominal and entry.n > MAX_ENTRIES]
    numbers = {name: expressions.number(e, candidate.figures) for name, e in step.args.items()}
    figures = {name: numbers.pop(name) for name in step.args if name in FIGURES[kind_of(step)]}
    words: dict[str, Any] = {name: candidate.fill_in(word) for name, word in step.words.items()}
    if "through" in words:
        words["through"] = words["through"].split()
    expect, until = step.expect, candidate.parsed.until
    if until is not None and (word := step.words.get("until")):
        reason = reflexes.reason_of(until)
        assert reason is not None, until  # others were refused
        expect = [reason] if word == ENDS else [*expect, reason]
    body = body or candidate.body
    cameras = PERFORMERS[step.who](step, candidate, body) if step.who in PERFORMERS else []
    looks = {"cameras": cameras, "body": body if cameras else ""} if step.who in PERFORMERS else {}
    return step_of(
        step,
        label=candidate.fill_in(step.label.replace("{body}", body).replace("{camera}", " and ".join(cameras))),
        who=step.who,
        expect=expect,
        keep=step.keep,
        trims=[*asked, *own],
        overrides=numbers,
        extra=step.extra,
        **looks,
        **words,
        **figures,
    )


def through_places(script: ScriptFile, candidate: TaskCandidate) -> ScriptFile:
    """The script for this candidate: two arms go straight to each place of THROUGH, where one arm follows a spline."""
    vias = candidate.vias
    if not vias or not any(step.space == segments.BOTH for step in script.steps):
        return script
    steps: list[ScriptStep] = []
    for step in script.steps:
        if step.space == segments.BOTH and "through" in step.words:
            words = {name: word for name, word in step.words.items() if name != "through"}
            places = zip(vias, candidate.parsed.through, strict=True)
            steps += [
                msgspec.structs.replace(step, to=via, words=words, label=f"{step.label}, by way of {place}")
                for via, place in places
            ]
            step = msgspec.structs.replace(step, words=words)
        steps.append(step)
    return msgspec.structs.replace(script, steps=steps)


def trims_for(compiled: Compiled, script: ScriptFile, candidate: TaskCandidate) -> tuple[list[Trim], list[str]]:
    """The trimming stack, and notes about entries without a piece of script, which are left out."""
    entries: list[Trim] = []
    left_out: list[str] = []
    roles = candidate.roles
    for entry in script.trimming_stack:
        piece = compiled.pieces.get(entry.skill)
        label = f"{entry.skill} {roles.get(entry.who, entry.who)}"
        if piece is None:
            left_out.append(f"trim {entry.n} ({label}) is left out: there is no piece of script for {entry.skill}")
            continue
        if _looks(_own_steps(piece, candidate) or piece.steps) and candidate.camera is None:
            left_out.append(f"trim {entry.n} ({label}) is left out: no camera can see {candidate.body}")
            continue
        try:
            steps = _steps_of(piece, candidate)
        except expressions.ExpressionError as error:
            if not entry.drift:
                raise
            left_out.append(f"trim {entry.n} ({label}) is left out: {error}")  # a drift is shown all the same
            continue
        entries.append(Trim(n=entry.n, label=label, steps=steps, then=entry.then, fits=entry.fits))
    for n, reflex in enumerate((r for r in candidate.parsed.reflexes if r.trim), MAX_ENTRIES + 1):
        name = (reflex.trim or "").lower()
        piece = compiled.pieces.get(name)
        if piece is None or script.case < FIRST_SKILL or not _fits(piece, script, candidate):
            raise _cannot_try(name.upper(), compiled, script, candidate)
        reason = reflexes.reason_of(reflex.condition)
        steps = _steps_of(piece, candidate)
        entries.append(Trim(n=n, label=f"TRY {name.upper()}", steps=steps, fits=[reason] if reason else []))
    if script.case >= FIRST_SKILL:
        _add_reserve(compiled, script, candidate, entries, left_out)
    return entries, left_out


def _add_reserve(
    compiled: Compiled, script: ScriptFile, candidate: TaskCandidate, entries: list[Trim], left_out: list[str]
) -> None:
    """The entries of `reserve` whose pieces can be tried in this script; notes about the others."""
    roles = candidate.roles
    for n, entry in enumerate(compiled.program.reserve, RESERVE + 1):
        piece = compiled.pieces[entry.skill]
        label = f"{entry.skill} {roles.get(entry.who, entry.who)}"
        if _fits(piece, script, candidate):
            steps = _steps_of(piece, candidate)
            entries.append(Trim(n=n, label=label, steps=steps, then=entry.then, fits=entry.fits))
        else:
            left_out.append(f"trim {n} ({label}) is left out: {candidate.parsed.verb} has no use for it")


def _steps_of(piece: ScriptPiece, candidate: TaskCandidate) -> list[Step]:
    return [step_for(step, candidate, [], nominal=False) for step in _own_steps(piece, candidate)]


def _own_steps(piece: ScriptPiece, candidate: TaskCandidate) -> list[ScriptStep]:
    """The steps of a piece without those of a second arm that the command lacks, and without a look that may also find
    nothing, if no camera can see the object."""
    own = [step for step in piece.steps if step.who != PARTNER or candidate.partner is not None]
    if not _looks(own) or (candidate.body and candidate.camera is not None):
        return own
    return [step for step in own if step.who != CAMERA or StopReason.NOT_SEEN not in step.expect]


def _looks(steps: list[ScriptStep]) -> bool:
    return any(step.who == CAMERA for step in steps)


def _fits(piece: ScriptPiece, script: ScriptFile, candidate: TaskCandidate) -> bool:
    """Whether a piece can be tried in a script: its plan has the poses, its verb the figures that the piece needs."""
    poses = {"", "HERE", *(line.name for line in script.plan)}
    own = _own_steps(piece, candidate)
    figures = {name for step in own for value in step.args.values() for name in expressions.names(str(value))}
    blind = _looks(own) and (not candidate.body or candidate.camera is None)
    nowhere = candidate.target is None and any("{way_out}" in step.words.get("axis", "") for step in own)
    bound = all({step.to, step.words.get("about", "")} <= poses for step in own)
    known = figures <= candidate.figures.keys()
    if not own or any(strains(own, candidate) for strains in STRAINS):
        return False
    return bound and known and not (blind or nowhere)


def _cannot_try(name: str, compiled: Compiled, script: ScriptFile, candidate: TaskCandidate) -> Refused:
    if script.case < FIRST_SKILL and name.lower() in compiled.pieces:
        message = f"AND TRY {name}: {script.script} is an action, and only skills are corrected on the way"
        return Refused.because(RefusalReason.NO_SCRIPT, message, where=name, clears="leave out AND TRY")
    if name.lower() in compiled.pieces:
        able = [piece.skill.upper() for piece in compiled.pieces.values() if _fits(piece, script, candidate)]
        message = f"AND TRY {name}: {candidate.parsed.verb} has no use for it"
        clears = f"AND TRY {' or '.join(able)}, or without AND TRY"
        return Refused.because(RefusalReason.NO_SCRIPT, message, where=name, expected=able, clears=clears)
    return suggestions.unknown("piece of script to TRY", name, [piece.upper() for piece in compiled.pieces])


def lost_arms(script: ScriptFile, candidate: TaskCandidate) -> list[str]:
    """The other arms whose joints are not trusted, with what they hold: a motion cannot be planned beside them."""
    query = candidate.query
    if candidate.hand is None or not any(step.do == "move" for step in script.steps):
        return []
    moving = {arm for primitive in query.moving for arm in primitive.paths}
    others = [arm.name for arm in query.cell.arms if arm.name not in {candidate.arm.name, *moving}]
    lost = [arm for arm in others if not query.trusts(f"{arm}.joints")]
    return [name for arm in lost for name in (arm, query.holding(arm)) if name]


def sensed_first(compiled: Compiled, candidate: TaskCandidate, doubtful: list[str], others: list[str]) -> list[Step]:
    """Steps that sense untrusted facts of the arms, and what the plan relies on; they precede the steps of the script.
    `doubtful`: bodies that a camera can see. `others`: names of `lost_arms`."""
    if candidate.hand is None:
        return []
    senses, pieces, trusts = compiled.program.senses, compiled.pieces, candidate.query.trusts
    of_arm = [name for name in senses if name not in (FRAME, GRASP)]
    steps = []
    for arm in (candidate.arm, *(arm for arm in candidate.query.cell.arms if arm.name in others)):
        unknown = [name for name in of_arm if not trusts(f"{arm.name}.{name}")]
        steps += [
            _performed_by(arm.name, candidate, step_for(step, replace(candidate, hand=arm), [], nominal=False))
            for name in unknown
            for step in pieces[senses[name]].steps
        ]
    for body in doubtful:
        piece = pieces[senses[GRASP if candidate.query.held_by(body) else FRAME]]
        steps += [step_for(step, candidate, [], nominal=False, body=body) for step in piece.steps]
    return steps


def _performed_by(arm: str, candidate: TaskCandidate, step: Step) -> Step:
    """The step, with the arm that performs it if it is not that of the command."""
    return step if arm == candidate.arm.name else msgspec.structs.replace(step, arm=arm)


def _offers(compiled: Compiled, script: ScriptFile, entries: list[Trim]) -> dict[int, TrimOffer]:
    """The pieces of the entries of the script and of `reserve`; those of the sentence are for its own events."""
    skills = {entry.n: entry.skill for entry in script.trimming_stack}
    skills |= {n: entry.skill for n, entry in enumerate(compiled.program.reserve, RESERVE + 1)}
    return {entry.n: TrimOffer(skill=skills[entry.n], then=entry.then) for entry in entries if entry.n in skills}


def context_for(
    compiled: Compiled, script: ScriptFile, option: ScriptOption, candidate: TaskCandidate, entries: list[Trim]
) -> ScriptContext:
    known = {entry.n for entry in entries}
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
        until=candidate.parsed.until,
        report=candidate.parsed.report,
        fits={entry.n: entry.fits for entry in entries if entry.fits},
        if_drifting=next((entry.n for entry in script.trimming_stack if entry.drift and entry.n in known), 0),
        offers=_offers(compiled, script, entries),
        by_operator=by_operator(compiled, candidate),
    )


def by_operator(compiled: Compiled, candidate: TaskCandidate) -> str:
    """The sentence that asks a mechanism for what the script does not achieve; empty if none does it."""
    asked = (instead(compiled.program, compiled.scripts, candidate, NEEDS) for instead in INSTEAD)
    return next(filter(None, asked), "")


def names_by_role(candidate: TaskCandidate) -> dict[str, list[str]]:
    """The names that each role stands for."""
    query, thing = candidate.query, candidate.thing.name if candidate.thing else ""
    stands_for = {name: [role] for name, role in candidate.roles.items()}
    stands_for["its_seat"] = [query.seat(thing)] if thing else []
    stands_for["its_holder"] = [query.held_by(thing)] if thing else []
    stands_for["its_content"] = query.inside(candidate.seat.name) if candidate.seat is not None else []
    stands_for["its_parts"] = with_seats(candidate, [thing]) if query.cell.mounted(thing) else []
    return stands_for


def names_of(roles: list[str], stands_for: dict[str, list[str]], held: str) -> list[str]:
    """The names of these roles; includes the held object, because it moves with the arm."""
    found = [name for role in roles for name in stands_for.get(role, [role])]
    return list(dict.fromkeys(name for name in (*found, held) if name))


def with_seats(candidate: TaskCandidate, doubtful: list[str]) -> list[str]:
    """These bodies with what is mounted on them, their seats, and what is in these seats."""
    query = candidate.query
    bodies = [name for body in doubtful for name in (body, *(part.name for part in query.cell.mounted(body)))]
    inside = [thing.name for thing in query.cell.objects if query.seat(thing.name) in bodies]
    return [name for body in bodies for name in (body, query.seat(body)) if name] + inside
