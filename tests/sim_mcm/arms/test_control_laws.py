"""Control laws: computed torque, and one added by files alone (R63, R99)."""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.plugins import registry
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import ControlLaw
from rtc.subsystems.motion.arm import TICK_S
from sim_mcm.arms import control_laws
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.servo import Servo


@pytest.fixture(scope="module")
def model(cell) -> ArmModel:
    return ArmModel.of(cell, "RIGHT-ARM")


def test_position_brings_the_arm_to_where_it_is_wanted(cell, model) -> None:
    home = np.array(cell.arm("RIGHT-ARM").home_rad)
    servo, data = Servo(model, home.tolist()), model.model.createData()
    wanted = (home + 0.001).tolist()
    servo.wanted = (wanted, [0.0] * 6, [0.0] * 6)
    q, v = home.copy(), np.zeros(6)
    for _ in range(200):
        torque = np.array(servo.torque(q.tolist(), v.tolist()))
        v = v + pin.aba(model.model, data, q, v, torque) * TICK_S
        q = q + v * TICK_S
    assert q == pytest.approx(wanted, abs=1e-6)


def test_torques_stay_within_what_the_motors_can(cell, model) -> None:
    home = cell.arm("RIGHT-ARM").home_rad
    servo = Servo(model, home)
    servo.wanted = ([q + 1.0 for q in home], [0.0] * 6, [0.0] * 6)
    torque = np.abs(servo.torque(home, [0.0] * 6))
    assert np.all(torque <= model.limits.effort)
    assert np.any(torque == model.limits.effort)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (ControlLaw(name="magic"), "there is no control law magic; there are impedance, position"),
        (ControlLaw(gains={"wn": 5.0}), "outside 10 to 300"),
        (ControlLaw(gains={"kp": 5.0}), "knows the gain wn, not kp"),
        (ControlLaw(gains={"wn": float("inf")}), "not a finite number"),
    ],
)
def test_a_law_that_will_not_do_is_refused_in_words_and_the_old_one_stays(cell, model, law, words: str) -> None:
    home = cell.arm("RIGHT-ARM").home_rad
    servo = Servo(model, home)
    with pytest.raises(ValueError, match=words):
        servo.use_law(law, home)
    assert servo.torque(home, [0.0] * 6) == pytest.approx([0.0] * 6, abs=1e-9)


SLACK = """
class Slack:
    def __init__(self, model, gains):
        self.n = model.nq
    def torque(self, wanted, q, v):
        return [0.0] * self.n
"""


def test_a_law_is_added_by_installing_a_package_that_names_it(install, model) -> None:
    install(registry.CONTROL_LAWS, "slack", "Slack", SLACK)
    law = control_laws.make(ControlLaw(name="slack"), model, control_laws.known())
    assert law.torque(([1.0] * 6, [0.0] * 6, [0.0] * 6), [0.0] * 6, [0.0] * 6) == [0.0] * 6


SPRINGS = """
import numpy as np, pinocchio as pin

class Springs:
    def __init__(self, model, gains):
        self.model, self.data, self.wn = model, model.createData(), gains["wn"]
    def torque(self, wanted, q, v):
        off, rate = np.subtract(wanted[0], q), np.subtract(wanted[1], v)
        inertia = pin.crba(self.model, self.data, np.array(q))
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        return (inertia @ (self.wn**2 * off + 2.0 * self.wn * rate)).tolist()
"""


@pytest.mark.physics
def test_a_primitive_is_executed_under_an_added_law_in_physics(install, cell, make) -> None:
    install(registry.CONTROL_LAWS, "springs", "Springs", SPRINGS)
    world = BulletCell(cell)
    try:
        bench = make.Bench(world)
        start = cell.arm("RIGHT-ARM").home_rad
        path = make.joint_path(start, [*start[:-1], start[-1] + 0.3], 1.0)
        refused = bench.perform(make.primitive(path, id="C-1.1", control_law=ControlLaw(name="springs")))
        report = bench.perform(
            make.primitive(path, id="C-1.2", control_law=ControlLaw(name="springs", gains={"wn": 150.0}))
        )
    finally:
        world.close()
    assert refused.reason is StopReason.REFUSED
    assert "wn" in refused.message  # wording: which gain is wrong
    assert report.reason is StopReason.GOAL
    assert report.joints == pytest.approx([*start[:-1], start[-1] + 0.3], abs=1e-3)


ODD = """
class Law:
    def __init__(self, model, gains):
        self.n, self.ticks = model.nq, 0
    def torque(self, wanted, q, v):
        self.ticks += 1
        if self.ticks < 200:
            return [0.0] * self.n
        {what}
"""


@pytest.mark.parametrize("what", ["while True: pass", "import time; time.sleep(600.0)"])
def test_a_law_that_hangs_is_replaced_before_a_halt_has_waited_long(install, cell, model, what: str) -> None:
    install(registry.CONTROL_LAWS, "evil", "Law", ODD.format(what=what).replace("200", "20"))
    law, own = (control_laws.make(ControlLaw(name=name), model, control_laws.known()) for name in ("evil", "position"))
    home = cell.arm("RIGHT-ARM").home_rad
    wanted = ([q + 0.001 for q in home], [0.0] * 6, [0.0] * 6)
    before_s = time.thread_time()
    torques = [law.torque(wanted, home, [0.0] * 6) for _ in range(30)]
    assert time.thread_time() - before_s < 0.05
    assert torques[18] == [0.0] * 6
    assert torques[20] == torques[29] == own.torque(wanted, home, [0.0] * 6)
    assert "control law evil" in law.failed


def test_a_law_that_has_failed_once_is_tried_again_by_the_next_primitive(install, cell, model) -> None:
    install(registry.CONTROL_LAWS, "evil", "Law", ODD.format(what="raise RuntimeError").replace("200", "2"))
    home = cell.arm("RIGHT-ARM").home_rad
    servo = Servo(model, home)
    for _ in range(2):
        servo.use_law(ControlLaw(name="evil"), home)
        assert servo.fault == ""
        for _ in range(5):
            servo.torque(list(home), [0.0] * 6)
        assert "control law evil" in servo.fault


@pytest.mark.physics
@pytest.mark.parametrize("what", ["raise SystemExit(1)", "return [float('nan')] * self.n", "return 'x'", "return None"])
def test_a_law_that_fails_is_replaced_at_once_and_its_primitive_ends(install, cell, make, what: str) -> None:
    install(registry.CONTROL_LAWS, "evil", "Law", ODD.format(what=what))
    world = BulletCell(cell)
    try:
        bench = make.Bench(world)
        start = cell.arm("RIGHT-ARM").home_rad
        path = make.joint_path(start, [*start[:-1], start[-1] + 0.01], 4.0)
        report = bench.perform(make.primitive(path, id="C-1.1", control_law=ControlLaw(name="evil")))
        after = bench.perform(make.primitive(make.joint_path(report.joints, start, 1.0), id="C-1.2"))
    finally:
        world.close()
    assert report.reason is StopReason.FOLLOWING_ERROR
    assert "control law evil" in report.message  # wording: whose code has failed
    assert after.reason is StopReason.GOAL
