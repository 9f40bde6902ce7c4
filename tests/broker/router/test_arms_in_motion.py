"""The world database learns which arms are in motion, after each change and after its restart."""

from __future__ import annotations

import msgspec

from broker.decisions.state import ArmMotion
from rtc.protocol import messages as m
from rtc.world.lease import check
from tests.broker.router.bench import Bench


def begin(bench: Bench, arm: str) -> None:
    """As the Decision Unit does it."""
    bench.state.motions[arm] = ArmMotion(command="C-1", primitive="C-1.1", body=msgspec.Raw(b"\xc0"))
    bench.state.motions_begun += 1


def test_each_change_is_sent_once_and_signed(bench: Bench) -> None:
    bench.to_world.clear()
    bench.turn(3)
    assert bench.to_world == []
    begin(bench, "RIGHT-ARM")
    bench.turn(3)
    del bench.state.motions["RIGHT-ARM"]
    bench.state.motions_ended += 1
    bench.turn(3)
    assert [message.lease.locations for message in bench.to_world] == [["RIGHT-ARM"], []]
    assert all(check(b"k" * 32, message.lease) for message in bench.to_world)


def test_a_new_world_database_learns_them_again(bench: Bench) -> None:
    begin(bench, "RIGHT-ARM")
    bench.turn()
    bench.to_world.clear()
    bench.send("supervisor", b"supervisor", m.ProcessExited(name="world", pid=7, status=-9))
    bench.turn()
    assert [message.lease.locations for message in bench.to_world] == [["RIGHT-ARM"]]
