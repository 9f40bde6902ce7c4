"""Messages as bytes: one map, or an array of maps."""

from __future__ import annotations

import msgpack
import msgspec
import numpy as np
import pytest

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError

BEATS = [m.Heartbeat(name=f"W-{n}") for n in range(3)]
read = wire.reader_of_many(m.WorkerToBroker)


def test_messages_for_one_peer_travel_as_one_array_and_one_alone_as_a_map():
    ((protocol, body),) = wire.together(BEATS)
    assert protocol == wire.PROTOCOL
    assert [one["name"] for one in msgpack.unpackb(body)] == ["W-0", "W-1", "W-2"]
    assert wire.together(BEATS[:1]) == [wire.frames(BEATS[0])]
    assert wire.together([]) == []


def test_an_array_and_a_map_are_both_read():
    assert list(read(wire.together(BEATS)[0])) == BEATS
    assert list(read(wire.frames(BEATS[0]))) == BEATS[:1]


def test_what_is_encoded_already_travels_beside_what_is_not():
    (parts,) = wire.together([wire.raw(BEATS[0]), BEATS[1]])
    assert list(read(parts)) == BEATS[:2]


def test_arrays_have_bounds_of_number_and_bytes():
    many = [m.Heartbeat(name=str(n)) for n in range(wire.MAX_BATCH + 1)]
    assert [len(read(parts)) for parts in wire.together(many)] == [wire.MAX_BATCH, 1]
    long = [m.CommandText(request=str(n), text="X" * (wire.MAX_BATCH_BYTES // 2)) for n in range(3)]
    bodies = [parts[1] for parts in wire.together(long)]
    assert len(bodies) == 3
    assert all(isinstance(msgpack.unpackb(body), dict) for body in bodies)
    with pytest.raises(WireError):
        read([wire.PROTOCOL, wire.encode(many)])


def test_the_maps_of_a_spoilt_array_can_be_read_apart():
    spoilt = [wire.PROTOCOL, msgspec.msgpack.encode([BEATS[0], {"type": "Nonsense"}, BEATS[2]])]
    with pytest.raises(WireError):
        read(spoilt)
    first, second, third = wire.split(spoilt)
    assert (list(read(first)), list(read(third))) == ([BEATS[0]], [BEATS[2]])
    with pytest.raises(WireError):
        read(second)


@pytest.mark.parametrize(
    "body", [b"", b"\x90", b"\xc1", b"\x92\x01", msgpack.packb({"type": "Heartbeat", "name": "W"})]
)
def test_what_is_no_array_stays_as_it_is(body):
    parts = [wire.PROTOCOL, body]
    assert wire.split(parts) == [parts]


def test_arrays_in_arrays_are_none():
    with pytest.raises(WireError):
        read([wire.PROTOCOL, wire.encode([BEATS, BEATS])])


def test_a_number_of_numpy_travels_as_one_of_python():
    assert msgpack.unpackb(wire.encode({"measured": np.float64(0.5), "joint": np.int64(3)})) == {
        "measured": 0.5,
        "joint": 3,
    }
    with pytest.raises(TypeError):
        wire.encode({"measured": object()})
