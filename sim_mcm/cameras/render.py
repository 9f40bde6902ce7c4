"""Renders the cell: `python -m sim_mcm.cameras.render`, for `rtc.drawing.renderer`.

It renders one picture per line of JSON (`rtc.drawing.scene.Picture` or `CameraPicture`) on stdin.

Rendering runs in its own process, because pybullet holds the interpreter lock while it draws, and a tick must not wait.
The process builds the cell in a client without physics, sets all poses from the scene and uses the software renderer,
which needs no display.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pybullet
from numpy.typing import NDArray

from rtc.drawing.scene import VIEWS, CameraPicture, Drawn, Panel, Picture, SceneView
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera as CellCamera
from rtc.protocol.outcomes import RtcError
from rtc.sensing.optics import Window
from rtc.spatial import geometry
from sim_mcm.arms.bullet_world import PhysicsWorld
from sim_mcm.cameras import lens
from sim_mcm.cameras import picture as sheet
from sim_mcm.cameras.tag_plates import TagPlates

Image = NDArray[np.uint8]
Array = NDArray[np.float64]

SUPERSAMPLING = 2  # rendered at this scale and averaged, because the renderer does not antialias
FIELD_OF_VIEW_DEG = 37.0
NEAR_M, FAR_M = 0.1, 12.0
LIGHT = (-1.2, -0.5, 1.1)  # direction to the light
FLOOR_TILE_M, FLOOR_TILES = 0.4, 10
FLOOR_AT_M = 0.4  # of its middle along x
FLOOR_COLOURS = ((0.86, 0.87, 0.89, 1.0), (0.80, 0.82, 0.85, 1.0))
SKY = (232, 238, 246)
LIT = 0.95  # brightness of a level surface in the pictures of the cell's cameras
AWAY_M = 1000.0
BACKDROPS_KEPT = 8
PANEL = (760, 600)  # pixels, of two side by side
ALONE = (960, 720)
MIN_RADIUS_M = 0.75  # of a cell with little in it, so that its arm fits
CLOSE_M = 1.0  # distance from the eye to the target of a close view
#: view -> (direction from the cell's centre to the eye, distance in radii of the cell)
DIRECTIONS = {
    "overview": ((-2.0, -0.95, 1.6), 2.8),  # from above and behind the arms, a little to the right
    "behind": ((-2.6, 0.0, 0.9), 2.45),
    "left": ((-0.3, 2.6, 0.7), 2.6),
    "right": ((-0.3, -2.6, 0.7), 2.6),
    "above": ((-1.05, 0.0, 1.0), 2.2),  # from between the arms: both in full
    "top": ((-0.02, 0.0, 1.0), 2.9),
}
assert set(DIRECTIONS) == set(VIEWS)
CLOSE = (-1.0, -1.0, 0.75)  # direction of a close view


class RenderCamera(NamedTuple):
    """Column-major 4 x 4 matrices of pybullet."""

    view: Sequence[float]
    lens: Sequence[float]

    def pixel(self, point: geometry.Floats, size: tuple[int, int]) -> tuple[float, float]:
        """Pixel of a point (m, world frame) in a picture of this size; far outside if it is behind the eye."""
        view, lens = (np.array(matrix).reshape(4, 4).T for matrix in self)
        x, y, _, w = (lens @ view @ np.array([*list(point)[:3], 1.0])).tolist()
        return (-1e9, -1e9) if w <= 0 else (0.5 * (1 + x / w) * size[0], 0.5 * (1 - y / w) * size[1])


class RenderedPicture(NamedTuple):
    pixels: Image  # height x width x 3
    bodies: NDArray[np.integer[Any]]  # pybullet body id at each pixel; negative: background


class SceneRenderer:
    """The cell in a client without physics; it can be posed and rendered repeatedly."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.world = PhysicsWorld(cell, visual=True)
        self.tags = TagPlates(cell.tags, self.world.client)  # before the arms: later textures are black
        self.arms = {arm.name: self.world.load_arm(arm.name) for arm in cell.arms}
        self.joints = {
            name: {
                pybullet.getJointInfo(body, joint, physicsClientId=self.world.client)[1].decode(): joint
                for joint in range(pybullet.getNumJoints(body, physicsClientId=self.world.client))
            }
            for name, body in self.arms.items()
        }
        self._random = np.random.default_rng()
        self._floor = _floor(self.world)
        self._floor_shown = True
        self._backdrops: dict[tuple[str, bytes], Image] = {}

    def close(self) -> None:
        self.world.close()

    def pose(self, scene: SceneView) -> None:
        """Set all poses from the scene; anything not in it takes its initial pose."""
        poses = {name: scene.poses.get(name, self.cell.object_pose(name).tolist()) for name in self.world.objects}
        poses |= {name: scene.seats.get(name, seat.home.tolist()) for name, seat in self.world.seats.items()}
        for name, body in (*self.world.objects.items(), *self.world.seats.items()):
            self.world.place(body, poses[name])
        self.tags.place(poses)
        for arm in self.cell.arms:
            half = 0.5 * arm.gripper.max_opening_m
            wanted = dict(zip(arm.joints, scene.joints.get(arm.name, arm.home_rad), strict=True))
            wanted |= zip(arm.gripper.finger_joints, scene.fingers.get(arm.name, [half, half]), strict=True)
            for title, joint in self.joints[arm.name].items():
                if title in wanted:
                    pybullet.resetJointState(
                        self.arms[arm.name], joint, wanted[title], physicsClientId=self.world.client
                    )

    def camera(self, name: str, scene: SceneView, aspect: float) -> RenderCamera:
        """The camera of one of VIEWS, or a close view of the named arm's hand, object, seat or place."""
        middle, radius = self._extent()
        direction, far = DIRECTIONS.get(name, (CLOSE, 0.0))
        target = middle if name in DIRECTIONS else self._target(name, scene)
        distance = far * radius if name in DIRECTIONS else CLOSE_M
        eye = target + distance * np.array(direction) / math.hypot(*direction)
        return RenderCamera(
            pybullet.computeViewMatrix(eye.tolist(), target.tolist(), [0, 0, 1]),
            pybullet.computeProjectionMatrixFOV(FIELD_OF_VIEW_DEG, aspect, NEAR_M, FAR_M),
        )

    def _extent(self) -> tuple[Array, float]:
        """Centre (m) and radius (m) of the cell's content."""
        points: list[tuple[float, ...]] = [arm.base.xyz for arm in self.cell.arms]
        points += [tuple(seat.frame.xyz) for seat in self.cell.seats]
        points += [frame.xyz for place in self.cell.places for frame in place.poses.values()]
        points += [tuple(self.cell.object_pose(thing.name)[:3].tolist()) for thing in self.cell.objects]
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        radius = max(MIN_RADIUS_M, 0.5 * float(np.linalg.norm(high - low)))
        middle = 0.5 * (low + high) + [0.0, 0.0, 0.12 * radius]  # raised: arms reach up, and only the floor is below
        middle[2] = max(middle[2], 0.5 * self._highest())
        return middle, radius

    def _highest(self) -> float:
        """Height (m) of the highest joint of the arms."""
        client = self.world.client
        joints = [(body, joint) for name, body in self.arms.items() for joint in self.joints[name].values()]
        rows = [pybullet.getLinkState(*one, computeForwardKinematics=1, physicsClientId=client)[0] for one in joints]
        return max(row[2] for row in rows)

    def _target(self, name: str, scene: SceneView) -> Array:
        cell = self.cell
        if name in scene.poses:
            return np.array(scene.poses[name][:3])
        for arm in cell.arms:
            if name in (arm.name, arm.end_effector):
                return self.hand(arm.name)
        found = [seat.frame.xyz for seat in cell.seats if seat.name == name]
        found += [frame.xyz for place in cell.places if place.name == name for frame in place.poses.values()]
        if not found:
            raise RtcError(f"unknown camera {name}; use {', '.join(VIEWS)}, or the name of a thing of the cell")
        return np.array(found[0])

    def hand(self, arm: str) -> Array:
        """Position of an arm's palm (m, world frame)."""
        joint = self.joints[arm][self.cell.arm(arm).gripper.finger_joints[0]]
        state = pybullet.getLinkState(
            self.arms[arm], joint, computeForwardKinematics=1, physicsClientId=self.world.client
        )
        return np.array(state[0])

    def photograph(self, camera: RenderCamera, width: int, height: int, *, smooth: bool = True) -> RenderedPicture:
        self._show_floor(True)
        times = SUPERSAMPLING if smooth else 1
        wide, high = width * times, height * times
        image, bodies = self._drawn(
            wide,
            high,
            viewMatrix=camera.view,
            projectionMatrix=camera.lens,
            lightColor=[1.0, 0.98, 0.95],
            lightAmbientCoeff=0.62,
            lightDiffuseCoeff=0.48,
            lightSpecularCoeff=0.05,
            shadow=1,
        )
        image[bodies < 0] = SKY
        blocks = image.reshape(height, times, width, times, 3)
        averaged: Image = blocks.mean(axis=(1, 3)).astype(np.uint8)
        return RenderedPicture(averaged, bodies[::times, ::times])

    def _drawn(self, width: int, height: int, **view_and_light: Any) -> tuple[Image, NDArray[np.integer[Any]]]:
        """The colours [height][width][3] and the body of each pixel [height][width], -1 for none."""
        _, _, pixels, _, bodies = pybullet.getCameraImage(
            width,
            height,
            lightDirection=LIGHT,
            lightDistance=6.0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self.world.client,
            **view_and_light,
        )
        image: Image = np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[:, :, :3].copy()
        return image, np.asarray(bodies).reshape(height, width)

    def mask(self, photograph: RenderedPicture, name: str) -> sheet.Mask:
        """The pixels that show an object."""
        bodies = [part for part, _ in self.world.objects[name].parts] + self.tags.on(name)
        seen: sheet.Mask = np.isin(photograph.bodies, bodies)
        return seen

    def camera_picture(
        self, name: str, scene: SceneView, seed: int | None = None, window: Window | None = None
    ) -> Image:
        """The picture of a camera of the cell, or a window of it, height x width x 3; call `pose` first. Raises
        RtcError if the scene lacks the tcp of the arm that carries the camera. `seed`: of the noise."""
        camera = self.cell.camera(name)
        pose = camera.pose
        if camera.arm is not None:
            if camera.arm not in scene.tcp:
                raise RtcError(f"{name} is on {camera.arm}, whose tcp is not known")
            pose = geometry.compose(scene.tcp[camera.arm], pose)
        self._show_floor(False)  # drawing it takes more time than all the rest
        left, top, width, height = window or Window(0, 0, *camera.size_px)
        if name in scene.blind:
            return np.zeros((height, width, 3), dtype=np.uint8)
        matrices = lens.matrices(camera, pose, window)
        image, bodies = self._drawn(
            width,
            height,
            viewMatrix=matrices.view,
            projectionMatrix=matrices.lens,
            lightColor=[1.0, 1.0, 1.0],
            lightAmbientCoeff=0.85,
            lightDiffuseCoeff=0.15,
            lightSpecularCoeff=0.0,
            shadow=0,
        )
        behind = bodies[:, :, None] < 0
        np.copyto(image, self._backdrop(camera, pose)[top : top + height, left : left + width], where=behind)
        return lens.exposed(image, camera, self._random if seed is None else np.random.default_rng(seed))

    def _show_floor(self, shown: bool) -> None:
        """Put the floor in its place, or far outside of all pictures."""
        if shown is self._floor_shown:
            return
        self._floor_shown = shown
        for tile, (x, y, z) in self._floor:
            at = [x, y, z if shown else -AWAY_M]
            pybullet.resetBasePositionAndOrientation(tile, at, [0, 0, 0, 1], physicsClientId=self.world.client)

    def _backdrop(self, camera: CellCamera, pose: geometry.Floats) -> Image:
        """The floor and the sky as a camera at this pose sees them."""
        key = camera.name, np.asarray(pose, dtype=float).tobytes()
        if key not in self._backdrops:
            if len(self._backdrops) >= BACKDROPS_KEPT:
                self._backdrops.clear()
            self._backdrops[key] = backdrop(camera, pose)
        return self._backdrops[key]


def backdrop(camera: CellCamera, pose: geometry.Floats) -> Image:
    """Floor and sky as a camera at `pose` (world frame) sees them, height x width x 3."""
    width, height = camera.size_px
    focal_px = 0.5 * height / math.tan(math.radians(0.5 * camera.field_of_view_deg))
    right, down = ((np.arange(n, dtype=np.float32) + 0.5 - 0.5 * n) / np.float32(focal_px) for n in (width, height))
    matrix = geometry.to_matrix(pose).astype(np.float32)
    # The direction of each pixel's ray: a sum of a row and a column.
    x, y, z = (matrix[k, 0] * right + (matrix[k, 1] * down + matrix[k, 2])[:, None] for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        far = -matrix[2, 3] / z
        along = (matrix[0, 3] - FLOOR_AT_M + far * x) / FLOOR_TILE_M + 0.5 * FLOOR_TILES
        across = (matrix[1, 3] + far * y) / FLOOR_TILE_M + 0.5 * FLOOR_TILES
    hit = (far > 0.0) & (along >= 0.0) & (along < FLOOR_TILES) & (across >= 0.0) & (across < FLOOR_TILES)
    tile = np.where(hit, along, 0.0).astype(np.int8) + np.where(hit, across, 0.0).astype(np.int8)
    colours = [SKY, *([int(255.0 * LIT * n) for n in colour[:3]] for colour in FLOOR_COLOURS)]
    found: Image = np.array(colours, dtype=np.uint8)[np.where(hit, 1 + tile % 2, 0)]
    return found


def compose(studio: SceneRenderer, wanted: Picture) -> sheet.Sheet:
    """The panels of a picture with their text, all from the same camera."""
    size = ALONE if len(wanted.panels) == 1 else PANEL
    camera, first = None, None
    done = []
    for panel in wanted.panels:
        studio.pose(panel.scene)
        camera = camera or studio.camera(wanted.camera, panel.scene, size[0] / size[1])
        photograph = studio.photograph(camera, *size, smooth=wanted.smooth)
        first = first or photograph
        pixels = sheet.painted(photograph.pixels, [studio.mask(first, name) for name in panel.outlined])
        labels = {name: (words, camera.pixel(at, size)) for name, words, at in _anchors(studio, panel)}
        done.append((panel.title, sheet.labelled(pixels, labels, panel.doubtful)))
    return sheet.composed(done, wanted.caption)


def _draw_to_file(studio: SceneRenderer, wanted: Picture | CameraPicture) -> None:
    file = Path(wanted.out)
    if isinstance(wanted, Picture):
        return sheet.save(compose(studio, wanted), file)
    studio.pose(wanted.scene)
    if wanted.windows:
        parts = [studio.camera_picture(wanted.camera, wanted.scene, window=Window(*part)) for part in wanted.windows]
        np.save(file, np.concatenate([part.reshape(-1) for part in parts]))
        return None
    image = studio.camera_picture(wanted.camera, wanted.scene, wanted.seed)
    if file.suffix == ".npy":
        np.save(file, image)
    else:
        sheet.save(sheet.from_pixels(image), file)
    return None


def _anchors(studio: SceneRenderer, panel: Panel) -> list[tuple[str, str, Array]]:
    """(name, text, point (m, world frame)) of each label of a panel."""
    return [
        (name, words, studio.hand(name) if name in studio.arms else np.array(panel.scene.poses[name][:3]))
        for name, words in panel.labels.items()
        if name in studio.arms or name in panel.scene.poses
    ]


def _floor(world: PhysicsWorld) -> list[tuple[int, list[float]]]:
    """Add a chequered floor, which makes positions visible. Returns its tiles with their positions (m)."""
    half = [0.5 * FLOOR_TILE_M, 0.5 * FLOOR_TILE_M, 0.005]
    shapes = [
        pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=half, rgbaColor=colour, specularColor=[0, 0, 0], physicsClientId=world.client
        )
        for colour in FLOOR_COLOURS
    ]
    middle = 0.5 * (FLOOR_TILES - 1)
    tiles = []
    for row in range(FLOOR_TILES):
        for column in range(FLOOR_TILES):
            at = [FLOOR_AT_M + (row - middle) * FLOOR_TILE_M, (column - middle) * FLOOR_TILE_M, -0.005]
            tile = pybullet.createMultiBody(
                baseVisualShapeIndex=shapes[(row + column) % 2], basePosition=at, physicsClientId=world.client
            )
            tiles.append((tile, at))
    return tiles


def serve() -> None:
    """Write one `Drawn` to stdout per request on stdin, until stdin ends. The cell is built once."""
    read: msgspec.json.Decoder[Picture | CameraPicture] = msgspec.json.Decoder(Picture | CameraPicture)
    studio, built = None, ""
    for line in sys.stdin:
        wanted = read.decode(line)
        error = ""
        try:
            if studio is None or built != wanted.cell:
                studio, built = SceneRenderer(Cell.load(wanted.cell)), wanted.cell
            _draw_to_file(studio, wanted)
        except (OSError, RtcError) as trouble:
            error = str(trouble)
        print(msgspec.json.encode(Drawn(error=error)).decode(), flush=True)


if __name__ == "__main__":
    serve()
