"""An arm that moves without a primitive: its commands end, and the facts about it become suspect."""

from __future__ import annotations

import pytest

from broker.decisions.events import ArmStrayed
from broker.decisions.resources import WORLD
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind
from tests.broker.harness import Harness, script
from tests.simulation.invariants import violations

HOW = "moved without a command, joint_3 by 1.2 deg; braked, it moves"


def strays(s, arm="RIGHT-ARM"):
    return s.handle(ArmStrayed, subsystem="MCM", arm=arm, how=HOW)


def test_the_facts_about_it_become_suspect_and_it_is_closed_until_then():
    s = Harness()
    assert strays(s)[0] == "job C-1/1 analyzer #1 lease RIGHT-ARM doubt"
    (job,) = (effect for effect in s.log if getattr(effect, "job", "") == "C-1/1")
    assert job.doubt == f"RIGHT-ARM {HOW}"
    assert s.state.resources.quarantine == {"RIGHT-ARM": (WORLD, "C-1")}
    assert not list(violations(s.state))
    s.answers("C-1", None, job="C-1/1", attempt=1)
    assert s.state.resources.quarantine == {}
    assert not list(violations(s.state))


def test_the_operator_finds_it_among_the_commands():
    s = Harness()
    strays(s)
    (ended,) = (effect.record for effect in s.log if type(effect).__name__ == "ReportEnd")
    assert ended.text == "RIGHT-ARM moved without a command"
    assert ended.outcome.kind is OutcomeKind.FAILED
    assert "joint_3 by 1.2 deg" in ended.outcome.message  # wording: of the subsystem


@pytest.mark.parametrize(("arm", "ends"), [("RIGHT-ARM", True), ("LEFT-ARM", False)])
def test_a_command_that_uses_the_arm_ends_and_others_go_on(arm, ends):
    s = Harness()
    s.analyzing(script(steps=2))  # between two primitives
    strays(s, arm)
    assert (s.state.commands["C-1"].pending_outcome is not None) is ends
    assert not list(violations(s.state))
    assert wire.decoder(type(s.state))(wire.encode(s.state)) == s.state
