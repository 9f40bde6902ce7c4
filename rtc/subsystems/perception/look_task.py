"""One look as it is executed: the pictures of its cameras so far, the pose fitted to them, its stop functions. Pure.

Three clocks: ours, for the beat of the pictures and the age of what is reported; that of what is seen (`own_s` of a
picture), for how it moves, and for how long it is out of sight; the `LookClock`, for the limits of the look.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Measured, Sighting
from rtc.sensing import absence, rest
from rtc.sensing.detector import DetectedTag
from rtc.sensing.locate import Seen, locate
from rtc.sensing.optics import CameraView, Window
from rtc.sensing.pose_fit import Fit
from rtc.sensing.windows import windows
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.perception.look_clock import LookClock
from rtc.subsystems.perception.motion import FOLLOWED_S, RESTS_S, BodyMotion

BODY = "BODY"  # a look has one body, without a name
# What a stopped arm holds swings for some tenths of a second, so only a motion that pictures from then on show counts.
SETTLES_S = 1.0
SPACING_S = 0.3  # between pictures of a body at rest, by our clock

Windows = Mapping[int, Window]  # parts of a picture by the tag that is expected there


class Evaluated(NamedTuple):
    """A picture of a camera and the tags in it."""

    at_s: float  # time of its exposure
    own_s: float  # the same by the clock of what is seen
    view: CameraView
    image: NDArray[np.uint8] | None  # None: only windows of it were taken
    marks: Sequence[DetectedTag]


class _Side:
    """The pictures of one camera for one look."""

    def __init__(self, due_s: float, kept_s: float) -> None:
        self.due_s = due_s  # time of its next picture
        self.seen: list[Seen] = []  # pictures with the body, as many as its pose needs
        self.view: CameraView | None = None  # of the latest picture
        self.latest_s: float | None = None  # exposure of the latest picture
        self.seen_s: float | None = None  # exposure of the latest picture with the body
        # Exposures by the clock of what is seen: of the latest picture, of the first one, and of the first without the
        # body since it was seen.
        self.latest_own_s = self.first_own_s = 0.0
        self._unseen_own_s: float | None = None
        self._rate = 1.0  # of that clock, by ours
        self.unseen = ""  # why the body is not in the latest picture
        self.failure = ""  # why there is not a picture
        self.predicts = False  # the latest picture shows the body
        self.motion = BodyMotion(
            kept_s
        )  # of the body, by the pictures of this camera: their common errors do not matter
        self.doubt_m = math.inf  # of the latest pose in it

    def expose(self, at_s: float, own_s: float) -> None:
        """Note the times of a new picture."""
        if self.latest_s is None or own_s < self.latest_own_s:  # it is the first, or that clock has begun anew
            self.first_own_s, self._unseen_own_s = own_s, None
        elif at_s > self.latest_s:
            self._rate = (own_s - self.latest_own_s) / (at_s - self.latest_s)
        self.latest_s, self.latest_own_s = at_s, own_s

    def expected(self, now_s: float) -> Array | None:
        """The pose of the body now."""
        passed_s = 0.0 if self.latest_s is None else now_s - self.latest_s
        return self.motion.predicted(self.latest_own_s + self._rate * passed_s)

    @property
    def lasted_s(self) -> float:
        return self.latest_own_s - self.first_own_s

    @property
    def settles(self) -> bool:
        """Whether the body moves in its pictures, of which some are from before it has had the time to come to rest.
        Pictures that a fast simulation sets far apart must agree as those at the beat of a look: a swing may lie
        between them."""
        velocity = self.motion.velocity()
        if velocity is None or self.motion.oldest_s >= self.first_own_s + SETTLES_S:
            return False
        sparse = max(1.0, self.motion.spacing_s / SPACING_S)
        return rest.moves([sparse * part for part in velocity])

    def unseen_s(self) -> float | None:
        """From the first picture without the body to the latest: a busy machine, which takes few, hides nothing."""
        if self.latest_s is None:
            return None
        return 0.0 if self._unseen_own_s is None else self.latest_own_s - self._unseen_own_s

    def misses(self, why: str) -> None:
        """The body is not in the latest picture."""
        self.unseen = why
        self._unseen_own_s = self.latest_own_s if self._unseen_own_s is None else self._unseen_own_s

    def sees(self, pictures: list[Seen]) -> None:
        """The body is in the latest picture."""
        self.seen, self.seen_s, self.unseen, self._unseen_own_s = pictures, self.latest_s, "", None


class LookTask:
    """One look of one or several cameras."""

    def __init__(self, primitive: p.Primitive, now_s: float, clock: LookClock) -> None:
        assert isinstance(primitive.trajectory, p.Look)
        self.primitive, self.look, self.began_s = primitive, primitive.trajectory, now_s
        self._clock, self._began_own_s = clock, clock.own_s(now_s)
        self.tags = [_tag(tag) for tag in self.look.tags]
        self.pictures = 0  # number of pictures with the body
        self.fit: Fit | None = None
        self.halted = False
        self.over = False  # its end report is out
        kept_s = FOLLOWED_S if self.follows else RESTS_S
        self._sides = {camera: _Side(now_s, kept_s) for camera in primitive.performers}
        self._report_s = now_s + (primitive.reporting.every_s or 0.0)  # beat of the exposures that are reported
        self._reported_s = now_s  # exposure of the latest picture that was reported

    @property
    def follows(self) -> bool:
        return self.look.duration_s is not None

    def due_s(self, camera: str) -> float | None:
        """Time of the next picture of one of its cameras; None: it needs no more."""
        return None if self.over or self.halted or self._enough(self._sides[camera]) else self._sides[camera].due_s

    def windows(self, camera: str, now_s: float) -> Windows:
        """Where the tags are expected in a picture of a camera that has seen them; empty: it needs the whole one."""
        side = self._sides[camera]
        view, pose = side.view, side.expected(now_s)
        if view is None or pose is None or not side.predicts:
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
            side.predicts = False
            return
        # A look that follows keeps its beat, unless a picture is too late for it.
        beat_s = max(side.due_s, picture.at_s - 0.5 * self.look.every_s) if self.follows else picture.at_s
        side.due_s = beat_s + self.look.every_s
        side.view = picture.view
        side.expose(picture.at_s, picture.own_s)
        new = Seen(picture.view, picture.marks)
        kept = [new] if self.follows else [*side.seen, new][-self.look.pictures :]
        others = [one for other in self._sides.values() if other is not side for one in other.seen]
        expected = side.motion.predicted(picture.own_s)
        found = self._located([*others, *kept], expected if self.follows else None) if shown else None
        side.predicts = found is not None
        if found is None:
            assert picture.image is not None or shown
            side.misses(self._absence(picture))
            return
        side.sees(kept)
        self.fit = found
        self.pictures += 1
        read = self._read_well(new, found.pose)
        alone = found if read is new and len(others) + len(kept) == 1 else self._located([read], expected)
        if alone is not None:
            known = found.pose if expected is None or not found.ambiguous else expected
            side.motion.take(picture.own_s, _nearer_pose(alone, known))
            side.doubt_m = math.sqrt(float(np.trace(alone.noise[:3, :3])))

    def _read_well(self, picture: Seen, pose: Array) -> Seen:
        """The picture with the tags alone of which windows are taken, or all of it if that leaves none. A whole picture
        may show narrow ones too, whose corners are a pixel off: without them in the next one the body seems to move."""
        well = windows(self.tags, pose, picture.view)
        marks = [mark for mark in picture.marks if mark.tag in well]
        others = len(marks) < sum(mark.tag in {tag.id for tag in self.tags} for mark in picture.marks)
        return picture._replace(marks=marks) if marks and others else picture

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

    def ended(self, now_s: float) -> tuple[p.StopFunction, float | None, float | None] | None:
        """The stop function that is true, with the measured value and its limit."""
        for stop in self.primitive.by_priority():
            if (found := CHECKS[type(stop.when)](stop.when, self, now_s)) is not None:
                return (stop, *found)
        return None

    def passed_s(self, now_s: float) -> float:
        """Since its begin, as its limits count it."""
        return self._clock.own_s(now_s) - self._began_own_s

    @property
    def lasted_s(self) -> float:
        """From its first picture to the latest, by the clock of what is seen."""
        return max(side.lasted_s for side in self._sides.values())

    @property
    def trouble(self) -> str:
        """Why the body is not found, for the end report."""
        sides = self._sides.items()
        words = [(camera, side.failure or side.unseen) for camera, side in sides]
        found = [why if len(words) == 1 else f"{camera}: {why}" for camera, why in words if why]
        return "; ".join(found) or ("" if self.pictures else "no picture was taken in time")

    def located(self, now_s: float) -> bool:
        """Whether there are enough pictures of a body at rest: of each camera, except of those that do not see it."""
        sides = self._sides.values()
        enough = [side for side in sides if self._enough(side)]
        return bool(enough) and all(self._enough(side) or self._gave_up(side, now_s) for side in sides)

    def unseen_s(self) -> float | None:
        """For how long no camera has seen the body; None: one of them has not given a picture yet."""
        times = [side.unseen_s() for side in self._sides.values() if not side.failure]
        return None if not times else min((0.0 if one is None else one for one in times), default=None)

    def _enough(self, side: _Side) -> bool:
        if self.follows or len(side.seen) < self.look.pictures:
            return False
        if self.look.pictures == 1:
            return True
        # Several pictures of one moment do not show a motion.
        return side.motion.known and not (side is self._judge() and side.settles)

    def _judge(self) -> _Side | None:
        """The camera whose poses are the most accurate of those that have seen the body for long enough; None: there is
        none. One that is far away sees a body that turns by 0.3 deg/s move by 10 mm/s: pixels shift its corners."""
        known = [side for side in self._sides.values() if side.motion.known]
        return min(known, key=lambda side: side.doubt_m, default=None)

    def _gave_up(self, side: _Side, now_s: float) -> bool:
        limits = [one.when.limit_s for one in self.primitive.stop_functions if isinstance(one.when, p.UnseenAbove)]
        if not limits:
            return False
        if side.failure:
            return self.passed_s(now_s) >= limits[0]
        return (side.unseen_s() or 0.0) >= limits[0]

    def _seen_s(self) -> float | None:
        return max((side.seen_s for side in self._sides.values() if side.seen_s is not None), default=None)

    def _velocity(self) -> list[float] | None:
        judge = self._judge()
        return None if judge is None else judge.motion.velocity()

    def _located(self, pictures: Sequence[Seen], expected: Array | None) -> Fit | None:
        return locate(self.tags, pictures, {} if expected is None else {BODY: expected}).get(BODY)

    def _absence(self, picture: Evaluated) -> str:
        if picture.image is None:
            return absence.Cause.OCCLUDED.value
        return absence.cause(self.tags, self.look.believed, picture.view, picture.image).value


def _nearer_pose(fit: Fit, known: Array) -> Array:
    """The pose of a fit, or its second solution, if that explains the picture as well and is nearer to a known pose:
    one tag in one picture may be tilted either way, which is no motion from picture to picture."""
    if not fit.ambiguous or fit.second is None:
        return fit.pose
    poses = (fit.pose, geometry.from_matrix(fit.second.matrix))
    return min(poses, key=lambda pose: geometry.angle(known, pose))


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


def _goal(when: p.GoalReached, task: LookTask, now_s: float) -> Finding | None:
    duration_s = task.look.duration_s
    half_s = 0.5 * task.look.every_s  # the picture that is nearest to the end is the last one
    reached = task.located(now_s) if duration_s is None else task.lasted_s >= duration_s - half_s
    return (None, None) if reached else None


def _time(when: p.TimeAbove, task: LookTask, now_s: float) -> Finding | None:
    passed_s = task.passed_s(now_s)
    return (passed_s, when.limit_s) if passed_s > when.limit_s else None


def _unseen(when: p.UnseenAbove, task: LookTask, now_s: float) -> Finding | None:
    unseen_s = task.unseen_s()
    return (unseen_s, when.limit_s) if unseen_s is not None and unseen_s >= when.limit_s else None


#: what a camera can watch
CHECKS: Mapping[type, Callable[[Any, LookTask, float], Finding | None]] = {
    p.GoalReached: _goal,
    p.TimeAbove: _time,
    p.UnseenAbove: _unseen,
}
