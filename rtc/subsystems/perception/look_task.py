"""One look as it is executed: the pictures of its cameras so far, the pose fitted to them, its stop functions. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Measured, Sighting
from rtc.sensing import absence, rest
from rtc.sensing.detector import Mark
from rtc.sensing.locate import Seen, locate
from rtc.sensing.optics import View, Window
from rtc.sensing.pose_fit import Fit
from rtc.sensing.windows import windows
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.perception.motion import Motion

BODY = "BODY"  # a look has one body, without a name
# How long a look for a body at rest waits for it. What a stopped arm holds swings for some tenths of a second.
SETTLES_S = 2.0

Windows = Mapping[int, Window]  # parts of a picture by the tag that is expected there


class Evaluated(NamedTuple):
    """A picture of a camera and the tags in it."""

    at_s: float  # time of its exposure
    view: View
    image: NDArray[np.uint8] | None  # None: only windows of it were taken
    marks: Sequence[Mark]


class _Side:
    """The pictures of one camera for one look."""

    def __init__(self, due_s: float) -> None:
        self.due_s = due_s  # time of its next picture
        self.seen: list[Seen] = []  # pictures with the body, as many as its pose needs
        self.view: View | None = None  # of the latest picture
        self.seen_s: float | None = None  # exposure of the latest picture with the body
        self.latest_s: float | None = None  # exposure of the latest picture
        self.first_s: float | None = None  # exposure of the first picture
        self.unseen = ""  # why the body is not in the latest picture
        self.failure = ""  # why there is not a picture
        self.motion = Motion()  # of the body, by the pictures of this camera: their common errors do not matter

    @property
    def settles(self) -> bool:
        """Whether the body moves in its pictures, and has not had the time to come to rest."""
        if self.latest_s is None or self.first_s is None or self.latest_s - self.first_s >= SETTLES_S:
            return False
        return rest.moves(self.motion.velocity())

    def unseen_s(self) -> float | None:
        """It counts pictures without the body, not the time without pictures: a busy machine hides nothing."""
        since_s = self.first_s if self.seen_s is None else self.seen_s
        return None if since_s is None or self.latest_s is None else self.latest_s - since_s


class LookTask:
    """One look of one or several cameras."""

    def __init__(self, primitive: p.Primitive, now_s: float) -> None:
        assert isinstance(primitive.trajectory, p.Look)
        self.primitive, self.look, self.began_s = primitive, primitive.trajectory, now_s
        self.tags = [_tag(tag) for tag in self.look.tags]
        self.pictures = 0  # number of pictures with the body
        self.fit: Fit | None = None
        self.halted = False
        self.over = False  # its end report is out
        self._sides = {camera: _Side(now_s) for camera in primitive.performers}
        self._predicts = False  # the latest picture shows the body
        self._report_s = now_s + (primitive.reporting.every_s or 0.0)  # beat of the exposures that are reported
        self._reported_s = now_s  # exposure of the latest picture that was reported

    @property
    def follows(self) -> bool:
        return self.look.duration_s is not None

    def due_s(self, camera: str) -> float | None:
        """Time of the next picture of one of its cameras; None: it needs no more."""
        return None if self.over or self.halted or self._enough(self._sides[camera]) else self._sides[camera].due_s

    def windows(self, camera: str, now_s: float) -> Windows:
        """Where the tags of a body that it follows are expected in a picture; empty: it needs the whole picture."""
        side = self._sides[camera]
        view, pose = side.view, side.motion.predicted(now_s)
        if not self.follows or view is None or pose is None or not self._predicts:
            return {}
        return windows(self.tags, pose, view)

    def take(self, camera: str, picture: Evaluated) -> None:
        """Evaluate a picture, unless it was exposed before the look began."""
        side, ours = self._sides[camera], {tag.id for tag in self.tags}
        if picture.at_s < self.began_s:
            return
        side.failure = ""
        shown = ours & {mark.tag for mark in picture.marks}
        if picture.image is None and not shown:  # it may be elsewhere in the picture
            self._predicts = False
            return
        # A look that follows keeps its beat, unless a picture is too late for it.
        beat_s = max(side.due_s, picture.at_s - 0.5 * self.look.every_s) if self.follows else picture.at_s
        side.due_s = beat_s + self.look.every_s
        side.view, side.latest_s = picture.view, picture.at_s
        side.first_s = picture.at_s if side.first_s is None else side.first_s
        new = Seen(picture.view, picture.marks)
        kept = [new] if self.follows else [*side.seen, new][-self.look.pictures :]
        others = [one for other in self._sides.values() if other is not side for one in other.seen]
        expected = side.motion.predicted(picture.at_s)
        found = self._located([*others, *kept], expected if self.follows else None) if shown else None
        self._predicts = found is not None
        if found is None:
            assert picture.image is not None or shown
            side.unseen = self._absence(picture)
            return
        side.seen, side.seen_s, side.unseen = kept, picture.at_s, ""
        self.fit = found
        self.pictures += 1
        alone = found if len(others) + len(kept) == 1 else self._located([new], expected)
        if alone is not None:
            side.motion.take(picture.at_s, alone.pose)

    def fail(self, camera: str, why: str, retry_s: float) -> None:
        """The camera gave no picture. It tries again at `retry_s`, until the time limit."""
        side = self._sides[camera]
        side.failure, side.due_s = why, retry_s

    def progress(self, now_s: float) -> m.ProgressReport | None:
        """The periodic report, if one is due and the body has been seen since the last one."""
        every_s, seen_s = self.primitive.reporting.every_s, self._seen_s()
        if every_s is None or seen_s is None or seen_s <= self._reported_s:
            return None
        if seen_s < self._report_s - 0.5 * self.look.every_s:  # the exposure of the next picture is nearer to the beat
            return None
        self._report_s = max(self._report_s, seen_s - 0.5 * every_s) + every_s
        self._reported_s = seen_s
        return m.ProgressReport(primitive=self.primitive.id, at_s=now_s, reading=self._measured(now_s))

    def reading(self, now_s: float) -> Measured | None:
        """For the end report: the pose, if the sentence requests it and the body was seen."""
        measured = self._measured(now_s)
        return measured if self.primitive.reporting.items and measured.sighting is not None else None

    def _measured(self, now_s: float) -> Measured:
        return Measured(arm=self.primitive.performer, sighting=self.sighting(now_s))

    def sighting(self, now_s: float) -> Sighting | None:
        seen_s = self._seen_s()
        if self.fit is None or seen_s is None:
            return None
        cameras = [name for name, side in self._sides.items() if side.seen]
        return Sighting(
            pose=self.fit.pose.tolist(),
            covariance=self.fit.covariance.ravel().tolist(),
            tags=sorted({one.tag for one in self.fit.used}),
            error_px=self.fit.best.error_px,
            age_s=max(0.0, now_s - seen_s),
            pictures=self.pictures,
            ambiguous=self.fit.ambiguous,
            velocity=self._velocity(),
            cameras=cameras if len(cameras) > 1 else [],
        )

    def ended(self, now_s: float, scale: float) -> tuple[p.StopFunction, float | None, float | None] | None:
        """The stop function that is true, with the measured value and its limit. `scale`: our seconds per second of
        the simulation, in which limits are stated."""
        for stop in self.primitive.by_priority():
            if (found := CHECKS[type(stop.when)](stop.when, self, now_s, scale)) is not None:
                return (stop, *found)
        return None

    @property
    def trouble(self) -> str:
        """Why the body is not found, for the end report."""
        sides = self._sides.items()
        words = [(camera, side.failure or side.unseen) for camera, side in sides]
        found = [why if len(words) == 1 else f"{camera}: {why}" for camera, why in words if why]
        return "; ".join(found) or ("" if self.pictures else "no picture was taken in time")

    def located(self, now_s: float, scale: float) -> bool:
        """Whether there are enough pictures of a body at rest: of each camera, except of those that do not see it."""
        sides = self._sides.values()
        enough = [side for side in sides if self._enough(side)]
        return bool(enough) and all(self._enough(side) or self._gave_up(side, now_s, scale) for side in sides)

    def unseen_s(self) -> float | None:
        """For how long no camera has seen the body; None: one of them has not given a picture yet."""
        times = [side.unseen_s() for side in self._sides.values() if not side.failure]
        return None if not times else min((0.0 if one is None else one for one in times), default=None)

    def _enough(self, side: _Side) -> bool:
        return not self.follows and len(side.seen) >= self.look.pictures and not side.settles

    def _gave_up(self, side: _Side, now_s: float, scale: float) -> bool:
        limits = [one.when.limit_s for one in self.primitive.stop_functions if isinstance(one.when, p.UnseenAbove)]
        if not limits:
            return False
        if side.failure:
            return now_s - self.began_s >= limits[0] * scale
        return (side.unseen_s() or 0.0) >= limits[0] * scale

    def _seen_s(self) -> float | None:
        return max((side.seen_s for side in self._sides.values() if side.seen_s is not None), default=None)

    def _velocity(self) -> list[float] | None:
        """By the camera that sees the body move fastest; None: no camera has seen it for long enough."""
        found = [one for side in self._sides.values() if (one := side.motion.velocity()) is not None]
        return max(found, key=lambda one: float(np.linalg.norm(one[:3])), default=None)

    def _located(self, pictures: Sequence[Seen], expected: Array | None) -> Fit | None:
        return locate(self.tags, pictures, {} if expected is None else {BODY: expected}).get(BODY)

    def _absence(self, picture: Evaluated) -> str:
        if picture.image is None:
            return absence.Cause.OCCLUDED.value
        return absence.cause(self.tags, self.look.believed, picture.view, picture.image).value


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
        return (None, None) if task.located(now_s, scale) else None
    return (None, None) if now_s - task.began_s >= duration_s * scale else None


def _time(when: p.TimeAbove, task: LookTask, now_s: float, scale: float) -> Finding | None:
    passed_s = (now_s - task.began_s) / scale
    return (passed_s, when.limit_s) if passed_s > when.limit_s else None


def _unseen(when: p.UnseenAbove, task: LookTask, now_s: float, scale: float) -> Finding | None:
    unseen_s = task.unseen_s()
    if unseen_s is None:
        return None
    return (unseen_s / scale, when.limit_s) if unseen_s / scale >= when.limit_s else None


#: what a camera can watch
CHECKS: Mapping[type, Callable[[Any, LookTask, float, float], Finding | None]] = {
    p.GoalReached: _goal,
    p.TimeAbove: _time,
    p.UnseenAbove: _unseen,
}
