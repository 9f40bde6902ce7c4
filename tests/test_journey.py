"""docs/journey.md does not rot: each message in it is read with the types of today, in the order of the journey."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from rtc.language.parse import default_grammar, parse
from rtc.protocol import messages as m
from rtc.protocol.knots import Knots
from rtc.protocol.sentence import ParsedCommand

TEXT = (Path(__file__).parents[1] / "docs" / "journey.md").read_text()
BLOCKS: list[dict[str, Any]] = [json.loads(block) for block in re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL)]
ORDER = (
    *("CommandText", "Accepted", "JobBatch", "ParsedCommand", "Script", "BoundStep"),
    *("Started", "EndReport", "ReportAck", "Assessment", "CommandEnded"),
)


def unknown_keys(given: Any, read: Any) -> list[str]:
    """Keys of the page that the types do not have: decoding ignores them, the reader of the page can not."""
    if isinstance(read, msgspec.Struct):
        known = {field.encode_name: field.name for field in msgspec.structs.fields(read)}
        tag = read.__struct_config__.tag_field
        wrong = [key for key in given if key not in known and key != tag]
        return wrong + [
            found
            for key, name in known.items()
            if key in given
            for found in unknown_keys(given[key], getattr(read, name))
        ]
    if isinstance(read, list):
        return [found for a, b in zip(given, read, strict=True) for found in unknown_keys(a, b)]
    return []


def test_the_messages_come_in_the_order_of_the_journey() -> None:
    assert tuple(block["type"] for block in BLOCKS) == ORDER


@pytest.mark.parametrize("block", [b for b in BLOCKS if b["type"] != "JobBatch"], ids=lambda block: block["type"])
def test_a_message_of_the_page_is_one_of_today(block: dict[str, Any]) -> None:
    kind = ParsedCommand if block["type"] == "ParsedCommand" else getattr(m, block["type"])
    read = msgspec.json.decode(json.dumps(block), type=kind, dec_hook=lambda _, rows: Knots.of(rows))
    assert unknown_keys(block, read) == []


def test_the_record_of_the_page_is_what_the_parser_makes_of_the_sentence() -> None:
    sentence = next(block["text"] for block in BLOCKS if block["type"] == "CommandText")
    record = next(block for block in BLOCKS if block["type"] == "ParsedCommand")
    assert parse(default_grammar(), sentence) == msgspec.json.decode(json.dumps(record), type=ParsedCommand)
