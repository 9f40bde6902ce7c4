"""A key that restricts a motion is not ignored by a reader that does not know it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec import inspect

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError

#: what makes an arm move, or plans a motion
ORDERS = (m.Execute, m.ElaboratorInput, m.BinderInput, m.ParserInput)


def structs(kind: Any) -> set[type]:
    """All structs in a message of this type."""
    found: set[type] = set()

    def walk(info: Any) -> None:
        if isinstance(info, inspect.StructType):
            if info.cls in found:
                return
            found.add(info.cls)
        for name in getattr(info, "__struct_fields__", ()):
            value = getattr(info, name)
            for each in value if isinstance(value, tuple) else (value,):
                if isinstance(each, inspect.Type | inspect.Field):
                    walk(each)

    walk(inspect.type_info(kind))
    return found


@pytest.mark.parametrize("order", ORDERS)
def test_every_part_of_an_order_refuses_unknown_keys(order: type) -> None:
    parts = structs(order)
    assert order in parts
    assert [part.__name__ for part in parts if not part.__struct_config__.forbid_unknown_fields] == []


def test_the_parts_are_found_at_any_depth() -> None:
    names = {part.__name__ for part in structs(m.BinderInput)}
    assert {"Primitive", "StartAfter", "Partner", "StopFunction", "ClearanceBelow", "ForceProfile", "Limits"} <= names


def test_other_messages_ignore_unknown_keys() -> None:
    body = msgspec.to_builtins(m.Heartbeat(name="MCM")) | {"mood": "good"}
    assert wire.reader(m.SubsystemToBroker)(wire.frames(body)) == m.Heartbeat(name="MCM")
    with pytest.raises(WireError, match="mood"):
        wire.decoder(m.ParserInput)(wire.encode({"text": "STOW", "mood": "good"}))
