"""A broker that ends: with its cluster, without its supervisor, alone."""

from __future__ import annotations

import pytest

from broker.router.loop import ORPHAN_LIMIT_S
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind, RefusalReason
from tests.broker.harness import Harness, script
from tests.broker.router.bench import MCM, Bench, forwarded


def test_a_cluster_that_is_stopped_ends_its_commands_and_takes_no_more(working: Bench) -> None:
    supervisor = working.router.core.supervisor_peer
    for asked in range(2):  # the supervisor asks again until it has the answer
        answers = working.send("supervisor", supervisor, m.Shutdown())
        assert m.AllEnded(commands=["C-1"]) in answers, asked
    (declined,) = working.send("front", b"ann", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert declined.refusal.reason is RefusalReason.STATE
    known = working.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert [type(answer) for answer in known] == [m.Accepted, m.CommandEnded]
    assert known[1].outcome.kind is OutcomeKind.HALTED


def test_without_its_supervisor_it_sends_every_client_an_outcome_in_time(bench: Bench) -> None:
    """Given one command whose subsystem is silent, one that waits for its analyzer and one for its parser."""
    bench.send("subsystems", b"MCM", MCM)
    story = Harness(mcm=False)
    story.state, story.now = bench.state, bench.now
    silent = story.executing()
    done = story.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    story.reports(done)
    story.says("X")
    me, began_s = bench.router.core.me, bench.now

    def wait(timeout_s: float) -> tuple[()]:
        bench.now += timeout_s
        return ()

    me.stopping, me.orphaned, me.wait = True, True, wait  # type: ignore[misc, assignment, method-assign]
    bench.router.run()

    ended = {message.command: message.outcome for message in forwarded(bench) if isinstance(message, m.CommandEnded)}
    assert [(name, outcome.kind) for name, outcome in ended.items()] == [
        ("C-3", OutcomeKind.HALTED),
        (done, OutcomeKind.HALTED),
        (silent, OutcomeKind.HALT_NOT_CONFIRMED),
    ]
    assert bench.now - began_s == pytest.approx(ORPHAN_LIMIT_S, abs=0.01)


def test_a_broker_that_is_ended_alone_leaves_its_commands_to_the_next(working: Bench) -> None:
    me = working.router.core.me
    me.stopping, me.orphaned = True, False  # type: ignore[misc]
    working.router.run()
    assert list(working.state.commands) == ["C-1"]
