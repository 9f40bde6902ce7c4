"""The schemas of worker programs: the types of their documents, for elaborator, binder and analyzer.

A program is data. A name in it (script, stop class, resource, parameter) refers to another row of the same program. Or
it refers to an algorithm that the worker registers (`rtc.programs.extension_names`). `rtc.programs.loader` checks both.
Units are SI and stand last in the name (`approach_m`). This module knows no skill.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from rtc.protocol.advice import Advice
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.protocol.sentence import OPERATOR

Expression = str | float  # see rtc.programs.expressions
Case = Annotated[int, Meta(ge=1, le=4)]
Share = Annotated[float, Meta(ge=0, le=1)]
Then = Literal["retry_step", "restart_script", "skip", "replace_rest", "give_up"]


class ProgramPart(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of all parts of a program: an unknown field is an error."""


OWN = "own"  # rtc's own algorithm, among those that a program names
Named = Annotated[list[str], Meta(min_length=1)]  # algorithms, see `rtc.programs.named_algorithms`


class Algorithms(ProgramPart, frozen=True, kw_only=True):
    """Who plans the motions of a job, in this order: the first that finds a result is followed (R103, R104)."""

    planners: Named = msgspec.field(default_factory=lambda: [OWN])  # of free ways to joint values
    ik: Named = msgspec.field(default_factory=lambda: [OWN])  # of postures for a pose
    timing: Named = msgspec.field(default_factory=lambda: [OWN])  # of a path


OWN_ALONE = Algorithms()


# --- elaborator ----------------------------------------------------------------------------------------


class BranchCondition(ProgramPart, frozen=True, kw_only=True):
    """One condition of the decision tree: all fields that are set must hold. Paths are fields of ParsedCommand."""

    given: str = ""  # this field of the command must be set: place.joints
    missing: str = ""  # this field must not be set
    equals: dict[str, str] = {}  # field -> value
    differs: dict[str, str] = {}  # field -> value that it must not have; an unset field differs from every value
    of: Expression | None = None  # compared with at_least and at_most; over all parameters
    at_least: Expression | None = None
    at_most: Expression | None = None


class Branch(ProgramPart, frozen=True, kw_only=True, dict=True):
    """A verb, its conditions and its script. All branches that hold are candidates, the likeliest first (R28)."""

    verb: str
    script: str
    when: list[BranchCondition] = []
    likelihood: Share = 1.0
    enabled: bool = True
    extra: dict[str, Any] = {}  # the keys x-..., for evaluators of installed packages (rtc.programs.plugin_fields)

    @cached_property
    def by_operator(self) -> bool:
        """Whether the operator performs the script: VIA OPERATOR-INTERVENTION."""
        return any(check.equals.get("performer") == OPERATOR for check in self.when)


class TableRow(ProgramPart, frozen=True, kw_only=True):
    """A cell of the command-object table (R88): parameters of a verb for a kind of object or one named object."""

    verb: str
    kind: str = ""  # of the object; empty together with `name`: the verb without an object
    name: str = ""
    values: dict[str, Expression]  # over the numbers of the cell and the attributes of the object


class PlanLine(ProgramPart, frozen=True, kw_only=True):
    """How one binding is computed, backwards from the goal (R134): an anchor and an offset from it."""

    name: str
    at: str  # an earlier line, or a registered anchor: grasp_point, destination, stow, seat
    along: str = ""  # axis of the offset: TOOL-X, TOOL-Y, TOOL-Z, X, Y, Z, UP ...
    by: Expression = 0.0  # m, over the parameters
    turn_rad: Expression = 0.0  # turned about the same axis, on the spot
    solve: bool = False  # True: compute joint values; False: a pose is enough
    near: str = ""  # line whose joint values the IK solution must be nearest to


class ScriptStep(ProgramPart, frozen=True, kw_only=True):
    """One line of a script, as in Figure 4: do, resource, destination, stop class, space, and the pair of trims."""

    do: str  # an action of the binder; or piece: the steps of the piece `name` (rtc.programs.splice)
    label: str = ""  # required, except for a piece
    name: str = ""
    who: str = "active_arm"
    to: str = ""
    stop: str = ""
    space: str = ""
    value: str = ""
    op: str = ""
    expect: list[StopReason] = msgspec.field(default_factory=lambda: [StopReason.GOAL])
    keep: dict[str, str] = {}
    trim: tuple[int, int] = (0, 0)  # (index, count): the usable entries of the trimming stack (A9)
    args: dict[str, Expression] = {}  # parameters, evaluated when the script is elaborated
    words: dict[str, str] = {}  # passed on unchanged: an axis, the effect of success
    extra: dict[str, Any] = {}  # the keys x-..., for trimmers, phases and mechanisms of installed packages


class ReserveEntry(ProgramPart, frozen=True, kw_only=True):
    """A corrective piece that no script lists: rules or a search of the analyzer may choose it for a skill."""

    who: str = "active_object"
    skill: str
    then: Literal["retry_step", "restart_script", "skip", "replace_rest"] = "retry_step"
    fits: list[StopReason] = []


class TrimEntry(ProgramPart, frozen=True, kw_only=True):
    """`1 "active_object vision"`: a corrective piece of script, and how to go on after it (A11, A16)."""

    n: Annotated[int, Meta(ge=1)]
    who: str = "active_object"
    skill: str
    then: Then = "retry_step"
    fits: list[StopReason] = []
    drift: bool = False  # it corrects a grip that weakens, after a step that has succeeded; never a failure


class ScriptFile(ProgramPart, frozen=True, kw_only=True):
    script: str
    about: str = ""
    case: Case
    uses: list[str] = []  # fields of the command that it uses; a command with any other field is refused
    needs: list[str] = []  # registered conditions of the world: hand_empty, object_held ...
    unsure_if: BranchCondition | None = None  # then a camera looks for the object first; refused if none can see it
    despite_grasp: bool = False  # allowed with a suspect grasp or frame: it backs off or releases (R151)
    resources: list[str] = msgspec.field(default_factory=lambda: ["active_arm"])
    writes: list[str] = msgspec.field(default_factory=lambda: ["active_arm"])
    plan: list[PlanLine] = []
    steps: Annotated[list[ScriptStep], Meta(min_length=1)]
    trimming_stack: list[TrimEntry] = []


class ScriptPiece(ProgramPart, frozen=True, kw_only=True):
    """A corrective piece of script, named by the skill that trimming stacks refer to."""

    skill: str
    about: str = ""
    steps: list[ScriptStep]


class SettableAttribute(ProgramPart, frozen=True, kw_only=True):
    """An attribute that SET may change, and the form of its value."""

    unit: str = ""  # SI unit, as in a record; 1: a number without a unit; empty: the value is a name
    attitude: bool = False  # roll, pitch and yaw (rad) may follow
    of: Annotated[list[str], Meta(min_length=1)]  # names of its numbers, in order: [x, y, z]
    example: str  # "71.5 12 28 CM"


class ActsOn(ProgramPart, frozen=True, kw_only=True):
    """The steps that a constraint acts on: all fields that are set must match."""

    do: str | list[str] = ""  # one of these
    op: str = ""
    about: str  # the same as text


class ElaboratorProgram(Algorithms, frozen=True, kw_only=True, dict=True):
    decision_tree: list[Branch]
    command_object_table: list[TableRow]
    scripts: list[ScriptFile]
    pieces: list[ScriptPiece] = []
    reserve: list[ReserveEntry] = []
    by_hand: dict[str, str] = {}  # figure of the table -> figure of the hand that it cannot exceed
    constraints: dict[str, dict[str, str]] = {}  # MAINTAIN slot -> unit (or "name") -> limit
    acts_on: dict[str, ActsOn] = {}  # MAINTAIN slot -> the steps it acts on; without an entry, all steps
    ranges: dict[str, tuple[float, float]] = {}  # MAINTAIN slot -> least and greatest value, SI
    not_yet: dict[str, str] = {}  # field of the command -> reason for its refusal
    frees: list[str] = []  # sentences that free an arm, the first choice first; {arm}, {held} by it, {place}
    repairs: list[str] = []  # sentences that a TEST tries before a refused one; see workers/rehearsal/repairs.py
    instead: dict[str, str] = {}  # verb without a script -> a command with the same or a similar effect
    cannot: dict[str, str] = {}  # verb that no script can perform -> the reason
    grasp_planners: Named = msgspec.field(default_factory=lambda: [OWN])  # whose grasp points are tried, in this order
    fillers: list[str] = []  # of installed packages: asked for a row that the command-object table lacks
    evaluators: list[str] = []  # of installed packages: the option with the lowest sum of their scores comes first
    phases: list[str] = []  # of installed packages, in this order; each product passes through them
    needs: dict[str, Advice] = {}  # registered condition of the world -> what makes it true
    settable: dict[str, SettableAttribute] = {}  # attribute that SET may change -> form of its value
    settable_of_seats: list[str] = []  # those of `settable` that SET may change for a seat
    not_settable: dict[str, Advice] = {}  # attribute that SET may not change -> the command that measures it
    clears: dict[str, Advice] = {}  # attribute of a fact -> what makes it valid again
    senses: dict[str, str] = {}  # suspect attribute of an arm -> piece of script that runs first

    @cached_property
    def branches(self) -> dict[str, list[Branch]]:
        """The rows of the decision tree by verb."""
        return _by_verb(self.decision_tree)

    @cached_property
    def table_rows(self) -> dict[str, list[TableRow]]:
        """The rows of the command-object table by verb."""
        return _by_verb(self.command_object_table)


Row = TypeVar("Row", Branch, TableRow)


def _by_verb(rows: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row.verb, []).append(row)
    return found


# --- binder --------------------------------------------------------------------------------------------


class StopRow(ProgramPart, frozen=True, kw_only=True):
    """One row of F: a stop reason, the tag of a predicate of `rtc.protocol.primitive`, and its limit over the current
    values."""

    reason: StopReason
    when: str
    limit: Expression | None = None
    against_motion: bool = False  # of a force, use only the component against the motion
    reflex: Reflex = Reflex.STOP
    back_off_m: float = 0.0


class StopClass(ProgramPart, frozen=True, kw_only=True):
    """A stop class, the third column of a script: F, the default M (A14) and their parameters."""

    about: str = ""
    control_law: str = "position"
    touches: bool = False  # its purpose is contact with the active object, which may have moved then
    away: bool = False  # it moves away from contact: an object with a suspect frame does not forbid it
    seated: bool = False  # the held object may be in a seat or move into one
    rigid: bool = False  # it searches by touch, which a soft arm would not feel: STIFFNESS does not apply to it
    stops: list[StopRow]
    values: dict[str, Expression] = {}  # speed_m_s, force_n, contact_n ..., over the numbers of the cell


class BinderProgram(Algorithms, frozen=True, kw_only=True):
    stop_classes: dict[str, StopClass]
    hand: dict[str, str]  # `op` of a hand (open, close) -> stop class
    procedures: dict[str, str] = {}  # name in a script -> registered procedure
    computes: list[str] = []  # steps (`do`) and registered procedures without motion
    holding: list[StopRow] = []  # rows added to F while an object is held
    guarded: dict[str, dict[str, float]] = {}  # verb -> parameters of its GUARDED reflexes (A6); "" = any other verb
    values: dict[str, Expression] = {}  # defaults of every primitive, over the numbers of the cell
    clears: dict[str, Advice] = {}  # attribute of a fact -> what makes it valid again
    phases: list[str] = []  # of installed packages, in this order; each product passes through them


# --- analyzer ------------------------------------------------------------------------------------------


class OutcomeClass(ProgramPart, frozen=True, kw_only=True):
    """A failure class: its message, the facts that become suspect, and how to clear them.

    Texts may contain placeholders: {reason} {measured} {limit} {unit} {message} {arm} {object} {point} {target};
    in `pressing` also {away} and {leave}, in `clears` {leave}.
    """

    message: str
    # object: frame of the active object; if_touched: the same, if it may have moved; held: frame of the held object;
    # near: frames of all objects near the arm; target: frame of the seat that the object should enter
    suspect: list[Literal["object", "if_touched", "held", "near", "target"]] = []
    drops: bool = False  # the hand is empty afterwards
    misplaced: bool = False  # the held object is not where the world has it; only vision can locate it
    # first hint for an arm that pressed on something when it was stopped; the hint for what it holds precedes it
    pressing: Advice = []
    clears: Advice = []  # next hint; the hints of `clears` of the program for each suspect fact follow
    again: Advice = []  # last hint: what to do after that
    retriable: bool = True  # a trim may be tried


class Bounds(ProgramPart, frozen=True, kw_only=True):
    """A condition on a figure of the failed step (`extension_names.FAILURE_FIGURES`) or of `values`."""

    of: Expression
    at_least: Expression | None = None
    at_most: Expression | None = None


class TrimRule(ProgramPart, frozen=True, kw_only=True):
    """A rule of an expert: for these failures, this piece of script (R86). An empty list stands for all."""

    steps: list[str] = []  # rows of `outcomes`
    reasons: list[StopReason] = []
    classes: list[str] = []
    when: list[Bounds] = []
    trim: str  # the skill of an entry of the trimming stack or of `reserve`


class SearchPiece(ProgramPart, frozen=True, kw_only=True):
    """What a piece of script does to the conditions of the world, for the search of a recovery."""

    needs: list[str] = []  # conditions that must not be broken
    makes: list[str] = []
    breaks: list[str] = []


class SearchModel(ProgramPart, frozen=True, kw_only=True):
    """The finite graph in which a recovery is searched: events break conditions, pieces of script make them (R59)."""

    most: Annotated[int, Meta(ge=1, le=6)] = 3  # maximum number of pieces in a recovery
    breaks: dict[StopReason, list[str]]  # a reason without a row has no recovery
    pieces: dict[str, SearchPiece]  # by skill


class AnalyzerProgram(ProgramPart, frozen=True, kw_only=True):
    outcomes: dict[str, dict[StopReason, str]]  # row (see compatibility.row_of) -> stop reason -> failure class
    derived: dict[str, dict[str, StopReason]] = {}  # row -> defect of a nominal end -> stop reason that it counts as
    classes: dict[str, OutcomeClass]
    trimmers: Named = msgspec.field(default_factory=lambda: ["stack"])
    """Who chooses a trim, in this order: `stack`, `rules`, `search`, or the name of an installed package."""
    rules: list[TrimRule] = []
    search: SearchModel | None = None
    unmet: str = ""  # class of a step that has reached its end before the condition of UNTIL was true
    squeezed: str = ""  # class of a step that fingers have ended which press more than the GRIP-FORCE of the sentence
    values: dict[str, float] = {}  # tolerances: position_m, angle_rad, width_m
    clears: dict[str, Advice] = {}  # attribute of a fact -> what makes it valid again
    phases: list[str] = []  # of installed packages, in this order; each product passes through them


Program = ElaboratorProgram | BinderProgram | AnalyzerProgram
