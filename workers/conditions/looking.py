"""The cameras of a step that looks, as the elaborator writes them and the binder reads them. Pure."""

from __future__ import annotations

from rtc.protocol.messages import Step

CAMERA = "camera"  # performer of the steps of a script that look, and the arg with its name
FURTHER = "further"  # arg of such a step: other cameras


def cameras_of(step: Step) -> list[str]:
    """The cameras of a step that looks, the one that reports first."""
    return [*str(step.args.get(CAMERA, "")).split(), *str(step.args.get(FURTHER, "")).split()]
