"""AprilTags as textured squares in a pybullet client; they have no mass and touch nothing.

Each tag is a body of its own, placed where its object or seat is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pybullet

from rtc.model.cells import tag_family
from rtc.model.cells.parts import Tag
from rtc.spatial import geometry
from sim_mcm.cameras import picture

PIXELS_PER_CELL = 8  # of a texture; more pixels give the same picture


class TagPlates:
    def __init__(self, tags: Sequence[Tag], client: int) -> None:
        self._client = client
        with TemporaryDirectory(prefix="rtc-tags-") as folder:  # pybullet caches files by name, so each run has its own
            self._bodies = [(tag, self._plate(tag, Path(folder))) for tag in tags]

    def place(self, poses: Mapping[str, geometry.Floats]) -> None:
        """Move all tags to their bodies. `poses`: world pose of each object and seat."""
        for tag, body in self._bodies:
            at = geometry.compose(poses[tag.body], tag.frame.pose).tolist()
            pybullet.resetBasePositionAndOrientation(body, at[:3], at[3:], physicsClientId=self._client)

    def on(self, name: str) -> list[int]:
        """pybullet ids of the tags of an object or seat."""
        return [body for tag, body in self._bodies if tag.body == name]

    def _plate(self, tag: Tag, folder: Path) -> int:
        half = 0.5 * tag.size_m * tag_family.WHOLE / tag_family.BLACK
        square, texture = folder / f"tag-{tag.id}.obj", folder / f"tag-{tag.id}.png"
        square.write_text(_square(half), encoding="ascii")  # pybullet reads it when the body is made
        shades = np.where(tag_family.cells(tag.id), 255, 0).astype(np.uint8)
        whole = np.kron(shades, np.ones((PIXELS_PER_CELL,) * 2, np.uint8))
        picture.save(picture.from_pixels(whole).convert("RGB"), texture)  # pybullet shows a grey texture as black
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            fileName=str(square),
            rgbaColor=[1, 1, 1, 1],
            specularColor=[0, 0, 0],
            physicsClientId=self._client,
        )
        body: int = pybullet.createMultiBody(baseVisualShapeIndex=shape, physicsClientId=self._client)
        loaded = pybullet.loadTexture(str(texture), physicsClientId=self._client)
        pybullet.changeVisualShape(body, -1, textureUniqueId=loaded, physicsClientId=self._client)
        return body


def _square(half: float) -> str:
    """A square in the plane z = 0 as Wavefront OBJ; texture and square have x to the right and y upwards."""
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    lines = [f"v {x * half:.6f} {y * half:.6f} 0" for x, y in corners]
    lines += [f"vt {(x + 1) // 2} {(y + 1) // 2}" for x, y in corners]
    return "\n".join([*lines, "vn 0 0 1", "f 1/1/1 2/2/1 3/3/1", "f 1/1/1 3/3/1 4/4/1", ""])
