"""The driver of the cameras: a thread that takes one picture at a time and finds the tags in it.

Cameras are simulated. A picture is drawn by a process of its own (`rtc.perception.renderer`) from the true scene. The
true scene goes only to that process; the result is pixels. The drawing process starts with the first picture and ends
after IDLE_S without one. A driver of real cameras replaces `SimulatedCameras`.
"""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import zmq
from numpy.typing import NDArray

from rtc.cells.cell import Cell
from rtc.cells.scene import true_scene
from rtc.perception.look_task import Evaluated
from rtc.perception.renderer import Renderer
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError, TimedOut
from rtc.protocol.wire import frames, reader
from rtc.runtime.process import inbox, now_s, open_socket
from rtc.runtime.settings import Settings
from rtc.sensing import optics
from rtc.sensing.optics import Window
from rtc.spatial import geometry

if TYPE_CHECKING:
    from rtc.sensing.detector import TagDetector

DRAWING_NICENESS = 0  # of the drawing process, added to that of S&P
IDLE_S = 30.0  # after this time without a picture the drawing process ends
TRUTH_S = 1.0  # time limit for the state of the simulation
STILL_M, STILL_RAD = 0.0005, 0.001  # a camera on an arm must move less than this while it takes a picture


class Photograph(NamedTuple):
    at_s: float  # time of the exposure
    parts: Sequence[NDArray[np.uint8]]  # the windows of the picture, or the whole picture alone
    tcp: list[float] | None  # measured pose of the hand that carries the camera, world frame


class Cameras(Protocol):
    def photograph(self, camera: str, windows: Sequence[Window] = ()) -> Photograph:
        """A picture, or windows of it. Raises RtcError without one."""

    def rest(self) -> None:
        """Release what only pictures need."""


class SimulatedCameras:
    """Cameras of a simulated cell. Used by one thread."""

    def __init__(self, settings: Settings, cell: Cell, context: zmq.Context[Any]) -> None:
        self._settings, self._cell, self._context = settings, cell, context
        self._bench: zmq.Socket[bytes] | None = None
        self._telemetry: zmq.Socket[bytes] | None = None
        self._renderer: Renderer | None = None
        self._read, self._read_arms = reader(m.FromSim), reader(m.Telemetry)
        self._requests = 0
        self._arms: dict[str, m.ArmSample] = {}

    def photograph(self, camera: str, windows: Sequence[Window] = ()) -> Photograph:
        arm = self._cell.camera(camera).arm
        before = self._tcp(arm)
        asked_s, truth = now_s(), self._truth()
        if self._renderer is None:
            self._renderer = Renderer(DRAWING_NICENESS)
            self._renderer.__enter__()
        what = self._settings.cell, camera, true_scene(truth)
        try:
            parts = self._renderer.windows(*what, windows) if windows else [self._renderer.photograph(*what)]
        except RtcError:
            self.rest()  # the next picture gets a new process
            raise
        after = self._tcp(arm)
        if before is not None and after is not None and _moved(before, after):
            raise RtcError(f"{arm}, which carries {camera}, moved during the picture")
        return Photograph(truth.at_s or asked_s, parts, before)

    def rest(self) -> None:
        if self._renderer is not None:
            self._renderer.__exit__()
            self._renderer = None

    def _truth(self) -> m.SimTruthReply:
        """The scene to draw. Raises TimedOut."""
        bench = self._bench or open_socket(self._context, zmq.DEALER, self._settings.endpoint("bench"))
        self._bench = bench
        self._requests += 1
        name = f"eye-{self._requests}"
        bench.send_multipart(frames(m.SimTruth(request=name)))
        limit_s = now_s() + TRUTH_S * self._settings.timeout_scale
        while (left_s := limit_s - now_s()) > 0.0:
            if not bench.poll(int(1000 * left_s) + 1):
                break
            answer = self._read(bench.recv_multipart())
            if isinstance(answer, m.SimTruthReply) and answer.request == name:
                return answer
        bench.close(linger=0)
        self._bench = None
        raise TimedOut("cameras are simulated, and the simulation does not report its state")

    def _tcp(self, arm: str | None) -> list[float] | None:
        """The hand as measured last; None for a fixed camera. Raises RtcError."""
        if arm is None:
            return None
        telemetry = self._telemetry or open_socket(self._context, zmq.SUB, self._settings.endpoint("telemetry"))
        if self._telemetry is None:
            telemetry.subscribe(b"")
            self._telemetry = telemetry
        telemetry.poll(int(1000 * TRUTH_S))
        for parts in inbox(telemetry):
            self._arms = self._read_arms(parts).arms
        if arm not in self._arms:
            raise RtcError(f"the position of {arm}, which carries the camera, is not measured")
        return self._arms[arm].tcp_pose


def _moved(a: list[float], b: list[float]) -> bool:
    return geometry.distance(a, b) > STILL_M or geometry.angle(a, b) > STILL_RAD


class Failed(NamedTuple):
    """A camera gave no picture."""

    why: str


class _Order(NamedTuple):
    camera: str
    windows: Mapping[int, Window]  # by tag; empty: the whole picture


class Result(NamedTuple):
    camera: str
    found: Evaluated | Failed


class Eye:
    """Takes pictures in a thread. `wake_fd` becomes readable with each result. `cameras` makes the driver, in it."""

    def __init__(self, cell: Cell, cameras: Callable[[], Cameras], idle_s: float = IDLE_S) -> None:
        self._cell, self._cameras, self._idle_s = cell, cameras, idle_s
        self._wanted: queue.SimpleQueue[_Order | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[Result] = queue.SimpleQueue()
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

    def result(self) -> Result | None:
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
        while True:
            try:
                order = self._wanted.get(timeout=self._idle_s)
            except queue.Empty:
                cameras.rest()
                order = self._wanted.get()
            if order is None:
                cameras.rest()
                return
            try:
                found: Evaluated | Failed = self._evaluated(order, cameras, detector)
            except RtcError as error:
                found = Failed(f"{order.camera} gives no picture: {error}")
            self._results.put(Result(order.camera, found))
            self._wake_start.send(b"\0")

    def _evaluated(self, order: _Order, cameras: Cameras, detector: TagDetector) -> Evaluated:
        """Raises RtcError without a picture."""
        taken = cameras.photograph(order.camera, list(order.windows.values()))
        view = optics.view(self._cell.camera(order.camera), taken.tcp)
        if not order.windows:
            (image,) = taken.parts
            return Evaluated(taken.at_s, view, image, detector.find(image))
        parts = zip(order.windows.items(), taken.parts, strict=True)
        marks = detector.find_in({tag: (window, image) for (tag, window), image in parts})
        return Evaluated(taken.at_s, view, None, marks)
