"""From every end of a command a sentence leads on: out of what it touches, and out of what is in doubt."""

from __future__ import annotations

import pytest

from rtc.messages import Validity
from rtc.outcomes import StopReason

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
SAME_PLACE = "SET MACS-NEW FRAME 80 -80 60 CM"


@pytest.fixture
def in_the_handle(either):
    """A search that has felt nothing ends 10 mm inside the handle as it is believed."""
    stay = "skill: grasp\nsteps: [{do: hold, stop: hold, label: stay, args: {duration_s: 0.0}}]"
    either.load("elaborator", stay)  # not drawn back, as by one who is halted then
    either.load("elaborator", "command_object_table: [{verb: GRASP, name: MACS-NEW, values: {trim_m: 0.0}}]")
    either.subsystem.displace("MACS-NEW", [0.0, 0.020, 0.0])
    run = either.do(GRASP)
    assert run.failure.reason is StopReason.NO_CONTACT
    return either


def test_out_of_a_handle_that_is_in_doubt(in_the_handle):
    assert in_the_handle.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert in_the_handle.do("RETRACT RIGHT-ARM").succeeded
    assert in_the_handle.do("STOW RIGHT-ARM").succeeded


@pytest.mark.parametrize(
    "sentence", ["RETRACT RIGHT-ARM BY 20 CM", "STOW RIGHT-ARM", "MOVE RIGHT-ARM BY -5 CM ALONG Y", GRASP]
)
def test_out_of_a_handle_that_is_said_to_be_there_after_all(in_the_handle, sentence):
    assert in_the_handle.do(SAME_PLACE).succeeded
    run = in_the_handle.do(sentence)
    assert run.refusal is None, run.refusal
    assert run.succeeded or run.failure.reason == "no_contact"


def test_deeper_into_a_handle_stays_refused(in_the_handle):
    in_the_handle.do(SAME_PLACE)
    refusal = in_the_handle.do("MOVE RIGHT-ARM BY 1 CM ALONG Y STRAIGHT-LINE").refusal
    assert refusal.detail["cause"] == "collision"
