"""The cameras of the cell for tests of the workers: the real performer of a look, on pictures of the true scene.

`Ideal` projects the corners of the tags, in milliseconds. `Drawn` draws them and finds them in the pixels. Each of its
pictures has noise of its own, as those of the product: two pictures of a body at rest differ. They are repeatable.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import EndReport, Execute
from rtc.protocol.primitive import Primitive
from rtc.sensing import optics
from rtc.sensing.detector import DetectedTag
from rtc.sensing.locate import corners
from rtc.spatial import geometry
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.perception.look_task import Evaluated, Windows
from rtc.subsystems.perception.subsystem import PerceptionSubsystem

Seen = tuple[NDArray[np.uint8] | None, list[DetectedTag]]  # (the whole picture, the tags in it or in its windows)
NOTHING: Windows = {}
GREY = np.full((480, 640, 3), 128, np.uint8)
PERIOD_S = 0.1  # of a picture: those of several cameras come one after the other
WINDOW_S = 0.01  # of one window of a picture: 5 to 15 ms were measured (decision 0150)
START_S = 0.35  # of what draws, before the first picture: 0.31 to 0.35 s in six clusters


class Ideal:
    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.blind = False  # something hides everything
        self.now_s = 1000.0
        self.slower = 1.0  # how much longer than PERIOD_S, WINDOW_S its pictures take
        self._started = False
        self.rate = 1.0  # of the clock of what is seen, by ours

    def perform(self, made: Primitive, scene: SceneView) -> EndReport:
        """Pictures of this scene until the look ends."""
        cameras = PerceptionSubsystem(made.performers)
        cameras.handle(Execute(primitive=made), BROKER, self.now_s)
        self.now_s += 0.0 if self._started else START_S
        self._started = True
        while True:
            for _, message in cameras.tick(self.now_s):
                if isinstance(message, EndReport):
                    return message
            camera = cameras.next_camera(self.now_s)
            if camera is None:
                self.now_s = min(cameras.due_s(), self.now_s + PERIOD_S)
                continue
            windows = camera.windows(self.now_s)
            taken = self.picture(camera.name, scene, windows)
            took_s = self.slower * (WINDOW_S * len(windows) if windows else PERIOD_S)
            self.now_s += took_s
            camera.take(taken)
            cameras.clock.note(camera.name, took_s, len(windows))

    def picture(self, name: str, scene: SceneView, windows: Windows = NOTHING) -> Evaluated:
        """`windows`: only these parts of it."""
        camera = self.cell.camera(name)
        view = optics.view(camera, scene.tcp[camera.arm] if camera.arm else None)
        image, marks = self._seen(name, view, scene, windows)
        return Evaluated(self.now_s, self.rate * self.now_s, view, image, [] if self.blind else marks)

    def _seen(self, name: str, view: optics.CameraView, scene: SceneView, windows: Windows) -> Seen:
        marks = self._marks(view, scene)
        return (None, [mark for mark in marks if mark.tag in windows]) if windows else (GREY, marks)

    def _marks(self, view: optics.CameraView, scene: SceneView) -> list[DetectedTag]:
        marks = []
        for tag in self.cell.tags:
            matrix = geometry.to_matrix(_poses(self.cell, scene)[tag.body])
            world = corners(tag) @ matrix[:3, :3].T + matrix[:3, 3]
            if optics.visible(view, world, np.cross(world[1] - world[0], world[3] - world[0])):
                marks.append(DetectedTag(tag.id, view.pixels(world)))
        return marks


class Drawn(Ideal):
    def __init__(self, cell: Cell, seed: int = 1) -> None:
        """`seed`: of the noise of the first picture; each further picture has the next one."""
        from rtc.sensing.detector import TagDetector
        from sim_mcm.cameras.render import SceneRenderer

        super().__init__(cell)
        self.studio, self._detector = SceneRenderer(cell), TagDetector()
        self._seeds = itertools.count(seed)

    def _seen(self, name: str, view: optics.CameraView, scene: SceneView, windows: Windows) -> Seen:
        self.studio.pose(scene)
        if windows:
            parts = {
                tag: (window, self.studio.camera_picture(name, scene, next(self._seeds), window))
                for tag, window in windows.items()
            }
            return None, self._detector.find_in(parts)
        image = self.studio.camera_picture(name, scene, next(self._seeds))
        return image, self._detector.find(image)


def _poses(cell: Cell, scene: SceneView) -> Mapping[str, Any]:
    seats = {seat.name: seat.frame.pose for seat in cell.seats}
    return seats | {thing.name: cell.object_pose(thing.name) for thing in cell.objects} | scene.seats | scene.poses
