"""One camera as a performer: the looks it has accepted, each served by the next picture. Pure.

Looks are a queue that is served in turn: one picture is evaluated for every look whose next picture is due. So a camera
that follows a body for an hour still locates another one at once. A look of several cameras is in the queue of each;
the first of them reports.
"""

from __future__ import annotations

import numpy as np

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.base.subsystem import Reports, in_scope, not_begun
from rtc.subsystems.perception.look_clock import LookClock
from rtc.subsystems.perception.look_task import CHECKS, Evaluated, LookTask, Windows

MAX_LOOKS = 16  # maximum number of looks of one camera at a time
RETRY_S = 0.2  # pause after a camera that gave no picture


class CameraPerformer:
    """Accepts looks, states when it wants a picture, and takes it. `clock`: of all cameras that share it."""

    def __init__(self, name: str, clock: LookClock | None = None) -> None:
        self.name, self._clock = name, clock or LookClock()
        self._looks: dict[str, LookTask] = {}

    @property
    def primitives(self) -> list[str]:
        return [name for name, task in self._looks.items() if not task.over]

    @property
    def full(self) -> bool:
        return len(self.primitives) >= MAX_LOOKS

    @property
    def due_s(self) -> float | None:
        """When it wants its next picture; None: nothing to look for."""
        times = (task.due_s(self.name) for task in self._looks.values())
        return min((due_s for due_s in times if due_s is not None), default=None)

    def windows(self, now_s: float) -> Windows:
        """The parts of the next picture that the looks which are due need; empty: the whole picture."""
        found: dict[int, Windows] = {}
        for n, task in enumerate(self._due(now_s)):
            if not (parts := task.windows(self.name, now_s)):
                return {}
            found[n] = parts
        return {tag: window for parts in found.values() for tag, window in parts.items()}

    def accept(self, primitive: p.Primitive, now_s: float) -> Reports:
        why = self._objection(primitive)
        if why:
            return [not_begun(primitive.id, self.name, why, at_s=now_s)]
        self._looks[primitive.id] = LookTask(primitive, now_s, self._clock)
        return [m.Started(primitive=primitive.id, at_s=now_s)]

    def share(self, primitive: str, other: CameraPerformer) -> None:
        """Let another camera take pictures for this look too, if it was accepted."""
        if (task := self._looks.get(primitive)) is not None:
            other._looks[primitive] = task

    def _objection(self, primitive: p.Primitive) -> str:
        if not isinstance(primitive.trajectory, p.Look):
            return f"{self.name} is a camera; it cannot execute a {type(primitive.trajectory).__name__}"
        if self.full:
            return f"{self.name} has {MAX_LOOKS} looks already"
        if primitive.trajectory.cameras and primitive.trajectory.duration_s is not None:
            return "only one camera can follow a body: pictures of several are not exposed at one time"
        unknown = [type(stop.when).__name__ for stop in primitive.stop_functions if type(stop.when) not in CHECKS]
        if unknown:
            return f"a camera cannot watch {', '.join(unknown)}"
        finite = [*primitive.trajectory.believed, *(n for tag in primitive.trajectory.tags for n in tag.pose)]
        if len(primitive.trajectory.believed) != 7 or not np.isfinite(finite).all():
            return "the look has a pose that is not 7 finite numbers"
        return ""

    def take(self, picture: Evaluated) -> None:
        for task in self._due(picture.at_s):
            task.take(self.name, picture)

    def fail(self, why: str, now_s: float) -> None:
        """The camera gave no picture. Its looks try again until their time limits."""
        for task in self._looks.values():
            task.fail(self.name, why, now_s + RETRY_S)

    def _due(self, at_s: float) -> list[LookTask]:
        times = ((task.due_s(self.name), task) for task in self._looks.values())
        return [task for due_s, task in times if due_s is not None and due_s <= at_s]

    def tick(self, now_s: float) -> Reports:
        out: list[m.ProgressReport | m.EndReport] = []
        for name, task in list(self._looks.items()):
            if not task.over and task.primitive.performer == self.name:
                out += self._advance(task, now_s)
            if task.over:
                del self._looks[name]
        return out

    def _advance(self, task: LookTask, now_s: float) -> list[m.ProgressReport | m.EndReport]:
        if task.halted:
            return [self._end(task, StopReason.HALT, now_s)]
        report = task.progress(now_s)
        out: list[m.ProgressReport | m.EndReport] = [] if report is None else [report]
        if (ended := task.ended(now_s)) is not None:
            stop, measured, limit = ended
            out.append(self._end(task, stop.reason, now_s, measured, limit))
        return out

    def halt(self, scope: str) -> bool:
        """End the looks in the scope of a halt with the next tick. True if there was one."""
        halted = [self._looks[name] for name in self.primitives if in_scope(scope, self.name, name)]
        for task in halted:
            task.halted = True
        return bool(halted)

    def _end(
        self,
        task: LookTask,
        reason: StopReason,
        now_s: float,
        measured: float | None = None,
        limit: float | None = None,
    ) -> m.EndReport:
        task.over = True
        return m.EndReport(
            primitive=task.primitive.id,
            performer=self.name,
            reason=reason,
            at_s=now_s,
            duration_s=task.passed_s(now_s),
            measured=measured,
            limit=limit,
            message=task.trouble,
            sighting=task.sighting(now_s),
            reading=task.reading(now_s),
            pictures=self._clock.pictures(),
        )
