"""Schemas of recorded messages: of the form that viewers read, and true of the messages."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rtc.apps.observers.viewer_schema import viewer_schema
from rtc.protocol import causes
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Measured, Outcome, OutcomeKind, Refusal, RefusalReason

RECORDED = (m.ProgressNote, m.CommandEnded, m.CommandRecord, m.ArmSample)
REFUSED = Outcome(
    kind=OutcomeKind.REFUSED,
    message="no",
    refusal=Refusal(
        reason=RefusalReason.INFEASIBLE,
        message="no",
        cause=causes.InSeat(arm="LEFT-ARM", seat="BAY-1"),
    ),
    measured=Measured(arm="LEFT-ARM", joints=[0.0] * 6),
)
ENDED = m.CommandEnded(seq=1, at_s=1.0, command="C-1", request="r", text="STOW", outcome=REFUSED, took_s=0.5)


def read_as_a_viewer(schema: dict[str, Any]) -> None:
    """The rules of Foxglove's reader of JSON schemas: it fails on anything else."""
    assert schema["type"] == "object"
    for field in schema["properties"].values():
        part = field["items"] if field["type"] == "array" else field
        assert part["type"] in ("boolean", "string", "number", "integer", "object")
        if part["type"] == "object":
            read_as_a_viewer(part)


@pytest.mark.parametrize("kind", RECORDED)
def test_a_viewer_can_read_each_schema(kind):
    read_as_a_viewer(viewer_schema(kind))


def matches(value: Any, schema: dict[str, Any]) -> bool:
    match schema["type"]:
        case "object":
            listed = schema["properties"]
            return isinstance(value, dict) and all(matches(value[k], listed[k]) for k in value if k in listed)
        case "array":
            return all(matches(item, schema["items"]) for item in value)
        case "string":
            return isinstance(value, str) and value in schema.get("enum", [value])
        case "integer":
            return type(value) is int
        case "number":
            return type(value) in (int, float)
        case "boolean":
            return isinstance(value, bool)
    return False


def test_a_refused_command_matches_its_schema():
    sent = msgspec.json.decode(msgspec.json.encode(ENDED))
    schema = viewer_schema(m.CommandEnded)
    assert matches(sent, schema)
    assert set(sent) <= set(schema["properties"])
    assert not matches(sent | {"took_s": "long"}, schema)
