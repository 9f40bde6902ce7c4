"""The thread that takes pictures, one at a time, and finds the tags in each.

How a picture is made is known to the driver alone, a `Cameras`: simulated ones are `sim_mcm.cameras.simulated`.
"""

from __future__ import annotations

import contextlib
import itertools
import operator
import queue
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rtc.model.cells.cell import Cell
from rtc.plugins import guard, registry
from rtc.plugins.guard import TookTooLong
from rtc.protocol.outcomes import RtcError
from rtc.sensing import optics
from rtc.sensing.optics import Window
from rtc.subsystems.perception.look_task import Evaluated

if TYPE_CHECKING:
    from rtc.sensing.detector import DetectedTag, TagDetector

MOST_MARKS = 1000  # of one sensor of a package, in one picture


class Exposure(NamedTuple):
    at_s: float  # time of the exposure
    parts: Sequence[NDArray[np.uint8]]  # the windows of the picture, or the whole picture alone
    tcp: list[float] | None  # measured pose of the hand that carries the camera, world frame
    own_s: float | None = None  # time of the exposure by the clock of what is seen, if it is not ours: a simulation


class Cameras(Protocol):
    def photograph(self, camera: str, windows: Sequence[Window] = ()) -> Exposure:
        """A picture, or windows of it. Raises RtcError without one."""

    def release(self) -> None:
        """There will be no further pictures."""


class Failed(NamedTuple):
    """A camera gave no picture."""

    why: str


class _Order(NamedTuple):
    camera: str
    windows: Mapping[int, Window]  # by tag; empty: the whole picture


class LookResult(NamedTuple):
    camera: str
    found: Evaluated | Failed
    windows: int = 0  # number of them in the picture; 0: it is whole


class CameraThread:
    """Takes pictures in a thread. `wake_fd` becomes readable with each result. `cameras` makes the driver, in it."""

    def __init__(self, cell: Cell, cameras: Callable[[], Cameras]) -> None:
        self._cell, self._cameras = cell, cameras
        self._wanted: queue.SimpleQueue[_Order | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[LookResult] = queue.SimpleQueue()
        self._wake_end, self._wake_start = socket.socketpair()
        self._wake_end.setblocking(False)
        self.wake_fd = self._wake_end.fileno()
        self.busy = False  # a picture is under way
        self._thread: threading.Thread | None = None

    def look(self, camera: str, windows: Mapping[int, Window] | None = None) -> None:
        """Order a picture; one at a time. `windows`: only the parts in which these tags are expected."""
        assert not self.busy
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, daemon=True)
            self._thread.start()
        self.busy = True
        self._wanted.put(_Order(camera, windows or {}))

    def result(self) -> LookResult | None:
        """The picture that was ordered, if it is there."""
        with contextlib.suppress(BlockingIOError):
            self._wake_end.recv(64)
        try:
            found = self._results.get_nowait()
        except queue.Empty:
            return None
        self.busy = False
        return found

    def close(self) -> None:
        if self._thread is not None:
            self._wanted.put(None)
            self._thread.join(2.0)

    def _work(self) -> None:
        from rtc.sensing.detector import TagDetector  # its library is loaded with the first look

        detector, cameras = TagDetector(), self._cameras()
        while (order := self._wanted.get()) is not None:
            guard.begin_anew()
            try:
                found: Evaluated | Failed = self._evaluated(order, cameras, detector)
            except (RtcError, TookTooLong) as error:
                found = Failed(f"{order.camera} gives no picture: {error}")
            self._results.put(LookResult(order.camera, found, len(order.windows)))
            self._wake_start.send(b"\0")
        cameras.release()

    def _evaluated(self, order: _Order, cameras: Cameras, detector: TagDetector) -> Evaluated:
        """Raises RtcError without a picture."""
        taken = cameras.photograph(order.camera, list(order.windows.values()))
        view = optics.view(self._cell.camera(order.camera), taken.tcp)
        own_s = taken.at_s if taken.own_s is None else taken.own_s
        if not order.windows:
            (image,) = taken.parts
            return Evaluated(
                taken.at_s, own_s, view, image, [*detector.find(image), *_added_marks(order.camera, image)]
            )
        parts = zip(order.windows.items(), taken.parts, strict=True)
        marks = detector.find_in({tag: (window, image) for (tag, window), image in parts})
        return Evaluated(taken.at_s, own_s, view, None, marks)


def _added_marks(camera: str, image: NDArray[np.uint8]) -> list[DetectedTag]:
    """What the sensors of installed packages find. Raises PluginError."""
    from rtc.sensing.detector import DetectedTag

    marks: list[DetectedTag] = []
    for name, find in registry.installed(registry.SENSORS).items():
        with registry.guarded(registry.SENSORS, name):
            found = [*itertools.islice(find(camera, image.copy()), MOST_MARKS)]
            marks += [DetectedTag(operator.index(mark.tag), _corners(mark.corners, image.shape)) for mark in found]
    return marks


def _corners(given: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Raises ValueError and others."""
    corners = np.array(given, dtype=float)
    if corners.shape != (4, 2) or not np.isfinite(corners).all() or np.abs(corners).max() > 2 * max(shape):
        raise ValueError(f"a mark has four corners in the picture, not {corners.tolist()!s:.80}")
    return corners
