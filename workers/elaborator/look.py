"""Cameras of commands: candidates of those that only cameras perform, and the cameras of a step that looks. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from rtc.language.hands import hand_in_words
from rtc.model.cells import parts
from rtc.programs.extension_names import CAMERA
from rtc.programs.schema import ElaboratorProgram, ScriptFile, ScriptStep
from rtc.protocol import causes
from rtc.protocol.advice import Advice, fill_in
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import ParsedCommand
from workers.elaborator.figures import with_figures
from workers.planning import sight, suggestions, trust
from workers.planning.world_query import WorldQuery
from workers.tasks import object_attributes
from workers.tasks.candidate import TaskCandidate

MAX_FURTHER = 3  # maximum number of cameras beside the best one


def candidates(
    program: ElaboratorProgram,
    scripts: Mapping[str, ScriptFile],
    parsed: ParsedCommand,
    limits: Limits,
    query: WorldQuery,
) -> list[TaskCandidate]:
    """A camera that the sentence names looks in any case; else those that can see the body where it is believed.

    Raises Refused."""
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
    target = next((one for one in cell.seats if one.name == parsed.target), None)
    if parsed.target is not None and target is None:
        raise suggestions.unknown("seat", parsed.target, [one.name for one in cell.seats])
    cameras = _cameras(program, parsed, query, name)
    alone = TaskCandidate(query, program, parsed, limits, None, None, None, None, {})
    figures = with_figures(alone).figures | object_attributes.figures(program, query, thing)
    return [
        TaskCandidate(query, program, parsed, limits, None, thing, None, target, figures, camera, seat)
        for camera in cameras
    ]


def camera_for(step: ScriptStep, candidate: TaskCandidate, body: str) -> parts.Camera | None:
    """The camera that looks for the body and reports; empty `body`: the object. None: it is not a step of a camera."""
    if step.who != CAMERA:
        return None
    return candidate.camera if body in ("", candidate.body) else candidate.query.cameras(body)[0]


def further_cameras(step: ScriptStep, candidate: TaskCandidate, body: str, camera: parts.Camera) -> list[str]:
    """The other cameras that can see the body, if the sentence names none: together they measure its distance better.
    Only one camera can follow a body."""
    if "duration_s" in step.args or candidate.parsed.performer is not None:
        return []
    return [other.name for other in candidate.query.cameras(body) if other.name != camera.name][:MAX_FURTHER]


def _cameras(program: ElaboratorProgram, parsed: ParsedCommand, query: WorldQuery, body: str) -> list[parts.Camera]:
    known = {camera.name: camera for camera in query.cell.cameras}
    if parsed.performer is None:
        if not (able := query.cameras(body)):
            raise _unseen(program, query, body, list(known))
        return able
    if parsed.performer not in known:
        raise suggestions.unknown("camera", parsed.performer, known)
    return [known[parsed.performer]]


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
