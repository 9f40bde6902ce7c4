"""Halts at the broker's socket: floods, callers of one name, and names of the broker's own halts."""

from __future__ import annotations

import msgspec

from broker.router.halts import CALLERS_KEPT, HALTS_OF_CALLER
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.runtime.halt_admission import PER_S
from tests.broker.router.bench import Bench


def test_who_calls_halts_without_end_is_obeyed_and_folded(working: Bench) -> None:
    """Given a stream of halts of one caller, when another calls a halt, then it is answered. The last halt of the
    stream has stopped its scope too."""
    calls = [m.HaltOrder(halt=f"H-{n}", scope=("LEFT-ARM", "RIGHT-ARM")[n % 2]) for n in range(PER_S + 50)]
    working.send("halt", b"x", *calls)
    working.now += 0.2
    working.turn()
    passed_on = [wire.reader(m.BrokerToSubsystem)(parts[1:]) for parts in working.sockets["subsystems"].sent]
    assert working.router.core.dropped["halts_folded"] == 50
    assert len(passed_on) == PER_S + 1  # those beyond number together
    assert (passed_on[-1].halt, passed_on[-1].scope) == (calls[-1].halt, "ALL")  # of two scopes
    assert len(working.router.halts.callers[b"x"]) == HALTS_OF_CALLER

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
