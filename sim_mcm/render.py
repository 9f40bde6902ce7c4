"""`python -m sim_mcm.render --truth FILE.json --out scene.png`: a picture of the cell as the simulator saw it.

Drawn by a process of its own, because pybullet holds the interpreter while it draws, and a tick must not wait for that.
It rebuilds the cell in a client without physics, puts everything where the truth (a `SimTruthReply` as JSON) says, and
uses the software renderer: no display is needed.
"""

from __future__ import annotations

import argparse
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pybullet
from numpy.typing import NDArray

from rtc.cell import Cell
from rtc.outcomes import RtcError
from sim_mcm.bullet_world import World

Image = NDArray[np.uint8]

SUPERSAMPLING = 2  # drawn twice as large and averaged: the renderer does not smooth edges
FIELD_OF_VIEW_DEG = 37.0
EYE = (-1.15, -2.35, 1.75)  # from behind the arms, to the right and above
LOOK_AT = (0.40, -0.06, 0.58)
LIGHT = (-1.2, -0.5, 1.1)  # direction towards it
FLOOR_TILE_M, FLOOR_TILES = 0.4, 10
FLOOR_COLOURS = ((0.86, 0.87, 0.89, 1.0), (0.80, 0.82, 0.85, 1.0))
SKY = (232, 238, 246)


class Truth(msgspec.Struct, frozen=True):
    """What is drawn of a SimTruthReply; whatever is missing stays as the cell begins."""

    poses: dict[str, list[float]] = {}
    joints: dict[str, list[float]] = {}
    fingers: dict[str, list[float]] = {}


def draw(cell: Cell, truth: Truth, width: int = 960, height: int = 720) -> Image:
    """The picture, height x width x 3."""
    world = World(cell, visual=True)
    try:
        _floor(world)
        for name, pose in truth.poses.items():
            if name in world.objects:
                world.place(world.objects[name], pose)
        for arm in cell.arms:
            _pose_arm(world, cell, arm.name, truth)
        return _photograph(world, width, height)
    finally:
        world.close()


def _pose_arm(world: World, cell: Cell, name: str, truth: Truth) -> None:
    spec = cell.arm(name)
    body = world.load_arm(name)
    half = 0.5 * spec.gripper.max_opening_m
    wanted = dict(zip(spec.joints, truth.joints.get(name, spec.home_rad), strict=True))
    wanted |= zip(spec.gripper.finger_joints, truth.fingers.get(name, [half, half]), strict=True)
    for joint in range(pybullet.getNumJoints(body, physicsClientId=world.client)):
        title = pybullet.getJointInfo(body, joint, physicsClientId=world.client)[1].decode()
        if title in wanted:
            pybullet.resetJointState(body, joint, wanted[title], physicsClientId=world.client)


def _floor(world: World) -> None:
    """A chequered floor: without it nobody sees where things stand."""
    half = [0.5 * FLOOR_TILE_M, 0.5 * FLOOR_TILE_M, 0.005]
    shapes = [
        pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=half, rgbaColor=colour, specularColor=[0, 0, 0], physicsClientId=world.client
        )
        for colour in FLOOR_COLOURS
    ]
    middle = 0.5 * (FLOOR_TILES - 1)
    for row in range(FLOOR_TILES):
        for column in range(FLOOR_TILES):
            at = [0.4 + (row - middle) * FLOOR_TILE_M, (column - middle) * FLOOR_TILE_M, -0.005]
            pybullet.createMultiBody(
                baseVisualShapeIndex=shapes[(row + column) % 2], basePosition=at, physicsClientId=world.client
            )


def _photograph(world: World, width: int, height: int) -> Image:
    wide, high = width * SUPERSAMPLING, height * SUPERSAMPLING
    view = pybullet.computeViewMatrix(EYE, LOOK_AT, [0, 0, 1])
    lens = pybullet.computeProjectionMatrixFOV(FIELD_OF_VIEW_DEG, wide / high, 0.3, 12.0)
    _, _, pixels, _, segments = pybullet.getCameraImage(
        wide,
        high,
        viewMatrix=view,
        projectionMatrix=lens,
        lightDirection=LIGHT,
        lightColor=[1.0, 0.98, 0.95],
        lightDistance=6.0,
        lightAmbientCoeff=0.62,
        lightDiffuseCoeff=0.48,
        lightSpecularCoeff=0.05,
        shadow=1,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=world.client,
    )
    image = np.asarray(pixels, dtype=np.uint8).reshape(high, wide, 4)[:, :, :3].copy()
    image[np.asarray(segments).reshape(high, wide) < 0] = SKY
    blocks = image.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3)
    smooth: Image = blocks.mean(axis=(1, 3)).astype(np.uint8)
    return smooth


def write_png(image: Image, file: Path) -> None:
    """PNG by hand: a header, one deflated block, an end. Spares a library."""
    height, width, _ = image.shape
    rows = b"".join(b"\0" + row.tobytes() for row in image)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 6)), (b"IEND", b""))
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    size = int(width), int(height)
    if not all(16 <= n <= 4096 for n in size):
        raise argparse.ArgumentTypeError("a size is WIDTHxHEIGHT, each 16 to 4096")
    return size


def main(arguments: Sequence[str] | None = None) -> None:
    words = argparse.ArgumentParser(prog="python -m sim_mcm.render", description=__doc__)
    words.add_argument("--truth", type=Path, help="SimTruthReply as JSON; without it the cell as it begins")
    words.add_argument("--out", type=Path, required=True, help="the PNG to write")
    words.add_argument("--cell", default="swapout", help="name or file of the cell")
    words.add_argument("--size", type=_size, default=(960, 720), help="WIDTHxHEIGHT")
    given = words.parse_args(arguments)
    try:
        truth = msgspec.json.decode(given.truth.read_bytes(), type=Truth) if given.truth else Truth()
        write_png(draw(Cell.load(given.cell), truth, *given.size), given.out)
    except (OSError, msgspec.MsgspecError, RtcError) as error:
        words.exit(1, f"{words.prog}: {error}\n")


if __name__ == "__main__":
    main()
