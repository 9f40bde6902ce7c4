"""Closed sets of stop reasons, refusals and outcomes (R59, R84), and the tree of exceptions.

Three kinds of failure are kept apart:

* a `Refusal` is expected: a value that travels in messages; inside a worker it is raised as `Refused`;
* an `RtcError` is a failure of the environment: an exception, see the tree below;
* a bug is an AssertionError, which ends the process.

    RtcError
    ├── WireError          bytes that are not a message of this protocol
    ├── ClusterError       no cluster, or it did not start or end
    │   ├── NoCluster      no process answers in that run directory
    │   └── TimedOut       no answer, or no outcome, in time
    ├── RequestDeclined    the cluster did not accept a request; carries the refusal
    ├── NotSucceeded       raised on request, by `raise_for_outcome`: a command ended otherwise; carries the outcome
    ├── KeyTrouble         a key file or a tcp address is invalid
    └── ProgramError       a program, script or cell file is invalid
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Any

import msgspec

from rtc.protocol.advice import Advice, by_person, by_sentence
from rtc.protocol.causes import Cause, Effort
from rtc.protocol.rehearsal import Rehearsal


class RtcError(Exception):
    """Base of every exception that this project raises on purpose: the environment failed, not the code."""


class WireError(RtcError):
    """Bytes that are not a message of this protocol: wrong version, malformed, unknown type."""


class ClusterError(RtcError):
    """The cluster as a whole did not do what was requested."""


class NoCluster(ClusterError):
    """No process answers in this run directory."""


class TimedOut(ClusterError, TimeoutError):
    """No answer, or no outcome, within the time limit of the caller."""


class RequestDeclined(RtcError):
    """The cluster did not accept a request (unknown command, queue full, bad program); `refusal` has the reason."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.message)
        self.refusal = refusal


class NotSucceeded(RtcError):
    """A command has ended, but not as succeeded; `command` is its number, `outcome` has the cause."""

    def __init__(self, command: str, text: str, outcome: Outcome) -> None:
        why = f": {outcome.message}" if outcome.message else ""
        super().__init__(f"{command} {outcome.kind.value.replace('_', ' ')}: {text}{why}".lstrip())
        self.command, self.outcome = command, outcome


class KeyTrouble(RtcError):
    """A key, its file or a tcp address is invalid; the text names the cure."""


class ProgramError(RtcError):
    """A program, script or cell file is invalid; the text names the place, for example `$.steps[3].trim`."""


class StopReason(StrEnum):
    """Why a primitive ended; exactly one per end report (R83, A21). Declared in order of priority:
    if several conditions hold in the same servo tick, the first in this list is reported."""

    HALT = "halt"  # a halt from outside
    ARM_CONTACT = "arm_contact"  # two arms touch: a global fault, which stops both
    COLLISION = "collision"  # unplanned contact of two bodies
    JOINT_LIMIT = "joint_limit"  # a joint came within its margin of a limit
    COMMAND_LIMIT = "command_limit"  # the next setpoint was beyond the limits of the arm, and was not executed
    FORCE_LIMIT = "force_limit"  # measured force beyond the guard
    TORQUE_LIMIT = "torque_limit"  # measured torque beyond the guard
    OVERSPEED = "overspeed"  # measured joint speed above its limit
    FOLLOWING_ERROR = "following_error"  # measured joint position too far from its setpoint
    OUT_OF_RANGE = "out_of_range"  # the tcp left its range, its attitude or a distance
    CONTACT = "contact"  # the contact that the primitive was to detect
    SLIP = "slip"  # the held object moves in the fingers
    OBJECT_LOST = "object_lost"  # nothing is between the fingers any more
    FOUND = "found"  # a camera has seen the body that it was to look for
    GOAL = "goal"  # the end of the trajectory, or the commanded width and force
    NOT_SEEN = "not_seen"  # the camera has not seen that body within the time limit
    TIMEOUT = "timeout"  # the time limit passed first
    NO_CONTACT = "no_contact"  # a contact ended; or, derived by the analyzer, the goal was reached without one
    # The reasons below do not come from a servo tick.
    REFUSED = "refused"  # the subsystem did not start the primitive
    BLOCKED = "blocked"  # not started, or stopped on its way: another arm has not left the space that it needs
    SUBSYSTEM_LOST = "subsystem_lost"  # the subsystem was lost before its report
    # Answers of the operator to a request.
    OPERATOR_DONE = "operator_done"  # it is done, and the subsystem has proved it
    OPERATOR_CANNOT = "operator_cannot"  # it cannot be done


#: Answers of the operator: only what the operator performs ends with one.
OF_OPERATOR = frozenset({StopReason.OPERATOR_DONE, StopReason.OPERATOR_CANNOT})

PRIORITY: dict[StopReason, int] = {reason: n for n, reason in enumerate(StopReason)}


class FaultScope(StrEnum):
    """What a stop reason concerns (R47, A30)."""

    COMMAND = "command"  # the command of the primitive alone; other arms go on
    SUBSYSTEM = "subsystem"  # every arm of the subsystem, and every command that has been taken up for one


FAULT_SCOPE: dict[StopReason, FaultScope] = dict.fromkeys(StopReason, FaultScope.COMMAND) | {
    StopReason.ARM_CONTACT: FaultScope.SUBSYSTEM,
    StopReason.SUBSYSTEM_LOST: FaultScope.SUBSYSTEM,
}


class Reflex(StrEnum):
    """What the MCM does when the condition of a stop function holds (A22)."""

    STOP = "stop"  # jerk-limited stop, then hold
    BACK_OFF = "back_off"  # stop, then retreat along the path it came
    COMPLY = "comply"  # comply: regulate forces to zero
    RELEASE = "release"  # stop and open the hand


class RefusalReason(StrEnum):
    """Why something was not started."""

    SENTENCE = "sentence"  # the words are not a sentence of the language
    NAME = "name"  # an unknown name
    NO_SCRIPT = "no_script"  # a verb that has no script yet
    INFEASIBLE = "infeasible"  # geometry or load forbids it: limit, reach, collision
    RESOURCE = "resource"  # a resource is in use, and the sentence has NOW
    STATE = "state"  # the state of the world or of the command does not allow it (e.g. hand not empty)
    SUSPECT = "suspect"  # a fact it needs is suspect; sense it again first
    STALE = "stale"  # what its test rests on has changed since
    NOT_ALLOWED = "not_allowed"  # this role may not do that
    OVERLOAD = "overload"  # a queue is full
    POISON = "poison"  # the job killed its worker too often
    PROGRAM = "program"  # a program is invalid, or lacks an entry
    TIMEOUT = "timeout"  # no answer within the limit
    VERSION = "version"  # the two sides speak different versions of the protocol


class OutcomeKind(StrEnum):
    """How a command ended; a closed set, one per command."""

    SUCCEEDED = "succeeded"
    FAILED = "failed"  # executed without success; the cause gives the reason
    REFUSED = "refused"  # not executed, or not to its end, because a step was refused
    ABORTED = "aborted"  # ended by ABORT of this command
    HALTED = "halted"  # halted, and rest is confirmed
    HALT_NOT_CONFIRMED = "halt_not_confirmed"  # halted, but rest was not confirmed
    LOST_SUBSYSTEM = "lost_subsystem"  # the connection to the executing subsystem was lost


class Refusal(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An expected refusal, as a value: the cause in the words of the task, and what would clear it."""

    reason: RefusalReason
    message: str  # one or two sentences: what, where, why
    where: str = ""  # the place: "step 3 (GP1)", "column 12", "$.steps[3].trim"
    column: int | None = None  # first offending character of a sentence, from 0
    expected: list[str] = []  # what is allowed at that place
    nearest: list[str] = []  # the most similar known names
    owner: str = ""  # command that holds the resource, e.g. "C-3"
    clears: Advice = []  # what would clear it, the first choice first
    by_operator: str = ""  # the sentence that asks the operator for what was refused, or has failed
    cause: Cause | None = None
    in_the_way: str = ""  # arm that blocks the motion, now or on its way, and may leave
    fraction: float = 1.0  # of the way is free before the problem; 1: all of it, or not known
    along_m: float | None = None  # of a line is free before the problem
    effort: Effort | None = None  # what was tried

    def offering(self, sentence: str) -> Refusal:
        """With the sentence that asks the operator instead, as the last advice (R81); unchanged if it is empty."""
        if not sentence:
            return self
        return msgspec.structs.replace(self, clears=[*self.clears, *by_sentence(sentence)], by_operator=sentence)

    def figures(self) -> dict[str, float | str | tuple[str, ...]]:
        """Cause, figures and effort by name, for people."""
        cause = {} if self.cause is None else {"cause": _tag(self.cause), **msgspec.structs.asdict(self.cause)}
        free = self.fraction if self.fraction < 1.0 else None
        rows = {**cause, "in_the_way": self.in_the_way, "fraction": free, "along_m": self.along_m}
        rows |= {} if self.effort is None else msgspec.structs.asdict(self.effort)
        return {name: value for name, value in rows.items() if value not in (None, "")}

    def after(self, **effort: Any) -> Refusal:
        """With more fields of its effort."""
        known = msgspec.structs.asdict(self.effort) if self.effort is not None else {}
        return msgspec.structs.replace(self, effort=Effort(**{**known, **effort}))


def _tag(cause: Cause) -> str:
    return str(cause.__struct_config__.tag)


class Refused(Exception):
    """Leaves the computation of a worker, whose `run` returns the `refusal`. Never leaves a worker."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.message)
        self.refusal = refusal

    @classmethod
    def because(
        cls,
        reason: RefusalReason,
        message: str,
        *,
        where: str = "",
        expected: Iterable[str] = (),
        nearest: Iterable[str] = (),
        owner: str = "",
        clears: str | Advice = "",
        cause: Cause | None = None,
        in_the_way: str = "",
    ) -> Refused:
        """With a new refusal; the fields are those of `Refusal`. `clears`: words are for a person."""
        return cls(
            Refusal(
                reason=reason,
                message=message,
                where=where,
                expected=list(expected),
                nearest=list(nearest),
                owner=owner,
                clears=by_person(clears) if isinstance(clears, str) else clears,
                cause=cause,
                in_the_way=in_the_way,
            )
        )


def refuse_if(problem: Refusal | None) -> None:
    """Raise Refused for a problem that a check has found."""
    if problem is not None:
        raise Refused(problem)


class Sighting(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """The pose of one body as a camera saw it, without the name of the body."""

    pose: list[float]  # [x y z qx qy qz qw]: m, world axes
    covariance: list[float]  # 6 x 6, row by row: position (m) and small turn (rad) about the body's origin, world axes
    tags: list[int]  # numbers of the AprilTags that it is made of
    error_px: float  # reprojection error of their corners, root mean square
    age_s: float  # from the exposure of the latest picture to the report
    pictures: int = 1  # number of pictures in which it was seen
    ambiguous: bool = False  # a second attitude explains the pictures nearly as well; the covariance covers it
    velocity: list[float] | None = None  # m/s three times, rad/s three times, world axes; None = not measured
    cameras: list[str] = []  # whose pictures it is made of, if there are several


class Measured(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """What a subsystem measured, as far as REPORT requested it; None = not requested."""

    arm: str  # or the camera
    tcp_pose: list[float] | None = None  # [x y z qx qy qz qw]: m, world axes
    joints: list[float] | None = None  # rad; m for those of `slides`
    slides: list[int] = []  # numbers of the joints that slide
    wrench: list[float] | None = None  # [Fx Fy Fz Tx Ty Tz]: N, N.m, tool axes; at rest, or in the tick of a report
    peak_force_n: float | None = None  # maximum during the last primitive
    peak_torque_nm: float | None = None
    sighting: Sighting | None = None  # of a camera
    partner: Measured | None = None  # of the second arm of the same primitive; the peaks above are then those of both
    others: dict[str, Any] = {}  # items of installed packages, by name


class Figure(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One figure of a step. It drifts if it differs by more than `band` from what was predicted."""

    name: str  # of `workers.analyzer.comparison.FIGURES`, with its unit: duration_s
    predicted: float
    measured: float
    band: float

    @property
    def drifts(self) -> bool:
        return abs(self.measured - self.predicted) > self.band


class Compared(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """What a step was expected to do, against what came (R79)."""

    verb: str
    kind: str  # row of the analyzer's outcomes: move_free, grip-close
    figures: list[Figure] = []  # empty: it ended otherwise than expected
    label: str = ""  # of the step


class Outcome(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """How one command ended; sent to the client that submitted it."""

    kind: OutcomeKind
    message: str = ""  # the cause in words; on a success empty, or what is left to do
    stop: StopReason | None = None  # the stop reason, if the end of a primitive ended it
    refusal: Refusal | None = None  # the refusal, if one ended it
    step: str = ""  # the step it ended in, e.g. "5 of 9: feel GP1"
    trims: list[str] = []  # the trims used, in order
    steps_done: int = 0
    measured: Measured | None = None  # at the end of the last primitive, as far as REPORT requested it
    rehearsal: Rehearsal | None = None  # of a TEST sentence

    def __repr__(self) -> str:
        return f"<Outcome {self.kind.value}{': ' if self.message else ''}{self.message}>"
