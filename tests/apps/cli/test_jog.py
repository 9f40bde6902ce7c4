"""The keyboard of `rtc jog` in a pseudo terminal, with an arm that keeps what it is asked for."""

from __future__ import annotations

import os
import pty
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from rtc.apps.cli import jog
from rtc.client.halt import HaltResult

STILL = [0.0] * 6


class Arm:
    """A hand controller: at the first of its `moments` the keys are typed."""

    def __init__(self, moments: int, type_keys: Callable[[], object]) -> None:
        self.arm, self.reply, self.left, self._type = "RIGHT-ARM", None, moments, [type_keys]
        self.moves: list[dict[str, Any]] = []
        self.halts: list[str] = []

    @property
    def request(self) -> str:
        while self._type:  # not before: what is typed ahead is dropped
            self._type.pop()()
        self.left -= 1
        return "move it" if self.left >= 0 else ""

    def move(self, twist: list[float], **more: Any) -> str:
        self.moves.append({"twist": twist, **more})
        return ""

    def release(self) -> str:
        self.moves.append({})
        return ""

    def halt(self, scope: str, on_rest: object = None) -> HaltResult:
        self.halts.append(scope)
        return HaltResult(halt="H-1", scope=scope, latency_s=0.001, confirmed=True, sent_to=["halt"], subsystems=[])


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch):
    """Moves an arm by what is typed, all at once; the arm."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)

        def run(keys: bytes, moments: int = 3) -> Arm:
            arm = Arm(moments, lambda: os.write(ours, keys))
            jog._by_keys(arm, SimpleNamespace(halt=arm.halt), 0.03, "world")
            return arm

        yield run
    os.close(ours)


def test_the_latest_key_moves_the_arm_and_none_waits_behind_it(typed) -> None:
    arm = typed(b"rrrrrrrrrrrrw")
    assert arm.moves[0]["twist"] == [0.03, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert len(arm.moves) == 3


def test_halt_is_obeyed_behind_keys_that_wait(typed) -> None:
    arm = typed(b"rrrr rrrr")
    assert arm.halts == ["RIGHT-ARM"]


@pytest.mark.parametrize("keys", [b"\x1b[A", b"\x1bOD", b"\x1bd", b"x", b"\x1b[1;5D"])
def test_other_keys_move_nothing(typed, keys: bytes) -> None:
    assert typed(keys).moves == [{}, {}, {}]


def test_capital_letters_are_keys_too(typed) -> None:
    assert typed(b"C").moves[0] == {"twist": STILL, "frame": "world", "hand": "close", "turn": 0.0}


def test_q_ends_it(typed) -> None:
    assert typed(b"q", moments=1000).moves == []
