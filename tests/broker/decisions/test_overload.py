"""Overload and unauthorised requests: which ones the Decision Unit accepts, and from which client."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest

from broker.decisions import decide
from broker.decisions.command.dependencies import _waits_for
from broker.decisions.context import DecisionContext
from broker.decisions.events import HaltConfirmed, PrimitiveEnded, SubsystemConnected, SubsystemGone
from broker.decisions.state import ParsedHead
from broker.decisions.subsystem_link import MAX_SUBSYSTEMS
from rtc.protocol.messages import Declined, Phase
from rtc.protocol.outcomes import RefusalReason
from tests.broker.harness import Harness, bound, go_on, record, report, script
from tests.simulation.invariants import violations


@pytest.fixture
def story(monkeypatch: pytest.MonkeyPatch) -> Harness:
    monkeypatch.setattr(decide, "LIVE_PER_CLIENT", 3)
    return Harness()


def test_one_client_has_so_many_live_and_another_is_taken(story: Harness) -> None:
    for n in range(3):
        story.says("X", request=str(n))
    assert story.says("X", request="3") == ["tell ann Declined"]
    declined = story.log[-1].message
    assert isinstance(declined, Declined)
    assert declined.refusal.reason is RefusalReason.OVERLOAD
    assert "tell bob Accepted C-4" in story.says("X", client="bob", request="3")
    story.declines("C-1")
    assert "tell ann Accepted C-5" in story.says("X", request="4")
    assert not violations(story.state)


def test_a_halt_is_obeyed_also_from_one_who_has_too_many_live(story: Harness) -> None:
    for n in range(3):
        story.says("X", request=str(n))
    lines = story.says("HALT ALL", request="halt")
    assert "halt ALL to MCM" in lines
    assert [line for line in lines if line.startswith("end")] == ["end C-1 halted", "end C-2 halted", "end C-3 halted"]
    assert "tell ann Declined" in lines


def test_a_report_counts_only_from_the_subsystem_that_executes(story: Harness) -> None:
    command = story.executing()
    primitive = story.state.commands[command].primitive
    story.handle(SubsystemConnected, subsystem="EVIL", pid=6, performers=["RIGHT-ARM"])
    story.handle(PrimitiveEnded, subsystem="EVIL", report=report(primitive))
    assert story.phase(command) == Phase.EXECUTING
    story.halts()
    story.handle(HaltConfirmed, subsystem="EVIL", halt=f"stop-{command}", at_rest=True, performers=["RIGHT-ARM"])
    assert story.phase(command) == Phase.HALTING
    assert not violations(story.state)


def test_subsystems_that_come_and_go_do_not_pile_up(story: Harness) -> None:
    for n in range(3 * MAX_SUBSYSTEMS):
        story.handle(SubsystemConnected, subsystem=f"S{n}", pid=n, performers=[f"P{n}"])
        if n % 2:
            story.handle(SubsystemGone, subsystem=f"S{n}", why="silent")
    assert len(story.state.subsystems) == MAX_SUBSYSTEMS
    assert "MCM" in story.state.subsystems


# --- thousands live at once: what one event costs, in calls, which no busy machine changes ----------------------------


def calls(act: Callable[[], Any]) -> int:
    made = [0]

    def count(_: Any, event: str, __: Any) -> None:
        made[0] += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        act()
    finally:
        sys.setprofile(before)
    return made[0]


def crowd(n: int, **head: Any) -> Harness:
    """C-1 executes; n more want the same arm and the same object."""
    story = Harness()
    for k in range(1, n + 2):
        story.says("X", client=f"c{k % 8}", progress=False)
        story.answers(f"C-{k}", record(object="MODULE", **head))
        if k == 1:
            story.answers("C-1", script(writes=("RIGHT-ARM", "MODULE")))
            story.answers("C-1", bound("C-1.1"))
    return story


def ended(story: Harness) -> None:
    story.reports("C-1")
    story.answers("C-1", go_on())


FEW, MANY = 250, 1000


@pytest.mark.parametrize(
    "act",
    [ended, lambda s: s.halts("ALL"), lambda s: s.halts("RIGHT-ARM"), lambda s: s.says("HALT ALL")],
    ids=["the end of one", "HALT ALL", "HALT of an arm", "HALT ALL, a sentence"],
)
def test_what_an_event_costs_grows_no_faster_than_the_crowd(act: Callable[[Harness], Any]) -> None:
    few, many = crowd(FEW), crowd(MANY)
    assert calls(lambda: act(many)) < 1.3 * (MANY / FEW) * calls(lambda: act(few))


def test_one_more_costs_the_same_however_many_there_are() -> None:
    def one_more(story: Harness) -> None:
        story.says("X")
        story.answers(f"C-{story.state.accepted}", record(object="MODULE"))

    few, many = crowd(FEW), crowd(MANY)
    assert calls(lambda: one_more(many)) < 1.3 * calls(lambda: one_more(few))


def test_a_halt_in_a_line_of_thousands_costs_the_same_however_many_there_are() -> None:
    few, many = crowd(FEW), crowd(MANY)
    assert calls(lambda: many.halts("C-100")) < 1.3 * calls(lambda: few.halts("C-100"))


class CountedId(str):
    """The id of a command that counts how often any of its kind is compared."""

    compared = 0

    __hash__ = str.__hash__

    def __eq__(self, other: object) -> bool:
        CountedId.compared += 1
        return str.__eq__(self, other)


def test_a_chain_of_afters_is_followed_with_few_comparisons_per_command() -> None:
    """A search in a list calls no Python function, so comparisons are counted instead of calls."""
    n, story = 500, Harness()
    for k in range(1, n + 1):
        story.says("X", client=f"c{k % 8}", progress=False)
        command = story.state.commands[f"C-{k}"]
        command.id = CountedId(command.id)
        command.head = ParsedHead(kind="task", verb="X", after=f"C-{k - 1}")
    CountedId.compared = 0
    assert len(_waits_for(DecisionContext(story.state, 0.0), story.state.commands[f"C-{n}"])) == n
    assert CountedId.compared < 10 * n  # a search in a list would make n * n / 2
