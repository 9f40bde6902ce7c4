"""The bytes of this version of the protocol are read by every later build of it, or refused with the reason.

`python -m tests.protocol.wire_examples` writes the file of a new message. A file that is not read any more means: the
version of the protocol must rise (`rtc/protocol/versions.py`), or the old key must still be read.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError
from rtc.protocol.versions import VERSION, misfit
from tests.protocol.wire_examples import FOLDER, TYPES
from tests.source_files import ROOT

FILES = sorted(FOLDER.glob("*.msgpack"))
FREE = (
    "gains",
    "facts",
    "bindings",
    "overrides",
    "keep",
    "stated",
    "fits",
    "limits",
    "offers",
    "owners",
    "relies_on",
    "extra",
    "pictures",
)  # maps with any keys, or with parts


def test_the_page_of_the_protocol_lists_every_kind_of_note() -> None:
    page = (ROOT / "docs" / "protocol.md").read_text()
    kinds = page.partition("| kind | what has happened |")[2].partition("A note with")[0]
    rows = [line.split("|")[1] for line in kinds.splitlines() if line.startswith("| `")]
    assert sorted(word.strip(" `") for row in rows for word in row.split(",")) == sorted(m.NoteKind)


def body_of(name: str) -> Any:
    return msgspec.msgpack.decode((FOLDER / f"{name}.msgpack").read_bytes())


def test_every_message_has_a_file_and_every_file_a_message() -> None:
    assert [file.stem for file in FILES] == sorted(TYPES)


@pytest.mark.parametrize("name", TYPES)
def test_all_that_is_in_the_bytes_is_read(name: str) -> None:
    data = (FOLDER / f"{name}.msgpack").read_bytes()
    message = wire.reader(TYPES[name])([wire.PROTOCOL, data])
    assert type(message) is TYPES[name]
    assert msgspec.msgpack.decode(wire.encode(message)) == msgspec.msgpack.decode(data)


@pytest.mark.parametrize("name", TYPES)
def test_bytes_of_another_framing_are_refused(name: str) -> None:
    with pytest.raises(WireError, match="protocol"):
        wire.reader(TYPES[name])([b"RTC9", (FOLDER / f"{name}.msgpack").read_bytes()])


def with_a_newer_key(body: Any) -> Iterator[tuple[str, Any]]:
    """Copies of the map, each with an unknown key in another part of it."""

    def places(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        if isinstance(value, dict):
            yield path
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            if isinstance(inner, dict | list) and key not in FREE:
                yield from places(inner, (*path, key))

    for path in places(body, ()):
        changed = inner = copy.deepcopy(body)
        for key in path:
            inner = inner[key]
        inner["not_before_s"] = 9.0
        yield ".".join(map(str, path)), changed


@pytest.mark.parametrize("name", ["Execute", "ParserInput", "ElaboratorInput", "BinderInput"])
def test_a_newer_key_in_any_part_of_an_order_is_refused(name: str) -> None:
    read, parts = wire.reader(TYPES[name]), []
    for where, changed in with_a_newer_key(body_of(name)):
        parts.append(where)
        with pytest.raises(WireError, match="not_before_s"):
            read(wire.frames(changed))
    assert parts
    assert name != "Execute" or {"primitive.start_after.0", "primitive.partner"} <= set(parts)


@pytest.mark.parametrize("name", [name for name, kind in TYPES.items() if issubclass(kind, m.Hello)])
def test_a_hello_of_another_version_is_read_and_does_not_fit(name: str) -> None:
    hello = wire.reader(TYPES[name])(wire.frames(body_of(name) | {"protocol": VERSION + 1, "a_newer_key": True}))
    assert misfit("it", hello.protocol, "this")
    assert not misfit("it", VERSION, "this")


@pytest.mark.parametrize(
    "name", [name for name in TYPES if name not in ("Execute", "Primitive") and "Input" not in name]
)
def test_a_newer_key_of_another_message_is_ignored(name: str) -> None:
    read = wire.reader(TYPES[name])
    assert read(wire.frames(body_of(name) | {"a_newer_key": True})) == read(wire.frames(body_of(name)))
