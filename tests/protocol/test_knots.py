"""Knots travel as doubles: the same numbers arrive, and what is no path is refused."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from rtc.protocol import wire
from rtc.protocol.knots import Knots
from rtc.protocol.outcomes import WireError
from rtc.protocol.primitive import JointTrajectory

ROWS = [[0.1, -1 / 3, 1e-300], [math.pi, 5e-324, -0.0], [2.0, 1e300, 7.0]]
STILL = [[0.0] * 3] * 3
PATH = JointTrajectory(space="joint", time_s=[0.0, 0.1, 0.3], positions=ROWS, velocities=STILL, accelerations=STILL)
read = wire.decoder(JointTrajectory)


def test_the_same_numbers_arrive():
    arrived = read(wire.encode(PATH))
    assert arrived == PATH
    assert list(arrived.positions) == ROWS
    assert arrived.positions[-1] == ROWS[-1]
    assert arrived.positions[1:] == ROWS[1:]
    assert np.array_equal(np.asarray(arrived.positions), np.array(ROWS))


def test_a_path_is_a_few_long_fields_of_doubles():
    body = msgspec.msgpack.decode(wire.encode(PATH))
    assert body["positions"] == np.array(ROWS, dtype="<f8").tobytes()


@pytest.mark.parametrize(
    "changes",
    [
        {"positions": b""},
        {"positions": bytes(70)},  # no whole rows
        {"velocities": bytes(48)},  # of two joints
        {"accelerations": ROWS},  # as version 2 of the protocol had it
        {"time_s": [0.0, 0.2, 0.1]},
    ],
)
def test_what_is_no_path_is_refused(changes):
    body = msgspec.msgpack.decode(wire.encode(PATH)) | changes
    with pytest.raises(WireError):
        read(wire.encode(body))


@pytest.mark.parametrize("rows", [[], [[1.0], [1.0, 2.0]], [[], []]])
def test_rows_are_equally_long(rows):
    with pytest.raises(ValueError, match="rows"):
        Knots.of(rows)
