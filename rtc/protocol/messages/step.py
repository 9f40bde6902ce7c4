"""A step of an elaborated script: what the elaborator writes, the binder performs and the analyzer assesses."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from rtc.protocol.outcomes import StopReason
from rtc.protocol.strict import Strict


class PlannedPath(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """A way of an arm that an elaborator has found free. A binder may use it if its own planning request has the same
    digest; otherwise it tests the way again or plans anew (`workers.planning.motion.path_reuse`)."""

    request_digest: bytes  # digest of the planning request: joints of all arms, goal, scene, rules
    space: Literal["joint", "task"]
    s: list[float]  # parameter of each knot; rises from 0
    knots: list[list[float]]  # rad
    radii: list[float] = []  # of the rounded corners at the inner knots, in the unit of s
    notes: list[str] = []  # how it was found


class StepWords(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """Words of a step, of the columns `words` of a script."""

    axis: str = ""  # of a displacement, a turn, a press; empty: TOOL-Z
    about: str = "HERE"  # what a move_circle turns about
    through: list[str] = []  # poses on the way to the target
    around: str = ""  # "allowed": two arms may leave the straight line where that is not free
    effect: str = ""  # of success on the world
    missed: str = ""  # the effect of a failure that may be tried again
    leaves: str = ""  # "seat": the held object leaves its seat
    seat: str = ""  # where the object is set down, or should be seen
    rest: str = ""  # the sentence for what is left of a relative one: {left} stands for its amount
    says: str = ""  # the answer that the result of the command states
    until: str = ""  # "ends": the condition of UNTIL ends it; "watched": it may
    place: str = ""  # binding that the operator is asked to bring the hand to
    operator_has: str = ""  # what the operator has besides the arm: hand, spindle
    needs: str = ""  # a seat whose bounds the pose of the held object must keep


class StepFigures(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """Numbers of a step, of the column `args` of a script; None: not given."""

    # shape of a path, see `rtc.programs.extension_names.SPACE_ARGS`
    by_m: float | None = None
    by_rad: float | None = None
    hand_turn: float | None = None
    from_rad: float | None = None  # the angle of the held hinge that by_rad and turn_rad count from
    radius_m: float | None = None
    pitch_m: float | None = None
    # turn of a spindle, in turns of the bolt; positive turns are outwards
    by_turns: float | None = None
    to_turns: float | None = None  # out of its tight place
    # duration of a motion, of a hold or of a look
    takes_s: float | None = None
    duration_s: float | None = None
    # hand: opening, and the bounds within which it must end
    width_m: float | None = None
    least_m: float | None = None
    most_m: float | None = None
    grip_n: float | None = None
    # limits
    within_m: float | None = None
    speed_m_s: float | None = None
    force_n: float | None = None
    contact_n: float | None = None
    torque_nm: float | None = None
    # centring touches
    beyond_m: float | None = None
    felt_m: float | None = None
    lever_m: float | None = None
    aside_m: float | None = None
    pad_m: float | None = None
    centre_n_m: float | None = None
    play_m: float | None = None
    apart_m: float | None = None
    tilt_m: float | None = None
    # compliance
    stiffness_n_m: float | None = None
    press_n: float | None = None  # force set-point along the axis
    centre_share: float | None = None  # centre of compliance, from the tcp (0) to the load's centre of mass (1)
    spin_m: float | None = None  # stiffness in rotation about the axis = stiffness * this squared
    press_from_n: float | None = None  # the set-point at the start
    press_s: float | None = None  # the time in which it changes
    # required accuracy of the held object's pose
    needs_m: float | None = None
    needs_rad: float | None = None
    # a look
    within_rad: float | None = None
    pictures: float | None = None
    seen_m: float | None = None
    seen_rad: float | None = None
    seated_m: float | None = None
    at_rest: float | None = None

    @property
    def turns_spindle(self) -> bool:
        return self.by_turns is not None or self.to_turns is not None

    def given(self) -> dict[str, float]:
        """Those that are given, by name."""
        return {name: value for name in self.__struct_fields__ if (value := getattr(self, name)) is not None}


class Step(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """One line of a script (Figure 4): do, resource, destination, stop class, interpolation space, trims."""

    do: str  # "proc", "move", "let", "grip", "hold": a row of the binder's program
    label: str  # in words, for people: "feel one side of the handle (GP1)"
    name: str = ""  # of the procedure, or of the value that is set
    who: str = "active_arm"
    to: str = ""  # a binding's name
    stop: str = ""  # stop class: move_free, move_to_contact ...
    space: str = ""  # move_joint, move_task
    value: str = ""  # of a "let": an expression over bindings
    op: str = ""  # of a "grip": open, close
    expect: list[StopReason] = msgspec.field(
        default_factory=lambda: [StopReason.GOAL]
    )  # the stop reasons that count as success (A13)
    keep: dict[str, str] = {}  # binding to set from the report on success: {"GP1": "report.pose"}
    trims: list[int] = []  # entries of the trimming stack that may correct it, in order (A9)
    words: StepWords = StepWords()
    figures: StepFigures = StepFigures()
    overrides: dict[str, float] = {}  # instead of values of the binder's program or of the cell's numbers, by name
    arm: str = ""  # that performs it, if it is not that of the command
    extra: dict[str, Any] = {}  # the keys x-... of its program, for trimmers, phases and mechanisms of packages
    cameras: list[str] = []  # those that look, the one that reports first
    body: str = ""  # what they look for
    way: PlannedPath | None = None  # of the first motion of a script
