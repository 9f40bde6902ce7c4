"""One camera as a performer: the looks it has accepted, each served by the next picture. Pure.

Looks are a queue that is served in turn: one picture is evaluated for every look whose next picture is due. So a camera
that follows a body for an hour still locates another one at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtc.perception.motion import Motion
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Sighting, StopReason
from rtc.robot import geometry
from rtc.robot.geometry import Array
from rtc.sensing import absence
from rtc.sensing.detector import Mark
from rtc.sensing.locate import Seen, locate
from rtc.sensing.optics import View
from rtc.sensing.pose_fit import Fit
from rtc.subsystem.subsystem import Reports, in_scope, not_begun

MOST_LOOKS = 16  # maximum number of looks of one camera at a time
RETRY_S = 0.2  # pause after a camera that gave no picture
BODY = "BODY"  # a look has one body, without a name


class Evaluated(NamedTuple):
    """A picture of a camera and the tags in it."""

    at_s: float  # time of its exposure
    view: View
    image: NDArray[np.uint8]
    marks: Sequence[Mark]


class LookTask:
    """One look: its pictures so far and its stop functions."""

    def __init__(self, primitive: p.Primitive, now_s: float) -> None:
        assert isinstance(primitive.trajectory, p.Look)
        self.primitive, self.look, self.began_s = primitive, primitive.trajectory, now_s
        self.tags = [_tag(tag) for tag in self.look.tags]
        self.due_s = now_s  # time of its next picture
        self.seen: list[Seen] = []  # pictures with the body, as many as its pose needs
        self.seen_s: float | None = None  # exposure of the latest picture with the body
        self.latest_s: float | None = None  # exposure of the latest picture
        self.first_s: float | None = None  # exposure of the first picture
        self.pictures = 0  # number of pictures with the body
        self.fit: Fit | None = None
        self.unseen = ""  # why the body is not in the latest picture
        self._motion = Motion()
        self._reported_s = now_s

    def take(self, picture: Evaluated) -> None:
        """Evaluate a picture, unless it was exposed before the look began."""
        if picture.at_s < self.began_s:
            return
        # The beat is kept, unless a picture is too late for it.
        self.due_s = max(self.due_s, picture.at_s - 0.5 * self.look.every_s) + self.look.every_s
        self.latest_s = picture.at_s
        self.first_s = picture.at_s if self.first_s is None else self.first_s
        new = Seen(picture.view, picture.marks)
        kept = [*self.seen, new] if self.look.duration_s is None else [new]
        shown = {tag.id for tag in self.tags} & {mark.tag for mark in picture.marks}
        found = locate(self.tags, kept).get(BODY) if shown else None
        if found is None:
            self.unseen = absence.cause(self.tags, self.look.believed, picture.view, picture.image).value
            return
        self.seen, self.fit, self.unseen = kept, found, ""
        self.seen_s = picture.at_s
        self.pictures += 1
        if self.look.duration_s is not None:
            self._motion.take(picture.at_s, found.pose)

    def progress(self, now_s: float) -> m.ProgressReport | None:
        """The periodic report, if one is due and the body has been seen since the last one."""
        every_s = self.primitive.reporting.every_s
        if every_s is None or self.seen_s is None or self.seen_s <= self._reported_s:
            return None
        if now_s - self._reported_s < 0.9 * every_s:
            return None
        self._reported_s = now_s
        return m.ProgressReport(primitive=self.primitive.id, at_s=now_s, sighting=self.sighting(now_s))

    def sighting(self, now_s: float) -> Sighting | None:
        if self.fit is None or self.seen_s is None:
            return None
        return Sighting(
            pose=self.fit.pose.tolist(),
            covariance=self.fit.covariance.ravel().tolist(),
            tags=sorted({one.tag for one in self.fit.used}),
            error_px=self.fit.best.error_px,
            age_s=max(0.0, now_s - self.seen_s),
            pictures=self.pictures,
            ambiguous=self.fit.ambiguous,
            velocity=self._motion.velocity(),
        )

    def ended(self, now_s: float, scale: float) -> tuple[p.StopFunction, float | None, float | None] | None:
        """The stop function that is true, with the measured value and its limit. `scale`: our seconds per second of
        the simulation, in which limits are stated."""
        for stop in self.primitive.by_priority():
            if (found := CHECKS[type(stop.when)](stop.when, self, now_s, scale)) is not None:
                return (stop, *found)
        return None


class _Place(NamedTuple):
    pose: Array


class _Tag(NamedTuple):
    """See `rtc.sensing.locate.TagOnBody`."""

    id: int
    body: str
    size_m: float
    frame: _Place


def _tag(tag: p.TagGeometry) -> _Tag:
    return _Tag(tag.id, BODY, tag.size_m, _Place(geometry.normalise(tag.pose)))


# --- F ---------------------------------------------------------------------------------------------------

Finding = tuple[float | None, float | None]


def _goal(when: p.GoalReached, task: LookTask, now_s: float, scale: float) -> Finding | None:
    duration_s = task.look.duration_s
    if duration_s is None:
        return (None, None) if task.pictures >= task.look.pictures else None
    return (None, None) if now_s - task.began_s >= duration_s * scale else None


def _time(when: p.TimeAbove, task: LookTask, now_s: float, scale: float) -> Finding | None:
    passed_s = (now_s - task.began_s) / scale
    return (passed_s, when.limit_s) if passed_s > when.limit_s else None


def _unseen(when: p.UnseenAbove, task: LookTask, now_s: float, scale: float) -> Finding | None:
    """It counts pictures without the body, not the time without pictures: a busy machine hides nothing."""
    since_s = task.first_s if task.seen_s is None else task.seen_s
    if since_s is None or task.latest_s is None:
        return None
    unseen_s = (task.latest_s - since_s) / scale
    return (unseen_s, when.limit_s) if unseen_s >= when.limit_s else None


#: what a camera can watch
CHECKS: Mapping[type, Callable[[Any, LookTask, float, float], Finding | None]] = {
    p.GoalReached: _goal,
    p.TimeAbove: _time,
    p.UnseenAbove: _unseen,
}


# --- the performer -----------------------------------------------------------------------------------------


class Camera:
    """Accepts looks, states when it wants a picture, and takes it. `scale`: see `LookTask.ended`."""

    def __init__(self, name: str, scale: float = 1.0) -> None:
        self.name, self._scale = name, scale
        self._looks: dict[str, LookTask] = {}
        self._failure = ""  # of the camera, since its latest picture
        self._halted: list[LookTask] = []  # whose end reports are not out

    @property
    def primitives(self) -> list[str]:
        return [*self._looks, *(task.primitive.id for task in self._halted)]

    @property
    def due_s(self) -> float | None:
        """When it wants its next picture; None: nothing to look for."""
        return min((task.due_s for task in self._looks.values()), default=None)

    def accept(self, primitive: p.Primitive, now_s: float) -> Reports:
        why = self._objection(primitive)
        if why:
            return [not_begun(primitive.id, self.name, why, at_s=now_s)]
        self._looks[primitive.id] = LookTask(primitive, now_s)
        return [m.Started(primitive=primitive.id, at_s=now_s)]

    def _objection(self, primitive: p.Primitive) -> str:
        if not isinstance(primitive.trajectory, p.Look):
            return f"{self.name} is a camera; it cannot execute a {type(primitive.trajectory).__name__}"
        if len(self._looks) >= MOST_LOOKS:
            return f"{self.name} has {MOST_LOOKS} looks already"
        unknown = [type(stop.when).__name__ for stop in primitive.stop_functions if type(stop.when) not in CHECKS]
        if unknown:
            return f"a camera cannot watch {', '.join(unknown)}"
        finite = [*primitive.trajectory.believed, *(n for tag in primitive.trajectory.tags for n in tag.pose)]
        if len(primitive.trajectory.believed) != 7 or not np.isfinite(finite).all():
            return "the look has a pose that is not 7 finite numbers"
        return ""

    def take(self, picture: Evaluated) -> None:
        self._failure = ""
        for task in self._looks.values():
            if task.due_s <= picture.at_s:
                task.take(picture)

    def fail(self, why: str, now_s: float) -> None:
        """The camera gave no picture. Its looks try again until their time limits."""
        self._failure = why
        for task in self._looks.values():
            task.due_s = now_s + RETRY_S

    def tick(self, now_s: float) -> Reports:
        out: list[m.ProgressReport | m.EndReport] = []
        out += [self._report(task, StopReason.HALT, now_s) for task in self._halted]
        self._halted.clear()
        for name, task in list(self._looks.items()):
            if (report := task.progress(now_s)) is not None:
                out.append(report)
            if (ended := task.ended(now_s, self._scale)) is not None:
                stop, measured, limit = ended
                del self._looks[name]
                out.append(self._report(task, stop.reason, now_s, measured, limit))
        return out

    def halt(self, scope: str) -> bool:
        """End the looks in the scope of a halt with the next tick. True if there was one."""
        halted = [name for name in self._looks if in_scope(scope, self.name, name)]
        self._halted += [self._looks.pop(name) for name in halted]
        return bool(halted)

    def _report(
        self,
        task: LookTask,
        reason: StopReason,
        now_s: float,
        measured: float | None = None,
        limit: float | None = None,
    ) -> m.EndReport:
        return m.EndReport(
            primitive=task.primitive.id,
            performer=self.name,
            reason=reason,
            at_s=now_s,
            duration_s=(now_s - task.began_s) / self._scale,
            measured=measured,
            limit=limit,
            message=self._failure or task.unseen or ("" if task.pictures else "no picture was taken in time"),
            sighting=task.sighting(now_s),
        )
