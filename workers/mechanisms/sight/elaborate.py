"""Cameras of commands: candidates of those that only cameras perform, and the cameras of a step that looks. Pure."""

from __future__ import annotations

from rtc.language.hands import hand_in_words
from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptStep
from rtc.protocol import causes
from rtc.protocol.advice import Advice, fill_in
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from workers.planning import sight, suggestions, trust
from workers.planning.world_query import WorldQuery
from workers.tasks.candidate import AskedTask, TaskCandidate

MAX_FURTHER = 3  # maximum number of cameras beside the best one


def candidates(asked: AskedTask) -> list[TaskCandidate]:
    """A camera that the sentence names looks in any case; else those that can see the body where it is believed.

    Raises Refused."""
    program, parsed, query = asked.program, asked.parsed, asked.query
    cell, name = query.cell, parsed.object or ""
    report = parsed.report
    if report is not None and (set(report.items) - {"POSE"} or report.when):
        message = f"a camera reports the pose of {name}; it has neither joints nor forces, nor conditions of an arm"
        raise Refused.because(RefusalReason.NO_SCRIPT, message, where="REPORT", clears="REPORT POSE")
    thing = next((one for one in cell.objects if one.name == name), None)
    seat = next((one for one in cell.seats if one.name == name), None)
    if thing is None and seat is None:
        known = [*(one.name for one in cell.objects), *(one.name for one in cell.seats)]
        raise suggestions.unknown("object or seat", name, known)
    if not sight.tags(cell, name):
        raise _without_tags(program, query, name)
    target = None if parsed.target is None else suggestions.part(cell.seats, parsed.target, "seat")
    return [
        TaskCandidate(query, program, parsed, asked.limits, None, thing, None, target, {}, camera, seat)
        for camera in _cameras(program, parsed, query, name)
    ]


def cameras(step: ScriptStep, candidate: TaskCandidate, body: str) -> list[str]:
    """The camera that looks for the body and reports, and others that can see it, if the sentence names none: together
    they measure its distance better. Only one camera can follow a body."""
    query = candidate.query
    camera = candidate.camera if body == candidate.body else query.cameras(body)[0]
    if camera is None:
        return []
    alone = "duration_s" in step.args or candidate.parsed.performer is not None
    others = [] if alone else [other.name for other in query.cameras(body) if other.name != camera.name]
    return [camera.name, *others[:MAX_FURTHER]]


def _cameras(program: ElaboratorProgram, parsed: ParsedCommand, query: WorldQuery, body: str) -> list[parts.Camera]:
    if parsed.performer is not None:
        return [suggestions.part(query.cell.cameras, parsed.performer, "camera")]
    if not (able := query.cameras(body)):
        raise _unseen(program, query, body, [camera.name for camera in query.cell.cameras])
    return able


def _without_tags(program: ElaboratorProgram, query: WorldQuery, body: str) -> Refused:
    carrier = query.bodies.get(body, "")
    row = "no_tags_on" if carrier and sight.tags(query.cell, carrier) else "no_tags"
    return Refused.because(
        RefusalReason.INFEASIBLE,
        f"{body} has no tags, by which a camera could find it",
        where=body,
        expected=sight.bodies(query.cell),
        clears=_advice(program, row, body, carrier=carrier),
        cause=causes.NoTags(body=body),
    )


def _unseen(program: ElaboratorProgram, query: WorldQuery, body: str, known: list[str]) -> Refused:
    """No camera can see the body where it is believed; one that is named looks all the same."""
    place = trust.shown_at(query, body)
    row = "out_of_view_held" if place else "out_of_view" if known else "no_cameras"
    words = {"cameras": ", ".join(known), "place": place, "holder": hand_in_words(query.held_by(body))}
    return Refused.because(
        RefusalReason.INFEASIBLE,
        f"no camera can see {body} where it is believed to be",
        where=body,
        clears=_advice(program, row, body, **words),
        cause=causes.OutOfView(body=body),
    )


def _advice(program: ElaboratorProgram, row: str, body: str, **words: str) -> Advice:
    return fill_in(program.clears.get(row, []), {"location": body, **words})
