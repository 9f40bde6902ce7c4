"""Conditions on the way of a motion: it stands before a place until another arm has left the space beyond it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from sim_mcm.arms.kinematic_arm import KinematicCell

ARM, OTHER = "RIGHT-ARM", "LEFT-ARM"
FIRST, SECOND = "C-7.1", "C-8.1"


@pytest.fixture
def bench(cell, make):
    return make.Bench(KinematicCell(cell))


@pytest.fixture
def swing(cell, make):
    def build(id: str = FIRST, performer: str = ARM, *after: p.StartAfter, duration_s: float = 2.0, **more: object):
        home = cell.arm(performer).home_rad
        path = make.joint_path(home, [home[0] + 0.5, *home[1:]], duration_s)
        return make.primitive(path, id=id, performer=performer, start_after=list(after), **more)

    return build


def after(path_s: float, *further: tuple[float, float], within_s: float = 5.0) -> p.StartAfter:
    return p.StartAfter(primitive=FIRST, path_s=path_s, within_s=within_s, further=list(further))


def sent_of(bench, primitive: str, kind: type) -> list[m.Message]:
    return [message for _, message in bench.sent if isinstance(message, kind) and message.primitive == primitive]


def end_of(bench, primitive: str) -> m.EndReport:
    reports = sent_of(bench, primitive, m.EndReport)  # repeated until acknowledged
    assert reports == [reports[0]] * len(reports)
    return reports[0]


def pair(bench) -> SimpleNamespace:
    executors = bench.subsystem.executors
    return SimpleNamespace(first=executors[ARM], second=executors[OTHER])


def test_it_is_not_slower_than_alone_if_the_other_arm_is_in_time(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 0.7), (1.2, 1.1)))))
    bench.tick(3000)
    alone_s = end_of(bench, FIRST).duration_s
    assert (end_of(bench, SECOND).duration_s, end_of(bench, SECOND).paused_s) == (pytest.approx(alone_s, abs=0.01), 0.0)


def test_it_stands_before_its_place_until_the_other_arm_has_passed(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 0.9)), limit_s=3.0)))
    bench.tick(500)
    bench.handle(m.SetPaused(primitive=FIRST, paused=True))
    bench.tick(8000)  # longer than all its limits: neither counts while the other arm is in a pause
    arms = pair(bench)
    assert arms.second.held_back
    assert arms.second.command[1] == [0.0] * 6
    assert 0.7 < arms.second.path_s <= 0.8
    bench.handle(m.SetPaused(primitive=FIRST, paused=False))
    bench.tick(4000)
    assert end_of(bench, SECOND).reason is StopReason.GOAL
    assert end_of(bench, SECOND).paused_s > 6.0
    assert sent_of(bench, SECOND, m.PauseChanged) == []  # no client has paused it


def test_it_ends_where_it_stands_if_the_other_arm_does_not_come_there_any_more(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 0.9)))))
    bench.tick(600)
    bench.handle(m.HaltOrder(halt="h", scope="C-7"))
    bench.tick(1000)
    report = end_of(bench, SECOND)
    assert report.reason is StopReason.BLOCKED
    assert report.duration_s > 0.0
    assert report.joints[0] != pytest.approx(bench.simulation.arms[ARM].read().joints[0])
    assert pair(bench).second.path_s <= 0.8


def test_a_stop_of_the_other_arm_behind_the_last_place_changes_nothing(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 0.5)))))
    bench.tick(600)
    bench.handle(m.HaltOrder(halt="h", scope="C-7"))
    bench.tick(3000)
    assert end_of(bench, SECOND).reason is StopReason.GOAL


def test_all_its_waits_together_have_a_limit(bench, swing, make):
    bench.handle(m.Execute(primitive=make.primitive(p.HoldStill(duration_s=20.0))))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.0, (0.8, 15.0), within_s=0.5))))
    bench.tick(5000)
    assert end_of(bench, SECOND).reason is StopReason.BLOCKED
    assert 0.5 < end_of(bench, SECOND).duration_s < 2.0  # the other arm would be there for 15 s


def test_a_pause_while_it_stands_is_reported_and_ends_although_it_may_not_go_on(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 0.9)))))
    bench.tick(500)
    bench.handle(m.SetPaused(primitive=FIRST, paused=True))
    bench.tick(2000)
    bench.handle(m.SetPaused(primitive=SECOND, paused=True))
    bench.tick(500)
    bench.handle(m.SetPaused(primitive=SECOND, paused=False))
    bench.tick(500)
    assert [message.paused for message in sent_of(bench, SECOND, m.PauseChanged)] == [True, False]
    assert pair(bench).second.path_s <= 0.8


def test_it_does_not_go_on_for_a_way_that_is_too_short_to_stand_again(bench, swing):
    bench.handle(m.Execute(primitive=swing(duration_s=6.0)))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 3.0), (1.0, 5.0)))))
    bench.tick(2500)
    arms = pair(bench)
    stood_s = arms.second.path_s
    for _ in range(2400):
        bench.tick(1)
        assert arms.second.path_s == stood_s
    bench.tick(3000)
    assert end_of(bench, SECOND).reason is StopReason.GOAL


def test_a_halt_ends_it_while_it_stands(bench, swing):
    bench.handle(m.Execute(primitive=swing()))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, after(0.3, (0.8, 0.9)))))
    bench.tick(500)
    bench.handle(m.SetPaused(primitive=FIRST, paused=True))
    bench.tick(2000)
    bench.handle(m.HaltOrder(halt="h", scope="C-8"))
    bench.tick(500)
    assert end_of(bench, SECOND).reason is StopReason.HALT


@pytest.mark.parametrize("seed", range(12))
def test_it_is_never_where_the_other_arm_has_not_left_yet(bench, swing, seed):
    """Random places, random speeds; either is paused and goes on at random, at last one is halted."""
    random = np.random.default_rng(seed)
    count = int(random.integers(1, p.MAX_FURTHER + 1))
    own_s, other_s = np.sort(random.uniform(0.05, 2.0, count)), np.sort(random.uniform(0.4, 2.0, count))
    condition = after(0.3, *zip(own_s.tolist(), other_s.tolist(), strict=True), within_s=60.0)
    bench.handle(m.Execute(primitive=swing(duration_s=random.uniform(2.0, 4.0))))
    bench.handle(m.Execute(primitive=swing(SECOND, OTHER, condition, duration_s=random.uniform(2.0, 3.0))))
    arms, paused, reached_s = pair(bench), {FIRST: False, SECOND: False}, 0.0
    most = np.array(arms.second.arm.traits.acceleration)
    for tick in range(20_000):
        if random.random() < 0.002 and tick < 10_000:
            name = (FIRST, SECOND)[int(random.integers(2))]
            paused[name] = not paused[name]
            bench.handle(m.SetPaused(primitive=name, paused=paused[name]))
        if tick == 10_000:
            for name in paused:
                bench.handle(m.SetPaused(primitive=name, paused=False))
        if seed % 3 == 0 and tick == 4000:
            bench.handle(m.HaltOrder(halt="h", scope="C-7"))
        bench.tick(1)
        if arms.first.primitive_id == FIRST or arms.first.path_s > reached_s:
            reached_s = arms.first.path_s
        if arms.second.primitive_id == SECOND and arms.second.trip is None:
            assert condition.needed_s(arms.second.path_s) <= reached_s + 1e-9
            assert (np.abs(arms.second.command[2]) <= 1.01 * most).all()
        if bench.subsystem.idle:
            break
    reason = end_of(bench, SECOND).reason
    assert reason is StopReason.GOAL or (seed % 3 == 0 and reason is StopReason.BLOCKED)
