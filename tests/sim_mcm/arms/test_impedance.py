"""Impedance control on pybullet: measured stiffness, pressed force, and the change between it and position control."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pybullet
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import TICK_S
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.impedance import Impedance

pytestmark = pytest.mark.physics
ARM = "RIGHT-ARM"
PALM = 7  # link of the URDF
FACE_M, HOME_M, TIP_M = 0.75, 0.64, 0.015  # x of the satellite's face and of the tcp at home; from the tcp to the tips
WALL_M = 0.005  # distance of the fingertips from the wall at the start of a press


@pytest.fixture
def world(cell):
    made = BulletCell(cell)
    yield made
    made.close()


@pytest.fixture
def bench(world, make):
    return make.Bench(world)


@pytest.fixture(scope="module")
def model(cell) -> ArmModel:
    return ArmModel.of(cell, ARM)


def impedance(stiffness_n_m: float = 1000.0, turning_nm_rad: float = 30.0, **more: object) -> p.ControlLaw:
    figures = [stiffness_n_m] * 3 + [turning_nm_rad] * 3
    return p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=figures, **more))  # type: ignore[arg-type]


def hold(make, law: p.ControlLaw, duration_s: float = 1.0, id: str = "C-1.1", *stops: p.StopFunction) -> p.Primitive:
    return make.primitive(p.HoldStill(duration_s=duration_s), *stops, id=id, control_law=law)


def pushed(world, bench, wrench: list[float], ticks: int) -> None:
    """Push at the tcp for some ticks with a wrench in world axes."""
    arm = world.arms[ARM]
    at = arm.tcp_pose(arm.read().joints)[:3].tolist()
    client = world.world.client
    for _ in range(ticks):
        pybullet.applyExternalForce(arm.body, PALM, wrench[:3], at, pybullet.WORLD_FRAME, physicsClientId=client)
        pybullet.applyExternalTorque(arm.body, PALM, wrench[3:], pybullet.WORLD_FRAME, physicsClientId=client)
        bench.tick()


def before_the_wall(world, bench, make, model) -> None:
    """Bring the satellite's face WALL_M in front of the fingertips, which point at it."""
    executor = bench.subsystem.executors[ARM]
    world.displace("SATELLITE", [HOME_M + TIP_M + WALL_M - FACE_M, 0.0, 0.0, 0.0, 0.0, 0.0])
    down = geometry.translate(model.fk(executor.sample.joints), (0.0, 0.0, -0.15))
    path = make.line_path(model, executor.command[0], down, 0.25)
    assert bench.perform(make.primitive(path, id="C-9.1")).reason is StopReason.GOAL


@pytest.mark.parametrize("frame", ["tool", "world"])
@pytest.mark.parametrize("stiffness", [(200.0, 10.0), (1000.0, 30.0), (5000.0, 150.0)])
def test_the_measured_stiffness_is_the_commanded_one(world, bench, make, model, stiffness, frame) -> None:
    along, about = stiffness
    executor = bench.subsystem.executors[ARM]
    for axis in range(3):
        bench.handle(m.Execute(primitive=hold(make, impedance(along, about, frame=frame), 4.0, f"C-1.{axis + 1}")))
        bench.tick(2)
        start = model.fk(executor.sample.joints)
        push = [0.0] * 6
        push[axis] = 5.0
        pushed(world, bench, push, 2500 if along < 1000.0 else 1000)  # a soft spring swings longer
        moved = model.fk(executor.sample.joints)[:3] - start[:3]
        assert moved[axis] == pytest.approx(5.0 / along, rel=0.05)
        assert np.abs(np.delete(moved, axis)).max() < 0.1 * moved[axis]
        bench.handle(m.HaltOrder(halt=f"H-{axis}", scope="ALL"))
        bench.tick(200)
        assert executor.primitive is None


def test_a_soft_axis_gives_way_and_a_stiff_one_does_not(world, bench, make, model) -> None:
    """The selection frame is that of the tool, which points along world x here."""
    soft_along_tool = p.Compliance(stiffness=[5000.0, 5000.0, 200.0, 150.0, 150.0, 150.0])
    bench.handle(m.Execute(primitive=hold(make, p.ControlLaw(name="impedance", compliance=soft_along_tool), 3.0)))
    bench.tick(2)
    executor = bench.subsystem.executors[ARM]
    start = model.fk(executor.sample.joints)
    pushed(world, bench, [4.0, 4.0, 0.0, 0.0, 0.0, 0.0], 2000)
    moved = model.fk(executor.sample.joints)[:3] - start[:3]
    assert moved[0] == pytest.approx(0.020, rel=0.05)
    assert moved[1] == pytest.approx(0.0008, rel=0.1)


@pytest.mark.parametrize(("ratio", "least", "most"), [(0.2, 1.15, 1.7), (1.0, 0.9, 1.05)])
def test_the_damping_decides_how_far_a_sudden_push_overshoots(world, bench, make, model, ratio, least, most) -> None:
    law = impedance(1000.0, 30.0, damping=[ratio] * 6)
    bench.handle(m.Execute(primitive=hold(make, law, 4.0)))
    bench.tick(2)
    executor = bench.subsystem.executors[ARM]
    start, farthest_m = model.fk(executor.sample.joints), 0.0
    for _ in range(60):
        pushed(world, bench, [0.0, 5.0, 0.0, 0.0, 0.0, 0.0], 10)
        farthest_m = max(farthest_m, geometry.distance(start, model.fk(executor.sample.joints)))
    assert least < farthest_m / (5.0 / 1000.0) < most


@pytest.mark.parametrize(
    ("limits", "push", "yields_m", "yields_rad"),
    [
        ({"most_n": 3.0}, [0.0, 10.0, 0.0, 0.0, 0.0, 0.0], 0.014, 0.0),  # an unlimited spring yields by 10 mm
        ({"most_nm": 0.5}, [0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 0.0, 0.06),  # and by 0.033 rad
    ],
)
def test_a_spring_pulls_with_its_greatest_force_and_gives_way_to_more(
    world, bench, make, model, limits, push, yields_m, yields_rad
) -> None:
    bench.handle(m.Execute(primitive=hold(make, impedance(1000.0, 30.0, **limits), 4.0)))
    bench.tick(2)
    executor = bench.subsystem.executors[ARM]
    start = model.fk(executor.sample.joints)
    pushed(world, bench, push, 500)
    now = model.fk(executor.sample.joints)
    assert geometry.distance(start, now) >= yields_m
    assert geometry.angle(start, now) >= yields_rad


@pytest.mark.parametrize("frame", ["tool", "world"])
def test_a_push_at_the_centre_of_compliance_does_not_turn_the_tool(world, bench, make, model, frame) -> None:
    """The centre is 150 mm before the palm and 85 mm aside; the tool points along world x, and its y is that of the
    world. A push at the tcp turns the tool then."""
    executor = bench.subsystem.executors[ARM]
    centre = {"centre": [0.0, 0.085, 0.150], "frame": frame}
    turned = []
    for n, torque_nm in enumerate((4.0 * 0.150, 0.0)):
        bench.handle(m.Execute(primitive=hold(make, impedance(400.0, 5.0, **centre), 4.0, f"C-1.{n + 1}")))
        bench.tick(2)
        start = model.fk(executor.sample.joints)
        pushed(world, bench, [0.0, 4.0, 0.0, 0.0, 0.0, torque_nm], 2000)
        now = model.fk(executor.sample.joints)
        turned.append(geometry.angle(start, now))
        if torque_nm:
            assert now[:3] - start[:3] == pytest.approx([0.0, 0.010, 0.0], abs=0.001)
        bench.handle(m.HaltOrder(halt=f"H-{n}", scope="ALL"))
        bench.tick(200)
    assert turned[0] < 0.005
    assert turned[1] == pytest.approx(4.0 * 0.150 / 5.0, rel=0.1)


@pytest.mark.parametrize("frame", ["tool", "world"])
def test_a_force_set_point_is_held_on_a_wall_within_5_percent(world, bench, make, model, frame) -> None:
    before_the_wall(world, bench, make, model)
    executor = bench.subsystem.executors[ARM]
    wrench: list[float | None] = [None] * 6
    wrench[2 if frame == "tool" else 0] = 10.0
    felt: list[float] = []

    def watch() -> None:
        if executor.primitive is not None and executor.trip is None:
            felt.append(-executor.wrench[2])

    report = bench.perform(hold(make, impedance(wrench=wrench, frame=frame), 6.0), watch=watch)

    assert report.reason is StopReason.GOAL
    assert np.mean(felt[-1000:]) == pytest.approx(10.0, rel=0.05)
    assert np.std(felt[-1000:]) < 0.5
    assert max(felt) < 25.0  # the touch itself
    # and it does not press any longer once the primitive has ended
    assert np.linalg.norm(report.wrench[:3]) < 1.0


def test_a_set_point_without_a_wall_moves_slowly_and_does_not_wind_up(world, bench, make, model) -> None:
    executor = bench.subsystem.executors[ARM]
    start = model.fk(executor.sample.joints)
    bench.perform(hold(make, impedance(wrench=[None, None, 10.0, None, None, None]), 2.0))
    assert 0.005 < geometry.distance(start, model.fk(executor.sample.joints)) < 0.012  # 5 mm/s


@pytest.mark.parametrize("false_n", [0.0, 3.0, -3.0])  # the bias of the sensor may hold a force that has ended
@pytest.mark.parametrize("approach_m_s", [0.001, 0.0026, 0.005])
def test_a_set_point_meets_nothing_faster_than_its_approach(model, cell, approach_m_s: float, false_n: float) -> None:
    """Pure. It passed 4 mm/s, whatever was wanted: its damping is limited."""
    figures = p.Compliance(
        stiffness=[300.0] * 3 + [200.0] * 3, wrench=[None, None, 8.0, None, None, None], approach_m_s=approach_m_s
    )
    law = Impedance(model.model, model.tcp_frame, np.eye(3), figures, np.full(model.model.nv, 1e3))
    start = np.array(cell.arm(ARM).home_rad)
    along = geometry.rotate(model.fk(start), (0.0, 0.0, 1.0))
    q, v, data, still = start, np.zeros_like(start), model.model.createData(), [0.0] * len(start)
    fastest_m_s = 0.0
    for _ in range(300):
        law.feel([0.0, 0.0, -false_n, 0.0, 0.0, 0.0])
        torque = np.array(law.torque((start.tolist(), still, still), q.tolist(), v.tolist()))
        v = v + TICK_S * pin.aba(model.model, data, q, v, torque)
        q = q + TICK_S * v
        fastest_m_s = max(fastest_m_s, float(along @ (model.jacobian(q)[:3] @ v)))
    assert fastest_m_s == pytest.approx(approach_m_s, abs=0.001 if false_n else 1e-5)


def test_a_halt_while_pressing_holds_where_it_is(world, bench, make, model) -> None:
    before_the_wall(world, bench, make, model)
    executor = bench.subsystem.executors[ARM]
    bench.handle(m.Execute(primitive=hold(make, impedance(wrench=[None, None, 10.0, None, None, None]), 30.0)))
    bench.tick(3000)
    pressed, at = -executor.wrench[2], model.fk(executor.sample.joints)
    assert pressed == pytest.approx(10.0, rel=0.05)

    bench.handle(m.HaltOrder(halt="H-1", scope=ARM))
    felt = []
    for ticks in range(1, 500):  # noqa: B007
        bench.tick()
        felt.append(float(np.linalg.norm(executor.wrench[:3])))
        if executor.primitive is None:
            break

    assert ticks < 60
    assert max(felt) < pressed + 1.0
    assert felt[-1] < 1.0
    assert geometry.distance(at, model.fk(executor.sample.joints)) < 0.0005
    bench.tick(500)
    assert geometry.distance(at, model.fk(executor.sample.joints)) < 0.0005


def test_a_stretched_spring_does_not_jump_at_the_end_of_its_primitive(world, bench, make, model) -> None:
    """Pushed 25 mm aside, then halted when the push ends: position control holds from there."""
    executor = bench.subsystem.executors[ARM]
    bench.handle(m.Execute(primitive=hold(make, impedance(200.0, 10.0), 30.0)))
    pushed(world, bench, [0.0, 5.0, 0.0, 0.0, 0.0, 0.0], 2500)
    at = model.fk(executor.sample.joints)
    bench.handle(m.HaltOrder(halt="H-1", scope=ARM))
    bench.tick(300)
    assert executor.primitive is None
    assert geometry.distance(at, model.fk(executor.sample.joints)) < 0.0005


def test_an_arm_that_is_to_comply_until_it_rests_is_pulled_back_by_its_spring(world, bench, make, model) -> None:
    """As the second arm at an object does, which must not hold against the first."""
    executor = bench.subsystem.executors[ARM]
    start = model.fk(executor.sample.joints)
    bench.handle(m.Execute(primitive=hold(make, impedance(200.0, 10.0, until_rest=True), 30.0)))
    pushed(world, bench, [0.0, 5.0, 0.0, 0.0, 0.0, 0.0], 1000)
    at = model.fk(executor.sample.joints)
    bench.handle(m.HaltOrder(halt="H-1", scope="ALL"))
    bench.tick(2000)
    assert executor.primitive is None
    assert geometry.distance(start, at) > 0.02
    assert geometry.distance(start, model.fk(executor.sample.joints)) < 0.005


def test_backing_off_is_counted_from_where_the_arm_is_and_not_from_its_command(world, bench, make, model) -> None:
    """A soft arm on a wall is 20 mm behind its command when the force trips."""
    before_the_wall(world, bench, make, model)
    executor = bench.subsystem.executors[ARM]
    front = model.fk(executor.sample.joints)
    goal = geometry.translate(front, (0.06, 0.0, 0.0))
    path = make.line_path(model, executor.command[0], goal, 0.02)
    trip = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=8.0, axis=[0.0, 0.0, -1.0]), Reflex.BACK_OFF, 0.004)
    report = bench.perform(make.primitive(path, trip, id="C-1.2", control_law=impedance(300.0, 10.0)))
    assert report.reason is StopReason.CONTACT
    assert report.reflex is Reflex.BACK_OFF
    assert geometry.distance(report.tcp_pose, report.trip_pose) == pytest.approx(0.004, abs=0.0015)


def test_an_impedance_follows_a_path_as_position_control_does(world, bench, make, model) -> None:
    executor = bench.subsystem.executors[ARM]
    goal = geometry.translate(model.fk(executor.sample.joints), (-0.10, 0.1, -0.2))
    path = make.line_path(model, executor.command[0], goal, 0.25)
    worst = [0.0]

    def watch() -> None:
        error = geometry.distance(model.fk(executor.command[0]), model.fk(executor.sample.joints))
        worst[0] = max(worst[0], error)

    report = bench.perform(make.primitive(path, control_law=impedance(400.0, 12.0)), watch=watch)
    assert report.reason is StopReason.GOAL
    assert worst[0] < 0.001  # the inertia is fed forward
