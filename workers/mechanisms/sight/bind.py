"""A look as a primitive: the tags of a body, for one camera, with the place where the body should be. Pure.

The primitive contains no name of the body (R15); the analyzer has it from the evaluation.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

from rtc.protocol.messages import BoundStep, EvaluationContext, LookStep, PictureTime
from rtc.protocol.primitive import Look, TagGeometry
from rtc.sensing import optics
from rtc.sensing.windows import windows
from workers.planning import sight, suggestions
from workers.tasks import assemble
from workers.tasks.bind_task import BindTask, RuledTask, refused_program


def bind_look(task: BindTask) -> BoundStep:
    """Figures of the step: `pictures`, or `duration_s` to follow the body every `every_s`. Raises Refused."""
    step = task.data.step.of_kind(LookStep)
    ruled = task.under(step.stop)
    cameras, body, values, follows_s = _cameras(ruled), step.body, ruled.values, step.duration_s
    evaluation = EvaluationContext(
        context=ruled.data.context,
        step=step,
        predicted_s=_lasts_s(ruled, _in_turn(ruled, cameras), body) if follows_s is None else follows_s,
        body=body,
        body_pose=_place(ruled),
    )
    look = Look(
        tags=_tags(ruled, body),
        believed=ruled.query.pose(body).tolist(),
        pictures=round(values["pictures"]) if follows_s is None else 1,
        duration_s=follows_s,
        every_s=values["every_s"] if follows_s is None else _followed_every_s(ruled),
        cameras=cameras[1:],
    )
    return assemble.of_camera(ruled, look, cameras[0], evaluation)


def _followed_every_s(task: RuledTask) -> float:
    """Time between pictures of a body that is followed: two for each periodic report, within the program's bounds."""
    values, report = task.values, task.data.context.report
    reported_s = report.every_s if report else None
    if reported_s is None:
        return values["every_s"]
    return min(max(values["every_s"], 0.5 * reported_s), values["most_every_s"])


def _lasts_s(task: RuledTask, cameras: Sequence[str], body: str) -> float:
    """Of a look for a body at rest that all its cameras see. Their pictures are drawn, and searched, one after the
    other; those of one camera are `every_s` apart. All but the first are windows, one around each tag."""
    values, known, query = task.values, task.data.pictures, task.query
    windows_s = [one.window_s for one in known.values() if one.window_s is not None]
    typical_s = fmean(one.whole_s for one in known.values()) if known else values["picture_s"]
    typical_window_s = fmean(windows_s) if windows_s else values["window_s"]
    passed_s = 0.0 if known else values["start_s"]
    first_s, further_s, due_s = {}, {}, dict.fromkeys(cameras, 0.0)
    for name in cameras:
        camera, time = query.cell.camera(name), known.get(name, PictureTime(whole_s=typical_s))
        view = optics.view(camera, query.tcp(camera.arm) if camera.arm else None)
        parts = len(windows(sight.tags(query.cell, body), query.pose(body), view))
        window_s = typical_window_s if time.window_s is None else time.window_s
        first_s[name], further_s[name] = time.whole_s, parts * window_s if parts else time.whole_s
    for n in range(round(values["pictures"])):
        for name in cameras:
            passed_s = max(passed_s, due_s[name])
            due_s[name] = passed_s + values["every_s"]
            passed_s += further_s[name] if n else first_s[name]
    return passed_s


def _in_turn(task: RuledTask, cameras: Sequence[str]) -> list[str]:
    """In the order in which their subsystem takes the first picture of each."""
    return [camera.name for camera in task.query.cell.cameras if camera.name in cameras]


def _cameras(task: RuledTask) -> list[str]:
    cameras, known = task.data.step.of_kind(LookStep).cameras, [camera.name for camera in task.query.cell.cameras]
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
    seat = task.data.step.of_kind(LookStep).seat
    return task.query.seated_pose(seat).tolist() if seat else None
