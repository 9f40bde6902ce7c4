"""An end report to be judged: what all parts of the analyzer share."""

from __future__ import annotations

from rtc.model.cells import parts
from rtc.programs.schema import AnalyzerProgram
from rtc.protocol.messages import AnalyzerInput
from rtc.spatial import geometry
from workers.planning.world_query import WorldQuery


class AnalyzeTask:
    """One end report, with the world before its changes."""

    def __init__(self, program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> None:
        self.program, self.query, self.data = program, query, data
        self.values, self.report, self.evaluation = program.values, data.report, data.evaluation
        self.step, self.context = data.evaluation.step, data.evaluation.context

    @property
    def arm(self) -> str:
        """The arm that has performed the step: that of the command, or its second one."""
        return self.evaluation.arm or self.context.arm

    @property
    def point(self) -> parts.GraspPoint:
        """The grasp point of the command; without one, that of its object which is nearest to the hand."""
        thing, tcp = self.query.cell.object(self.context.object), self.report.tcp_pose
        if self.context.grasp_point:
            return thing.grasp_point(self.context.grasp_point)
        frame = self.query.frame(thing.name)
        return min(thing.grasp_points, key=lambda one: geometry.distance(tcp, geometry.compose(frame, one.frame.pose)))
