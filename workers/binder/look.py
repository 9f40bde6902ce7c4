"""A look as a primitive: the tags of a body, for one camera, with the place where the body should be. Pure.

The primitive contains no name of the body (R15); the analyzer has it from the evaluation.
"""

from __future__ import annotations

from rtc.protocol.messages import BoundStep, EvaluationContext
from rtc.protocol.primitive import Look, TagGeometry
from workers.binder import assemble
from workers.binder.bind_task import RuledTask, refused_program
from workers.conditions.stop_conditions import Values
from workers.planning import sight, suggestions


def bind(task: RuledTask) -> BoundStep:
    """Figures of the step: `pictures`, or `duration_s` to follow the body every `every_s`. Raises Refused."""
    cameras, body, values = _cameras(task), task.data.step.body, task.values
    follows_s = values.get("duration_s")
    evaluation = EvaluationContext(
        context=task.data.context,
        step=task.data.step,
        predicted_s=_lasts_s(values, len(cameras)) if follows_s is None else follows_s,
        body=body,
        body_pose=_place(task),
    )
    look = Look(
        tags=_tags(task, body),
        believed=task.query.pose(body).tolist(),
        pictures=round(values["pictures"]) if follows_s is None else 1,
        duration_s=follows_s,
        every_s=values["every_s"],
        cameras=cameras[1:],
    )
    return assemble.of_camera(task, look, cameras[0], evaluation)


def _lasts_s(values: Values, cameras: int) -> float:
    """Of a look for a body at rest. The pictures of a camera are `every_s` apart. Those of all cameras are drawn, and
    searched, one after the other."""
    round_s = cameras * values["picture_s"]
    return round_s + (values["pictures"] - 1.0) * max(values["every_s"], round_s)


def _cameras(task: RuledTask) -> list[str]:
    cameras, known = task.data.step.cameras, [camera.name for camera in task.query.cell.cameras]
    for name in cameras or [""]:
        if name not in known:
            raise suggestions.unknown("camera", name, known)
    own = {name: task.query.cell.subsystem_of(name) for name in cameras}  # one subsystem fits a pose to all
    return [name for name in cameras if own[name] == own[cameras[0]]]


def _tags(task: RuledTask, body: str) -> list[TagGeometry]:
    tags = sight.tags(task.query.cell, body)
    if not tags:
        raise refused_program(f"a step looks for {body or 'nothing'}, which has no tags", "tags of it in the cell file")
    return [TagGeometry(id=tag.id, size_m=tag.size_m, pose=tag.frame.pose.tolist()) for tag in tags]


def _place(task: RuledTask) -> list[float] | None:
    """Where the body should be: seated in the seat that the step names; None: the step checks nothing."""
    seat = task.data.step.words.seat
    return task.query.seated_pose(seat).tolist() if seat else None
