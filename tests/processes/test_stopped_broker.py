"""The broker is stopped by SIGSTOP during a guarded move: the MCM stops at the contact by itself (R55).

A real cluster with pybullet in real time.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from rtc.client.client import Client
from rtc.demos.own_cluster import own_cluster
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.robot import geometry
from rtc.runtime.process_table import processes

pytestmark = pytest.mark.slow
LIMIT_S = 60.0
ARM = "RIGHT-ARM"
FACE_M, TIP_M, GAP_M = 0.75, 0.015, 0.004  # x of the satellite's face; from the tcp to the fingertips; before the touch


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(mcm="bullet", dim=2) as path:
        yield path


def test_a_guarded_move_stops_at_the_contact_without_the_broker(run_dir: Path) -> None:
    with Client(run_dir) as rtc:
        assert rtc.run(f"MOVE {ARM} BY 15 CM ALONG DOWN", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        before = rtc.truth().tcp[ARM]
        rtc.displace("SATELLITE", [before[0] + TIP_M + GAP_M - FACE_M, 0.0, 0.0, 0.0, 0.0, 0.0])
        samples = rtc.telemetry(silence_s=LIMIT_S)
        next(samples)
        # 3 mm/s: the first tick on the rigid wall is below the 45 N of the verb
        line = f"MOVE {ARM} BY 3 CM ALONG TOOL-Z MAINTAIN SPEED 3 MM/S UNLESS CONTACT THEN STOP"
        command = rtc.submit(line)
        next(sample for sample in samples if sample.arms[ARM].primitive)
        broker = processes(run_dir)["broker"].pid
        os.kill(broker, signal.SIGSTOP)
        try:
            next(sample for sample in samples if not sample.arms[ARM].primitive)
            stopped = rtc.truth()
        finally:
            with suppress(ProcessLookupError):  # a slow machine: the supervisor has replaced it meanwhile
                os.kill(broker, signal.SIGCONT)
        end = command.wait(LIMIT_S)
        after = rtc.truth()

        assert stopped.tcp[ARM][0] - before[0] == pytest.approx(GAP_M, abs=0.001)
        assert geometry.distance(stopped.tcp[ARM], after.tcp[ARM]) < 0.0002  # it holds
        assert end.outcome.kind is OutcomeKind.FAILED
        assert end.outcome.stop is StopReason.CONTACT
        assert "as asked: UNLESS CONTACT THEN STOP" in end.outcome.message
