"""The cameras of the cell for tests of the workers: the real performer of a look, on pictures of the true scene.

`Ideal` projects the corners of the tags, in milliseconds. `Drawn` draws them and finds them in the pixels. Each of its
pictures has noise of its own, as those of the product: two pictures of a body at rest differ. They are repeatable.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import EndReport, Execute
from rtc.protocol.primitive import Primitive
from rtc.sensing import optics
from rtc.sensing.detector import Mark
from rtc.sensing.locate import corners
from rtc.spatial import geometry
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.perception.look_task import Evaluated
from rtc.subsystems.perception.subsystem import PerceptionSubsystem

GREY = np.full((480, 640, 3), 128, np.uint8)
PERIOD_S = 0.1  # of a picture: those of several cameras come one after the other


class Ideal:
    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.blind = False  # something hides everything
        self.now_s = 1000.0
        self.rate = 1.0  # of the clock of what is seen, by ours

    def perform(self, made: Primitive, scene: SceneView) -> EndReport:
        """Pictures of this scene until the look ends."""
        cameras = PerceptionSubsystem(made.performers)
        cameras.handle(Execute(primitive=made), BROKER, self.now_s)
        while True:
            for _, message in cameras.tick(self.now_s):
                if isinstance(message, EndReport):
                    return message
            due = [one for one in cameras.performers.values() if one.due_s is not None]
            due = [one for one in due if one.due_s - PERIOD_S <= self.now_s + 1e-9]
            for camera in due:
                self.now_s += PERIOD_S
                camera.take(self.picture(camera.name, scene))
            self.now_s += 0.0 if due else PERIOD_S

    def picture(self, name: str, scene: SceneView) -> Evaluated:
        camera = self.cell.camera(name)
        view = optics.view(camera, scene.tcp[camera.arm] if camera.arm else None)
        return Evaluated(self.now_s, self.rate * self.now_s, view, GREY, [] if self.blind else self._marks(view, scene))

    def _marks(self, view: optics.View, scene: SceneView) -> list[Mark]:
        marks = []
        for tag in self.cell.tags:
            matrix = geometry.to_matrix(_poses(self.cell, scene)[tag.body])
            world = corners(tag) @ matrix[:3, :3].T + matrix[:3, 3]
            if optics.visible(view, world, np.cross(world[1] - world[0], world[3] - world[0])):
                marks.append(Mark(tag.id, view.pixels(world)))
        return marks


class Drawn(Ideal):
    def __init__(self, cell: Cell, seed: int = 1) -> None:
        """`seed`: of the noise of the first picture; each further picture has the next one."""
        from rtc.sensing.detector import TagDetector
        from sim_mcm.cameras.render import SceneRenderer

        super().__init__(cell)
        self.studio, self._detector = SceneRenderer(cell), TagDetector()
        self._seeds = itertools.count(seed)

    def picture(self, name: str, scene: SceneView) -> Evaluated:
        self.studio.pose(scene)
        image = self.studio.camera_picture(name, scene, seed=next(self._seeds))
        camera = self.cell.camera(name)
        view = optics.view(camera, scene.tcp[camera.arm] if camera.arm else None)
        return Evaluated(
            self.now_s, self.rate * self.now_s, view, image, [] if self.blind else self._detector.find(image)
        )


def _poses(cell: Cell, scene: SceneView) -> Mapping[str, Any]:
    seats = {seat.name: seat.frame.pose for seat in cell.seats}
    return seats | {thing.name: cell.object_pose(thing.name) for thing in cell.objects} | scene.seats | scene.poses
