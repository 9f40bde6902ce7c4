"""A real cluster with pybullet in real time: guarded moves without a broker (R55), an arm that is pushed at rest."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.faults import Drifting
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.runtime.process_table import processes
from rtc.spatial import geometry
from rtc.subsystems.motion.stray_watch import STRAYED

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


def test_an_arm_that_is_pushed_at_rest_is_braked_and_reported_and_can_leave(run_dir: Path) -> None:
    with Client(run_dir) as rtc:
        before = rtc.truth().joints
        events = rtc.events(silence_s=LIMIT_S)
        rtc.inject(Drifting(object="SATELLITE", velocity=[-0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
        ended = next(one for one in events if isinstance(one, m.CommandEnded))
        rtc.undo_fault("ALL")
        assert ended.outcome.kind is OutcomeKind.FAILED
        arm, other = sorted(before, key=lambda name: name in ended.outcome.message, reverse=True)
        assert ended.outcome.message.startswith(f"{arm} moved without a command")  # wording: which arm
        (mcm,) = (row for row in rtc.status().subsystems if row.name == "MCM")
        assert any(arm in words for words in mcm.strayed)
        facts = {fact.key: fact for fact in rtc.world.view(keys=[arm]).facts}
        assert facts[f"{arm}.joints"].validity is m.Validity.SUSPECT

        rtc.displace("SATELLITE", [0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert math.dist(rtc.truth().joints[arm], before[arm]) > STRAYED / 2  # not pulled back; it had strayed
        for sentence in (f"STOW {other}", f"STOW {arm}"):  # each reads the joints of the arm that was pushed
            assert rtc.run(sentence, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        (mcm,) = (row for row in rtc.status().subsystems if row.name == "MCM")
        assert not mcm.strayed
