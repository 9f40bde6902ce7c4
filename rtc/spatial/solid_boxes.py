"""Boxes that move in the frame of a hand, against a box that stands: how far they are beyond it, or in it. Pure.

A box is [x y z qx qy qz qw, three sides] (m): its pose and its size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats

Boxes = Sequence[Sequence[float]]
CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
PARALLEL = 1e-5  # length of the product of two parallel sides


class Beside:
    """Boxes in the frame of a hand, and one that stands in the world at `centre` (pose) with the sides `size_m`."""

    def __init__(self, boxes: Boxes, centre: Floats, size_m: Sequence[float]) -> None:
        self._back, self._half = geometry.inverse(centre), 0.5 * np.asarray(size_m)
        poses = [geometry.to_matrix(box[:7]) for box in boxes]
        self._turns = np.array([pose[:3, :3] for pose in poses])
        self._middles = np.array([pose[:3, 3] for pose in poses])
        self._sides = 0.5 * np.array([box[7:] for box in boxes])
        self._corners = np.vstack(
            [pose[:3, 3] + (CORNERS * box[7:]) @ pose[:3, :3].T for pose, box in zip(poses, boxes, strict=True)]
        )
        self._reach_m = np.linalg.norm(self._sides, axis=1)

    def beyond_m(self, hand: Floats) -> float:
        """How far the farthest corner is beyond the faces of the standing box; below 0: all are inside."""
        pose = geometry.to_matrix(geometry.compose(self._back, hand))
        return float((np.abs(self._corners @ pose[:3, :3].T + pose[:3, 3]) - self._half).max())

    def inside_m(self, hand: Floats) -> float:
        """How deep one of them is in the standing box; 0 or below: none is."""
        pose = geometry.to_matrix(geometry.compose(self._back, hand))
        turn, middles = pose[:3, :3], self._middles @ pose[:3, :3].T + pose[:3, 3]
        near = np.linalg.norm(np.maximum(np.abs(middles) - self._half, 0.0), axis=1) < self._reach_m
        if not near.any():
            return -1.0
        return float(self._depths_m(turn @ self._turns[near], middles[near], self._sides[near]).max())

    def _depths_m(self, turns: Array, middles: Array, halves: Array) -> Array:
        """Of each box the least overlap along the fifteen axes that can separate it from the standing one."""
        sides = turns.transpose(0, 2, 1)  # rows are the axes of a box
        own = np.broadcast_to(np.eye(3), sides.shape)
        edges = np.cross(own[:, :, None, :], sides[:, None, :, :]).reshape(-1, 9, 3)
        axes = np.concatenate((own, sides, edges), axis=1)
        lengths = np.linalg.norm(axes, axis=2)
        overlap = np.abs(axes) @ self._half - np.abs(np.einsum("nak,nk->na", axes, middles))
        overlap += np.einsum("nai,ni->na", np.abs(axes @ turns), halves)
        parallel = lengths < PARALLEL
        return np.where(parallel, np.inf, overlap / np.where(parallel, 1.0, lengths)).min(axis=1)
