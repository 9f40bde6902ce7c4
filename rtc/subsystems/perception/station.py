"""The loop of S&P: orders of the broker, pictures, time. It never waits for a picture, so a halt is obeyed at once.

What the thread still evaluates after a halt is ignored.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.runtime import handover, process
from rtc.runtime.memory_guard import limit_data
from rtc.runtime.process import Every, Process
from rtc.runtime.settings import Settings
from rtc.subsystems.base.broker_link import BrokerLink
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.perception.camera_thread import Cameras, CameraThread, Failed
from rtc.subsystems.perception.sensor_watch import SensorWatch
from rtc.subsystems.perception.subsystem import PerceptionSubsystem

HEARTBEAT_S = 0.25
NICENESS = -10  # before the workers, if the system permits it: a camera that follows a body has a beat to keep
TICK_S = 0.02  # period of time limits while something is looked for


MakeCameras = Callable[[Settings, Cell, "zmq.Context[Any]"], Cameras]  # called in the thread that takes the pictures


def live(run_dir: Path, name: str, fd: int, make_cameras: MakeCameras) -> None:
    """Run a subsystem of cameras until it is stopped.

    `name`: its name in the cell. `fd`: handover from the supervisor (rtc.runtime.handover)."""
    process.show_name(name)
    given = handover.claim_role(name, run_dir, fd)
    process.nice(NICENESS)
    process.nice_session(NICENESS)  # with processes that the cameras start
    limit_data()
    with process.start(name, run_dir) as me:
        Station(me, name, given, make_cameras).run()


class Station:
    """The process: socket to the broker, thread of the cameras, heartbeat."""

    def __init__(self, me: Process, name: str, given: handover.Handover, make_cameras: MakeCameras) -> None:
        self._me, settings = me, given.settings
        cell = Cell.load(settings.cell)
        scale = settings.timeout_scale
        own = [camera.name for camera in cell.cameras if cell.subsystem_of(camera.name) == name]
        self._subsystem = PerceptionSubsystem(own, name, os.getpid(), scale)
        self._link = BrokerLink(me, settings, given.identity(name))
        context: zmq.Context[Any] = me.context
        self._thread = CameraThread(cell, lambda: make_cameras(settings, cell, context))
        me.poller.register(self._thread.wake_fd, zmq.POLLIN)
        self._heartbeat = Every(HEARTBEAT_S)
        self._watch = SensorWatch(me.calls)

    def run(self) -> None:
        subsystem, link = self._subsystem, self._link
        link.send(subsystem.hello())
        process.freeze_heap()
        self._me.ready()
        while not self._me.stopping:
            self._me.wait(self._pause_s(process.now_s()))
            self._turn(process.now_s())
        subsystem.brake()
        link.send(subsystem.tick(process.now_s()))
        self._thread.close()

    def _pause_s(self, now_s: float) -> float:
        """The longest time without anything to do."""
        if self._subsystem.idle:
            return HEARTBEAT_S
        return TICK_S if self._thread.busy else min(TICK_S, max(0.0, self._subsystem.due_s() - now_s))

    def _turn(self, now_s: float) -> None:
        subsystem, link = self._subsystem, self._link
        if link.newly_connected():
            link.send(subsystem.hello())
        for order in link.orders(now_s):
            link.send(subsystem.handle(order, BROKER, now_s))
        if (result := self._thread.result()) is not None:
            subsystem.clock.end_picture(now_s)
            camera = subsystem.performers[result.camera]
            if isinstance(result.found, Failed):
                self._me.log.warning("%s", result.found.why)
                camera.fail(result.found.why, now_s)
            else:
                camera.take(result.found)
                subsystem.clock.note(camera.name, process.now_s() - result.found.at_s, result.windows)
        link.send(subsystem.tick(now_s))
        if stuck := self._watch.look(now_s):
            self._me.log.error("the %s of an installed package does not return: the process ends", stuck)
            process.leave(1)
        if not self._thread.busy and (due := subsystem.next_camera(now_s)) is not None:
            self._thread.look(due.name, due.windows(now_s))
            subsystem.clock.begin_picture(now_s)
        if self._heartbeat.due(now_s):
            link.send([(BROKER, m.Heartbeat(name=subsystem.name, own_s=subsystem.clock.own_s(now_s)))])
