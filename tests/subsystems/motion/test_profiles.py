"""Commanded motion: through the knots, and never a jump (limits are those written in `profiles`)."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.protocol.primitive import JointTrajectory
from rtc.subsystems.motion import profiles
from rtc.subsystems.motion.arm import TICK_S

NUMBER = st.floats(-1.0, 1.0)


def trajectory(seed: int, knots: int = 5, dof: int = 6) -> JointTrajectory:
    rng = np.random.default_rng(seed)
    rest = np.zeros(dof)
    velocities, accelerations = rng.uniform(-0.5, 0.5, (2, knots, dof))
    velocities[0] = velocities[-1] = accelerations[0] = accelerations[-1] = rest
    return JointTrajectory(
        space="joint",
        time_s=[0.0, *np.cumsum(rng.uniform(1.0, 3.0, knots - 1)).tolist()],
        positions=rng.uniform(-0.5, 0.5, (knots, dof)).tolist(),
        velocities=velocities.tolist(),
        accelerations=accelerations.tolist(),
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_path_goes_through_its_knots_with_their_velocities(seed: int) -> None:
    wanted = trajectory(seed)
    path = profiles.Follow(wanted, wanted.positions[0])
    motion = path.path(np.array(wanted.time_s))
    assert motion[:, 0] == pytest.approx(np.array(wanted.positions), abs=1e-9)
    assert motion[:, 1] == pytest.approx(np.array(wanted.velocities), abs=1e-8)
    assert motion[:, 2] == pytest.approx(np.array(wanted.accelerations), abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_velocity_and_acceleration_are_the_derivatives_of_the_path(seed: int) -> None:
    wanted = trajectory(seed)
    path = profiles.Follow(wanted, [q + 0.005 for q in wanted.positions[0]])  # with a blend
    step = 1e-3
    ticks = np.arange(0.0, wanted.duration_s - 2e-3, TICK_S)
    q, v, a = (np.array(rows) for rows in zip(*(path.at(t) for t in ticks), strict=True))
    assert np.abs((q[2:] - q[:-2]) / (2 * step) - v[1:-1]).max() < 2e-3
    inner = np.abs((v[2:] - v[:-2]) / (2 * step) - a[1:-1])
    assert inner.max() < 0.02


@pytest.mark.parametrize(("off_rad", "fades_s"), [(1e-5, 0.011), (1e-3, 0.11), (0.02, 0.25), (0.08, 0.75)])
def test_an_offset_from_the_path_fades_out_the_sooner_the_smaller_it_is(off_rad: float, fades_s: float) -> None:
    """So it makes a short motion no longer, and its acceleration and speed stay small."""
    path = trajectory(seed=1)
    motion = profiles.Follow(path, [joint + off_rad for joint in path.positions[0]])
    times_s = np.arange(0.0, motion.duration_s, TICK_S)
    added = np.array([motion.at(t) for t in times_s]) - motion.path(times_s)
    assert times_s[np.abs(added[:, 0]).max(axis=1) > 1e-3 * off_rad].max() == pytest.approx(fades_s, rel=0.15)
    assert np.abs(added[:, 1]).max() < 1.01 * profiles.BLEND_RAD_S
    assert motion.duration_s == pytest.approx(max(path.duration_s, fades_s), rel=0.15)


def test_blocks_and_single_times_agree_forwards_and_backwards() -> None:
    wanted = trajectory(3)
    path = profiles.Follow(wanted, wanted.positions[0])
    times = [0.001, 0.5, 0.063, 0.064, 0.065, 1.2, 0.2]
    for t in times:
        assert np.array(path.at(t)) == pytest.approx(path.path(np.array([t]))[0], abs=1e-9)
    end = path.at(wanted.duration_s + 5.0)
    assert end[0] == wanted.positions[-1]
    assert end[1] == [0.0] * 6


@settings(max_examples=100, deadline=None)
@given(
    joints=st.lists(NUMBER, min_size=6, max_size=6),
    velocities=st.lists(NUMBER, min_size=6, max_size=6),
    accelerations=st.lists(st.floats(-8, 8), min_size=6, max_size=6),
)
def test_any_motion_is_braked_to_rest_within_limits(joints, velocities, accelerations) -> None:
    brake = profiles.Brake((joints, velocities, accelerations))
    assert brake.duration_s < 0.3
    ticks = np.arange(0.0, brake.duration_s + 2 * TICK_S, TICK_S)
    q, v, a = (np.array(rows) for rows in zip(*(brake.at(t) for t in ticks), strict=True))
    assert q[0] == pytest.approx(joints)
    assert np.abs(a).max() <= profiles.STOP_ACCELERATION_RAD_S2 + 1e-6
    assert np.abs(np.diff(a, axis=0)).max() / TICK_S <= profiles.STOP_JERK_RAD_S3 * 1.001
    assert np.all(v[-1] == 0.0)
    assert np.all(a[-1] == 0.0)
    assert np.abs(v).max() <= max(np.abs(velocities).max() + np.abs(accelerations).max() * 0.01, 1e-9)


def test_a_slow_guarded_move_stands_within_a_hair() -> None:
    slow = 0.04  # rad/s: 20 mm/s at half a metre
    brake = profiles.Brake(([0.0] * 6, [slow, 0, 0, 0, 0, 0], [0.0] * 6))
    assert brake.duration_s < 0.005
    assert 0.5 * brake.at(1.0)[0][0] < 5e-5  # metres, at half a metre


def test_a_command_goes_to_an_arm_that_leans_on_something_springy_and_along_with_it() -> None:
    """A joint whose servo is as stiff as what it leans on: it is half-way between its command and the free position."""
    commanded = [0.02, 0.0, 0.0, 0.0, 0.0, 0.0]
    way = profiles.Unload((commanded, [0.0] * 6, [0.0] * 6), lambda: [0.5 * q for q in commanded])
    steps = []
    for n in range(1, 2000):
        now = way.at(n * TICK_S)[0]
        steps.append(now[0] - commanded[0])
        commanded[:] = now
        if way.done(n * TICK_S):
            break
    assert abs(commanded[0]) < 2.5 * profiles.MIN_LEAD_RAD
    assert n * TICK_S < 0.3
    assert np.abs(np.diff([0.0, *steps])).max() <= profiles.STOP_ACCELERATION_RAD_S2 * TICK_S**2 * 1.001
    assert way.at(2.0)[0] == way.at(3.0)[0] == pytest.approx([0.5 * q for q in commanded])


@given(st.lists(st.sampled_from([-0.02, -0.006, 1e-4, 0.002, 0.008]), min_size=2, max_size=7))
def test_a_light_arm_gives_way_in_the_direction_in_which_it_is_pushed(pushed: list[float]) -> None:
    """Its leads are larger than what speed and acceleration allow: all joints are slowed alike. Limited each by itself,
    the wrist of a small arm lagged behind, and a finger that had touched a cube pressed on it with 9 N, then 7.5 N."""
    still = [0.0] * len(pushed)
    command = profiles.Unload((still, still, still), lambda: pushed)
    for tick in range(1, 8):
        joints, speeds, _ = command.at(tick * TICK_S)
        for values in (joints, speeds):
            assert np.allclose(values, np.max(np.abs(values)) / np.max(np.abs(pushed)) * np.array(pushed), atol=1e-12)


def test_a_command_does_not_follow_an_arm_that_a_weight_pulls_down() -> None:
    """It sinks below any command by the same angle."""
    commanded = [0.0] * 6
    way = profiles.Unload((commanded, [0.0] * 6, [0.0] * 6), lambda: [q - 0.01 for q in commanded])
    n = 0
    while not way.done(n * TICK_S):
        n += 1
        commanded[:] = way.at(n * TICK_S)[0]
    assert n * TICK_S <= profiles.UNLOAD_LIMIT_S
    assert commanded[0] == pytest.approx(-profiles.UNLOAD_FAR_RAD - 0.01, abs=0.002)


@pytest.mark.parametrize("back_m", [0.0, 0.01, 0.1, 1.0])
def test_retracing_stays_on_the_way_it_came(back_m: float) -> None:
    wanted = trajectory(1)
    came = profiles.Follow(wanted, wanted.positions[0])
    start_s = 0.6 * wanted.duration_s

    def tcp(joints) -> np.ndarray:
        return np.array([joints[0], joints[1], joints[2], 0, 0, 0, 1.0])

    start = came.path(np.array([start_s]))[0, 0]
    back = profiles.Retrace(came, start_s, start.tolist(), back_m, tcp)
    q = np.array([back.at(t)[0] for t in np.arange(0.0, back.duration_s + 0.01, 0.01)])
    on_path = came.path(np.arange(0.0, start_s + TICK_S, TICK_S))[:, 0]
    away = np.linalg.norm(q[::5, None, :] - on_path[None, ::2], axis=2).min(axis=1)
    assert away.max() < 2e-3
    length = np.linalg.norm(np.diff(q[:, :3], axis=0), axis=1).sum()
    whole = np.linalg.norm(np.diff(on_path[:, :3], axis=0), axis=1).sum()
    assert length == pytest.approx(min(back_m, whole), rel=0.02, abs=1e-3)
    assert q[0] == pytest.approx(start)


def test_ruckig_is_used_from_state_to_state_only() -> None:
    assert "intermediate" not in inspect.getsource(profiles)  # waypoints would be sent to a web service
