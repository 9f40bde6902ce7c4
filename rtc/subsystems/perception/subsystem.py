"""S&P as a subsystem (`rtc.subsystems.base`): its performers are cameras. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable

from rtc.protocol.primitive import Primitive
from rtc.protocol.subsystems import CAMERAS
from rtc.subsystems.base.subsystem import BaseSubsystem, Outgoing, Reports, in_scope
from rtc.subsystems.perception.camera import MAX_LOOKS, CameraPerformer
from rtc.subsystems.perception.look_clock import LookClock


class PerceptionSubsystem(BaseSubsystem[CameraPerformer]):
    """`scale`: our seconds per second of the simulation."""

    def __init__(self, cameras: Iterable[str], name: str = CAMERAS.name, pid: int = 0, scale: float = 1.0) -> None:
        self.clock = LookClock(scale)
        super().__init__({camera: CameraPerformer(camera, self.clock) for camera in cameras}, name, pid, queues=True)

    def next_camera(self, now_s: float) -> CameraPerformer | None:
        """The camera whose next picture has been due for longest; None: none is due."""
        due = [(camera.due_s, camera) for camera in self.performers.values()]
        waiting = [(due_s, camera) for due_s, camera in due if due_s is not None and due_s <= now_s]
        return min(waiting, key=lambda one: one[0])[1] if waiting else None

    def due_s(self) -> float:
        """When the next picture is due; infinite: none is wanted."""
        return min((due_s for one in self.performers.values() if (due_s := one.due_s) is not None), default=math.inf)

    def _primitives(self, performer: CameraPerformer) -> list[str]:
        return performer.primitives

    def _busy(self, primitive: Primitive) -> str:
        """Why a further camera of the look cannot take pictures for it."""
        further = primitive.performers[1:]
        unknown = [name for name in further if name not in self.performers]
        full = [name for name in further if name in self.performers and self.performers[name].full]
        if unknown:
            return f"{self.name} has no {', '.join(unknown)}; it has {', '.join(self.performers)}"
        return f"{', '.join(full)}: {MAX_LOOKS} looks already" if full else ""

    def _accept(self, performer: CameraPerformer, primitive: Primitive, now_s: float) -> Reports:
        reports = performer.accept(primitive, now_s)
        for name in primitive.performers[1:]:
            performer.share(primitive.id, self.performers[name])
        return reports

    def _tick(self, performer: CameraPerformer, now_s: float) -> Outgoing:
        return self._sent(performer.tick(now_s), now_s)

    def _stop(self, performer: CameraPerformer, scope: str) -> bool:
        return performer.halt(scope)

    def _rests(self, performer: CameraPerformer, scope: str) -> bool:
        return not any(in_scope(scope, performer.name, primitive) for primitive in performer.primitives)
