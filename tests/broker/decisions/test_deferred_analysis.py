"""The world database is absent: refusals before motion, repeated analyses after it."""

from __future__ import annotations

import pytest

from broker.decisions.events import (
    BrokerRestarted,
    TimerFired,
)
from broker.decisions.resources import WORLD
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import NoteKind
from rtc.protocol.outcomes import RefusalReason
from tests.broker.harness import Harness, go_on, script


def away(s, command="C-1"):
    return s.declines(command, RefusalReason.TIMEOUT)


@pytest.mark.parametrize("reach", ["says", "parsed", "elaborated"])
def test_before_anything_has_moved_a_world_that_is_away_is_a_refusal(reach):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    assert away(s) == ["note C-1 ended", "end C-1 refused"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.TIMEOUT


def test_between_two_steps_it_is_a_failure():
    s = Harness()
    s.analyzing(script(steps=2))
    s.answers("C-1", go_on())
    assert away(s) == ["note C-1 ended", "end C-1 failed"]
    assert s.state.deferred_analyses == {}  # the step before is written


def test_an_analysis_that_the_world_did_not_get_is_repeated_without_blame():
    s = Harness()
    s.analyzing(script(steps=2))
    for attempt in range(1, 11):  # six seconds each
        s.now += 5.0
        assert away(s) == ["timer C-1", "note C-1 analyzing"]
        assert s.answers("C-1", go_on(), attempt=attempt) == []  # late
        assert s.rings("C-1") == [f"job C-1/4 analyzer #{attempt + 1} lease RIGHT-ARM"]
    assert s.state.commands["C-1"].job.deaths == ()
    assert s.answers("C-1", go_on()) == ["note C-1 analyzing", "job C-1/5 binder #1", "note C-1 binding"]


def test_after_a_minute_the_command_fails_and_what_it_touched_is_closed_until_the_world_is_written():
    s = Harness()
    s.analyzing(script(resources=("RIGHT-ARM", "MODULE")))
    s.now += 61.0
    assert away(s) == ["note C-1 ended", "end C-1 failed", "timer C-1/4"]
    assert s.outcome("C-1").refusal.reason is RefusalReason.TIMEOUT
    assert s.state.resources.quarantine == dict.fromkeys(("RIGHT-ARM", "MODULE"), (WORLD, "C-1"))
    s.parsed()
    waits = s.state.commands["C-2"].notes[-1]
    assert (waits.kind, waits.about) == (NoteKind.IN_USE, "RIGHT-ARM")
    assert waits.owner == "the world database, which does not have the changes of C-1 yet"
    s.halts("RIGHT-ARM")
    s.rests("h1")  # rest is not a fact for the world
    assert set(s.state.resources.quarantine) == {"RIGHT-ARM", "MODULE"}
    assert s.handle(TimerFired, timer="C-1/4") == ["job C-1/4 analyzer #3 lease RIGHT-ARM+MODULE"]
    assert s.tells("C-1", "away") == ["timer C-1/4"]
    assert s.handle(TimerFired, timer="C-1/4") == ["job C-1/4 analyzer #5 lease RIGHT-ARM+MODULE"]
    s.state = wire.decoder(State)(wire.encode(s.state))
    assert s.handle(BrokerRestarted) == ["job C-1/4 analyzer #6 lease RIGHT-ARM+MODULE"]
    assert s.tells("C-1") == []
    assert s.state.resources.quarantine == {}
    assert s.parsed() == "C-3"
    assert s.phase("C-3") == "elaborating"


def test_a_command_stopped_while_it_waits_for_the_world_ends_soon_and_the_world_is_written_later():
    s = Harness()
    s.analyzing()
    away(s)
    assert s.halts() == ["halt ALL to MCM", "job C-1/4 analyzer #2 lease RIGHT-ARM", "timer C-1", "note C-1 closing"]
    assert away(s) == ["no timer C-1", "note C-1 ended", "end C-1 halted", "timer C-1/4"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}


def test_an_arm_neither_at_rest_nor_analysed_is_closed_until_both_are():
    s = Harness()
    s.executing()
    s.mcm_gone()
    away(s)
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.mcm_hello(pid=2)
    assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}
    s.handle(TimerFired, timer="C-1/4")
    s.tells("C-1")
    assert s.state.resources.quarantine == {}


def test_an_analysis_left_that_kills_its_workers_is_given_up():
    s = Harness()
    s.executing()
    s.mcm_gone()
    s.rings("C-1")
    s.mcm_hello(pid=2)
    for deaths in (1, 2):
        assert s.tells("C-1", "dies") == [f"job C-1/4 analyzer #{deaths + 1} lease RIGHT-ARM"]
    for attempt in (5, 7):
        assert s.tells("C-1", "dies") == ["timer C-1/4"]
        assert s.rings("C-1/4") == [f"job C-1/4 analyzer #{attempt} lease RIGHT-ARM doubt"]
        assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}
    assert s.tells("C-1") == []
    assert (s.state.deferred_analyses, s.state.resources.quarantine) == ({}, {})
    assert s.state.counts["analyses_given_up"] == 1


def test_a_restarted_broker_asks_the_world_at_once():
    s = Harness()
    s.analyzing()
    away(s)
    assert s.handle(BrokerRestarted) == ["job C-1/4 analyzer #3 lease RIGHT-ARM"]
    assert s.rings("C-1") == []


def test_a_repeated_report_is_acknowledged_twice_and_handled_once():
    s = Harness()
    s.analyzing()
    assert s.reports("C-1", primitive="C-1.1") == ["ack C-1.1"]
