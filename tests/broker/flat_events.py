"""Events that carry a message, made from the fields of both in one call."""

from __future__ import annotations

from typing import Any, TypeVar

from broker.decisions import events
from rtc.protocol import messages as m
from rtc.protocol.versions import PAUSES

E = TypeVar("E", bound=events.Event)

#: event -> its field for the message, and the type of the message
CARRIED: dict[type[events.Event], tuple[str, type[m.Message]]] = {
    events.CommandReceived: ("sentence", m.CommandText),
    events.HaltCalled: ("order", m.HaltOrder),
    events.PrimitiveStarted: ("start", m.Started),
    events.PrimitivePaced: ("change", m.PauseChanged),
    events.HaltConfirmed: ("answer", m.HaltAtRest),
    events.SubsystemConnected: ("hello", m.SubsystemHello),
}


def made(kind: type[E], /, at_s: float, **fields: Any) -> E:
    """An event of this kind. `pauses` of a hello stands for the ability; `subsystem` for its name."""
    if kind not in CARRIED:
        return kind(at_s=at_s, **fields)
    name, message = CARRIED[kind]
    own = {key: fields.pop(key) for key in kind.__struct_fields__ if key in fields}
    if kind is events.SubsystemConnected:
        fields = {"name": fields.pop("subsystem"), "abilities": [PAUSES] * fields.pop("pauses", False), **fields}
    if "at_s" in message.__struct_fields__:
        fields["at_s"] = at_s
    return kind(at_s=at_s, **own, **{name: message(**fields)})
