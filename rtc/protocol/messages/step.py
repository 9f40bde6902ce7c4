"""The steps of an elaborated script: what the elaborator writes, the binder performs and the analyzer assesses.

Each kind of step has its own type, with the columns, words and figures that it reads. `do` is its tag. A script that
states anything else for a step is refused when it is loaded (`rtc.programs.step_kinds`).
"""

from __future__ import annotations

from typing import Any, Literal, TypeVar

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


Kind = TypeVar("Kind", bound="BaseStep")


class BaseStep(Strict, frozen=True, kw_only=True, omit_defaults=True, tag_field="do"):
    """One line of a script (Figure 4), of any kind (`Step`). Figures are SI; None: not given."""

    to = stop = space = name = op = until = ""  # of kinds that do not have them
    label: str  # in words, for people: "feel one side of the handle (GP1)"
    who: str = "active_arm"
    arm: str = ""  # that performs it, if it is not that of the command
    expect: list[StopReason] = msgspec.field(
        default_factory=lambda: [StopReason.GOAL]
    )  # the stop reasons that count as success (A13)
    keep: dict[str, str] = {}  # binding to set from the report on success: {"GP1": "report.pose"}
    trims: list[int] = []  # entries of the trimming stack that may correct it, in order (A9)
    effect: str = ""  # of success on the world
    missed: str = ""  # the effect of a failure that may be tried again
    says: str = ""  # the answer that the result of the command states
    rest: str = ""  # the sentence for what is left of a relative one: {left} stands for its amount
    overrides: dict[str, float] = {}  # instead of values of the binder's program or of the cell's numbers, by name
    extra: dict[str, Any] = {}  # the keys x-... of its program, for trimmers, phases and mechanisms of packages

    @property
    def do(self) -> str:
        return str(self.__struct_config__.tag)

    @property
    def leaves_seat(self) -> bool:
        """Whether the held object leaves its seat."""
        return isinstance(self, PathStep) and self.leaves == "seat"

    @property
    def complies(self) -> bool:
        """Whether the step itself states a stiffness."""
        return isinstance(self, ArmStep) and self.stiffness_n_m is not None

    @property
    def presses(self) -> bool:
        """Whether it ends where an obstacle is, and not at its goal."""
        return isinstance(self, ArmStep) and self.press_n is not None

    def of_kind(self, kind: type[Kind]) -> Kind:
        """The step, which is of this kind: a script with another one was refused when it was loaded."""
        assert isinstance(self, kind), self.do
        return self

    def given(self) -> dict[str, float]:
        """Its figures, by name."""
        return {name: value for name in self.__struct_fields__ if isinstance(value := getattr(self, name), float)}


class ArmStep(BaseStep, frozen=True, kw_only=True):
    """A step of an arm or its hand."""

    until: str = ""
    axis: str = ""  # of a displacement, a turn, a press; empty: TOOL-Z
    within_m: float | None = None  # of the goal, for success
    # required accuracy of the held object's pose; or that which a seat demands, by its name
    needs: str = ""
    needs_m: float | None = None
    needs_rad: float | None = None
    # compliance
    stiffness_n_m: float | None = None
    press_n: float | None = None  # force set-point along the axis
    press_from_n: float | None = None  # the set-point at the start
    press_s: float | None = None  # the time in which it changes
    centre_share: float | None = None  # centre of compliance, from the tcp (0) to the load's centre of mass (1)
    spin_m: float | None = None  # stiffness in rotation about the axis = stiffness * this squared


class PathStep(ArmStep, frozen=True, kw_only=True):
    """A step along a path of the arm."""

    to: str  # a binding's name, or HERE
    stop: str
    space: str  # move_joint, move_task ...
    leaves: str = ""  # "seat": the held object leaves its seat
    takes_s: float | None = None
    way: PlannedPath | None = None  # of the first motion of a script


class MoveStep(PathStep, frozen=True, kw_only=True, tag="move"):
    """To a binding, or a displacement and a turn from HERE. A straight one may feel for the object."""

    through: list[str] = []  # poses on the way
    around: str = ""  # "allowed": two arms may leave the straight line where that is not free
    by_m: float = 0.0
    by_rad: float = 0.0
    beyond_m: float = 0.0  # a touch is expected this far before the end
    felt_m: float = 0.0  # accuracy of the touch
    lever_m: float = 0.0  # maximum distance of the touch from the grasp point
    aside_m: float = 0.0  # if nothing was felt, the object is assumed this much farther on, or to the side
    apart_m: float = 0.0  # distance of this touch from the one before, along the bar
    tilt_m: float = 0.0  # accuracy of the difference of the two touches


class CircleStep(PathStep, frozen=True, kw_only=True, tag="circle"):
    """From HERE about the axis through a pose, or about the hinge of what the hand holds."""

    about: str  # a binding's name, or HERE
    by_rad: float
    by_m: float = 0.0  # rise along the axis
    hand_turn: float = 1.0  # share of the turn that the hand makes with it
    from_rad: float | None = None  # the angle of the held hinge that by_rad and turn_rad count from


class PatternStep(PathStep, frozen=True, kw_only=True, tag="pattern"):
    """A search in a plane round HERE: a spiral, or lines back and forth."""

    radius_m: float
    pitch_m: float
    by_m: float = 0.0  # advance along the normal


class SharedStep(PathStep, frozen=True, kw_only=True, tag="share"):
    """A path of the program, on which some axes are the operator's."""

    through: list[str] = []
    place: str = ""  # binding that the hand is brought to


class HoldStep(ArmStep, frozen=True, kw_only=True, tag="hold"):
    """The arm rests."""

    stop: str
    duration_s: float


class TurnStep(ArmStep, frozen=True, kw_only=True, tag="turn"):
    """A turn of the spindle, in turns of the bolt; positive turns are outwards. One of the two figures is given."""

    stop: str
    by_turns: float | None = None
    to_turns: float | None = None  # out of its tight place


class HandStep(ArmStep, frozen=True, kw_only=True):
    """A step that opens or closes a hand: the opening, and the bounds within which it must end."""

    width_m: float | None = None
    least_m: float | None = None
    most_m: float | None = None
    grip_n: float | None = None
    seat: str = ""  # where the object is set down
    pad_m: float = 0.0  # depth of the bar between the pads
    centre_n_m: float = 0.0  # stiffness of the centred hand
    play_m: float = 0.0  # of the object in its seat, whose frame is corrected


class GripStep(HandStep, frozen=True, kw_only=True, tag="grip"):
    op: str  # open, close


class ProcedureStep(HandStep, frozen=True, kw_only=True, tag="proc"):
    name: str  # of a procedure of the binder


class OperateStep(HandStep, frozen=True, kw_only=True, tag="operate"):
    """The operator moves the arm, closes its hand, or turns the spindle of its driver."""

    stop: str
    op: str = ""
    place: str = ""  # binding that the operator is asked to bring the hand to
    operator_has: str = ""  # what the operator has besides the arm: hand, spindle
    by_turns: float | None = None


class LookStep(BaseStep, frozen=True, kw_only=True, tag="look"):
    """Cameras look for a body."""

    stop: str
    cameras: list[str] = []  # the one that reports first
    body: str = ""
    seat: str = ""  # where it should be seen
    pictures: float | None = None
    duration_s: float | None = None  # it follows the body so long
    seen_m: float = 0.0  # accuracy of the cameras and of their places
    seen_rad: float = 0.0
    seated_m: float = 0.0  # within it, an object is in a seat
    play_m: float | None = None  # of the object in its seat; what is mounted on it is located too
    at_rest: float = 0.0  # 1: a body that goes on moving is a failure
    within_m: float = 0.0  # of its place in the seat
    within_rad: float = 0.0


class LetStep(BaseStep, frozen=True, kw_only=True, tag="let"):
    """A binding from other bindings, without motion."""

    name: str
    value: str  # an expression


class TellStep(BaseStep, frozen=True, kw_only=True, tag="tell"):
    """Facts that the sentence states."""


class AnswerStep(BaseStep, frozen=True, kw_only=True, tag="answer"):
    """A question; `says` has the answer."""

    name: str  # of the question


class HandOverStep(BaseStep, frozen=True, kw_only=True, tag="hand_over"):
    """An arm is handed to the operator."""


class InstalledStep(ArmStep, frozen=True, kw_only=True, tag="installed"):
    """A step that the mechanism of an installed package performs; its figures are `overrides`."""

    action: str  # NAME.word
    stop: str


# fmt: off
Step = (
    MoveStep | CircleStep | PatternStep | SharedStep | HoldStep | TurnStep | GripStep | ProcedureStep | OperateStep
    | LookStep | LetStep | TellStep | AnswerStep | HandOverStep | InstalledStep
)
# fmt: on
