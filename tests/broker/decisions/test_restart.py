"""A broker that restarts takes up what its journal shows."""

from __future__ import annotations

from broker.decisions.events import (
    BrokerRestarted,
)
from broker.decisions.state import State
from rtc.protocol import wire
from tests.broker.harness import Harness, bound


def test_a_restarted_broker_assigns_again_what_was_assigned():
    s = Harness()
    s.says("X", client="bob")
    s.executing(hand="LEFT-ARM")
    s.state = wire.decoder(State)(wire.encode(s.state))  # as through a snapshot
    assert s.handle(BrokerRestarted) == ["job C-1/1 parser #2", "timer C-2"]
    assert s.mcm_hello(outstanding=["C-2.1"]) == []  # it has gone on meanwhile
    assert s.reports("C-2")[2] == "job C-2/4 analyzer #1 lease RIGHT-ARM"


def test_a_primitive_that_never_arrived_is_sent_again_after_a_restart():
    s = Harness()
    s.executing()
    s.handle(BrokerRestarted)
    assert s.mcm_hello(outstanding=[]) == ["primitive C-1.1 to MCM", "timer C-1"]


def test_a_primitive_bound_before_the_subsystem_reconnects_waits_for_it():
    s = Harness()
    s.elaborated()
    s.handle(BrokerRestarted)
    assert s.answers("C-1", bound("C-1.1")) == ["timer C-1", "note C-1 executing"]
    assert s.mcm_hello()[0] == "primitive C-1.1 to MCM"


def test_a_halt_lost_with_the_broker_is_ordered_again():
    s = Harness()
    s.executing()
    s.halts()
    s.handle(BrokerRestarted)
    assert s.mcm_hello(outstanding=["C-1.1"]) == ["halt C-1 to MCM", "timer C-1"]
