"""A sentence that states or asks facts: no arm moves, and nothing is planned. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.programs.step_kinds import step_of
from rtc.protocol.messages import SavedWorld, Script, ScriptContext
from rtc.protocol.sentence import ParsedCommand
from workers.planning.world_query import WorldQuery


class DataSentence(NamedTuple):
    program: ElaboratorProgram
    file: ScriptFile
    parsed: ParsedCommand
    query: WorldQuery
    owners: Mapping[str, str]  # name -> the commands that use it
    saved: SavedWorld | None  # facts of a file, which only SET WORLD FACTS SAVED states

    @property
    def name(self) -> str:
        return self.parsed.hand or self.parsed.object or ""

    def script(
        self, says: str, thing: str = "", facts: Mapping[str, Any] | None = None, concerned: Sequence[str] = ()
    ) -> Script:
        """The script whose result says this. `facts`: those that it states, about `thing` and all that is concerned."""
        parsed, file = self.parsed, self.file
        texts = {"{object}": self.name, "{attribute}": parsed.attribute or "", "{value}": _shown(parsed)}
        steps = []
        for step in file.steps:
            label = step.label
            for name, text in texts.items():
                label = label.replace(name, text)
            steps.append(step_of(step, label=label, expect=step.expect, says=says))
        return Script(
            context=ScriptContext(verb=parsed.verb, script=file.script, object=thing, stated=dict(facts or {})),
            case=file.case,
            steps=steps,
            resources=_names(file.resources, concerned),
            writes=_names(file.writes, concerned),
        )


def _shown(parsed: ParsedCommand) -> str:
    """The values with their units, each unit once for the numbers that share it: 0.8 0.77 0.6 m 0 0 0.07 rad."""
    values = [value if isinstance(value, str) else f"{value:.6g}" for value in parsed.value or []]
    unit = parsed.value_unit or ""
    if " " not in unit:
        return f"{' '.join(values)} {unit}".strip()
    units = unit.split()
    ends = [unit if unit != after else "" for unit, after in zip(units, [*units[1:], ""], strict=True)]
    return " ".join(word for pair in zip(values, ends, strict=True) for word in pair if word)


def _names(roles: Sequence[str], active: Sequence[str]) -> list[str]:
    """The names that the roles of a script stand for."""
    return list(dict.fromkeys(name for role in roles for name in (active if role == "active_object" else [role])))
