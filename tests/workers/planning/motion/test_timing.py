"""Timing: at rest at both ends, every limit held, also between the knots. Tolerances are written here.

Between knots the executor joins them by quintic Hermite polynomials; the same is done here.
"""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.robot import quintic as quintic_pieces
from rtc.protocol.primitive import JointTrajectory
from rtc.spatial import geometry
from workers.planning.motion.path import joint_line, task_line, through
from workers.planning.motion.timing import KNOT_S, SpeedLimits, time_path

TOLERANCE = 1.02  # of every limit, between knots


def quintic(timed, per_knot=8):
    """(t, q, v, a) between all knots: the polynomial with these positions, speeds, accelerations at both ends."""
    rows = []
    for k in range(len(timed.time_s) - 1):
        t0, t1 = timed.time_s[k : k + 2]
        h = t1 - t0
        p0, p1 = timed.positions[k : k + 2]
        v0, v1 = timed.velocities[k : k + 2] * h
        a0, a1 = timed.accelerations[k : k + 2] * h * h
        c = [
            p0,
            v0,
            a0 / 2,
            10 * (p1 - p0) - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
            -15 * (p1 - p0) + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
            6 * (p1 - p0) - 3 * (v0 + v1) - 0.5 * (a0 - a1),
        ]
        for u in np.linspace(0, 1, per_knot, endpoint=False):
            q = sum(c[n] * u**n for n in range(6))
            v = sum(n * c[n] * u ** (n - 1) for n in range(1, 6)) / h
            a = sum(n * (n - 1) * c[n] * u ** (n - 2) for n in range(2, 6)) / h**2
            rows.append((t0 + u * h, q, v, a))
    t, q, v, a = zip(*rows, strict=True)
    return np.array(t), np.array(q), np.array(v), np.array(a)


def random_paths(arm, n, seed):
    """Joint lines and curves between seeded random postures."""
    random = np.random.default_rng(seed)
    low, high = 0.7 * arm.limits.lower, 0.7 * arm.limits.upper
    for k in range(n):
        yield through(list(random.uniform(low, high, (2 + k % 2, 6))))


def speeds(arm, q, v):
    return np.array([np.linalg.norm(arm.jacobian(a)[:3] @ b) for a, b in zip(q, v, strict=True)])


def assert_at_rest(timed, path):
    assert np.allclose(timed.positions[0], path.knots[0], atol=1e-12)
    assert np.allclose(timed.positions[-1], path.knots[-1], atol=1e-12)
    assert np.abs(timed.velocities[[0, -1]]).max() == 0.0


@pytest.mark.parametrize(
    "pace",
    [SpeedLimits(), SpeedLimits(speed_m_s=10.0, acceleration_m_s2=100.0), SpeedLimits(0.02), SpeedLimits(10, 100, 0.5)],
)
def test_limits_hold_on_random_paths(right, pace):
    for path in random_paths(right, 4, seed=7):
        timed = time_path(right, path, pace)
        assert_at_rest(timed, path)
        _, q, v, a = quintic(timed)
        assert (np.abs(v) <= TOLERANCE * pace.ratio * right.limits.velocity).all()
        # Curves change their acceleration in leaps; a polynomial across one swings beyond it a little.
        over = TOLERANCE if len(path.knots) == 2 else 1.25
        assert (np.abs(a) <= over * pace.ratio * right.limits.acceleration).all()
        assert speeds(right, q, v).max() <= 1.03 * pace.speed_m_s


@pytest.mark.parametrize("pace", [SpeedLimits(), SpeedLimits(speed_m_s=10.0, acceleration_m_s2=100.0)])
def test_between_the_knots_no_limit_is_passed_at_all(right, pace):
    """An arm refuses what does: a curve used to pass its limit of acceleration by 15 %, of speed by 3 %."""
    limits = right.limits
    for path in random_paths(right, 12, seed=9):
        timed = time_path(right, path, pace)
        points = quintic_pieces.control_points(timed.time_s, timed.positions, timed.velocities, timed.accelerations)
        assert quintic_pieces.excess(points.velocities, -1.0001 * limits.velocity, 1.0001 * limits.velocity) is None
        hardest = 1.0001 * limits.acceleration
        assert quintic_pieces.excess(points.accelerations, -hardest, hardest) is None
        assert_at_rest(timed, path)


def test_some_limit_is_used(right):
    """Not merely slow: at full pace one joint, or the tcp, is at its limit."""
    for path in random_paths(right, 4, seed=8):
        timed = time_path(right, path, SpeedLimits(speed_m_s=10.0, acceleration_m_s2=100.0))
        used = max(
            (np.abs(timed.velocities) / right.limits.velocity).max(),
            (np.abs(timed.accelerations) / right.limits.acceleration).max(),
        )
        assert used > 0.9
        slow = time_path(right, path, SpeedLimits(0.1))
        assert speeds(right, *slow.sampled()[:2]).max() > 0.09


def test_a_task_line_runs_at_its_speed_and_stays_straight(right, home):
    begin = right.ik(geometry.make_pose((0.48, -0.085, 0.70), geometry.LEVEL), home["RIGHT-ARM"])[0]
    goal = geometry.make_pose((0.78, -0.085, 0.70), geometry.LEVEL)
    path = task_line(right, begin, goal)
    timed = time_path(right, path, SpeedLimits(0.10))
    t, q, v, _ = quintic(timed)
    hands = np.array([right.fk(row) for row in q])
    assert np.abs(hands[:, 1:3] - (-0.085, 0.70)).max() < 1e-4
    assert max(geometry.angle(pose, goal) for pose in hands) < 1e-4
    speed = speeds(right, q, v)
    assert speed.max() == pytest.approx(0.10, rel=1e-2)
    assert (speed[(t > 0.5) & (t < 2.5)] > 0.099).all()
    assert timed.duration_s == pytest.approx(0.3 / 0.1 + 0.1 / 1.0 + 0.1, abs=0.02)  # cruise, ramps, jerk
    change = np.gradient(np.array([right.jacobian(a)[:3] @ b for a, b in zip(q, v, strict=True)]), t, axis=0)
    assert np.linalg.norm(change, axis=1).max() < 1.05


def test_a_line_starts_and_ends_without_acceleration(right, home):
    timed = time_path(right, joint_line(home["RIGHT-ARM"], np.array(home["RIGHT-ARM"]) + 0.3))
    assert np.abs(timed.accelerations[[0, -1]]).max() < 1e-9


def test_half_the_ratio_halves_what_the_joints_do(right):
    path = joint_line([0, 1, -2, 0, 0.5, 0], [1, 1.5, -1.5, 0.5, 0.2, 1])
    half = time_path(right, path, SpeedLimits(10, 100, 0.5))
    assert (np.abs(half.velocities) <= 0.5 * right.limits.velocity * 1.001).all()
    assert half.duration_s > 1.3 * time_path(right, path, SpeedLimits(10, 100, 1.0)).duration_s


def test_no_way_to_go_is_a_short_stay(right, home):
    timed = time_path(right, joint_line(home["RIGHT-ARM"], home["RIGHT-ARM"]))
    assert timed.duration_s == KNOT_S
    assert np.abs(timed.velocities).max() == 0.0


def test_it_becomes_the_trajectory_of_a_primitive(right, home):
    timed = time_path(right, joint_line(home["RIGHT-ARM"], np.array(home["RIGHT-ARM"]) + 0.1))
    trajectory = timed.trajectory()
    assert isinstance(trajectory, JointTrajectory)
    assert trajectory.duration_s == timed.duration_s
    assert len(trajectory.positions[0]) == 6


def test_the_knots_of_a_line_in_joint_space_are_the_ends_of_its_pieces_and_exact(right):
    random = np.random.default_rng(5)
    for n in range(60):
        start = random.uniform(right.limits.lower, right.limits.upper)
        end = random.uniform(right.limits.lower, right.limits.upper)
        path = joint_line(start, start + 10.0 ** -(n % 6) * (end - start))
        timed = time_path(right, path, SpeedLimits(speed_m_s=10.0 ** random.uniform(-2, 0)))
        assert len(timed.time_s) <= 8
        times_s = np.linspace(0.0, timed.duration_s, 2000)
        q, _, a = np.moveaxis(timed.at(times_s), 1, 0)
        way = path.knots[-1] - path.knots[0]
        share = (q - path.knots[0]) @ way / np.sum(way**2)
        assert np.abs(q - (path.knots[0] + share[:, None] * way)).max() < 1e-9
        # The jerk of a piece is constant: all but the intervals with an end of a piece have one of three values.
        jerks = np.diff(a[:, int(np.abs(way).argmax())])
        jerks /= np.abs(jerks).max()
        assert (np.abs(jerks[:, None] - (-1.0, 0.0, 1.0)).min(axis=1) < 2e-3).sum() >= len(jerks) - 7
