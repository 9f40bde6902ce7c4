"""The shares of stages in a profile."""

from __future__ import annotations

import pstats

import pytest

from benchmarks.sentences import IDLE, shares

STAGES = {IDLE: ("poll.py",), "journal": ("journal.py",), "decisions": ("broker/decisions",)}
SORTED = ("~", 0, "<built-in method builtins.sorted>")
LOOP, APPEND, DECIDE = ("loop.py", 1, "run"), ("journal.py", 1, "append"), ("broker/decisions/decide.py", 1, "decide")
POLL = ("poll.py", 1, "poll")


def profile(entries: dict) -> pstats.Stats:
    """`entries`: function -> (own time in s, {caller: own time when it calls})."""
    stats = pstats.Stats()
    stats.stats = {  # type: ignore[attr-defined]
        function: (1, 1, own_s, own_s, {caller: (1, 1, part_s, part_s) for caller, part_s in callers.items()})
        for function, (own_s, callers) in entries.items()
    }
    return stats


def test_a_built_in_function_counts_for_its_callers_and_waiting_is_left_out():
    found = shares(
        profile(
            {
                LOOP: (1.0, {}),
                POLL: (90.0, {LOOP: 90.0}),
                APPEND: (2.0, {LOOP: 2.0}),
                DECIDE: (3.0, {LOOP: 3.0}),
                SORTED: (4.0, {APPEND: 1.0, DECIDE: 3.0}),
            }
        ),
        STAGES,
    )
    assert found == pytest.approx({"decisions": 0.6, "journal": 0.3, "other": 0.1})
    assert list(found) == ["decisions", "journal", "other"]


def test_functions_that_call_each_other_end_somewhere():
    found = shares(profile({LOOP: (1.0, {SORTED: 1.0}), SORTED: (1.0, {LOOP: 1.0})}), STAGES)
    assert found == {"other": 1.0}
