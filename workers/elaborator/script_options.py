"""Options of a command: pairs of a branch of the decision tree and a candidate whose conditions hold. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from rtc.plugins import registry
from rtc.programs import attributes, expressions
from rtc.programs.named_algorithms import acted
from rtc.programs.schema import OWN, Branch, BranchCondition, ScriptFile
from rtc.protocol.outcomes import Refusal
from workers.elaborator import no_script
from workers.tasks import command_fields, object_attributes
from workers.tasks.candidate import TaskCandidate


class ScriptOption(NamedTuple):
    branch: Branch
    candidate: TaskCandidate

    @property
    def name(self) -> str:
        point = self.candidate.point.name if self.candidate.point else ""
        return " ".join(filter(None, (self.branch.script, *self.candidate.roles.values(), point)))

    @property
    def notes(self) -> tuple[str, ...]:
        """Whose grasp point it is, if the program leaves a choice; and which package has computed its figures."""
        point, named = self.candidate.point, self.candidate.program.grasp_planners
        planner = acted(registry.GRASP_PLANNERS, point.planner or OWN, named) if point else ()
        filler = self.candidate.filler
        return (*planner, *(acted(registry.FILLERS, filler, ()) if filler else ()))


def ranked(
    branches: list[Branch], candidates: list[TaskCandidate], scripts: Mapping[str, ScriptFile], unstated: list[Refusal]
) -> list[ScriptOption]:
    """All pairs of branch and candidate whose conditions hold: the likeliest first, then the nearest.

    A condition on an attribute that the object lacks does not hold; its refusal is added to `unstated`."""
    options = []
    for branch in branches:
        by_camera = only_looks(scripts[branch.script])
        for candidate in (one for one in candidates if (one.hand is None) == by_camera):
            try:
                if (lacks := _unstated(branch, candidate)) is not None:
                    unstated += [lacks] if lacks not in unstated else []
                elif all(holds(check, candidate) for check in branch.when):
                    options.append(ScriptOption(branch, candidate))
            except expressions.ExpressionError as error:
                message = f"the decision tree for {branch.verb} ({branch.script}): {error}"
                clears = "LOAD a row of command_object_table that has that figure"
                raise no_script.wrong_program(message, "decision_tree", clears) from error
    return sorted(options, key=lambda one: (_score(one), -one.branch.likelihood))


def _score(option: ScriptOption) -> float:
    """The sum of the evaluators of the program; the lowest one comes first. Raises PluginError."""
    total = 0.0
    for name in option.candidate.program.evaluators:
        with registry.guarded(registry.EVALUATORS, name):
            one = float(registry.installed(registry.EVALUATORS)[name](option))
            if not math.isfinite(one):
                raise ValueError(f"its score of {option.name} is {one}")
        total += one
    return total


def _unstated(branch: Branch, candidate: TaskCandidate) -> Refusal | None:
    if not (names := attributes.of_conditions(branch.when)) or not command_fields.fits_sentence(
        branch, candidate.parsed
    ):
        return None
    why = object_attributes.why_unstated(candidate.program, candidate.query, candidate.thing, names)
    return None if why is None else msgspec.structs.replace(why, message=f"{branch.script}: {why.message}")


def in_words(options: list[ScriptOption]) -> list[str]:
    """The ranking, where there was a choice (R70). Other notes have the reasons against those before the chosen one."""
    if len(options) < 2:
        return []
    rank = " and ".join(("rank", *(f"evaluator {name}" for name in options[0].candidate.program.evaluators)))
    return [f"candidates by {rank}: {', '.join(one.name for one in options)}"]


def only_looks(script: ScriptFile) -> bool:
    """Whether only a camera works for this script."""
    return "camera" in script.resources and "active_arm" not in script.resources


def holds(check: BranchCondition, candidate: TaskCandidate) -> bool:
    if not command_fields.holds_for(check, candidate.parsed):
        return False
    if check.of is None:
        return True
    value = expressions.number(check.of, candidate.figures)
    least = check.at_least is None or value >= expressions.number(check.at_least, candidate.figures) - 1e-9
    return least and (check.at_most is None or value <= expressions.number(check.at_most, candidate.figures) + 1e-9)
