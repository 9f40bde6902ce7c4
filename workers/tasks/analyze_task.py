"""An end report to be judged: what all parts of the analyzer share."""

from __future__ import annotations

from rtc.model.cells import parts
from rtc.programs.schema import AnalyzerProgram
from rtc.protocol.messages import AnalyzerInput, LookStep, WorldChange
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning.world_query import WorldQuery

Changes = list[WorldChange]


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

    @property
    def object_frame(self) -> tuple[Array, list[float]]:
        """The frame (world) and the spread of the object of the command, before this report."""
        thing = self.context.object
        return self.query.frame(thing), list(self.query.spread(f"{thing}.frame"))

    @property
    def off_m(self) -> float:
        """How far the hand is from its goal, or what a camera has seen from the place where it should be."""
        place, sighting = self.evaluation.body_pose, self.report.sighting
        if place is not None:
            return geometry.distance(sighting.pose, place) if sighting is not None else 0.0
        goal, tcp = self.evaluation.goal_pose, self.report.tcp_pose
        return geometry.distance(tcp, goal) if goal is not None and tcp else 0.0

    @property
    def turned_rad(self) -> float:
        """By how much what a camera has seen is turned against the place where it should be."""
        place, sighting = self.evaluation.body_pose, self.report.sighting
        return geometry.angle(sighting.pose, place) if place is not None and sighting is not None else 0.0

    @property
    def seen_as_believed(self) -> bool:
        """Whether a camera that looked for a body in another place has seen it where it is believed to be."""
        sighting, step = self.report.sighting, self.step
        if sighting is None or self.evaluation.body_pose is None or not isinstance(step, LookStep):
            return False
        believed = self.query.pose(self.evaluation.body)
        near = geometry.distance(sighting.pose, believed) <= step.within_m
        return near and geometry.angle(sighting.pose, believed) <= step.within_rad
