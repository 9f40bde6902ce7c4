"""What the stages ask of a mechanism of the robot, such as bolts. Each mechanism is a folder beside this file.

elaborate.py states figures, needs, anchors and refusals of scripts; bind.py makes primitives of steps; assess.py says
what a report changes in the world and what is wrong with it; predict.py foretells a report; advice.py says how a
blocked way is cleared, and what to do after a failure. What a mechanism does not state is empty. No folder of a
mechanism imports another.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from msgspec import Struct

from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptFile, ScriptStep
from rtc.protocol.advice import Advice, Texts
from rtc.protocol.messages import BaseStep, BoundStep, EndReport, EvaluationContext, Script, Step, Validity, WorldChange
from rtc.protocol.outcomes import Refusal, StopReason
from rtc.protocol.primitive import Primitive
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask, Changes
from workers.tasks.anchor import Anchor
from workers.tasks.bind_task import BindTask
from workers.tasks.candidate import AskedTask, TaskCandidate
from workers.tasks.data_sentence import DataSentence
from workers.tasks.report import Course
from workers.tasks.unmet import UnmetPrecondition

Thing = parts.Object | parts.Seat
Need = Callable[[TaskCandidate], UnmetPrecondition | None]
Needs = Mapping[str, Need]
Partner = tuple[parts.Arm | None, parts.Place | None]
Instead = Callable[[ElaboratorProgram, Mapping[str, ScriptFile], TaskCandidate, Needs], str]
Check = Callable[[ScriptFile, TaskCandidate], None]
Stated = Callable[[ElaboratorProgram, list[Any], Thing, WorldQuery], dict[str, Any]]
#: changes of stated facts, the world before and after them, figures -> (key, what cannot be)
Contradiction = Callable[
    [Sequence[WorldChange], WorldQuery, WorldQuery, Mapping[str, float]], Iterable[tuple[str, str]]
]
About = Callable[[WorldQuery, str], Texts]  # texts about a body
Felt = Callable[[WorldQuery, EvaluationContext, EndReport], EndReport]
Report = Callable[[WorldQuery, Primitive, EvaluationContext, StopReason], EndReport]


@dataclass(frozen=True, kw_only=True)
class Mechanism:
    """One row of `workers.mechanisms.MECHANISMS`. Names of words are those that scripts and programs use."""

    name: str
    #: elaborate: variables of expressions that a candidate adds
    figures: Callable[[TaskCandidate], dict[str, float]] | None = None
    #: the arms that are tried when the sentence names no single one; empty: those that the stage would try
    arms: Callable[[AskedTask], list[str]] | None = None
    #: the second arms for such an arm, and where they take the object; those of its grasp points that are of use
    partners: Callable[[AskedTask, parts.Arm], Iterable[Partner]] | None = None
    points: Callable[[AskedTask, list[parts.GraspPoint]], list[parts.GraspPoint]] | None = None
    #: role in the resources of a script -> the candidates of a script in which this performs, and no arm
    candidates: Mapping[str, Callable[[AskedTask], list[TaskCandidate]]] = field(default_factory=dict)
    #: performer of a step (`who`) -> the names that perform it for a body; the first one reports
    performers: Mapping[str, Callable[[ScriptStep, TaskCandidate, str], list[str]]] = field(default_factory=dict)
    #: the sentence that asks someone else for what no script has achieved; empty: none
    instead: Instead | None = None
    needs: Needs = field(default_factory=dict)
    anchors: Mapping[str, Callable[[TaskCandidate], Anchor]] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    #: that what a script does is so before it begins, and the row of `needs` with what is left to do; None: it is not
    done: Callable[[ScriptFile, TaskCandidate], tuple[str, str] | None] | None = None
    #: the steps of a script, with what their results say beside
    noted: Callable[[list[Step], TaskCandidate], list[Step]] | None = None
    #: what makes the script of stated facts; attribute of a SET sentence -> the facts that it states
    states: Callable[[DataSentence, Mapping[str, Stated]], Script] | None = None
    stated: Mapping[str, Stated] = field(default_factory=dict)
    #: whether steps of a trim would harm what the candidate is about
    strains: Callable[[Sequence[ScriptStep], TaskCandidate], bool] | None = None
    #: effect of a step -> what it changes for the steps and sentences after it
    foreseen: Mapping[str, Callable[[TaskCandidate, WorldQuery], Changes]] = field(default_factory=dict)
    #: bind: kind of step -> what makes its primitive; of a package its own `do`, and the figures that such a step reads
    actions: Mapping[type[BaseStep] | str, Callable[[BindTask], BoundStep]] = field(default_factory=dict)
    reads: Mapping[str, Collection[str]] = field(default_factory=dict)
    #: procedure of a step (`proc`) -> what performs it
    procedures: Mapping[str, Callable[[BindTask], BoundStep]] = field(default_factory=dict)
    #: assess: effect of a step -> its changes of the world; what is wrong with it (empty: nothing); what a failure says
    effects: Mapping[str, Callable[[AnalyzeTask, Validity], Changes]] = field(default_factory=dict)
    violated: Mapping[str, Callable[[AnalyzeTask], str]] = field(default_factory=dict)
    #: the same of a step that was stopped, before what follows for what the hand holds
    interrupted: Mapping[str, Callable[[AnalyzeTask], Changes]] = field(default_factory=dict)
    after_failure: Mapping[str, Callable[[AnalyzeTask, bool], Changes]] = field(default_factory=dict)
    #: effect of a step that has succeeded -> (what was found, what the outcome of the command states)
    found: Mapping[str, Callable[[AnalyzeTask], tuple[str, str]]] = field(default_factory=dict)
    #: placeholder of messages -> its text; empty: the common one
    texts: Mapping[str, Callable[[AnalyzeTask], str]] = field(default_factory=dict)
    #: stop reason -> what clears it, where its class of failures does not help; placeholder of advice -> its sentences
    cures: Mapping[StopReason, Callable[[AnalyzeTask, About], Advice]] = field(default_factory=dict)
    advice: Mapping[str, Callable[[AnalyzeTask], Advice | list[str]]] = field(default_factory=dict)
    #: what is left of a relative sentence: the amount, empty for nothing; None: the step is not of this mechanism
    left: Callable[[AnalyzeTask], str | None] | None = None
    #: whether a step has ended where it should, although the hand is elsewhere
    has_reached: Callable[[AnalyzeTask], bool] | None = None
    #: the spread of a held object after a step, from that of an object that is free but for the hand
    spread: Callable[[AnalyzeTask, list[float]], list[float]] | None = None
    #: the same of an object that the mechanism keeps in its place, after these changes; None: it keeps no such object
    spread_in_place: Callable[[AnalyzeTask, Changes], list[float] | None] | None = None
    #: changes of a report -> those that follow from them
    derived: Callable[[WorldQuery, Changes], Changes] | None = None
    #: attribute of a stated fact -> why it is not plausible (empty: it is); the facts that follow from it (or Refused)
    plausible: Mapping[str, Callable[[str, Any, Mapping[str, float]], str]] = field(default_factory=dict)
    follows: Mapping[str, Callable[[str, Any, WorldQuery, Mapping[str, float]], Changes]] = field(default_factory=dict)
    #: what stated facts cannot be together
    contradictions: tuple[Contradiction, ...] = ()
    #: attributes with a meaning for an object; why a stated fact of it cannot be (empty: it can)
    attributes: Callable[[parts.Object], Collection[str]] | None = None
    impossible: Callable[[WorldChange, parts.Object, WorldQuery], str] | None = None
    #: predict: when the touch that a step expects is felt on its way (s); None: not of this mechanism
    touch_s: Callable[[WorldQuery, str, EvaluationContext, Course], float | None] | None = None
    #: when a path reaches its goal before its end (s); None: it does not
    reached_s: Callable[[WorldQuery, Primitive], float | None] | None = None
    reports: Mapping[type, Report] = field(default_factory=dict)
    #: effect of a step -> its predicted report, with the forces that an arm feels on its way
    feels: Mapping[str, Felt] = field(default_factory=dict)
    #: advice: row of `clears` for a motion of this arm that a body blocks (empty: not of it); texts about a body
    way: Callable[[Refusal, WorldQuery, str, str], str] | None = None
    about: About | None = None
    #: of a package: the form of its piece of the cell file, `mechanisms: {NAME: ...}` (see `CellModel.piece`)
    piece: type[Struct] | None = None
