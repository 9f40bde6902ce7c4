"""What an arm refuses to begin: limits hold in every piece of a trajectory, not at its knots alone."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.robot import quintic
from rtc.protocol.primitive import JointTrajectory, Primitive
from rtc.subsystems.motion import acceptance
from rtc.subsystems.motion.arm import Traits

CASES = 500  # of each family
SAMPLES = 200  # of each piece
SEED = 11


@pytest.fixture(scope="module")
def traits(cell) -> Traits:
    return Traits.of(cell, "RIGHT-ARM")


@pytest.fixture(scope="module")
def middle(traits) -> np.ndarray:
    return 0.5 * (np.array(traits.lower) + np.array(traits.upper))


def _why(trajectory: JointTrajectory, traits: Traits, make) -> str:
    primitive: Primitive = make.primitive(trajectory)
    return acceptance.objection(primitive, traits, trajectory.positions[0])


def _trajectory(time_s, q, v, a) -> JointTrajectory:
    return JointTrajectory(
        space="joint", time_s=time_s.tolist(), positions=q.tolist(), velocities=v.tolist(), accelerations=a.tolist()
    )


def _sampled(time_s, q, v, a) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration at many moments, in the way of the textbook: [samples][joints]."""
    h = np.diff(time_s)[:, None]
    w, b = v * 1.0, a * 1.0
    p0, p1, v0, v1, a0, a1 = q[:-1], q[1:], w[:-1] * h, w[1:] * h, b[:-1] * h * h, b[1:] * h * h
    c = np.stack((
        p0, v0, a0 / 2, 10 * (p1 - p0) - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
        -15 * (p1 - p0) + 8 * v0 + 7 * v1 + 1.5 * a0 - a1, 6 * (p1 - p0) - 3 * (v0 + v1) - 0.5 * (a0 - a1),
    ))  # fmt: skip
    u = np.linspace(0.0, 1.0, SAMPLES)[:, None] ** np.arange(6)
    n = np.arange(6)
    first, second = n[1:] * u[:, :5], (n * (n - 1))[2:] * u[:, :4]
    position = np.einsum("sn,nkj->skj", u, c)
    velocity = np.einsum("sn,nkj->skj", first, c[1:]) / h
    acceleration = np.einsum("sn,nkj->skj", second, c[2:]) / (h * h)
    joints = q.shape[1]
    return position.reshape(-1, joints), velocity.reshape(-1, joints), acceleration.reshape(-1, joints)


def _family(rng, traits: Traits, middle, ratio: float):
    """Random trajectories whose greatest velocity, acceleration or deviation is `ratio` times its limit, somewhere."""
    velocity, acceleration = np.array(traits.velocity), np.array(traits.acceleration)
    half = 0.5 * (np.array(traits.upper) - np.array(traits.lower))
    for n in range(CASES):
        knots = int(rng.integers(2, 6))
        time_s = np.concatenate(([0.0], np.cumsum(rng.uniform(0.2, 1.5, knots - 1))))
        q = np.vstack((np.zeros(6), rng.normal(size=(knots - 1, 6)))) * rng.uniform(0.01, 0.3)
        v, a = rng.normal(size=(knots, 6)) * 0.3, rng.normal(size=(knots, 6)) * rng.uniform(0.1, 3.0)
        v[[0, -1]] = 0.0
        q_, v_, a_ = _sampled(time_s, q, v, a)
        wide = float((np.abs(q_) / half).max())
        if n % 3 == 0 or wide > 1.0:  # as wide as that, slowly
            scale = ratio / wide
            q, v, a, v_, a_ = q * scale, v * scale, a * scale, v_ * scale, a_ * scale
            rate = max(float((np.abs(v_) / velocity).max()), float(np.sqrt((np.abs(a_) / acceleration).max())))
            by = max(1.0, rate / 0.9)
        else:  # as fast or as hard as that
            rate = max(
                float((np.abs(v_) / velocity).max()) / ratio, float(np.sqrt((np.abs(a_) / acceleration).max() / ratio))
            )
            by = rate
        yield _trajectory(time_s * by, middle + q, v / by, a / by**2)


def test_a_thousand_trajectories_beyond_a_limit_between_knots_are_all_refused(traits, middle, make) -> None:
    rng = np.random.default_rng(SEED)
    beyond = [*_family(rng, traits, middle, 1.01), *_family(rng, traits, middle, 3.0)]
    accepted = [t for t in beyond if not _why(t, traits, make)]
    assert len(beyond) == 2 * CASES
    assert accepted == []


def test_a_thousand_trajectories_within_all_limits_are_all_accepted(traits, middle, make) -> None:
    rng = np.random.default_rng(SEED + 1)
    within = [*_family(rng, traits, middle, 0.999), *_family(rng, traits, middle, 0.3)]
    refused = [why for t in within if (why := _why(t, traits, make))]
    assert len(within) == 2 * CASES
    assert refused == []


def _pieces(home, *knots, times, a0=0.0):
    q = np.array(home) + np.array([[k, 0, 0, 0, 0, 0] for k in knots])
    a = np.zeros_like(q)
    a[len(knots) // 2, 0] = a0
    return _trajectory(np.array(times, dtype=float), q, np.zeros_like(q), a)


@pytest.mark.parametrize(
    ("knots", "times", "middle_acceleration", "words"),
    [
        ((0.0, 0.6), (0, 0.05), 0.0, "velocity of joint_1 reaches"),
        ((0.0, 0.5), (0, 1e-9), 0.0, "velocity of joint_1 reaches"),
        ((0.0, 0.01, 0.0), (0, 1, 2), 400.0, "velocity of joint_1 reaches"),
        ((0.0, 0.01), (0, 1), 1e300, "joint_1 reaches"),
        ((0.0, 0.01, 0.02), (0, 6, 12), 3.4, "of joint_1 reaches"),
    ],
)
def test_at_rest_at_every_knot_and_beyond_between_them(
    cell, traits, make, knots, times, middle_acceleration, words
) -> None:
    trajectory = _pieces(cell.arm("RIGHT-ARM").home_rad, *knots, times=times, a0=middle_acceleration)
    assert words in _why(trajectory, traits, make)


def test_a_trajectory_of_too_many_knots_is_refused(cell, traits, make) -> None:
    home = cell.arm("RIGHT-ARM").home_rad
    many = _pieces(home, *[0.0] * 10_001, times=range(10_001))
    assert "10000 is the maximum" in _why(many, traits, make)


def test_the_first_joint_outside_is_named_with_its_figures() -> None:
    points = quintic.control_points([0.0, 1.0], [[0.0, 0.0]] * 2, [[0.0, 0.0]] * 2, [[0.0, 4.0], [0.0, 0.0]])
    found = quintic.excess(points.accelerations, [-3.0, -3.0], [3.0, 3.0])
    assert found == quintic.Excess(piece=0, joint=1, value=4.0)


def test_control_points_outside_a_limit_that_the_curve_keeps_are_no_excess() -> None:
    # q(t) = t^2 (1 - t)^2 a / 2 from rest to rest: its greatest value is a / 32
    points = quintic.control_points([0.0, 1.0], [[0.0], [0.0]], [[0.0], [0.0]], [[1.0], [1.0]])
    assert points.positions.max() == pytest.approx(0.05)
    assert quintic.excess(points.positions, [-1.0], [1 / 32 + 1e-9]) is None
    assert quintic.excess(points.positions, [-1.0], [1 / 32 - 1e-9]) is not None
    assert quintic.most_beyond(points.positions, [1 / 64]) == pytest.approx(2, rel=2e-3)
    assert quintic.most_beyond(points.positions, [1 / 31]) == 1.0
