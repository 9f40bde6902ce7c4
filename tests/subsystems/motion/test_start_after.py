"""Start conditions: a primitive begins when another arm has left the space that it needs."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.base.subsystem import BROKER
from sim_mcm.arms.kinematic_arm import KinematicCell

ARM, OTHER = "RIGHT-ARM", "LEFT-ARM"


@pytest.fixture
def bench(cell, make):
    return make.Bench(KinematicCell(cell))


@pytest.fixture
def swing(cell, make):
    def build(id: str = "C-7.1", performer: str = ARM, *conditions: p.StartAfter) -> p.Primitive:
        home = cell.arm(performer).home_rad
        path = make.joint_path(home, [home[0] + 0.3, *home[1:]], 1.0)
        return make.primitive(path, id=id, performer=performer, start_after=list(conditions))

    return build


def when(path_s: float, within_s: float = 5.0, primitive: str = "C-7.1") -> p.StartAfter:
    return p.StartAfter(primitive=primitive, path_s=path_s, within_s=within_s)


def of_left(sent: list[tuple[bytes, m.Message]]) -> list[m.Message]:
    return [message for _, message in sent if getattr(message, "primitive", "") == "C-8.1"]


def test_it_starts_when_the_other_arm_has_come_far_enough(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    assert bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.4)))) == []
    assert bench.subsystem.outstanding == ["C-7.1", "C-8.1"]
    assert of_left(bench.tick(399)) == []
    assert isinstance(of_left(bench.tick(2))[0], m.Started)
    assert of_left(bench.tick(1100))[0].reason is StopReason.GOAL


def test_it_waits_as_long_as_the_other_arm_pauses(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.6, within_s=1.0))))
    bench.tick(200)
    bench.handle(m.SetPaused(primitive="C-7.1", paused=True))
    assert of_left(bench.tick(3000)) == []
    bench.handle(m.SetPaused(primitive="C-7.1", paused=False))
    assert isinstance(of_left(bench.tick(2500))[0], m.Started)


def test_it_does_not_start_while_it_is_paused(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.2))))
    bench.handle(m.SetPaused(primitive="C-8.1", paused=True))
    assert bench.subsystem.hello()[0][1].paused == ["C-8.1"]
    assert of_left(bench.tick(500)) == []
    bench.handle(m.SetPaused(primitive="C-8.1", paused=False))
    assert isinstance(of_left(bench.tick(2))[0], m.Started)


def test_it_starts_at_once_if_the_other_arm_is_past(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(500)
    assert isinstance(of_left(bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.4)))))[0], m.Started)


def test_a_goal_counts_as_the_end_of_the_path(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(p.MAX_S))))
    bench.tick(1500)
    assert [type(message) for message in of_left(bench.sent)] == [m.Started]
    first = next(message for _, message in bench.sent if isinstance(message, m.EndReport))
    assert first.primitive == "C-7.1"


def test_an_arm_that_is_stopped_before_it_has_left_blocks_the_start(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.4))))
    bench.tick(200)
    bench.handle(m.HaltOrder(halt="h", scope="C-7"))
    bench.tick(300)
    (report,) = of_left(bench.sent)
    assert report.reason is StopReason.BLOCKED
    assert report.joints  # it is known where the arm stands
    assert bench.simulation.arms[OTHER].read().velocities == [0.0] * 6


def test_an_arm_that_is_stopped_after_it_has_left_does_not(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(600)
    bench.handle(m.HaltOrder(halt="h", scope="C-7"))
    bench.tick(300)
    assert isinstance(of_left(bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.4)))))[0], m.Started)


def test_the_wait_has_a_limit(bench, swing, cell, make):
    still = make.primitive(p.HoldStill(duration_s=20.0))
    bench.handle(m.Execute(primitive=still))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(30.0, within_s=0.2))))
    bench.tick(190)
    assert of_left(bench.sent) == []
    bench.tick(20)
    assert of_left(bench.sent)[0].reason is StopReason.BLOCKED


def test_an_unknown_primitive_blocks_the_start(bench, swing):
    (report,) = of_left(bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.4)))))
    assert report.reason is StopReason.BLOCKED


@pytest.mark.parametrize("scope", ["ALL", OTHER, "C-8"])
def test_a_halt_ends_the_wait(bench, swing, scope):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER, when(0.4))))
    bench.handle(m.HaltOrder(halt="h", scope=scope))
    assert of_left(bench.sent)[0].reason is StopReason.HALT
    bench.tick(2000)
    assert len({type(message) for message in of_left(bench.sent)}) == 1  # never started


def test_a_repeated_order_waits_once_and_another_one_is_refused(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    waiting = swing("C-8.1", OTHER, when(0.4))
    bench.handle(m.Execute(primitive=waiting))
    assert bench.handle(m.Execute(primitive=waiting)) == []
    ((_, report),) = bench.handle(m.Execute(primitive=swing("C-9.1", OTHER)))
    assert report.reason is StopReason.REFUSED
    assert report.primitive == "C-9.1"


def test_a_contact_of_two_arms_stops_both(cell, make):
    arms = {name: make.SteeredArm(cell, name) for name in (ARM, OTHER)}
    bench = make.Bench(SimpleNamespace(arms=arms, step=lambda: None))
    for name, id in ((ARM, "C-7.1"), (OTHER, "C-8.1")):
        home = cell.arm(name).home_rad
        path = make.joint_path(home, [home[0] + 0.3, *home[1:]], 1.0)
        bench.handle(m.Execute(primitive=make.primitive(path, id=id, performer=name)))
    bench.tick(300)
    arms[ARM].meeting = {"RIGHT-ARM forearm touches LEFT-ARM palm": 3.0}
    bench.tick(600)
    ends = {report.primitive: report for _, report in bench.sent if isinstance(report, m.EndReport)}
    assert {id: report.reason for id, report in ends.items()} == dict.fromkeys(("C-7.1", "C-8.1"), "arm_contact")
    assert all("forearm touches LEFT-ARM palm" in one.message for one in ends.values())  # wording: the bodies
    assert all(receiver == BROKER for receiver, _ in bench.sent)
