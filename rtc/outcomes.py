"""How things end: the closed sets of words for stops, refusals and outcomes (R59, R84).

Three kinds of failing are never mixed:

* a `Refusal` is expected: a value that travels on as a message;
* an `RtcError` is the outside failing: an exception, its tree is drawn below;
* a bug is an assertion, and stops the process loudly.

    RtcError
    ├── WireError          bytes that are no message of ours
    ├── ClusterError       no cluster, or it did not come up / go down
    │   ├── NoCluster      nothing answers in that run directory
    │   └── TimedOut       no answer, or no outcome, in time
    ├── RequestDeclined    the cluster did not take a request; carries the refusal
    ├── KeyTrouble         a key file or an address for tcp is no good
    ├── ProgramError       a program, script or cell file does not check
    └── SubsystemError     a simulator or device did not do what it must
"""

from __future__ import annotations

from enum import StrEnum

import msgspec


class RtcError(Exception):
    """The outside failed. Root of every exception this project raises on purpose."""


class WireError(RtcError):
    """Bytes that are no message of ours: wrong version, malformed, unknown type."""


class ClusterError(RtcError):
    """The cluster did not do what it was asked to as a whole."""


class NoCluster(ClusterError):
    """Nothing answers in this run directory."""


class TimedOut(ClusterError, TimeoutError):
    """No answer, or no outcome, within the time the caller gave."""


class RequestDeclined(RtcError):
    """The cluster did not take a request (unknown command, queue full, bad program); `refusal` says why."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.message)
        self.refusal = refusal


class KeyTrouble(RtcError):
    """A key, its file or an address for tcp is no good; the text says what to do."""


class ProgramError(RtcError):
    """A program, script or cell file does not check; the text names the place, as `$.steps[3].trim`."""


class SubsystemError(RtcError):
    """A simulator or device did not do what it must."""


class StopReason(StrEnum):
    """Why a primitive ended; exactly one per end report (R83, A21). Declared in order of priority:
    when several conditions hold in the same servo tick, the first of these wins."""

    HALT = "halt"  # told to stop from outside
    COLLISION = "collision"  # a body touched another where no touch was planned
    JOINT_LIMIT = "joint_limit"  # a joint came within its margin of a limit
    COMMAND_LIMIT = "command_limit"  # the next command was beyond the limits of the arm; it was not followed
    FORCE_LIMIT = "force_limit"  # measured force beyond the guard
    TORQUE_LIMIT = "torque_limit"  # measured torque beyond the guard
    OVERSPEED = "overspeed"  # a joint was measured faster than it may turn
    FOLLOWING_ERROR = "following_error"  # a joint was measured too far from where it was commanded to be
    CONTACT = "contact"  # a touch that the primitive was told to feel for
    SLIP = "slip"  # the held object moves in the fingers
    OBJECT_LOST = "object_lost"  # nothing between the fingers any more
    GOAL = "goal"  # the end of the trajectory, or the commanded width and force
    TIMEOUT = "timeout"  # the time limit passed first
    # The reasons below are never seen by a servo tick; they come from elsewhere.
    NO_CONTACT = "no_contact"  # derived by the analyzer: goal reached where a touch was expected
    REFUSED = "refused"  # the subsystem would not start the primitive
    OPERATOR_DONE = "operator_done"  # the operator says the primitive is done
    OPERATOR_CANNOT = "operator_cannot"  # the operator says it cannot be done
    SUBSYSTEM_LOST = "subsystem_lost"  # nobody there to report


PRIORITY: dict[StopReason, int] = {reason: n for n, reason in enumerate(StopReason)}


class Reflex(StrEnum):
    """What the MCM does when a stop function comes true (A22)."""

    STOP = "stop"  # jerk-limited stop, then hold
    BACK_OFF = "back_off"  # stop, then retreat along the way it came
    COMPLY = "comply"  # go limp: forces to zero
    RELEASE = "release"  # stop and open the hand


class RefusalReason(StrEnum):
    """Why something was not even tried."""

    SENTENCE = "sentence"  # the words are no sentence of the language
    NAME = "name"  # a name that nothing known bears
    NO_SCRIPT = "no_script"  # a verb that has no script yet
    INFEASIBLE = "infeasible"  # geometry or load forbids it: limit, reach, collision
    RESOURCE = "resource"  # a resource is taken, and NOW was said
    STATE = "state"  # the world or the command is in no state for it (e.g. hand not empty)
    SUSPECT = "suspect"  # a fact it needs is not to be trusted; sense it again first
    NOT_ALLOWED = "not_allowed"  # this role may not do that
    OVERLOAD = "overload"  # a queue is at its length
    POISON = "poison"  # the job killed its worker too often
    PROGRAM = "program"  # a program does not check, or lacks an entry
    TIMEOUT = "timeout"  # nobody answered within the limit


class OutcomeKind(StrEnum):
    """How a command ended; a closed set, one per command."""

    SUCCEEDED = "succeeded"
    FAILED = "failed"  # executed and ended otherwise than hoped; the cause says how
    REFUSED = "refused"  # never executed, or not to its end, because a step was refused
    ABORTED = "aborted"  # ended by ABORT, alone
    HALTED = "halted"  # halted, and rest is confirmed
    HALT_NOT_CONFIRMED = "halt_not_confirmed"  # halted, and nobody confirmed rest
    LOST_SUBSYSTEM = "lost_subsystem"  # the subsystem that executed it went away


class Refusal(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An expected no, as a value. It tells the cause in the words of the task, and what would clear it."""

    reason: RefusalReason
    message: str  # one or two sentences: what, where, why
    where: str = ""  # the place: "step 3 (GP1)", "column 12", "$.steps[3].trim"
    column: int | None = None  # first offending character of a sentence, from 0
    expected: list[str] = []  # what would have been right there
    nearest: list[str] = []  # the nearest known names
    owner: str = ""  # who has the resource, e.g. "C-3"
    clears: str = ""  # what would clear it
    detail: dict[str, float | str] = {}  # figures: joint, limit_rad, value_rad, bodies, distance_m ...


class Measured(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """What a subsystem measured, as far as REPORT asked for it; None = not asked for."""

    arm: str
    tcp_pose: list[float] | None = None  # [x y z qx qy qz qw]: m, world axes
    joints: list[float] | None = None  # rad
    wrench: list[float] | None = None  # [Fx Fy Fz Tx Ty Tz]: N, N.m, tool axes; at rest, or in the tick of a report
    peak_force_n: float | None = None  # the greatest while the last primitive was executed
    peak_torque_nm: float | None = None


class Outcome(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """How one command ended, told to whoever submitted it."""

    kind: OutcomeKind
    message: str = ""  # the cause in words; empty on a plain success
    stop: StopReason | None = None  # the stop reason that ended it, when a primitive did
    refusal: Refusal | None = None  # the refusal that ended it, when one did
    step: str = ""  # the step it ended in, e.g. "5 of 9: feel GP1"
    trims: list[str] = []  # the trims used, in order
    steps_done: int = 0
    measured: Measured | None = None  # at the end of the last primitive, as far as REPORT asked for it
