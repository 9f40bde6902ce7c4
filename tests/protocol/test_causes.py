"""Causes of refusals: each kind travels, and docs/protocol.md has its fields."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from rtc.protocol import causes
from rtc.protocol.outcomes import Refusal, RefusalReason

PAGE = Path(__file__).parents[2] / "docs/protocol.md"
KINDS = causes.Cause.__args__
ROW = re.compile(r"^\| `(\w+)` \| (.+) \|$", re.MULTILINE)


def test_the_page_has_the_fields_of_each_kind() -> None:
    table = PAGE.read_text().split("| kind | fields |")[1].split("\n\n")[0]
    written = {kind: re.findall(r"`(\w+)`", fields) for kind, fields in ROW.findall(table)}
    assert written == {kind.__struct_config__.tag: list(kind.__struct_fields__) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_cause_travels_with_its_kind(kind: type[msgspec.Struct]) -> None:
    values = {"str": "X", "float": 0.5, "float | None": 0.5, "int": 3, "tuple[str, ...]": ("X",)}
    cause = kind(**{name: values[text] for name, text in kind.__annotations__.items()})
    refusal = Refusal(reason=RefusalReason.INFEASIBLE, message="no", cause=cause, in_the_way="LEFT-ARM", fraction=0.4)

    assert msgspec.json.decode(msgspec.json.encode(refusal), type=Refusal) == refusal
    assert msgspec.to_builtins(refusal)["cause"]["kind"] == refusal.figures()["cause"]


def test_the_effort_grows() -> None:
    refusal = Refusal(reason=RefusalReason.INFEASIBLE, message="no").after(samples=0).after(candidates=4)
    assert refusal.effort == causes.Effort(samples=0, candidates=4)
    assert refusal.figures() == {"samples": 0, "candidates": 4}
