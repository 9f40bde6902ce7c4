"""The process S&P: `python -m rtc.perception --run-dir D`. Its cameras look for bodies when the broker orders it.

The loop never waits for a picture, so a halt is obeyed at once: what a thread still evaluates is then ignored.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import zmq

from rtc.cells.cell import Cell
from rtc.perception.eye import Eye, Failed, SimulatedCameras
from rtc.perception.subsystem import NAME, PerceptionSubsystem
from rtc.protocol import messages as m
from rtc.runtime import handover, process
from rtc.runtime.process import Every, Process
from rtc.subsystem.broker_link import BrokerLink
from rtc.subsystem.subsystem import BROKER

HEARTBEAT_S = 0.25
NICENESS = -10  # before the workers, if the system permits it: a camera that follows a body has a beat to keep
TICK_S = 0.02  # period of time limits while something is looked for


class Station:
    """The loop: orders of the broker, results of the eye, time."""

    def __init__(self, me: Process, given: handover.Handover) -> None:
        self._me, settings = me, given.settings
        cell = Cell.load(settings.cell)
        scale = settings.timeout_scale
        self._subsystem = PerceptionSubsystem([camera.name for camera in cell.cameras], os.getpid(), scale)
        self._link = BrokerLink(me, settings, given.identity(NAME))
        context: zmq.Context[Any] = me.context
        self._eye = Eye(cell, lambda: SimulatedCameras(settings, cell, context))
        me.poller.register(self._eye.wake_fd, zmq.POLLIN)
        self._heartbeat = Every(HEARTBEAT_S)

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
        self._eye.close()

    def _pause_s(self, now_s: float) -> float:
        """The longest time without anything to do."""
        if self._subsystem.idle:
            return HEARTBEAT_S
        return TICK_S if self._eye.busy else min(TICK_S, max(0.0, self._subsystem.due_s() - now_s))

    def _turn(self, now_s: float) -> None:
        subsystem, link = self._subsystem, self._link
        if link.newly_connected():
            link.send(subsystem.hello())
        for order in link.orders(now_s):
            link.send(subsystem.handle(order, BROKER, now_s))
        if (result := self._eye.result()) is not None:
            camera = subsystem.performers[result.camera]
            if isinstance(result.found, Failed):
                self._me.log.warning("%s", result.found.why)
                camera.fail(result.found.why, now_s)
            else:
                camera.take(result.found)
        link.send(subsystem.tick(now_s))
        if not self._eye.busy and (due := subsystem.next_camera(now_s)) is not None:
            self._eye.look(due.name, due.windows(now_s))
        if self._heartbeat.due(now_s):
            link.send([(BROKER, m.Heartbeat(name=NAME))])


def live(run_dir: Path, fd: int = -1) -> None:
    """Run S&P until it is stopped. `fd`: handover from the supervisor (rtc.runtime.handover)."""
    process.show_name(NAME)
    given = handover.begin(NAME, run_dir, fd)
    process.nice(NICENESS)
    process.nice_session(NICENESS)  # with the drawing process
    with process.start(NAME, run_dir) as me:
        Station(me, given).run()


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m rtc.perception", description=__doc__)
    arguments.add_argument("--run-dir", required=True, type=Path, help="run directory of the cluster")
    handover.add_option(arguments)
    given = arguments.parse_args()
    live(given.run_dir, given.handed)


if __name__ == "__main__":
    main()
