"""What the steps of a script do, in their order."""

from __future__ import annotations

from rtc.programs.schema import ScriptFile


def lets_go_first(script: ScriptFile, *, of_object: bool = False) -> bool:
    """Whether the hand of the script opens before the arm moves; `of_object`: and lets go of an object by that."""
    first = next((step for step in script.steps if step.op or step.to), None)
    return first is not None and first.op == "open" and (not of_object or first.words.get("effect") == "let_go")
