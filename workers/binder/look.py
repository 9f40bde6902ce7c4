"""A look as a primitive: the tags of a body, for one camera, with the place where the body should be. Pure.

The primitive contains no name of the body (R15); the analyzer has it from the evaluation.
"""

from __future__ import annotations

from rtc.programs.schema import StopClass
from rtc.protocol.messages import BinderInput, BoundStep, EvaluationContext
from rtc.protocol.primitive import Look, Primitive, Reporting, TagGeometry
from workers.binder.bind_task import refuse_if_endless, refused_program
from workers.conditions import stop_conditions
from workers.conditions.looking import cameras_of
from workers.conditions.stop_conditions import Values
from workers.planning import sight, suggestions
from workers.planning.world_query import WorldQuery

SUBSYSTEM = "S&P"


def bind(query: WorldQuery, data: BinderInput, stop_class: StopClass, values: Values) -> BoundStep:
    """Args of the step: `camera`, `body`; `pictures`, or `duration_s` to follow the body every `every_s`; `further`:
    other cameras, with blanks between."""
    args, context = data.step.args, data.context
    cameras, body = cameras_of(data.step), str(args.get("body", ""))
    known = [one.name for one in query.cell.cameras]
    if unknown := [name for name in cameras if name not in known] or ([""] if not cameras else []):
        raise suggestions.unknown("camera", unknown[0], known)
    tags = sight.tags(query.cell, body)
    if not tags:
        raise refused_program(f"a step looks for {body or 'nothing'}, which has no tags", "tags of it in the cell file")
    follows = "duration_s" in values
    picture_s = values["picture_s"]
    predicted_s = values["duration_s"] if follows else values["pictures"] * picture_s * len(cameras)
    limit_s = values["time_factor"] * predicted_s + values["time_margin_s"]
    if context.limits.time_s is not None:
        limit_s = min(limit_s, context.limits.time_s)
    look = Look(
        tags=[TagGeometry(id=tag.id, size_m=tag.size_m, pose=tag.frame.pose.tolist()) for tag in tags],
        believed=query.pose(body).tolist(),
        pictures=1 if follows else round(values["pictures"]),
        duration_s=values["duration_s"] if follows else None,
        every_s=values["every_s"],
        cameras=cameras[1:],
    )
    refuse_if_endless(limit_s)
    every_s = args.get("report_every_s")
    made = Primitive(
        id=data.primitive_id,
        performer=cameras[0],
        trajectory=look,
        stop_functions=stop_conditions.stop_functions(
            stop_class.stops, {**values, "time_limit_s": limit_s}, None, [], stop_conditions.Line(None, None)
        ),
        reporting=Reporting(every_s=float(every_s) if every_s is not None else None),
    )
    evaluation = EvaluationContext(
        context=context,
        step=data.step,
        predicted_s=predicted_s,
        body=body,
        body_pose=_place(query, data),
    )
    return BoundStep(
        subsystem=SUBSYSTEM,
        primitive=made,
        evaluation=evaluation,
        predicted_s=predicted_s,
        limit_s=values["report_factor"] * limit_s + values["report_margin_s"],
    )


def _place(query: WorldQuery, data: BinderInput) -> list[float] | None:
    """Where the body should be: seated in the seat that the step names; None: the step checks nothing."""
    seat = data.step.args.get("seat")
    return query.seated_pose(seat).tolist() if isinstance(seat, str) and seat else None
