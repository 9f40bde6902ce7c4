"""The generated functions give what the loops would give, for every number of joints."""

import struct

import numpy as np
import pytest

from sim_mcm.arms import unrolled

NUMBERS = (1, 2, 6, 7, 9)


@pytest.mark.parametrize("joints", NUMBERS)
def test_states_are_split_into_positions_speeds_fingers_and_the_reaction_at_the_sensor(joints: int) -> None:
    states = [(float(n), 10.0 + n, (100.0 * n,) * 6, 0.5) for n in range(joints + 3)]
    left, right, sensor = states[joints:]
    assert unrolled.split_states(joints)(states) == (
        [state[0] for state in states[:joints]],
        [state[1] for state in states[:joints]],
        (left[0], right[0]),
        (left[1], right[1]),
        sensor[2],
    )


@pytest.mark.parametrize("joints", NUMBERS)
def test_the_acceleration_is_the_wanted_one_and_that_of_spring_and_damper(joints: int) -> None:
    rng = np.random.default_rng(joints)
    qw, vw, aw, q, v = rows = rng.uniform(-3.0, 3.0, (5, joints))
    buffer = np.zeros((3, joints))
    pack_into = struct.Struct(f"{buffer.size}d").pack_into
    wanted, given_q, given_v = (qw.tolist(), vw.tolist(), aw.tolist()), rows[3].tolist(), rows[4].tolist()
    unrolled.fill_computed_torque(joints)(pack_into, buffer.data, wanted, given_q, given_v, 22500.0, 300.0)
    assert np.allclose(buffer, [q, v, aw + 22500.0 * (qw - q) + 300.0 * (vw - v)])


@pytest.mark.parametrize("part", range(5))
def test_a_row_of_another_length_is_refused(part: int) -> None:
    qw, vw, aw, q, v = ([0.0] * (5 if n == part else 6) for n in range(5))
    fill, pack_into = unrolled.fill_computed_torque(6), struct.Struct("18d").pack_into
    with pytest.raises(ValueError, match="values to unpack"):
        fill(pack_into, np.zeros(18).data, (qw, vw, aw), q, v, 1.0, 1.0)
