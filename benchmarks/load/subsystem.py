"""A subsystem that ends every primitive at once: `python -m benchmarks.load.subsystem --run-dir D`.

It has the protocol of the MCM (hello, heartbeat, reports repeated until they are acknowledged, answers to halts), and
moves nothing.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import zmq

from benchmarks.load.trivial import PERFORMERS, SUBSYSTEM, performer
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import StopReason, WireError
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.runtime import process
from rtc.runtime.process import Every, inbox, now_s
from rtc.runtime.settings import Settings

HEARTBEAT_S = 0.5
REPEAT_S = 0.5


class Instant:
    """The answers to each message. Pure."""

    def __init__(self, pid: int, performers: list[str]) -> None:
        self.pid, self.performers = pid, performers
        self.kept: dict[str, tuple[m.EndReport, float]] = {}  # unacknowledged report, time of its last sending

    def handle(self, message: m.BrokerToSubsystem, now: float) -> list[m.Message]:
        if isinstance(message, m.Execute):
            report = _done(message.primitive.id, message.primitive.performer, now)
            self.kept[report.primitive] = (report, now)
            return [report]
        if isinstance(message, m.ReportAck):
            self.kept.pop(message.primitive, None)
            return []
        if isinstance(message, m.HelloWanted):
            return self.hello()
        about: dict[str, Any] = {"halt": message.halt, "subsystem": SUBSYSTEM}
        return [
            m.HaltStarted(received_at_s=now, decelerating_at_s=now, moving=[], **about),
            m.HaltAtRest(at_s=now, at_rest=True, performers=self.performers, **about),
        ]

    def hello(self) -> list[m.Message]:
        hello = m.SubsystemHello(
            protocol=VERSION,
            name=SUBSYSTEM,
            pid=self.pid,
            performers=self.performers,
            outstanding=list(self.kept),
            abilities=[ARRAYS],
        )
        return [hello, *(report for report, _ in self.kept.values())]

    def overdue(self, now: float) -> list[m.Message]:
        """Reports to be repeated because they were not acknowledged in time."""
        due = [report for report, at_s in self.kept.values() if now - at_s > REPEAT_S]
        self.kept.update((report.primitive, (report, now)) for report in due)
        return list(due)


def _done(primitive: str, who: str, now: float) -> m.EndReport:
    return m.EndReport(
        primitive=primitive,
        performer=who,
        reason=StopReason.GOAL,
        at_s=now,
        duration_s=0.0,
        joints=[0.0] * 6,
        tcp_pose=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        wrench=[0.0] * 6,
        hand_width_m=0.0,
        hand_force_n=0.0,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--performers", nargs="+", default=[performer(n) for n in range(PERFORMERS)])
    given = parser.parse_args()
    run_dir = given.run_dir
    with process.start(SUBSYSTEM, run_dir) as me:
        process.show_name(SUBSYSTEM)
        socket = me.socket(zmq.DEALER, Settings.load(run_dir).endpoint("subsystems"), identity=SUBSYSTEM)
        read = wire.reader_of_many(m.BrokerToSubsystem)
        instant, heartbeat = Instant(os.getpid(), given.performers), Every(HEARTBEAT_S)
        process.freeze_heap()
        me.ready()
        messages = instant.hello()
        while not me.stopping:
            for parts in wire.together(messages):
                socket.send_multipart(parts)
            me.wait(heartbeat.left_s(now_s()))
            messages = []
            if heartbeat.due(now_s()):
                messages = [m.Heartbeat(name=SUBSYSTEM), *instant.overdue(now_s())]
            for parts in inbox(socket):
                try:
                    for message in read(parts):
                        messages += instant.handle(message, now_s())
                except WireError as error:
                    me.log.warning("dropped: %s", error)


if __name__ == "__main__":
    main()
