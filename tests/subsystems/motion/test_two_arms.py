"""Two arms in one primitive: they start together, a stop of one stops the other, and one report has both ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason

ARM, OTHER = "RIGHT-ARM", "LEFT-ARM"


@pytest.fixture
def arms(cell, make) -> dict[str, Any]:
    return {name: make.SteeredArm(cell, name) for name in (ARM, OTHER)}


@pytest.fixture
def bench(arms, make):
    return make.Bench(SimpleNamespace(arms=arms, step=lambda: None))


@pytest.fixture
def pair(cell, make):
    def build(id: str = "C-7.1", turn_rad: float = 0.3) -> p.Primitive:
        paths = {}
        for name in (ARM, OTHER):
            home = cell.arm(name).home_rad
            paths[name] = make.joint_path(home, [home[0] + turn_rad, *home[1:]], 1.0)
        limit = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=20.0))
        law = p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=[600.0] * 3 + [30.0] * 3))
        partner = p.Partner(
            performer=OTHER, trajectory=paths[OTHER], control_law=law, stop_functions=make.complete(limit)
        )
        return make.primitive(paths[ARM], limit, id=id, partner=partner)

    return build


def ends(bench) -> list[m.EndReport]:
    return [message for _, message in bench.sent if isinstance(message, m.EndReport)]


def test_both_arms_move_and_one_report_has_both_ends(bench, pair, arms, cell):
    bench.handle(m.Execute(primitive=pair()))
    bench.tick(1300)
    (report,) = ends(bench)[:1]
    assert (report.reason, report.performer) == (StopReason.GOAL, ARM)
    assert (report.partner.reason, report.partner.performer) == (StopReason.GOAL, OTHER)
    for arm, end in ((ARM, report), (OTHER, report.partner)):
        assert end.joints[0] == pytest.approx(cell.arm(arm).home_rad[0] + 0.3, abs=1e-3)
    assert sum(isinstance(message, m.Started) for _, message in bench.sent) == 1


def test_both_arms_pause_and_go_on_together(bench, pair, arms, cell, make):
    """Whatever ramp each would need alone: otherwise they would pull at what they hold."""
    wanted, home = pair(), cell.arm(OTHER).home_rad
    farther = make.joint_path(home, [home[0] + 0.9, *home[1:]], 1.6)
    near = msgspec.structs.replace(wanted.trajectory, time_s=[0.0, 1.6])
    partner = msgspec.structs.replace(wanted.partner, trajectory=farther)
    bench.handle(m.Execute(primitive=msgspec.structs.replace(wanted, trajectory=near, partner=partner)))
    bench.tick(700)
    bench.handle(m.SetPaused(primitive="C-7.1", paused=True))
    parts = []
    for tick in range(5000):
        if tick == 2500:
            bench.handle(m.SetPaused(primitive="C-7.1", paused=False))
        bench.tick()
        parts.append([arms[name].motion[0][0] - cell.arm(name).home_rad[0] for name in (ARM, OTHER)])
    assert max(abs(3.0 * a - b) for a, b in parts) < 1e-9
    assert parts[2100] == parts[2499] != parts[-1]
    paced = [message.paused for _, message in bench.sent if isinstance(message, m.PauseChanged)]
    assert paced == [True, False]


@pytest.mark.parametrize("tripped", [ARM, OTHER])
def test_a_stop_of_one_stops_the_other(bench, pair, arms, tripped):
    bench.handle(m.Execute(primitive=pair()))
    bench.tick(300)
    arms[tripped].wrench = [0.0, 0.0, 25.0, 0.0, 0.0, 0.0]
    bench.tick(500)
    (report,) = ends(bench)[:1]
    assert (report.reason, report.limit) == (StopReason.FORCE_LIMIT, 20.0)
    assert report.partner.reason is StopReason.FORCE_LIMIT
    assert all(arm.motion[1] == [0.0] * 6 for arm in arms.values())


@pytest.mark.parametrize("scope", ["ALL", ARM, OTHER, "C-7"])
def test_a_halt_of_either_arm_stops_both(bench, pair, arms, scope):
    bench.handle(m.Execute(primitive=pair()))
    bench.tick(300)
    bench.handle(m.HaltOrder(halt="h", scope=scope))
    bench.tick(500)
    (report,) = ends(bench)[:1]
    assert (report.reason, report.partner.reason) == (StopReason.HALT, StopReason.HALT)
    assert all(arm.motion[1] == [0.0] * 6 for arm in arms.values())


@pytest.mark.parametrize("away", [ARM, OTHER])
def test_neither_arm_starts_if_one_cannot(bench, pair, arms, away, cell, make):
    home = cell.arm(away).home_rad
    path = make.joint_path(home, [home[0] + 0.2, *home[1:]], 1.0)
    bench.perform(make.primitive(path, id="C-6.1", performer=away))
    before = {name: arm.motion[0] for name, arm in arms.items()}
    bench.handle(m.Execute(primitive=pair()))
    bench.tick(300)
    report = ends(bench)[-1]
    assert (report.primitive, report.reason) == ("C-7.1", StopReason.REFUSED)
    assert {name: arm.motion[0] for name, arm in arms.items()} == before
    assert bench.subsystem.idle


def test_an_arm_that_is_busy_cannot_be_a_partner(bench, pair, make):
    bench.handle(m.Execute(primitive=make.primitive(p.HoldStill(duration_s=9.0), id="C-6.1", performer=OTHER)))
    bench.tick(10)
    bench.handle(m.Execute(primitive=pair()))
    (report,) = ends(bench)
    assert (report.primitive, report.reason) == ("C-7.1", StopReason.REFUSED)
    assert bench.subsystem.outstanding == ["C-6.1", "C-7.1"]  # it goes on


def test_an_unknown_partner_is_refused(bench, pair):
    wrong = pair()
    wrong = msgspec.structs.replace(wrong, partner=msgspec.structs.replace(wrong.partner, performer="GANTRY"))
    ((_, report),) = bench.handle(m.Execute(primitive=wrong))
    assert report.reason is StopReason.REFUSED


def test_an_arm_is_not_its_own_partner_and_a_hand_has_none(pair, make):
    part = pair().partner
    with pytest.raises(ValueError, match="own partner"):
        make.primitive(part.trajectory, performer=OTHER, partner=part)
    with pytest.raises(ValueError, match="motion along a path"):
        make.primitive(p.HoldStill(duration_s=1.0), partner=part)
