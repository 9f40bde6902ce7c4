"""The toolbar of the shell: arms, what each holds, commands in progress, and what is wrong."""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.apps.cli.live_state import Live, in_words
from rtc.protocol.messages import Status

CALM: dict[str, Any] = {
    "resources": [{"name": "RIGHT-ARM", "owner": "C-7"}],
    "commands": [{"command": f"C-{n}", "phase": "executing", "step": "2 of 9: close"} for n in (7, 8, 9, 10)],
    "subsystems": [{"name": "MCM", "state": "connected", "injected": [], "strayed": []}],
    "halts": {"called": 0},
}
ARMS = {"LEFT-ARM.holding": "MACS-OLD", "RIGHT-ARM.holding": "", "MACS-OLD.frame": [0.0]}


def words(live: Live) -> str:
    return "".join(text for _, text in in_words(live))


def test_each_arm_with_what_it_holds_and_the_commands_in_progress() -> None:
    shown = words(Live(msgspec.convert(CALM, Status), ARMS))

    assert "LEFT-ARM holds MACS-OLD" in shown
    assert "RIGHT-ARM in use by C-7" in shown
    assert "C-7 executing 2 of 9: close" in shown
    assert "and 1 more" in shown
    assert "halt" not in shown


def test_halts_faults_and_a_silent_cluster() -> None:
    mcm = {"name": "MCM", "state": "lost", "injected": ["jam RACK-1"], "strayed": ["LEFT-ARM moved by itself"]}
    trouble = msgspec.convert({**CALM, "commands": [], "subsystems": [mcm], "halts": {"called": 2}}, Status)
    shown = words(Live(trouble, ARMS, "no answer"))

    for one in ("MCM is lost", "jam RACK-1", "LEFT-ARM moved by itself", "2 halts", "no answer", "no command"):
        assert one in shown
    assert words(Live(trouble="no cluster")) == "no cluster"
