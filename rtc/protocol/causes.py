"""Causes of refusals, one struct for each: what a program decides on. The words for people are in `Refusal.message`.

Units are in the names of the fields; points are in the world frame. Angles and lengths of a joint that slides are in m.
Bodies are those of collision models: the owner, a blank and the link or part ("RIGHT-ARM link_2").
"""

from __future__ import annotations

import msgspec


class _Cause(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False, tag_field="kind"):
    """Base of all causes; `kind` names the struct in messages."""


# --- geometry and motion ---------------------------------------------------------------------------------


class Collides(_Cause, frozen=True, tag="collision"):
    """Two bodies would touch, or come nearer than the clearance. A distance below 0 is the penetration depth."""

    body_a: str
    body_b: str
    distance_m: float = 0.0
    margin_m: float = 0.0  # the clearance of this pair
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    leaving: str = ""  # body that the arm may touch at its start: it cannot leave it this way

    @property
    def owners(self) -> tuple[str, str]:
        """The arms or objects of the two bodies."""
        return self.body_a.split()[0], self.body_b.split()[0]


class JointLimitPassed(_Cause, frozen=True, tag="joint_limit"):
    arm: str
    joint: str
    value_rad: float
    limit_rad: float
    margin_rad: float
    excess_rad: float


class OutOfReach(_Cause, frozen=True, tag="reach"):
    arm: str
    which: str  # way in which it is: "farther out"
    distance_m: float
    turned_rad: float | None = None  # of the nearest posture, off the attitude; None: not computed


class Singular(_Cause, frozen=True, tag="singularity"):
    arm: str
    joint: str = ""  # that would leap
    leap_rad: float | None = None
    sigma_min: float = 0.0  # least singular value of the Jacobian before it


class OtherBranch(_Cause, frozen=True, tag="branch"):
    arm: str
    off_rad: float


class BadCurve(_Cause, frozen=True, tag="curve"):
    """A curve that cannot be made of its figures."""


class OutsideWorkRange(_Cause, frozen=True, tag="work_range"):
    region: str
    x_m: float
    y_m: float
    z_m: float


class OffAttitude(_Cause, frozen=True, tag="attitude"):
    attitude: str
    off_rad: float
    limit_rad: float
    x_m: float
    y_m: float
    z_m: float


class NoPosture(_Cause, frozen=True, tag="place"):
    """The cell has no posture of this arm for the place."""

    arm: str
    place: str


class SpaceTaken(_Cause, frozen=True, tag="space"):
    """Another arm moves through the space that this one needs (`Refusal.in_the_way`)."""

    arm: str


class TooLong(_Cause, frozen=True, tag="time"):
    predicted_s: float
    limit_s: float
    moved_s: float | None = None  # of the limit, in steps before; None: the limit is that of one step


# --- forces, torques and hands ---------------------------------------------------------------------------


class JointTorqueExceeded(_Cause, frozen=True, tag="torque"):
    arm: str
    joint: str
    torque_nm: float
    limit_nm: float


class TooHeavy(_Cause, frozen=True, tag="payload"):
    mass_kg: float
    limit_kg: float
    arm: str


class ForceExceeded(_Cause, frozen=True, tag="force"):
    limit_n: float
    value_n: float
    arm: str


class GripForceExceeded(_Cause, frozen=True, tag="grip_force"):
    value_n: float
    limit_n: float
    arm: str


class OpeningExceeded(_Cause, frozen=True, tag="opening"):
    value_m: float
    limit_m: float
    arm: str


class UntilForce(_Cause, frozen=True, tag="until_force"):
    """An UNTIL waits for a force that the step does not reach."""

    value_n: float
    limit_n: float


class UntilTorque(_Cause, frozen=True, tag="until_torque"):
    """An UNTIL waits for a torque that the step does not reach."""

    value_nm: float
    limit_nm: float


# --- objects, seats and mechanisms -----------------------------------------------------------------------


class InSeat(_Cause, frozen=True, tag="seat"):
    """The held object leaves this seat only in a straight line."""

    arm: str
    seat: str


class Fastened(_Cause, frozen=True, tag="bolts"):
    """Bolts of this seat are in, or may be."""

    seat: str


class BeyondStop(_Cause, frozen=True, tag="stop"):
    """An angle beyond a stop of a hinge."""

    value_rad: float
    least_rad: float
    most_rad: float


class BeyondThread(_Cause, frozen=True, tag="thread"):
    value_turns: float
    most_turns: float


class NeedUnmet(_Cause, frozen=True, tag="need"):
    """What the script needs is not so: a hand that is empty, an object that is held, a seat that is free."""

    need: str  # row of `needs` of the elaborator's program, which has the advice: "hand_empty", "object_held"
    by: str = ""  # object or arm that causes it: what is in the hand, or in the seat
    doubt: str = ""  # key of the fact that would allow it, and is not trusted


class ExactArm(_Cause, frozen=True, tag="exact_arm"):
    """The arm cannot comply with a force, and turns no bolts."""

    arm: str


class AlreadyDone(_Cause, frozen=True, tag="already"):
    """Nothing is left to do with the object but to free the arm."""

    object: str


# --- what is believed ------------------------------------------------------------------------------------


class Distrusted(_Cause, frozen=True, tag="distrusted"):
    fact: str  # its key
    validity: str
    source: str
    version: int


class Changing(_Cause, frozen=True, tag="changing"):
    """An arm is changing the fact (`Refusal.in_the_way`)."""

    fact: str


class TooUncertain(_Cause, frozen=True, tag="spread"):
    """A pose is less certain than a step needs."""

    fact: str


class NoTags(_Cause, frozen=True, tag="no_tags"):
    body: str


class OutOfView(_Cause, frozen=True, tag="out_of_view"):
    body: str


class UnknownName(_Cause, frozen=True, tag="unknown_name"):
    """Nothing of this kind has the name (`Refusal.nearest`, `Refusal.expected`)."""

    what: str  # "place or seat"
    name: str
    of: str = ""  # body whose part is named


class ChangedSince(_Cause, frozen=True, tag="changed_since"):
    """A fact has changed since a test on which the sentence rests."""

    test: str


# --- the cluster -----------------------------------------------------------------------------------------


class WorkersKilled(_Cause, frozen=True, tag="workers_killed"):
    """A job ended each worker that had it."""

    deaths: tuple[str, ...]  # the last output of each


Cause = (
    Collides
    | JointLimitPassed
    | OutOfReach
    | Singular
    | OtherBranch
    | BadCurve
    | OutsideWorkRange
    | OffAttitude
    | NoPosture
    | SpaceTaken
    | TooLong
    | JointTorqueExceeded
    | TooHeavy
    | ForceExceeded
    | GripForceExceeded
    | OpeningExceeded
    | UntilForce
    | UntilTorque
    | InSeat
    | Fastened
    | BeyondStop
    | BeyondThread
    | NeedUnmet
    | ExactArm
    | AlreadyDone
    | Distrusted
    | Changing
    | TooUncertain
    | NoTags
    | OutOfView
    | UnknownName
    | ChangedSince
    | WorkersKilled
)


class Effort(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """What was tried before a refusal; None = not searched in this way."""

    branches_tried: int | None = None  # of the inverse kinematics
    samples: int | None = None  # of the search for a way round
    ways_tried: int | None = None
    candidates: int | None = None  # arms and grasp points
    others: str = ""  # what the other candidates met, for people
