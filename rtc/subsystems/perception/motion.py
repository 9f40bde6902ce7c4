"""The velocity of a body from its latest poses: a straight line through their positions and small turns. Pure.

All times are by the clock of what is seen: of a simulation its own, which runs faster or slower than ours. It begins
anew with a new process.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from rtc.spatial import geometry
from rtc.spatial.geometry import Array

# Span that the kept poses have at least, once there are so many: of a body that is followed, and of one that should
# rest. Pixels shift each pose: of what turns by 0.3 deg/s poses of 1 s showed 0.27 to 0.54 deg/s.
FOLLOWED_S, RESTS_S = 1.0, 2.0
MIN_S = 0.25  # span of poses below which a velocity would be noise


class BodyMotion:
    def __init__(self, kept_s: float) -> None:
        self._kept_s = kept_s
        self._poses: deque[tuple[float, Array]] = deque()

    def take(self, at_s: float, pose: Array) -> None:
        """`pose`: of the body, world frame."""
        if self._poses and at_s < self._poses[-1][0]:
            self._poses.clear()
        self._poses.append((at_s, pose))
        while len(self._poses) > 2 and at_s - self._poses[1][0] >= self._kept_s:
            self._poses.popleft()

    def predicted(self, at_s: float) -> Array | None:
        """The pose at a time after the latest one; None without a pose. Without a velocity: the latest pose."""
        if not self._poses:
            return None
        seen_s, pose = self._poses[-1]
        velocity = self.velocity()
        if velocity is None:
            return pose
        moved, turned = ((at_s - seen_s) * np.array(part) for part in (velocity[:3], velocity[3:]))
        turn = geometry.make_pose((0.0, 0.0, 0.0), (*(0.5 * turned), 1.0))  # of a small angle
        return geometry.make_pose(pose[:3] + moved, geometry.compose(turn, (0.0, 0.0, 0.0, *pose[3:]))[3:])

    @property
    def known(self) -> bool:
        """Whether the history is long enough for a velocity."""
        return len(self._poses) > 1 and self._poses[-1][0] - self._poses[0][0] >= MIN_S

    @property
    def oldest_s(self) -> float:
        """The time of the oldest pose of which the velocity is; there must be one."""
        return self._poses[0][0]

    @property
    def spacing_s(self) -> float:
        """The mean time between two poses."""
        return (self._poses[-1][0] - self._poses[0][0]) / max(1, len(self._poses) - 1)

    def velocity(self) -> list[float] | None:
        """m/s and rad/s, world axes; None with too short a history."""
        if not self.known:
            return None
        last = self._poses[-1][1]
        times = np.array([at_s for at_s, _ in self._poses])
        rows = np.array([[*(pose[:3] - last[:3]), *geometry.rotation_vector(last, pose)] for _, pose in self._poses])
        off = times - times.mean()
        slopes = off @ rows / float(off @ off)
        return [float(n) for n in slopes]
