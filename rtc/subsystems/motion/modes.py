"""The states of an executor, and the table of all their changes. Pure data."""

from __future__ import annotations

from enum import Enum

from rtc.protocol.outcomes import Reflex


class Mode(Enum):
    HOLDING = "holding"  # no primitive; the arm stays where it is, the hand keeps its grip
    EXECUTING = "executing"  # stop functions are evaluated every tick
    STOPPING = "stopping"  # the reason is fixed; braking, jerk-limited; thresholds masked
    RETREATING = "retreating"  # reflex BACK_OFF; the limits are watched again
    RELEASING = "releasing"  # reflex RELEASE
    COMPLYING = "complying"  # reflex COMPLY: the arm gives way to every force
    SETTLING = "settling"  # commanded to rest; waits until rest is measured, then reports the end


class Trigger(Enum):
    ACCEPTED = "accepted"  # a primitive passed its check
    TRIPPED = "tripped"  # a stop function came true
    HALTED = "halted"  # a halt from outside
    DONE = "done"  # the work of this state is complete


TRANSITIONS: dict[Mode, dict[Trigger, Mode]] = {
    Mode.HOLDING: {Trigger.ACCEPTED: Mode.EXECUTING, Trigger.HALTED: Mode.HOLDING},
    Mode.EXECUTING: {Trigger.TRIPPED: Mode.STOPPING, Trigger.HALTED: Mode.STOPPING},
    Mode.STOPPING: {
        Trigger.DONE: Mode.SETTLING,
        Trigger.HALTED: Mode.STOPPING,
    },  # DONE: the next state is in AFTER_STOP
    Mode.RETREATING: {
        Trigger.DONE: Mode.SETTLING,
        Trigger.TRIPPED: Mode.STOPPING,  # it meets something on its way back
        Trigger.HALTED: Mode.STOPPING,
    },
    Mode.RELEASING: {Trigger.DONE: Mode.SETTLING, Trigger.HALTED: Mode.STOPPING},
    Mode.COMPLYING: {Trigger.DONE: Mode.SETTLING, Trigger.HALTED: Mode.STOPPING},
    Mode.SETTLING: {Trigger.DONE: Mode.HOLDING, Trigger.HALTED: Mode.SETTLING},
}
AFTER_STOP: dict[Reflex, Mode] = {
    Reflex.STOP: Mode.SETTLING,
    Reflex.BACK_OFF: Mode.RETREATING,
    Reflex.RELEASE: Mode.RELEASING,
    Reflex.COMPLY: Mode.COMPLYING,
}
COUNTING = frozenset({Mode.EXECUTING, Mode.STOPPING, Mode.RETREATING})  # the wrench counts for the peaks of the report
MOVING = frozenset({Mode.EXECUTING, Mode.STOPPING, Mode.RETREATING, Mode.RELEASING, Mode.COMPLYING})
