"""Most ticks of a path compare the sample with bounds only. They command and report what whole ticks would."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.observation import WINDOW_TICKS

Events = dict[int, Callable[..., None]]  # tick -> what happens before it
REPORT_S = 0.05
EVENTS: dict[str, Events] = {
    "nothing": {},
    "a touch": {317: lambda rig: _feel(rig, 12.0)},
    "a touch in the first tick": {1: lambda rig: _feel(rig, 12.0)},
    "a touch shortly before the end": {990: lambda rig: _feel(rig, 12.0)},
    "a force below the limit": {200: lambda rig: _feel(rig, 9.0), 300: lambda rig: _feel(rig, 0.0)},
    "a contact": {611: lambda rig: rig.arm.leaning.update({"forearm touches SATELLITE": 3.0})},
    "a halt": {450: lambda rig: rig.executor.halt()},
    "a pause": {300: lambda rig: rig.executor.pace(True), 1100: lambda rig: rig.executor.pace(False)},
    "a lag": {700: lambda rig: setattr(rig.arm, "lag", 0.2)},
}


def _feel(rig, force_n: float) -> None:
    rig.arm.wrench = [0.0, 0.0, -force_n, 0.0, 0.0, 0.0]


def run(rig, wanted: p.Primitive, events: Events) -> list[m.Started | m.ProgressReport | m.EndReport]:
    rig.accept(wanted)
    for tick in range(1, 6000):
        if tick in events:
            events[tick](rig)
        if any(isinstance(message, m.EndReport) for message in rig.tick()):
            return rig.sent
    raise AssertionError("no end report")


@pytest.mark.parametrize("events", EVENTS.values(), ids=EVENTS)
def test_quiet_ticks_do_what_whole_ticks_do(cell, make, monkeypatch, events) -> None:
    touch = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=10.0), Reflex.BACK_OFF, 0.01)
    collision = make.stop(StopReason.COLLISION, p.BodyTouch())

    def all_of(rig) -> tuple[list, list]:
        reporting = p.Reporting(every_s=REPORT_S)
        return run(rig, rig.swing(touch, collision, reporting=reporting), events), rig.arm.commands

    sent, commands = all_of(make.Rig(cell))
    monkeypatch.setattr(Executor, "_look_ahead", lambda self, follow: None)
    whole_sent, whole_commands = all_of(make.Rig(cell))

    assert sent == whole_sent
    assert len(commands) == len(whole_commands)
    assert np.allclose(np.array(commands), np.array(whole_commands), rtol=0.0, atol=1e-12)


def test_a_time_limit_ends_a_quiet_path_in_its_tick(rig) -> None:
    rig.accept(rig.swing(limit_s=0.777))
    report = rig.until_end()
    assert report.reason is StopReason.TIMEOUT
    assert report.measured == pytest.approx(0.778)


def test_most_ticks_of_a_path_are_quiet(rig, monkeypatch) -> None:
    whole = []
    tick = Executor._whole_tick
    monkeypatch.setattr(Executor, "_whole_tick", lambda self, now_s: (whole.append(1), tick(self, now_s))[1])
    rig.accept(rig.swing())
    rig.tick(970)
    assert len(whole) < 20


def test_rest_is_confirmed_after_a_whole_window_of_watched_ticks(rig) -> None:
    """A path that is halted while it is still slow: its quiet ticks have not been watched for rest."""
    rig.accept(rig.swing())
    rig.tick(5)
    rig.executor.halt()
    assert not any(isinstance(message, m.EndReport) for message in rig.tick(WINDOW_TICKS - 1))
    assert rig.until_end(5).reason is StopReason.HALT
