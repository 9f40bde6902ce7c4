"""Cameras of a simulated cell: a process of its own draws each picture from the true scene.

The true scene goes only to that process (`rtc.drawing.renderer`); the result is pixels. The drawing process starts with
the first picture and is kept: its start takes longer than a look.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import zmq

from rtc.drawing.renderer import Renderer
from rtc.drawing.scene import SceneView, true_scene
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError, TimedOut
from rtc.protocol.wire import frames, reader
from rtc.runtime.process import inbox, now_s, open_socket
from rtc.runtime.settings import Settings
from rtc.sensing.optics import Window
from rtc.spatial import geometry
from rtc.subsystems.perception.camera_thread import Exposure

DRAWING_NICENESS = 0  # of the drawing process, added to that of S&P
TRUTH_S = 1.0  # time limit for the state of the simulation
STILL_M, STILL_RAD = 0.0005, 0.001  # a camera on an arm must move less than this while it takes a picture


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

    def photograph(self, camera: str, windows: Sequence[Window] = ()) -> Exposure:
        renderer = self._renderer or self._started(camera)
        arm = self._cell.camera(camera).arm
        before = self._tcp(arm)
        asked_s, truth = now_s(), self._truth()
        what = self._settings.cell, camera, true_scene(truth)
        try:
            parts = renderer.windows(*what, windows) if windows else [renderer.photograph(*what)]
        except RtcError:
            self.release()  # the next picture gets a new process
            raise
        after = self._tcp(arm)
        if before is not None and after is not None and _moved(before, after):
            raise RtcError(f"{arm}, which carries {camera}, moved during the picture")
        return Exposure(truth.at_s or asked_s, parts, before, truth.sim_s)

    def _started(self, camera: str) -> Renderer:
        """The drawing process, which has built the cell: the first picture takes no longer than others."""
        self._renderer = renderer = Renderer(DRAWING_NICENESS)
        renderer.__enter__()
        arm = self._cell.camera(camera).arm
        somewhere = SceneView(tcp={} if arm is None else {arm: [*geometry.IDENTITY]})
        try:
            renderer.windows(self._settings.cell, camera, somewhere, [Window(0, 0, 1, 1)])
        except RtcError:
            self.release()
            raise
        return renderer

    def release(self) -> None:
        if self._renderer is not None:
            self._renderer.__exit__()
            self._renderer = None

    def _truth(self) -> m.SimTruthReply:
        """The scene to draw. Raises TimedOut."""
        bench = self._bench or open_socket(self._context, zmq.DEALER, self._settings.endpoint("bench"))
        self._bench = bench
        self._requests += 1
        name = f"cameras-{self._requests}"
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
