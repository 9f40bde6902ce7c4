"""Time limits count the processor time of jobs and the ticks of subsystems, so that a busy machine breaks none.

What hangs is found: a job that computes or waits without end, a subsystem that stands still.
"""

from __future__ import annotations

import pytest

from broker.decisions.effects import StartTimer
from broker.decisions.state import LinkState
from rtc.protocol import messages as m
from rtc.protocol import wire
from tests.broker.harness import Harness
from tests.broker.router.bench import MCM, PARSER, Bench, forwarded


def beat(bench: Bench, worked_s: float, by_the_clock_s: float, inside: str = "") -> None:
    """The parser reports, over this time, that its job uses the processor for `worked_s` in all."""
    for tenth in range(1, int(10 * by_the_clock_s) + 1):
        bench.now += 0.1
        worked = m.Heartbeat(name="parser@0", own_s=worked_s * tenth / (10 * by_the_clock_s), inside=inside)
        bench.send("workers", b"parser@0", worked)


def kills(bench: Bench) -> list[m.KillProcess]:
    read = wire.reader(m.BrokerToSupervisor)
    sent = [read(parts[1:]) for parts in bench.sockets["supervisor"].sent]
    return [message for message in sent if isinstance(message, m.KillProcess)]


def test_a_job_of_little_processor_time_is_done_once_however_long_it_takes(working: Bench) -> None:
    beat(working, 0.6, by_the_clock_s=60.0)
    assert kills(working) == []
    refused = m.JobRefused(id="C-1/1", attempt=1, refusal=m.Refusal(reason="sentence", message="done"))
    working.send("workers", b"parser@0", m.ResultBatch(name="parser@0", results=[refused]))
    (ended,) = [message for message in forwarded(working) if isinstance(message, m.CommandEnded)]
    assert ended.outcome.refusal.reason == "sentence"


@pytest.mark.parametrize("worked_s", [20.0, 0.0])  # it computes without end; it waits without end
@pytest.mark.parametrize(("inside", "most"), [("", 3), ("phase SLOW (slow.py)", 2)])
def test_a_job_that_hangs_some_workers_is_poison(working: Bench, worked_s: float, inside: str, most: int) -> None:
    """Two are enough if code of a package ran in them, which the refusal names."""
    for death in range(1, most + 1):
        beat(working, worked_s, by_the_clock_s=10.0, inside=inside)
        assert [(kill.name, "hung: job C-1/1" in kill.why) for kill in kills(working)] == [("parser@0", True)] * death
        working.send("workers", b"parser@0", PARSER)  # its successor
    (ended,) = [message for message in forwarded(working) if isinstance(message, m.CommandEnded)]
    assert ended.outcome.refusal is not None
    assert ended.outcome.refusal.reason == "poison"
    assert inside in ended.outcome.refusal.message  # wording: whose code has failed


def subsystem_beats(bench: Bench, share: float, by_the_clock_s: float) -> None:
    """The MCM ticks this much slower than our clock."""
    until_s = bench.now + by_the_clock_s
    while bench.now < until_s:
        bench.now += 0.25
        bench.send("subsystems", b"MCM", m.Heartbeat(name="MCM", own_s=1.0 + share * bench.now))


def phase_of(bench: Bench, command: str) -> m.Phase:
    return bench.state.commands[command].phase


def executing(bench: Bench, share: float = 1.0) -> str:
    """A command whose primitive may take 5 s, and 2 s more until its report arrives."""
    bench.send("subsystems", b"MCM", MCM)
    subsystem_beats(bench, share, 0.25)
    story = Harness(mcm=False)
    story.state, story.now = bench.state, bench.now
    command = story.executing()
    bench.router.egress.perform([effect for effect in story.log if isinstance(effect, StartTimer)])
    return command


@pytest.mark.parametrize(("share", "halted_after_s"), [(1.0, 8.0), (0.05, 140.5), (0.0, 421.0)])
def test_a_motion_is_late_by_the_ticks_of_its_subsystem(bench: Bench, share: float, halted_after_s: float) -> None:
    command = executing(bench, share)
    subsystem_beats(bench, share, halted_after_s - 1.5)
    assert phase_of(bench, command) is m.Phase.EXECUTING
    subsystem_beats(bench, share, 2.0)
    assert phase_of(bench, command) is not m.Phase.EXECUTING


def test_a_subsystem_that_is_silent_is_lost_at_once(bench: Bench) -> None:
    command = executing(bench)
    for _ in range(30):
        bench.now += 0.1
        bench.turn()
    assert bench.state.subsystems["MCM"].link is LinkState.LOST
    assert phase_of(bench, command) is m.Phase.CLOSING


def test_a_worker_with_the_job_of_an_ended_command_is_killed_and_the_job_is_not_done_again(working: Bench) -> None:
    beat(working, 1.0, by_the_clock_s=1.0)
    working.router.core.registry.cancel("C-1/1")
    beat(working, 1.5, by_the_clock_s=1.0)
    assert kills(working) == []
    beat(working, 3.0, by_the_clock_s=1.0)
    (kill,) = kills(working)
    assert "its command has ended" in kill.why
