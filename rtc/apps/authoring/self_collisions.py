"""Which pairs of an arm's links need no collision check: neighbours, and pairs that never or always touch.

Random postures show which pairs always touch. A pair that touches in none of them may still do so in rare postures, so
the nearest of them are bent further towards contact. Only a pair that does not come within `NEAR_M` then is left out of
the checks. The result is an SRDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from rtc.apps.authoring.robot_file import RobotFile, kinematics
from rtc.model.robot import hulls
from rtc.spatial.geometry import Array

SEED, SAMPLES = 1, 1200
NEAREST, STEPS, STEP = 6, 70, 0.3  # postures that are bent towards contact, steps each, and the first step (rad, m)
NEAR_M = 0.005
ALWAYS = 0.95  # share of the postures in which a pair touches, so that its check would refuse nearly everything
OFTEN = 0.30  # a share beyond this is stated as a note

Pair = frozenset[str]


def srdf(robot: RobotFile, urdf: str, texts: Mapping[str, str]) -> tuple[str, list[str]]:
    """The SRDF text of an arm, and notes on pairs that collide often. `texts`: hulls by file name."""
    rows, notes = pairs(robot, urdf, texts)
    lines = [
        f'  <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} reason="{reason}"/>'
        for (a, b), reason in sorted((sorted(links), reason) for links, reason in rows.items())
    ]
    intro = f"Pairs of links that need no collision check: neighbours, and others by {SAMPLES} sampled postures."
    head = f'<?xml version="1.0"?>\n<!-- {intro} -->\n<robot name={quoteattr(robot.name)}>\n'
    return head + "\n".join(lines) + "\n</robot>\n", notes


def pairs(robot: RobotFile, urdf: str, texts: Mapping[str, str]) -> tuple[dict[Pair, str], list[str]]:
    """(pair -> Adjacent, Default (two fingers, which touch in a closed hand), Always or Never; notes)."""
    model = kinematics(urdf, robot.path)
    shapes = hulls.shapes(model, urdf, texts)
    links = [item.name.rsplit("_", 1)[0] for item in shapes.geometryObjects]
    rows = dict.fromkeys(adjacent(robot, set(links)), "Adjacent") | dict.fromkeys(_fingers(robot), "Default")
    for i, j in combinations(range(len(links)), 2):
        if links[i] != links[j] and frozenset((links[i], links[j])) not in rows:
            shapes.addCollisionPair(pin.CollisionPair(i, j))
    named = [frozenset((links[pair.first], links[pair.second])) for pair in shapes.collisionPairs]
    apart = _Apart(model, shapes)
    distances = apart.of_samples()
    touching: dict[Pair, float] = {}  # several shapes of two links count as one pair: its most frequent contact
    nearest: dict[Pair, float] = {}
    for n, links_of_pair in enumerate(named):
        share = float((distances[:, n] <= 0.0).mean())
        touching[links_of_pair] = max(share, touching.get(links_of_pair, 0.0))
        least_m = 0.0 if share else apart.least_m(n, distances[:, n])
        nearest[links_of_pair] = min(least_m, nearest.get(links_of_pair, np.inf))
    rows |= {pair: "Never" for pair, least_m in nearest.items() if least_m > NEAR_M}
    rows |= {pair: "Always" for pair, share in touching.items() if share >= ALWAYS}
    notes = [
        f"{' and '.join(sorted(pair))} touch in {share:.0%} of all postures: their hulls may be too wide"
        for pair, share in touching.items()
        if OFTEN < share < ALWAYS
    ]
    return rows, notes


class _Apart:
    """Distances between the shapes of one arm, at random postures and near them."""

    def __init__(self, model: Any, shapes: Any) -> None:
        self._model, self._shapes = model, shapes
        self._data, self._shape_data = model.createData(), shapes.createData()
        self._random = np.random.default_rng(SEED)
        self._lower, self._upper = model.lowerPositionLimit, model.upperPositionLimit
        self._postures = self._random.uniform(self._lower, self._upper, (SAMPLES, model.nq))

    def of_samples(self) -> Array:
        """[postures][pairs], m; 0 or less in contact."""
        rows = np.empty((SAMPLES, len(self._shapes.collisionPairs)))
        for n, q in enumerate(self._postures):
            pin.computeDistances(self._model, self._data, self._shapes, self._shape_data, q)
            rows[n] = [result.min_distance for result in self._shape_data.distanceResults]
        return rows

    def least_m(self, pair: int, distances: Array) -> float:
        """The least distance of a pair that is found from its nearest postures."""
        least_m = np.inf
        for n in np.argsort(distances, kind="stable")[:NEAREST]:
            q, here_m = self._postures[n], float(distances[n])
            for step in np.linspace(STEP, 0.02, STEPS):
                tried = np.clip(q + self._random.normal(scale=step, size=len(q)), self._lower, self._upper)
                there_m = self._distance(pair, tried)
                if there_m < here_m:
                    q, here_m = tried, there_m
                if here_m <= NEAR_M:
                    return here_m
            least_m = min(least_m, here_m)
        return least_m

    def _distance(self, pair: int, q: Array) -> float:
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._shape_data, q)
        return float(pin.computeDistance(self._shapes, self._shape_data, pair).min_distance)


def adjacent(robot: RobotFile, solid: set[str]) -> set[Pair]:
    """Pairs of solid links that are rigidly connected, or have one moving joint between them."""
    body = {link: _carrying(robot, link) for link in robot.links}
    neighbours = {frozenset((body[robot.parent[j]], body[robot.child[j]])) for j in robot.joints}
    return {
        frozenset(pair)
        for pair in combinations(solid, 2)
        if body[pair[0]] == body[pair[1]] or frozenset(body[link] for link in pair) in neighbours
    }


def without_shape(robot: RobotFile) -> list[str]:
    """The first link of each moving rigid body of which no link has a collision shape."""
    shaped = {_carrying(robot, name) for name, link in robot.links.items() if link.find("collision") is not None}
    bodies = {_carrying(robot, name): None for name in robot.links}
    return [name for name in bodies if name not in shaped and name != robot.root]


def _fingers(robot: RobotFile) -> set[Pair]:
    """Pairs of links that slide on the same link."""
    slides = [joint for joint in robot.joints if robot.type(joint) == "prismatic"]
    return {
        frozenset((robot.child[a], robot.child[b]))
        for a, b in combinations(slides, 2)
        if robot.parent[a] == robot.parent[b]
    }


def _carrying(robot: RobotFile, link: str) -> str:
    """The first link of the rigid body that a link belongs to."""
    while link in robot.carrier and robot.type(robot.carrier[link]) == "fixed":
        link = robot.parent[robot.carrier[link]]
    return link
