"""Pairs of bodies of a cell: which pairs a scene checks, and with which margins. Arrays and masks, without geometry."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rtc.model.robot.bodies import Bodies
from rtc.model.robot.collision_scene import Scene, in_hands


@dataclass(frozen=True, eq=False)
class CollisionPairs:
    """The pairs to check in a scene and their margins (m), by pair and as matrices [piece][piece]."""

    active: np.ndarray
    numbers: np.ndarray  # of the active ones
    kept: np.ndarray  # their margins
    margin: np.ndarray
    active_matrix: np.ndarray
    margin_matrix: np.ndarray


class PairTable:
    """Masks over the pieces of a cell and over their pairs. A name is an owner (RACK-1) or a part of one."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        pieces = bodies.pieces
        owners = list(dict.fromkeys(piece.owner for piece in pieces))
        self.number = {owner: n for n, owner in enumerate(owners)}
        self.pieces_of = {owner: [n for n, p in enumerate(pieces) if p.owner == owner] for owner in owners}
        self.owner = np.array([self.number[p.owner] for p in pieces])
        self.arm_piece = np.array([p.kind == "arm" for p in pieces])
        self._part = np.array([p.part for p in pieces])
        self._joint = np.array([item.parentJoint for item in bodies.geometry.geometryObjects])  # as the cell begins
        pairs = np.array(bodies.pairs, dtype=int).reshape(-1, 2)
        self.first, self.second = pairs[:, 0], pairs[:, 1]
        region_piece = np.array([p.kind == "region" for p in pieces])
        self.with_region = region_piece[self.first] | region_piece[self.second]  # by pair

    def of_scene(self, scene: Scene) -> CollisionPairs:
        """The active pairs and the margins. Raises ValueError for an unknown body."""
        moving = self.arm_piece.copy()  # pieces that move with an arm
        carrier = self.carriers(scene)
        for name, _ in in_hands(scene):
            moving |= self.owner == self.number[name]
        first, second = self.first, self.second
        if scene.moving:
            moving = carrier == self.number[scene.moving]
        active = moving[first] | moving[second]
        active &= ~self.with_region | self.touches(scene.keep_out)
        for name, arm in in_hands(scene):  # the hand touches what it holds
            hand = self.matching(arm) & np.isin(self._part, list(self._bodies.arms[arm].hand_links))
            active &= ~self.between(hand, self.owner == self.number[name])
        for a, b in scene.ignore:
            active &= ~self.between(self.matching(a), self.matching(b))
        margin = np.where(self._keeps_distance(scene, carrier), self._least_m(scene), 0.0)
        margin[self.touches(scene.near)] = 0.0
        for (a, b), most_m in scene.close.items():
            pair = self.between(self.matching(a), self.matching(b))
            margin[pair] = np.minimum(margin[pair], most_m)
        if scene.arms_apart_m > 0.0:
            by_arm = np.isin(carrier, [self.number[arm] for arm in self._bodies.arms])
            two_arms = by_arm[first] & by_arm[second] & (carrier[first] != carrier[second])
            margin = np.where(two_arms, np.maximum(margin, scene.arms_apart_m), margin)
        numbers = np.flatnonzero(active).astype(np.int32)
        return CollisionPairs(active, numbers, margin[numbers], margin, self.as_matrix(active), self.as_matrix(margin))

    def _keeps_distance(self, scene: Scene, carrier: np.ndarray) -> np.ndarray:
        """Mask of the pairs that a clearance applies to: two bodies that move apart, or a held one and its own arm.

        The links behind the last joint of that arm keep their distance from what the hand holds.
        """
        apart: np.ndarray = carrier[self.first] != carrier[self.second]
        for name, by in scene.held.items():
            links = (self.owner == self.number[by.arm]) & (self._joint != self._bodies.arms[by.arm].hand_joint)
            apart |= self.between(links, self.owner == self.number[name])
        return apart

    def _least_m(self, scene: Scene) -> np.ndarray:
        """The clearance of each pair: that of the scene, but not less than both bodies may be off together."""
        pose_tolerance_m = np.zeros(len(self.owner))
        for name, most_m in scene.pose_tolerance_m.items():
            pose_tolerance_m[self.matching(name)] = most_m
        least: np.ndarray = np.maximum(scene.clearance_m, pose_tolerance_m[self.first] + pose_tolerance_m[self.second])
        return least

    def carriers(self, scene: Scene) -> np.ndarray:
        """Number of the owner that moves each piece."""
        carrier = self.owner.copy()
        for name, arm in in_hands(scene):
            carrier[self.owner == self.number[name]] = self.number[arm]
        return carrier

    def matching(self, name: str) -> np.ndarray:
        """Mask of the pieces of an owner, or of a part of one. Raises ValueError for an unknown owner."""
        owner, _, part = name.partition(" ")
        if owner not in self.number:
            raise ValueError(f"no body {owner} in the cell")
        mask = self.owner == self.number[owner]
        return mask & (self._part == part) if part else mask

    def as_matrix(self, of_pairs: np.ndarray) -> np.ndarray:
        matrix = np.zeros((len(self.owner), len(self.owner)), dtype=of_pairs.dtype)
        matrix[self.first, self.second] = of_pairs
        return matrix

    def between(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Mask of the pairs of one piece in `a` and one piece in `b`."""
        return (a[self.first] & b[self.second]) | (b[self.first] & a[self.second])

    def touches(self, names: Iterable[str]) -> np.ndarray:
        """Mask of the pairs that contain any of these bodies."""
        mask = np.zeros(len(self.owner), dtype=bool)
        for name in names:
            mask |= self.matching(name)
        return mask[self.first] | mask[self.second]
