"""An arm that moves without a primitive is braked, reported, and rests; its next primitive lets the brakes go."""

from __future__ import annotations

import math

import numpy as np
import pybullet
import pytest

from rtc.apps.authoring.draft import draft
from rtc.protocol import messages as m
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.stray_watch import STRAYED
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms import hand
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.period import period
from tests.apps.authoring import small_arms
from tests.subsystems.motion.conftest import ARM, OTHER, joint_path, primitive


class Resting:
    """A subsystem on physics, with what it tells the broker."""

    def __init__(self, cell, arm):
        self.sim, self.arm = BulletCell(cell), arm
        self.mcm = McmSubsystem(self.sim.arms, pid=1)
        self.sent, self.now_s = [], 0.0

    def run(self, ticks, push_n=0.0):
        """Push the last link of the arm upwards. Returns the farthest that a joint has come from where it was."""
        body, at, far = self.sim.arms[self.arm], np.array(self.joints), 0.0
        last = pybullet.getNumJoints(body.body, physicsClientId=self.sim.world.client) - 1
        for _ in range(ticks):
            self.now_s += 0.001
            if push_n:
                pybullet.applyExternalForce(
                    body.body, last, (0, 0, push_n), (0, 0, 0), pybullet.LINK_FRAME, self.sim.world.client
                )
            sent = period(self.mcm.tick, self.sim, self.now_s)
            self.sent += [message for to, message in sent if to == BROKER]
            far = max(far, float(np.abs(np.array(self.joints) - at).max()))
        return far

    @property
    def joints(self):
        return self.mcm.executors[self.arm].sample.joints

    def reported(self, kind):
        return [message for message in self.sent if isinstance(message, kind)]


@pytest.fixture
def resting():
    made = []

    def make(cell, arm=ARM):
        made.append(Resting(cell, arm))
        return made[-1]

    yield make
    for one in made:
        one.sim.close()


@pytest.mark.physics
def test_an_arm_that_whirls_at_rest_is_braked_and_a_halt_of_it_is_confirmed(resting, tmp_path, monkeypatch):
    """Its fingers shake, because their springs are too stiff for their mass."""
    monkeypatch.setattr(hand, "gains_of", lambda kg: hand.Gains(hand.FINGER_N_M, hand.OPENING_NS_M, hand.CENTRE_NS_M))
    (tmp_path / "six.urdf").write_text(small_arms.urdf("six", small_arms.SIX, finger_kg=0.010))
    bench = resting(draft(tmp_path / "six.urdf", "SIX").cell, "SIX")
    assert bench.run(1000) < math.radians(30.0)
    assert bench.run(500) < math.radians(0.1)
    begun, ended = bench.reported(m.Strayed)
    assert "without a command" in begun.arms["SIX"]
    assert ended.arms["SIX"].endswith("it rests")
    bench.sent += [one for _, one in bench.mcm.handle(m.HaltOrder(halt="H-1"), BROKER, bench.now_s)]
    bench.run(10)
    (answer,) = bench.reported(m.HaltAtRest)
    assert answer.at_rest


@pytest.mark.physics
def test_an_arm_that_is_pushed_aside_is_reported_until_its_next_primitive(resting, cell):
    bench = resting(cell)
    assert bench.run(300) < STRAYED / 10
    assert bench.reported(m.Strayed) == []
    bench.run(400, push_n=900.0)
    bench.run(300)
    assert list(bench.reported(m.Strayed)[-1].arms) == [ARM]
    assert any(isinstance(one, m.Strayed) for _, one in bench.mcm.hello())
    at = bench.joints
    ordered = m.Execute(primitive=primitive(joint_path(at, [at[0] + 0.1, *at[1:]], 1.0)), pid=1)
    bench.sent += [one for _, one in bench.mcm.handle(ordered, BROKER, bench.now_s)]
    assert bench.reported(m.Strayed)[-1].arms == {}
    bench.run(2500)
    end, *_ = bench.reported(m.EndReport)
    assert end.reason is StopReason.GOAL
    assert bench.joints[0] == pytest.approx(at[0] + 0.1, abs=0.001)


def test_arms_that_rest_or_follow_a_primitive_do_not_stray(rig):
    assert rig.tick(100) == []
    rig.accept(rig.swing())
    assert rig.until_end().reason is StopReason.GOAL
    assert rig.tick(100) == []
    assert not rig.arm.braked
    rig.arm.lag = 0.02
    (strayed,) = rig.tick()
    assert strayed.arms[ARM].startswith("moved without a command, joint_1 by 1.1 deg")
    assert rig.arm.braked
    assert OTHER not in strayed.arms
