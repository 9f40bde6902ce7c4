"""Halts at the broker's socket: floods, callers of one name, and names of the broker's own halts."""

from __future__ import annotations

import msgspec
import pytest

from broker.router.halt_intake import AGAIN_S, CALLERS_KEPT, HALTS_OF_CALLER
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.runtime.halt_admission import PER_S
from tests.broker.router.bench import MCM, Bench


def test_who_calls_halts_without_end_is_obeyed_and_folded(working: Bench) -> None:
    """Given a stream of halts of one caller, when another calls a halt, then it is answered. The last halt of the
    stream has stopped its scope too."""
    calls = [m.HaltOrder(halt=f"H-{n}", scope=("LEFT-ARM", "RIGHT-ARM")[n % 2]) for n in range(PER_S + 50)]
    working.send("halt", b"x", *calls)
    working.now += 0.2
    working.turn()
    passed_on = [wire.reader(m.BrokerToSubsystem)(parts[1:]) for parts in working.sockets["subsystems"].sent]
    assert working.router.core.dropped["halts_merged"] == 50
    assert len(passed_on) == PER_S + 1  # those beyond number together
    assert (passed_on[-1].halt, passed_on[-1].scope) == (calls[-1].halt, "ALL")  # of two scopes
    assert len(working.router.halts.callers[b"x"]) == HALTS_OF_CALLER
    unconfirmed = [wire.reader(m.FromHalt)(parts[1:]) for parts in working.sockets["halt"].sent if parts[0] == b"x"]
    assert [one.request for one in unconfirmed if isinstance(one, m.Declined)] == [one.halt for one in calls[PER_S:]]

    working.send("halt", b"ann", m.HaltOrder(halt="H-ann", scope="LEFT-ARM"))
    rest = m.HaltAtRest(halt="H-ann", subsystem="MCM", at_s=1.0, at_rest=True, performers=["LEFT-ARM"])
    working.send("subsystems", b"MCM", rest)
    assert working.sockets["halt"].sent[-1] == [b"ann", *wire.frames(rest)]


def test_two_callers_of_one_name_each_get_the_answer_to_their_own_halt(working: Bench) -> None:
    for caller, scope in ((b"ann", "LEFT-ARM"), (b"bob", "ALL")):
        working.send("halt", caller, m.HaltOrder(halt="1", scope=scope))
    sent = [wire.reader(m.BrokerToSubsystem)(parts[1:]) for parts in working.sockets["subsystems"].sent]
    of_bob = next(order for order in sent if isinstance(order, m.HaltOrder) and order.scope == "ALL")
    working.sockets["halt"].sent.clear()
    rest = m.HaltAtRest(halt="1", subsystem="MCM", at_s=1.0, at_rest=True, performers=[], call=of_bob.call)
    working.send("subsystems", b"MCM", rest)
    assert working.sockets["halt"].sent == [[b"bob", *wire.frames(msgspec.structs.replace(rest, call=""))]]


def orders(bench: Bench) -> list[m.HaltOrder]:
    """The halts sent to the MCM, without those of the broker itself."""
    sent = [wire.reader(m.BrokerToSubsystem)(parts[1:]) for parts in bench.sockets["subsystems"].sent]
    return [one for one in sent if isinstance(one, m.HaltOrder) and one.halt.startswith("H-")]


@pytest.mark.parametrize("scope", ["ALL", "LEFT-ARM", "C-1"])
@pytest.mark.parametrize("noticed", [False, True])
def test_a_halt_that_the_mcm_took_with_it_is_answered_by_the_next(working: Bench, scope: str, *, noticed: bool) -> None:
    """Given a halt in the moments of the MCM's death, before or after the broker knows of it."""
    if noticed:
        working.send("supervisor", b"supervisor", m.ProcessExited(name="MCM", pid=1, status=-9))
    working.send("halt", b"ann", m.HaltOrder(halt="H-1", scope=scope, call="7"))
    working.send("subsystems", b"MCM", msgspec.structs.replace(MCM, pid=2, at_rest=True))
    (order,) = orders(working)
    assert (order.halt, order.scope) == ("H-1", scope)
    rest = m.HaltAtRest(halt="H-1", subsystem="MCM", at_s=1.0, at_rest=True, performers=[], call=order.call)
    working.send("subsystems", b"MCM", rest)
    assert working.sockets["halt"].sent == [[b"ann", *wire.frames(msgspec.structs.replace(rest, call="7"))]]


@pytest.mark.parametrize("why", ["answered", "the same process", "old", "of a camera"])
def test_other_halts_are_not_sent_to_a_process_that_connects(working: Bench, why: str) -> None:
    """They could stop commands that were given after them."""
    working.send("halt", b"ann", m.HaltOrder(halt="H-1", scope="CAMERA-1" if why == "of a camera" else "ALL"))
    if why == "answered":
        (order,) = orders(working)
        rest = m.HaltAtRest(halt="H-1", subsystem="MCM", at_s=1.0, at_rest=True, performers=[], call=order.call)
        working.send("subsystems", b"MCM", rest)
    if why == "old":
        working.now += AGAIN_S
    working.send("subsystems", b"MCM", msgspec.structs.replace(MCM, pid=1 if why == "the same process" else 2))
    assert orders(working) == []


def test_callers_are_forgotten_some_time(bench: Bench) -> None:
    for n in range(CALLERS_KEPT + 50):
        bench.sockets["halt"].put([b"c%d" % n, *wire.frames(m.HaltOrder(halt=f"H-{n}"))])
    bench.turn(100)
    assert len(bench.router.halts.callers) == CALLERS_KEPT


def test_the_names_of_the_brokers_own_halts_are_not_for_others(working: Bench) -> None:
    """Otherwise a client could get the rest of C-1 confirmed by a halt of something else."""
    working.send("halt", b"x", m.HaltOrder(halt="stop-C-1", scope="RIGHT-ARM", called_at_s=float("nan")))
    order = wire.reader(m.BrokerToSubsystem)(working.sockets["subsystems"].sent[-1][1:])
    assert (order.halt, order.scope, order.called_at_s) == ("H-stop-C-1", "RIGHT-ARM", 0.0)
