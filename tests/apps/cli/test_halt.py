"""What a halt prints: what moved, what did not, and why rest may take a while all the same."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from rtc.apps.cli.halt import not_reached, print_halt
from rtc.client.halt import HaltResult, SubsystemHalt
from rtc.protocol.messages import CommandRecord, Phase
from rtc.protocol.outcomes import Outcome, OutcomeKind


def printed(latency_s: float, rest_s: float, moving: list[str]) -> str:
    text = io.StringIO()
    mcm = SubsystemHalt(
        name="MCM", latency_s=latency_s, moving=moving, performers=["LEFT-ARM"], at_rest=True, rest_s=rest_s
    )
    result = HaltResult(
        halt="h", scope="ALL", latency_s=latency_s, confirmed=True, sent_to=["halt", "estop"], subsystems=[mcm]
    )
    print_halt(result, Console(file=text, soft_wrap=True, color_system=None))
    return text.getvalue().rstrip()


@pytest.mark.parametrize(
    ("rest_s", "moving", "line"),
    [
        (0.010, ["LEFT-ARM"], "HALT ALL: LEFT-ARM decelerating after 2.00 ms; rest confirmed after 10 ms"),
        (0.003, [], "HALT ALL: no joint was moving; the order arrived after 2.00 ms; rest confirmed after 3 ms"),
        (
            1.146,
            [],
            "HALT ALL: no joint was moving (but a hand still pressed, or a touch still gave way); "
            "the order arrived after 2.00 ms; rest confirmed after 1146 ms",
        ),
    ],
)
def test_a_halt_in_words(rest_s: float, moving: list[str], line: str) -> None:
    assert printed(0.002, rest_s, moving) == line


def test_a_halt_of_an_ended_command_states_how_it_ended_and_what_moves() -> None:
    about = {"text": "X", "source": "operator", "request": "1", "accepted_at_s": 0.0}
    ended = Outcome(kind=OutcomeKind.SUCCEEDED)
    record = CommandRecord(command="C-9", phase=Phase.ENDED, outcome=ended, ended_at_s=1.0, **about)
    moving = {"command": "C-11", "phase": "executing", "resources": ["MACS-NEW", "RIGHT-ARM"]}
    waiting = {"command": "C-12", "phase": "held", "resources": []}

    assert (
        not_reached(record, [moving, waiting])
        == "C-9 has ended: succeeded; in motion: C-11 (MACS-NEW, RIGHT-ARM): rtc halt C-11"
    )
    held = CommandRecord(command="C-12", phase=Phase.HELD, **about)
    assert not_reached(held, [waiting]) == "C-12 is held and moves nothing; no command is in motion"
