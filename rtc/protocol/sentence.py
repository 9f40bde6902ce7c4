"""The record of a sentence: its meaning, independent of wording, as all later phases use it (R117).

Units are SI (m, rad, N, N·m, s, kg); names are upper case with '-'. Two sentences with the same meaning give equal
records; the original words are not kept.
"""

from __future__ import annotations

from typing import Literal

from rtc.protocol.strict import Strict
from rtc.protocol.units import in_words, measured_in_words

Kind = Literal["task", "control", "data", "operator"]


class Quantity(Strict, frozen=True):
    """A number and its SI unit: m, rad, N, N.m, N/m, m/s, rad/s, s, Hz, kg, turn (kept as turns), ratio."""

    value: float
    unit: str


class Destination(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """A destination. Exactly one field is set, except `along`, which belongs to `by`, and `sliding` to `joints`."""

    name: str | None = None  # a named place or object
    joints: list[float] | None = None  # one per joint: rad, or m where the sentence gives a length
    sliding: list[int] = []  # indices of the joints whose value is a length
    position: list[float] | None = None  # m, world frame: x y z
    neighborhood_of: str | None = None  # object whose neighbourhood is the destination (paper, section 5)
    grasp_point_of: str | None = None  # object whose grasp point is the destination
    by: Quantity | None = None  # a relative step ...
    along: str | None = None  # ... along this axis: TOOL-Z, X, UP ...; None = the tool's axis


class Condition(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """An event, or a measured value beyond a bound. Either `event` or (`measure`, `bound`, `quantity`)."""

    event: str | None = None  # CONTACT NO-CONTACT COLLISION SLIP OBJECT-LOST JOINT-LIMIT TIMEOUT NO-PROGRESS
    measure: str | None = None  # FORCE TORQUE GRIP-FORCE DISTANCE CLEARANCE TURN
    along: str | None = None  # axis of the measure; None = magnitude
    bound: Literal["above", "below"] | None = None
    quantity: Quantity | None = None

    @property
    def words(self) -> str:
        """The words of a sentence, without the figure: FORCE ALONG TOOL-Z EXCEEDS."""
        if self.event is not None:
            return self.event
        bound = "EXCEEDS" if self.bound == "above" else "BELOW"
        return " ".join(filter(None, (self.measure, self.along and f"ALONG {self.along}", bound)))

    @property
    def sentence(self) -> str:
        """The same with the figure."""
        return self.words + (f" {in_words(self.quantity.value, self.quantity.unit).upper()}" if self.quantity else "")

    def measured_in_words(self, value: float) -> str:
        """A measured value (SI) in the unit of `sentence`; empty for an event, whose unit the stop reason states."""
        return measured_in_words(value, self.quantity.unit).upper() if self.quantity else ""


class ReflexItem(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """UNLESS condition THEN action [AND TRY script] (A8)."""

    condition: Condition
    action: Literal["stop", "back_off", "comply", "release"]
    by: Quantity | None = None  # how far to back off
    trim: str | None = None  # the script to try after the reflex


class Constraint(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """One MAINTAIN item: the reserved word and its argument, if any."""

    slot: str  # SAFE-WORK-RANGE AVOID-TASK-REGION AVOID-NEIGHBORS POSE-DURING-MOTION SPEED FORCE-LIMIT ...
    name: str | None = None  # region, attitude or shared part
    value: Quantity | None = None


class Report(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """The REPORT clause: contents of the report in addition to the standard ones."""

    items: list[str] = []  # JOINTS, FORCES, POSE, or the name of an installed item
    every_s: float | None = None  # period of event reports
    when: list[Condition] = []  # one report at the first moment of each step in which it is true


#: MAINTAIN SHARED part -> the axes of a twist that are the operator's: 0 to 2 along, 3 to 5 about x, y, z of the tool
SHARED_AXES = {"WRIST": [3, 4, 5], "TRANSLATION": [0, 1, 2], "TOOL-X": [0], "TOOL-Y": [1], "TOOL-Z": [2]}
SHARED = "SHARED"
BOTH_ARMS = "BOTH-ARMS"  # in the place of a hand: every arm
OPERATOR = "OPERATOR"  # in the place of a performer: VIA OPERATOR-INTERVENTION


class ParsedCommand(Strict, frozen=True, kw_only=True, omit_defaults=True, tag="ParsedCommand"):
    """The record of one sentence.

    `verb` is the canonical verb after synonyms (RELEASE for UNGRASP, STOW for PARK, HALT for a lone STOP).
    A hand is always represented by its arm: LEFT-ARM, RIGHT-ARM, BOTH-ARMS or the name of a further arm, so that
    `GRASP RIGHT-END-EFF X` and `GRASP X WITH RIGHT-ARM` are equal. Fields that the verb does not use stay None.
    """

    kind: Kind
    verb: str  # GRASP MOVE ... HALT PAUSE ... SHOW SET ... GIVE DONE ...
    test: bool = False  # TEST before the sentence: hypothesis only, without motion
    assuming: str | None = None  # TEST ... ASSUMING: a stop reason, SLIP or ARM-CONTACT; FAULTS: each one
    hand: str | None = None  # LEFT-ARM | RIGHT-ARM | BOTH-ARMS | name; None = the RTC chooses
    to_hand: str | None = None  # HANDOFF ... TO hand
    object: str | None = None  # the object, mechanism, seat, command or table the verb is about
    grasp_point: str | None = None
    target: str | None = None  # ON / INTO / FROM / TO (ALIGN, CARRY) / AT (VERIFY) / LOAD ... INTO
    place: Destination | None = None  # MOVE ... TO / BY
    path: Literal["straight_line", "joint"] | None = None
    through: list[str] = []
    amount: Quantity | None = None  # BY: relative amount
    to_value: Quantity | None = None  # TO: absolute value (OPEN RIGHT-ARM TO 2 CM)
    until: Condition | None = None
    duration_s: float | None = None  # FOR
    constraints: list[Constraint] = []  # sorted by slot, so that word order does not matter
    guarded: bool = False
    reflexes: list[ReflexItem] = []
    performer: str | None = None  # VIA name, or OPERATOR for VIA OPERATOR-INTERVENTION
    report: Report | None = None
    after: str | None = None  # AFTER C-n
    together_with: str | None = None
    now: bool = False
    attribute: str | None = None  # SET object attribute value
    value: list[float | str] | None = None  # SET ... datum, SI numbers or one name
    value_unit: str | None = None  # SI unit of all numbers, or one per number ("m m m rad rad rad")
    reason: str | None = None  # CANNOT "..."

    @property
    def shared(self) -> str | None:
        """The part of the motion that MAINTAIN SHARED gives to the operator; None: none is named."""
        return next((constraint.name for constraint in self.constraints if constraint.slot == SHARED), None)

    @property
    def conditions(self) -> list[Condition]:
        """Those of UNTIL, UNLESS and REPORT WHEN."""
        until = [] if self.until is None else [self.until]
        return [*until, *(item.condition for item in self.reflexes), *(self.report.when if self.report else [])]
