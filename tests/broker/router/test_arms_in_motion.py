"""The world database knows which arms are in motion after each change."""

from __future__ import annotations

import os
from collections.abc import Iterator

import msgspec
import pytest

from broker.decisions.state import ArmMotion
from rtc.runtime.handover import Handover
from tests.broker.router.bench import SETTINGS, Bench


@pytest.fixture
def given() -> Iterator[Handover]:
    made = Handover.make(SETTINGS, b"k" * 32, "token")
    yield made
    os.close(made.fd)


def test_each_change_is_stated(given: Handover) -> None:
    bench, elsewhere = Bench(given), Handover.read(given.fd)
    bench.turn(3)
    assert elsewhere.motions() == []
    for arm in ("RIGHT-ARM", "LEFT-ARM"):  # as the Decision Unit does it
        bench.state.motions[arm] = ArmMotion(command="C-1", primitive="C-1.1", body=msgspec.Raw(b"\xc0"))
        bench.state.motions_begun += 1
        bench.turn()
    assert elsewhere.motions() == ["RIGHT-ARM", "LEFT-ARM"]
    del bench.state.motions["RIGHT-ARM"]
    bench.state.motions_ended += 1
    bench.turn()
    assert elsewhere.motions() == ["LEFT-ARM"]


def test_a_new_broker_states_what_it_knows(given: Handover) -> None:
    given.state_motions(["RIGHT-ARM"])  # the broker has died during a motion
    Bench(given)
    assert given.motions() == []
