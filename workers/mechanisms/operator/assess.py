"""What an intervention of the operator changes in the world. Pure."""

from __future__ import annotations

from rtc.protocol.messages import Validity, WorldChange
from workers.tasks.analyze_task import AnalyzeTask


def handed(task: AnalyzeTask, _: Validity) -> list[WorldChange]:
    """The operator will move the arm: until it has rested again, no one knows where it is."""
    return [WorldChange(key=f"{task.context.arm}.joints", keep_value=True, validity=Validity.SUSPECT)]
