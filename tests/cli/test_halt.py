"""What a halt prints: what moved, what did not, and why rest may take a while all the same."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from rtc.cli.halt import print_halt
from rtc.client.halt import HaltResult, SubsystemHalt


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
