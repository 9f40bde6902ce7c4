"""How near an arm, its hand and its load come to other bodies: a stop condition, and what keeps a guided arm from it.

A body may be nearer than the limit at the start. Then it may only get farther, until it is beyond the limit. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from rtc.protocol import primitive as p
from rtc.protocol.units import measured_in_words
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import Near
from rtc.subsystems.motion.moment import Finding, Moment

NEAR_TICKS = 20  # interval of the looks
NEARER_M = 0.0005  # by which a body that was near at the start may come nearer again: noise, and a joint's last motion
# Of an arm that is moved by hand. It comes no nearer than the limit and this room: it is behind its command, and what
# it holds gives way. Bodies within `AHEAD_M` of the limit are looked at in every fifth tick.
ROOM_M = 0.001
AHEAD_M, AHEAD_TICKS = 0.045, 5
PER_S = 5.0  # it approaches at most by this share of what is left: as at the edge of a neighborhood
GIVES_M = 0.0001  # by which what was near at the start may come back, but no nearer than it was then
ASIDE = 0.01  # share of its speed with which the hand leaves a body that it slides along: so it never comes nearer
# It stops for what comes nearer by itself, such as its own fingers, another arm or a body that drifts, so long before.
LEAD_S = 0.04
PASSES = 6  # over the near bodies, in a corner between them

Sight = tuple[str, str]  # link of the arm or what it holds, and owner of the body


class Clearance:
    """The condition `ClearanceBelow`, one for each primitive."""

    def __init__(self, when: p.ClearanceBelow) -> None:
        self._limit, self._balls = when.limit_m, when.except_near
        self._wait = 0
        # Of bodies near since the start: their distances then, and the greatest ones since then (m).
        self._first: dict[Sight, float] = {}
        self._greatest: dict[Sight, float] | None = None
        self._seen: tuple[float, dict[Sight, float]] = (0.0, {})  # when (s), and the least distances
        self._found: Finding | None = None
        self._guide: Guide | None = None

    def guide(self, jacobian: Callable[[Sequence[float]], Array]) -> Guide:
        """What keeps an arm that is moved by hand from this condition."""
        self._guide = Guide(jacobian)
        return self._guide

    def __call__(self, now: Moment) -> Finding | None:
        if self._wait > 0:
            self._wait -= 1
            return self._found
        near = [one for one in now.near(self._within_m) if not self._excepted(one.point)]
        self._wait = (NEAR_TICKS if self._guide is None or not near else AHEAD_TICKS) - 1
        nearer_m_s = self._note(near, now.elapsed_s)
        self._found = self._nearest(near, nearer_m_s)
        if self._guide is not None:
            self._guide.see(now.joints, now.tcp(), near, [self._kept_m(one) for one in near])
        return self._found

    @property
    def _within_m(self) -> float:
        return self._limit if self._guide is None else self._limit + ROOM_M + AHEAD_M

    def _note(self, near: Sequence[Near], elapsed_s: float) -> dict[Sight, float]:
        """Which bodies have been near since the start, and how far they have been. Returns the speeds (m/s) at which
        bodies have come nearer to a guided arm since the latest look."""
        least: dict[Sight, float] = {}
        for one in near:
            least[_sight(one)] = min(one.distance_m, least.get(_sight(one), math.inf))
        if self._greatest is None:
            self._first = least
        before = least if self._greatest is None else self._greatest
        greatest = {sight: max(away_m, before[sight]) for sight, away_m in least.items() if sight in before}
        self._greatest = {sight: m for sight, m in greatest.items() if m < self._limit + ROOM_M}
        (before_s, seen), self._seen = self._seen, (elapsed_s, least)
        if self._guide is None or elapsed_s <= before_s:
            return {}
        return {sight: (seen[sight] - m) / (elapsed_s - before_s) for sight, m in least.items() if sight in seen}

    def _nearest(self, near: Sequence[Near], nearer_m_s: dict[Sight, float]) -> Finding | None:
        """The nearest body that is too near."""
        assert self._greatest is not None
        too_near = []
        for one in near:
            least_m = min(self._limit, self._greatest.get(_sight(one), math.inf) - NEARER_M)
            if one.distance_m - LEAD_S * max(nearer_m_s.get(_sight(one), 0.0), 0.0) < least_m:
                too_near.append((one.distance_m, self._limit, f"{one.link} near {one.body}, {_shown(one.distance_m)}"))
        return min(too_near, default=None)

    def _kept_m(self, one: Near) -> float:
        """The distance that a guided arm keeps from a body."""
        assert self._greatest is not None
        if (greatest_m := self._greatest.get(_sight(one))) is None:
            return self._limit + ROOM_M
        return min(self._limit + ROOM_M, max(self._first[_sight(one)], greatest_m - GIVES_M))

    def _excepted(self, point: Sequence[float]) -> bool:
        return any(math.dist(point, ball[:3]) < ball[3] for ball in self._balls)


class Guide:
    """Takes out of a wanted motion what goes towards near bodies. `cut`: from which one, in words, or empty."""

    def __init__(self, jacobian: Callable[[Sequence[float]], Array]) -> None:
        self._jacobian = jacobian
        self._near: Sequence[Near] = ()
        self._joints: Array = np.zeros(0)  # of the latest look
        self._away_m: Array = np.zeros(0)  # beyond what is kept, at these joints
        self._rates: Array = np.zeros((0, 0))  # of these distances, by joint (m/rad)
        self._most_m_s: Array = np.zeros(0)  # at most so fast each body may be approached
        # Of what moves with the hand: the same by a velocity of the tcp (m/s per m/s), and by its turn (m/s per rad/s).
        self._ways: Array = np.zeros((0, 3))
        self._turns: Array = np.zeros((0, 3))
        self.cut = ""

    def see(self, joints: Sequence[float], tcp: Array, near: Sequence[Near], kept_m: Sequence[float]) -> None:
        """The bodies near the arm at these joints, and the distances (m) to keep from them."""
        self._near, self._joints = near, np.asarray(joints)
        if not near:
            return
        self._away_m = np.array([one.distance_m for one in near]) - kept_m
        ways = np.array([one.away for one in near])
        points = np.array([one.point for one in near]) + ways * np.array([[one.distance_m] for one in near])
        turns = np.cross(points - tcp[:3], ways)
        jacobian = self._jacobian(joints)
        self._rates = ways @ jacobian[:3] + turns @ jacobian[3:]
        for row, one in zip(self._rates, near, strict=True):
            row[: one.joints[0]] = row[one.joints[1] :] = 0.0
        by_hand = np.array([[one.joints == (0, len(joints))] for one in near])
        self._ways, self._turns = ways * by_hand, turns * by_hand

    def at(self, joints: Array) -> None:
        """The commanded joints of this tick (rad)."""
        self.cut = ""
        if self._near:
            self._most_m_s = PER_S * np.maximum(self._away_m + self._rates @ (joints - self._joints), 0.0)

    def slide(self, twist: Array) -> Array:
        """A wanted twist of the tcp (m/s, rad/s, world axes) without its motion towards what is near the hand or its
        load."""
        if not self._near:
            return twist
        linear = twist[:3]
        most = self._most_m_s + self._turns @ twist[3:] - ASIDE * math.sqrt(linear @ linear)
        for _ in range(PASSES):
            towards = -(self._ways @ linear)
            excess = np.minimum(towards - most, towards)
            worst = int(excess.argmax())
            if excess[worst] <= 0.0:
                break
            linear = linear + excess[worst] * self._ways[worst]
            self._name(self._near[worst])
        return np.concatenate((linear, twist[3:]))

    def slow(self, speeds: Array) -> Array:
        """Joint speeds (rad/s) at which nothing comes too near."""
        if not self._near:
            return speeds
        shares = self._most_m_s / np.maximum(-(self._rates @ speeds), 1e-12)
        worst = int(shares.argmin())
        if shares[worst] >= 1.0:
            return speeds
        self._name(self._near[worst])
        return speeds * float(shares[worst])

    def _name(self, one: Near) -> None:
        self.cut = (
            self.cut or f"kept away from {one.body}: {one.link} is {measured_in_words(one.distance_m, 'm')} from it"
        )


def _sight(one: Near) -> Sight:
    return one.link, one.body.partition(" ")[0]


def _shown(away_m: float) -> str:
    return f"{1e3 * away_m:.1f} mm away"
