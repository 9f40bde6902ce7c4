"""The commanded motion of each tick: a profile, the rate of its time, and the limits of the joints. Pure.

This module must not know samples, states or stop reasons.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtc.protocol.primitive import JointTrajectory
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, Motion, Traits
from rtc.subsystems.motion.pace import PathRate
from rtc.subsystems.motion.profiles import Follow, Profile, Stay

# Factor by which a command may exceed a joint's speed limit. Reasons: an offset at the start of a path (0.08 rad/s);
# braking from an acceleration (0.14 rad/s). A greater excess is an error in the profile.
COMMAND_SLACK = 1.25


class Setpoints:
    """`command` is that of the latest tick. A tick calls `advance`, or `skip` while `next_check_tick` is ahead."""

    def __init__(self, traits: Traits, joints: Sequence[float]) -> None:
        self.most_rad_s = [COMMAND_SLACK * limit for limit in traits.velocity]
        self._most_step_rad = [limit * TICK_S for limit in self.most_rad_s]
        self.profile: Profile = Stay(joints)
        self.ticks = 0  # since the begin of the profile
        self._shift_s = 0.0  # time of the profile minus that of its ticks: what passed at another rate
        self.pace = PathRate()
        self.command: Motion = self.profile.at(0.0)
        self.path: Follow | None = None  # of the primitive, if it has one
        # The present motions of the path, the tick of the first, and the tick that needs a whole tick again.
        self.block: Array = np.empty((0, 3, 0))
        self.block_from = self.next_check_tick = 0

    @property
    def time_s(self) -> float:
        """Time of the profile."""
        return self.ticks * TICK_S + self._shift_s

    @property
    def over(self) -> bool:
        """Whether the profile has reached its end state."""
        return self.time_s >= self.profile.duration_s

    def use(self, profile: Profile) -> None:
        """Begin a profile, at its own rate."""
        self.profile = profile
        self.ticks, self._shift_s = 0, 0.0
        self.next_check_tick = 0
        self.pace = PathRate()

    def stay(self) -> None:
        """Stay at the latest command."""
        self.use(Stay(self.command[0]))

    def follow(self, trajectory: JointTrajectory) -> None:
        self.path = Follow(trajectory, self.command[0], self.most_rad_s)
        self.use(self.path)

    def keep(self, trajectory: JointTrajectory) -> None:
        """Keep a path to retreat along, without following it."""
        self.path = Follow(trajectory, trajectory.positions[0], self.most_rad_s)

    def stand_at(self, joints: Sequence[float]) -> Motion:
        """Stay at these joints, from this tick on. Returns the command."""
        self.use(Stay(joints))
        self.command = self.profile.at(0.0)
        return self.command

    def order_pace(self, paused: bool, least_s: float) -> None:
        """Pause the time of the profile, or let it go on, within this time or more (s)."""
        self.pace.order(paused, least_s)
        self.next_check_tick = 0

    def keep_before(self, before_s: float, most_rad_s2: Sequence[float]) -> None:
        """Let the time of the path not come beyond this one, as in `PathRate.keep_before`."""
        self.pace.keep_before(before_s, self.profile, self.time_s, most_rad_s2)
        if not self.pace.full:
            self.next_check_tick = 0

    def skip(self, tick: int) -> Motion:
        """The command of a tick of the block, whose limits are checked already."""
        self.ticks = tick
        # Lists made as late as this stay in the nearest cache: 2 us less than with lists of the whole block.
        self.command = command = self.block[tick - self.block_from].tolist()
        return command

    def advance(self) -> Motion:
        """The command of the next tick at full rate; the caller stores it."""
        self.ticks += 1
        return self.profile.at(self.ticks * TICK_S + self._shift_s)

    def advance_slowly(self, most_rad_s2: Sequence[float]) -> Motion:
        """The same in a pause, or on the way into or out of it."""
        self._shift_s += self.pace.advance(self.profile, self.time_s, most_rad_s2)
        return self.pace.scaled(self.profile.at(self.time_s))

    def replace(self, profile: Profile) -> Motion:
        """Begin another profile in this tick, after its command was refused. Returns the command of this tick."""
        self.use(profile)
        self.ticks = 1
        return profile.at(TICK_S)

    def allows(self, command: Motion) -> bool:
        """Whether every joint can reach the commanded position and speed within one tick. The path checks many ticks
        at once."""
        if self.path is self.profile and self.path.within_limits and self.pace.full:
            return True
        joints, speeds, _ = command
        for q, before, most, speed, fastest in zip(
            joints, self.command[0], self._most_step_rad, speeds, self.most_rad_s, strict=True
        ):
            if not (-most <= q - before <= most and -fastest <= speed <= fastest):  # false for NaN too
                return False
        return True

    def fastest(self, refused: Motion) -> tuple[int, float]:
        """(joint, rad/s) of the joint whose step to this command exceeds its limit most."""
        speeds = [abs(q - before) / TICK_S for q, before in zip(refused[0], self.command[0], strict=True)]
        joint = max(range(len(speeds)), key=lambda n: speeds[n] / self.most_rad_s[n])
        return joint, speeds[joint]

    @property
    def new_block(self) -> Follow | None:
        """The path, if it has computed a new block of ticks that `look_ahead` does not know; else None."""
        path = self.path
        return (
            path
            if path is self.profile and path is not None and self.pace.full and path.block is not self.block
            else None
        )

    def look_ahead(self, path: Follow) -> None:
        self.block, self.block_from, self.next_check_tick = path.block, self.ticks - path.latest, 0
