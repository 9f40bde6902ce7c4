"""What jobs carry: inputs and products of the four kinds of worker. Opaque to the Decision Unit."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from rtc.protocol.advice import Advice
from rtc.protocol.messages.saved import SavedWorld
from rtc.protocol.messages.shared import Message, PictureTime
from rtc.protocol.messages.step import Step
from rtc.protocol.messages.subsystem import EndReport
from rtc.protocol.messages.world import Fact, WorldChange
from rtc.protocol.outcomes import Compared, Refusal, StopReason
from rtc.protocol.primitive import Primitive
from rtc.protocol.rehearsal import Rehearsal
from rtc.protocol.sentence import Condition, ParsedCommand, ReflexItem, Report
from rtc.protocol.strict import Strict


class Binding(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """A named parameter of a script: joints, a pose (in the axes of the object or seat `frame`, if one is named), or a
    number. Exactly one of `joints`, `pose` and `number` is set."""

    joints: list[float] | None = None  # rad
    pose: list[float] | None = None  # of the tcp
    frame: str | None = None  # the object or seat whose axes the pose is in; None = world
    grasp: list[float] | None = None  # pose of the held object in the hand that this pose was made for
    number: float | None = None
    arm: str = ""  # whose joints or tcp, in a script of two arms in turn; empty: those of the only arm


class Trim(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """One entry of the trimming stack: a corrective piece of script, and what follows it (A16)."""

    n: int
    label: str
    steps: list[Step]
    then: Literal["retry_step", "restart_script", "skip", "replace_rest", "give_up"] = "retry_step"
    fits: list[StopReason] = []  # the failures it may correct; empty = any


class TrimOffer(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """An entry of the trimming stack, as an analyzer chooses it."""

    skill: str  # of its piece of script
    then: str = "retry_step"


class Limits(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """MAINTAIN, as numbers. None = the program's default."""

    speed_m_s: float | None = None
    speed_ratio: float | None = None
    force_n: float | None = None
    torque_nm: float | None = None
    grip_force_n: float | None = None
    time_s: float | None = None
    clearance_m: float | None = None  # AVOID-NEIGHBORS
    keep_out: list[str] = []  # regions
    work_range: str | None = None
    attitude: str | None = None  # POSE-DURING-MOTION
    stiffness_n_m: float | None = None
    shared: str | None = None  # SHARED: the part of the motion that is the operator's


class ScriptContext(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """What every step of a script is bound with. Opaque to the Decision Unit."""

    verb: str
    script: str  # its name: grasp-centering
    arm: str = ""  # active_arm; empty: only a camera works
    partner: str = ""  # the arm that holds the same object and complies; empty: one arm moves
    object: str = ""  # active_object
    grasp_point: str = ""
    target: str = ""
    limits: Limits = Limits()
    guarded: bool = False
    reflexes: list[ReflexItem] = []
    until: Condition | None = None  # of the sentence: it ends the steps with `words: {until: ends}`
    report: Report | None = None  # the REPORT clause
    fits: dict[int, list[StopReason]] = {}  # entry of the trimming stack -> failures it may correct; empty = any
    if_drifting: int = 0  # entry that corrects a grip which weakens, before a step fails of it; 0: none
    offers: dict[int, TrimOffer] = {}  # entry of the trimming stack -> its piece
    by_operator: str = ""  # the sentence that asks the operator for the same; empty: none can
    # Facts stated by the sentence itself, by key, SI.
    stated: dict[str, Any] = msgspec.field(default_factory=dict)


class Script(Message, frozen=True, kw_only=True):
    """Product of an elaborator: what to do, what may go wrong, what it needs (R118)."""

    context: ScriptContext
    case: int  # 1-4 (R68)
    steps: list[Step]
    trims: list[Trim] = []
    bindings: dict[str, Binding] = {}  # decided backwards from the goal (R134)
    resources: list[str] = []  # non-sharable, all or none
    writes: list[str] = []  # locations of the world that analyzers of this command may write
    reads: list[str] = []  # further locations that its plan relies on
    notes: list[str] = []  # log of the planning, for people: generated, tested, modified (R92)


class EvaluationContext(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """What the binder expects of a primitive; the analyzer judges the report by it. Opaque to the
    Decision Unit and never sent to a subsystem."""

    context: ScriptContext
    step: Step
    arm: str = ""
    goal_pose: list[float] | None = None  # of the tcp, predicted at the goal
    held: str = ""  # the object in the hand before the primitive, if any
    predicted_s: float = 0.0
    within_s: float = 0.0  # half the band of `predicted_s`, beyond what the analyzer's program allows every step
    force_n: float = 0.0  # at which F ends the motion as a fault; 0: none does, or a touch is to end it
    squeeze_n: float = 0.0  # finger force at which F ends the motion, by the GRIP-FORCE of the sentence; 0: none
    width_m: list[float] | None = None  # for a grip: [least, most] that count as success
    no_contact_is_failure: bool = False
    remark: str = ""  # on speed and force of the motion, for the result
    start_joints: list[float] | None = None
    body: str = ""  # what a camera looks for
    body_pose: list[float] | None = None  # where it should be, for a check


class ParserInput(Strict, frozen=True, kw_only=True):
    text: str


class RestsOn(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """What a tested sentence rests on: it is refused if that has changed, except by commands of the same test."""

    test: str  # digest
    relies_on: dict[str, int] = {}  # fact -> version; 0: it did not exist
    foreseen: list[str] = []  # facts that commands of the same test must have written last
    given: list[str] = []  # those commands


class ElaboratorInput(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """`saved`: as in `CommandText`."""

    command: str
    parsed: ParsedCommand
    moving: list[Primitive] = []  # of other arms: executing, or ended and not in the world database yet
    owners: dict[str, str] = {}  # of a sentence that states or asks facts: name -> the commands that use it
    rests_on: RestsOn | None = None
    saved: SavedWorld | None = None
    rigid: list[str] = []  # performers that neither comply with a force nor turn bolts


class BinderInput(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """`moving`: as in `ElaboratorInput`. `moved_s`: how long this command has moved, in arm time.

    `others`: other commands are in progress, so another arm may begin to move before this step is sent. `pictures`:
    what pictures of each camera have taken lately."""

    primitive_id: str
    context: ScriptContext
    step: Step
    bindings: dict[str, Binding]
    moving: list[Primitive] = []
    moved_s: float = 0.0
    others: bool = False
    pictures: dict[str, PictureTime] = {}


class AnalyzerInput(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """`closing`: the command is ending, so only the world is updated and advice is ignored (R151)."""

    evaluation: EvaluationContext
    report: EndReport
    trims_used: list[int] = []  # for this step
    closing: bool = False


class Paper(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """The world after a rehearsal: the predicted facts, and what the next sentence may refer to."""

    facts: list[Fact] = []
    at_s: float = 0.0  # predicted time, on the broker's clock
    begun: list[str] = []  # labels of the sentences before, in order: C-5, C-12
    lasting: dict[str, list[str]] = {}  # label of a sentence that lasts until it is stopped -> what it alone may use


class RehearsalInput(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """A TEST sentence. `at_s`: when the broker asks; predicted times count from it. `moving`: as in `ElaboratorInput`;
    the motions count as ended at their goals."""

    command: str
    text: str  # the sentence with its TEST, for repairs
    parsed: ParsedCommand
    label: str = ""  # number of the sentence in its list: C-5
    live: list[str] = []  # those of the commands that it names that are in progress
    at_s: float = 0.0
    moving: list[Primitive] = []
    rigid: list[str] = []  # performers that neither comply with a force nor turn bolts
    pictures: dict[str, PictureTime] = {}  # as in `BinderInput`
    before: Paper | None = None  # the world after the rehearsals before; None: as it is


class Rehearsed(Message, frozen=True, kw_only=True):
    """Product of a rehearsal."""

    rehearsal: Rehearsal
    parsed: ParsedCommand  # without TEST: the record of the sentence that may be given now
    after: Paper  # also of an infeasible sentence, which changes nothing
    refusal: Refusal | None = None  # why the sentence is not feasible
    step: str = ""  # in which step, as in `Outcome.step`; empty: before the first


class BoundStep(Message, frozen=True, kw_only=True):
    """Product of a binder: a primitive with its expected result, or bindings for a step without motion, or `report`.

    `report` has the facts that the operator stated; it goes to an analyzer without a subsystem.
    """

    subsystem: str = ""  # "MCM", "S&P"; empty = nothing to execute
    primitive: Primitive | None = None
    report: EndReport | None = msgspec.field(default=None)
    evaluation: EvaluationContext | None = None
    bindings: dict[str, Binding] = {}
    limit_s: float = 0.0  # time limit of the end report, above the time limit of the primitive itself
    predicted_s: float = 0.0  # planned duration of the primitive
    note: str = ""
    remark: str = ""  # shown with the step: why it is slow, or what it does not keep


class Assessment(Message, frozen=True, kw_only=True):
    """Product of an analyzer (R122): continue, trim or abort; and the changes of the world."""

    verdict: Literal["continue", "trim", "abort"]
    reason: StopReason  # after derivation: NO_CONTACT where goal was reached and a touch expected
    message: str = ""
    trim: int = 0  # entry of the trimming stack to push
    further: list[int] = []  # entries whose steps follow it; what follows then is that of the last one
    keep: dict[str, Binding] = {}  # measured values for later steps
    changes: list[WorldChange] = []
    clears: Advice = []  # what would clear the failure
    by_operator: str = ""  # after a failure: the sentence that asks the operator for the same (R81)
    remark: str = ""  # what the result of the command states after a success of its last step, or after a halt
    compared: Compared | None = None  # prediction and report; None: nothing was predicted
    found: str = ""  # in words: what an expected report says beyond that
    drift: str = ""  # in words: what left its band although the step ended as expected
