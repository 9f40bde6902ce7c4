"""Which pairs of an arm's links need no collision check: neighbours, and pairs that sampling never or always finds.

The result is an SRDF. A pair is left out of the checks only if it stays `NEAR_M` apart in every sampled posture.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin

from rtc.authoring.robot_file import RobotFile
from rtc.robot import hulls

SEED, SAMPLES = 1, 2000
NEAR_M = 0.02
ALWAYS = 0.95  # share of the postures in which a pair collides, so that its check would refuse nearly everything
OFTEN = 0.30  # a share beyond this is stated as a note

Pair = frozenset[str]


def srdf(robot: RobotFile, urdf: str, texts: Mapping[str, str]) -> tuple[str, list[str]]:
    """The SRDF text of an arm, and notes on pairs that collide often. `texts`: hulls by file name."""
    rows, notes = pairs(robot, urdf, texts)
    lines = [
        f'  <disable_collisions link1="{a}" link2="{b}" reason="{reason}"/>'
        for (a, b), reason in sorted((sorted(links), reason) for links, reason in rows.items())
    ]
    intro = f"Pairs of links that need no collision check: neighbours, and others by {SAMPLES} sampled postures."
    head = f'<?xml version="1.0"?>\n<!-- {intro} -->\n<robot name="{robot.name}">\n'
    return head + "\n".join(lines) + "\n</robot>\n", notes


def pairs(robot: RobotFile, urdf: str, texts: Mapping[str, str]) -> tuple[dict[Pair, str], list[str]]:
    """(pair -> Adjacent, Always or Never; notes)."""
    model = pin.buildModelFromXML(urdf)
    shapes = hulls.shapes(model, urdf, texts)
    links = [item.name.rsplit("_", 1)[0] for item in shapes.geometryObjects]
    rows = dict.fromkeys(adjacent(robot, set(links)), "Adjacent")
    for i, j in combinations(range(len(links)), 2):
        if links[i] != links[j] and frozenset((links[i], links[j])) not in rows:
            shapes.addCollisionPair(pin.CollisionPair(i, j))
    near, hit = np.zeros(len(shapes.collisionPairs)), np.zeros(len(shapes.collisionPairs))
    near_data, hit_data = shapes.createData(), shapes.createData()
    for request in near_data.collisionRequests:
        request.security_margin = NEAR_M
    data = model.createData()
    for q in np.random.default_rng(SEED).uniform(
        model.lowerPositionLimit, model.upperPositionLimit, (SAMPLES, model.nq)
    ):
        near += _collisions(model, data, shapes, near_data, q)
        if near.any():
            hit += _collisions(model, data, shapes, hit_data, q)
    return _judged(rows, [(links[p.first], links[p.second]) for p in shapes.collisionPairs], near, hit)


def _collisions(model: Any, data: Any, shapes: Any, shape_data: Any, q: Any) -> Any:
    pin.computeCollisions(model, data, shapes, shape_data, q, False)
    return np.array([result.isCollision() for result in shape_data.collisionResults])


def _judged(
    rows: dict[Pair, str], named: list[tuple[str, str]], near: Any, hit: Any
) -> tuple[dict[Pair, str], list[str]]:
    """Several shapes of two links count as one pair: its most frequent contact."""
    share: dict[Pair, tuple[float, float]] = {}
    for (a, b), n, h in zip(named, near / SAMPLES, hit / SAMPLES, strict=True):
        before = share.get(frozenset((a, b)), (0.0, 0.0))
        share[frozenset((a, b))] = max(before[0], n), max(before[1], h)
    rows |= {links: "Never" for links, (n, _) in share.items() if n == 0.0}
    rows |= {links: "Always" for links, (_, h) in share.items() if h >= ALWAYS}
    notes = [
        f"{' and '.join(sorted(links))} touch in {h:.0%} of all postures: their hulls may be too wide"
        for links, (_, h) in share.items()
        if OFTEN < h < ALWAYS
    ]
    return rows, notes


def adjacent(robot: RobotFile, solid: set[str]) -> set[Pair]:
    """Pairs of solid links that are rigidly connected, or have one moving joint between them."""
    body = {link: _carrying(robot, link) for link in robot.links}
    neighbours = {frozenset((body[robot.parent[j]], body[robot.child[j]])) for j in robot.joints}
    return {
        frozenset(pair)
        for pair in combinations(solid, 2)
        if body[pair[0]] == body[pair[1]] or frozenset(body[link] for link in pair) in neighbours
    }


def _carrying(robot: RobotFile, link: str) -> str:
    """The first link of the rigid body that a link belongs to."""
    while link in robot.carrier and robot.type(robot.carrier[link]) == "fixed":
        link = robot.parent[robot.carrier[link]]
    return link
