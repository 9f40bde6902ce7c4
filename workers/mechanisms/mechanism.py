"""What the stages ask of a mechanism of the robot, such as bolts. Each mechanism is a folder beside this file.

elaborate.py states figures, needs, anchors and refusals of scripts; bind.py makes primitives of steps; assess.py says
what a report changes in the world and what is wrong with it; predict.py foretells a report. What a mechanism does not
state is empty. No folder of a mechanism imports another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rtc.model.cells import parts
from rtc.programs.schema import ScriptFile
from rtc.protocol.messages import BoundStep, EndReport, EvaluationContext, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import Primitive
from rtc.spatial.geometry import Array
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask
from workers.tasks.anchor import Anchor
from workers.tasks.bind_task import BindTask
from workers.tasks.candidate import TaskCandidate
from workers.tasks.unmet import UnmetPrecondition

Changes = list[WorldChange]
Need = Callable[[TaskCandidate], UnmetPrecondition | None]
Check = Callable[[ScriptFile, TaskCandidate], None]
Touch = Callable[[WorldQuery, str, EvaluationContext], Callable[[Array], bool] | None]
Report = Callable[[WorldQuery, Primitive, EvaluationContext, StopReason], EndReport]


def _no_figures(_: WorldQuery, __: parts.Object) -> dict[str, float]:
    return {}


def _no_arms(_: WorldQuery, __: parts.Object) -> list[str]:
    return []


def _not_of_it(_: AnalyzeTask) -> str | None:
    return None


def _same_spread(_: AnalyzeTask, spread: list[float]) -> list[float]:
    return spread


def _no_touch(_: WorldQuery, __: str, ___: EvaluationContext) -> None:
    return None


@dataclass(frozen=True, kw_only=True)
class Mechanism:
    """One row of `workers.mechanisms.MECHANISMS`. Names of words are those that scripts and programs use."""

    name: str
    #: elaborate: variables of expressions that an object of the sentence adds
    figures: Callable[[WorldQuery, parts.Object], dict[str, float]] = _no_figures
    #: the arms that are tried for an object when the sentence names none; empty: those that the stage would try
    arms: Callable[[WorldQuery, parts.Object], list[str]] = _no_arms
    needs: Mapping[str, Need] = field(default_factory=dict)
    anchors: Mapping[str, Callable[[TaskCandidate], Anchor]] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    #: bind: kind of action -> what makes its primitive
    actions: Mapping[str, Callable[[BindTask], BoundStep]] = field(default_factory=dict)
    #: assess: effect of a step -> its changes of the world; what is wrong with it (empty: nothing); what a failure says
    effects: Mapping[str, Callable[[AnalyzeTask, Validity], Changes]] = field(default_factory=dict)
    violated: Mapping[str, Callable[[AnalyzeTask], str]] = field(default_factory=dict)
    after_failure: Mapping[str, Callable[[AnalyzeTask, bool], Changes]] = field(default_factory=dict)
    #: placeholder of messages -> its text
    texts: Mapping[str, Callable[[AnalyzeTask], str]] = field(default_factory=dict)
    #: what is left of a relative sentence: the amount, empty for nothing; None: the step is not of this mechanism
    left: Callable[[AnalyzeTask], str | None] = _not_of_it
    #: the spread of a held object after a step
    spread: Callable[[AnalyzeTask, list[float]], list[float]] = _same_spread
    #: attribute of a stated fact -> the facts that follow from it
    follows: Mapping[str, Callable[[str, Any, WorldQuery, Mapping[str, float]], Changes]] = field(default_factory=dict)
    #: predict: for a step that expects a touch, whether it is felt at a pose of the tcp; None: not of this mechanism
    touch: Touch = _no_touch
    reports: Mapping[type, Report] = field(default_factory=dict)
