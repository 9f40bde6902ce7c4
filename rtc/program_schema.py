"""What the programs of the workers may say: the types of their documents, phase by phase.

A program is data. Names in it (a script, a stop class, a resource, a parameter) refer to other rows of the same
program, which `rtc.program` checks when a program is put together, or to registered algorithms, which the worker that
runs the program knows. Units are SI and stand last in the name (`approach_m`). This file knows no skill.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from rtc.outcomes import Reflex, StopReason

Expression = str | float  # see rtc.expressions
Case = Annotated[int, Meta(ge=1, le=4)]
Share = Annotated[float, Meta(ge=0, le=1)]
Positive = Annotated[float, Meta(gt=0)]
Then = Literal["retry_step", "restart_script", "skip", "replace_rest", "give_up"]


class Part(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of all parts of a program: a misspelt field is an error, not a silence."""


# --- elaborator ----------------------------------------------------------------------------------------


class Check(Part, frozen=True, kw_only=True):
    """One condition of the decision tree; all that is set must hold. Paths are fields of the parsed command."""

    given: str = ""  # this field of the command is set: place.joints
    missing: str = ""  # this one is not
    equals: dict[str, str] = {}  # field -> value
    differs: dict[str, str] = {}  # field -> value it has not (a field that is not set differs from everything)
    of: Expression | None = None  # over the parameters: figures of the table, the cell, the hand, the object
    at_least: Expression | None = None
    at_most: Expression | None = None


class Branch(Part, frozen=True, kw_only=True):
    """A verb, what must hold, and the script for it then. All that hold are candidates, the likeliest first (R28)."""

    verb: str
    script: str
    when: list[Check] = []
    likelihood: Share = 1.0
    enabled: bool = True


class TableRow(Part, frozen=True, kw_only=True):
    """A cell of the command-object cross table (R88): figures of a verb for a kind of object, or for one by name."""

    verb: str
    kind: str = ""  # of the object; "" with an empty name: the verb without an object
    name: str = ""
    values: dict[str, float]


class PlanLine(Part, frozen=True, kw_only=True):
    """How one binding is decided, backwards from the goal (R134): where it is measured from, and how far off."""

    name: str
    at: str  # an earlier line, or a registered starting point: grasp_point, destination, here
    along: str = ""  # TOOL-X, TOOL-Y, TOOL-Z, X, Y, Z, UP ...: the axis of the shift
    by: Expression = 0.0  # m, over the parameters
    solve: bool = False  # joint values are wanted; without it a pose
    near: str = ""  # the line whose joints these must continue


class ScriptStep(Part, frozen=True, kw_only=True):
    """One line of a script, as in Figure 4: do, resource, destination, stop class, space, and the pair of trims."""

    do: str
    label: str
    name: str = ""
    who: str = "active_arm"
    to: str = ""
    stop: str = ""
    space: str = ""
    value: str = ""
    op: str = ""
    expect: list[StopReason] = msgspec.field(default_factory=lambda: [StopReason.GOAL])
    keep: dict[str, str] = {}
    trim: tuple[int, int] = (0, 0)  # index, count: which entries of the trimming stack may be used (A9)
    args: dict[str, Expression] = {}  # figures, worked out when the script is elaborated
    words: dict[str, str] = {}  # handed on as they are: an axis, the effect of success


class TrimEntry(Part, frozen=True, kw_only=True):
    """`1 "active_object vision"`: the piece of script that may mend a step, and what follows it (A11, A16)."""

    n: Annotated[int, Meta(ge=1)]
    who: str = "active_object"
    skill: str
    then: Then = "retry_step"
    fits: list[StopReason] = []


class ScriptFile(Part, frozen=True, kw_only=True):
    script: str
    about: str = ""
    case: Case
    uses: list[str] = []  # fields of the command it understands; any other that is set is refused, not ignored
    needs: list[str] = []  # registered conditions of the world: hand_empty, object_held ...
    despite_grasp: bool = (
        False  # it backs off or lets go: what is in doubt (a grasp, a frame) does not forbid it (R151)
    )
    resources: list[str] = msgspec.field(default_factory=lambda: ["active_arm"])
    writes: list[str] = msgspec.field(default_factory=lambda: ["active_arm"])
    plan: list[PlanLine] = []
    steps: Annotated[list[ScriptStep], Meta(min_length=1)]
    trimming_stack: list[TrimEntry] = []


class Piece(Part, frozen=True, kw_only=True):
    """A corrective piece of script, named by the skill that a trimming stack asks for."""

    skill: str
    about: str = ""
    steps: list[ScriptStep]


class Tellable(Part, frozen=True, kw_only=True):
    """An attribute of a thing that a sentence may tell, and how it is said."""

    unit: str = ""  # SI, as in a record; empty = it is a name
    attitude: bool = False  # roll, pitch and yaw (rad) may follow
    of: Annotated[list[str], Meta(min_length=1)]  # what its numbers are, in order: [x, y, z]
    example: str  # "71.5 12 28 CM"


class ActsOn(Part, frozen=True, kw_only=True):
    """The steps that a constraint acts on: all that is set must be so."""

    do: str = ""
    op: str = ""
    about: str  # the same in words


class ElaboratorProgram(Part, frozen=True, kw_only=True):
    decision_tree: list[Branch]
    command_object_table: list[TableRow]
    scripts: list[ScriptFile]
    pieces: list[Piece] = []
    constraints: dict[str, dict[str, str]] = {}  # MAINTAIN slot -> unit (or "name") -> limit
    acts_on: dict[str, ActsOn] = {}  # MAINTAIN slot -> the steps it acts on; any step when it is not here
    not_yet: dict[str, str] = {}  # field of the command -> why it is refused
    instead: dict[str, str] = {}  # verb without a script -> what does the same, or nearly, today
    needs: dict[str, str] = {}  # registered condition of the world -> what would bring it about
    told: dict[str, Tellable] = {}  # attribute of a thing -> how it is told
    told_of_seats: list[str] = []  # of these, what may be told of a seat
    not_told: dict[str, str] = {}  # attribute that is found out, not told -> what finds it out
    clears: dict[str, str] = {}  # attribute of a fact -> what would make it trusted again
    senses: dict[str, str] = {}  # attribute of an arm that is not trusted -> the piece of script that comes first then


# --- binder --------------------------------------------------------------------------------------------


class StopRow(Part, frozen=True, kw_only=True):
    """One row of F: a reason, a predicate of `rtc.primitive` by its tag, and its limit, over the values in force."""

    reason: StopReason
    when: str
    limit: Expression | None = None
    against_motion: bool = False  # a force: only its part that opposes the motion counts
    if_known: bool = False  # leave the row out when a value that its limit names is not set
    reflex: Reflex = Reflex.STOP
    back_off_m: float = 0.0


class StopClass(Part, frozen=True, kw_only=True):
    """What the word of the third column selects: F and, by default, M (A14); and the figures they start from."""

    about: str = ""
    control_law: str = "position"
    touches: bool = False  # a touch of the active object is its purpose: what it touched may have moved
    away: bool = False  # from what was touched: a thing whose place is in doubt does not forbid it
    seated: bool = False  # what the hand holds may be in a seat, or come into one
    stops: list[StopRow]
    values: dict[str, Expression] = {}  # speed_m_s, force_n, contact_n ..., over the figures of the cell


class BinderProgram(Part, frozen=True, kw_only=True):
    actions: dict[str, str]  # what a step does -> registered algorithm
    stop_classes: dict[str, StopClass]
    hand: dict[str, str]  # what a hand does: open, close -> its stop class
    procedures: dict[str, str] = {}  # name in a script -> registered procedure
    computes: list[str] = []  # the registered ones, actions and procedures, that move nothing
    holding: list[StopRow] = []  # added to F while something is held
    guarded: dict[str, dict[str, float]] = {}  # verb -> the figures of its GUARDED set (A6); "" = any other
    values: dict[str, Expression] = {}  # of every primitive, over the figures of the cell
    clears: dict[str, str] = {}  # attribute of a fact -> what would make it trusted again


# --- analyzer ------------------------------------------------------------------------------------------


class OutcomeClass(Part, frozen=True, kw_only=True):
    """What a failure means: its words, what cannot be trusted after it, and what would clear that. In the words may
    stand {reason} {measured} {limit} {unit} {message} {arm} {object} {point} {target}."""

    message: str
    # object: the frame of the one it is about; if_touched: the same, if it may have been moved; held: of what is held
    suspect: list[Literal["object", "if_touched", "held"]] = []
    drops: bool = False  # nothing is in the hand any more
    misplaced: bool = False  # what is held is elsewhere than believed: feeling it proves nothing, it must be looked at
    clears: str = ""  # first; then what makes those trusted again that have become suspect (`clears` of the program)
    again: str = ""  # and what to do after that
    retriable: bool = True  # a trim may be looked up


class AnalyzerProgram(Part, frozen=True, kw_only=True):
    outcomes: dict[str, dict[StopReason, str]]  # stop class, or what the step does -> stop reason -> failure class
    derived: dict[str, dict[str, StopReason]] = {}  # the same -> what is wrong with a good end -> what it is told as
    classes: dict[str, OutcomeClass]
    values: dict[str, float] = {}  # tolerances: position_m, angle_rad, width_m
    clears: dict[str, str] = {}  # attribute of a fact -> what would make it trusted again


Program = ElaboratorProgram | BinderProgram | AnalyzerProgram
