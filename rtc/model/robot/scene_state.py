"""The bodies of one cell at the present joint values, in the present scene: which pairs are too near, and how far.

coal and the compiled boxes have the same bodies. What changes is passed to coal only when it is asked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from rtc.model.cells import cell as cells
from rtc.model.robot import bodies
from rtc.model.robot.boxes import boxes_of
from rtc.model.robot.collision_pairs import CollisionPairs, PairTable
from rtc.model.robot.collision_scene import AS_BUILT, Scene, in_hands, same_places
from rtc.model.robot.levers import ball, levers, of_pairs
from rtc.protocol import causes
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import hinges
from rtc.spatial.geometry import Array, Floats

KEPT_SCENES = 64  # maximum number of scenes whose active pairs and margins are kept


@dataclass(frozen=True)
class Collision:
    """Two bodies in contact or nearer than the clearance. A negative distance is the penetration depth."""

    body_a: str
    body_b: str
    distance_m: float
    point: tuple[float, float, float]  # world frame, midway between the nearest points
    margin_m: float = 0.0  # the clearance of this pair

    def refusal(self, where: str = "") -> Refusal:
        verb, needed = "collides with", ""
        if self.distance_m > 0:
            verb, needed = f"comes within {_mm(self.distance_m)} of", f" ({_mm(self.margin_m)} needed)"
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=f"{self.body_a} {verb} {self.body_b}{needed}" + (f" {where}" if where else ""),
            where=where,
            clears=by_person(f"another goal: {self.body_b.split()[0]} is in the way"),
            cause=causes.Collides(
                body_a=self.body_a,
                body_b=self.body_b,
                distance_m=self.distance_m,
                margin_m=self.margin_m,
                x_m=self.point[0],
                y_m=self.point[1],
                z_m=self.point[2],
            ),
        )


class Nearest(NamedTuple):
    """How far two bodies are apart, below 0 how deep they are in one another."""

    distance_m: float
    points: tuple[Array, Array]  # one of each (m, world)
    normal: Array  # unit vector from the first to the second


def _mm(metres: float) -> str:
    return f"{math.floor(1e4 * metres + 1e-6) / 10:g} mm"  # never more than there is


class SceneState:
    """All bodies of a cell, for the checks of a `CollisionWorld`. Write joint values into `q`, then ask.

    Not thread-safe. `boxes`: the compiled proof that is asked before coal; None without it.
    """

    def __init__(self, cell: cells.Cell, *, boxes: bool) -> None:
        self._cell = cell
        self.bodies = bodies.build(cell)
        self.data = self.bodies.model.createData()
        self.geometry_data = self.bodies.geometry.createData()
        # The naive one is the fastest of pinocchio's broad phases here (70 boxes: 18 us; tree 49 us, pair list 300 us).
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(
            self.bodies.model, self.bodies.geometry, self.geometry_data
        )
        self._callback = pin.CollisionCallBackDefault(self.bodies.geometry, self.geometry_data, True)
        self.hit = 0  # the pair that a check has found
        self._left_out: set[int] = set()  # pairs that no check finds
        self.q = pin.neutral(self.bodies.model)
        self._places = {name: np.array(slots.joints) for name, slots in self.bodies.arms.items()}
        self.varying: list[int] = []  # joints of the arms that the scene checks
        self.scene: Scene | None = None
        self._placed: dict[str, tuple[str, list[float]]] = {}  # body -> the arm that holds it, and its pose there
        self._elsewhere: dict[str, tuple[int, pin.SE3]] = {}  # bodies that coal has not yet: parent joint, pose there
        self._pairs_of_coal: CollisionPairs | None = None  # the pairs that coal has
        self._pairs_of_scene: dict[tuple[object, ...], CollisionPairs] = {}  # by all that `PairTable.of_scene` reads
        self._joints_before: dict[tuple[str, int], int] = {}  # by arm and joint
        self._pair_levers: dict[int, Array] = {}  # by the first joint of an arm
        self.table = PairTable(self.bodies)
        self._measure_bodies()
        self.boxes = boxes_of(self.bodies, self.levers) if boxes else None
        self._put_in_force(self.table.of_scene(AS_BUILT))
        self.arrange(AS_BUILT)

    def update(self, joints: Mapping[str, Floats], scene: Scene) -> None:
        """Takes the joint values (rad) of every arm, and this scene. Raises ValueError."""
        if scene is not self.scene:
            self.arrange(scene)
        for name, place in self._places.items():
            if name not in joints:
                raise ValueError(f"joints of {name} are missing: a check needs those of every arm")
            self.q[place] = joints[name]

    def arrange(self, scene: Scene) -> None:
        """Applies a scene: poses, parents and openings; then active pairs and margins."""
        before, self.scene = self.scene, None  # None until done: after an error the scene is applied in part only
        # Scenes often differ only in active pairs and margins; then no body has to be placed again.
        if before is None or not same_places(before, scene):
            self._place_bodies(scene)
        self._switch(scene)
        self.scene = scene

    def turn_attached(self, scene: Scene) -> None:
        """Turns the attached objects of a scene to the hands that hold them at the present configuration."""
        pin.forwardKinematics(self.bodies.model, self.data, self.q)
        for name, body in scene.attached.items():
            hand = self.bodies.arms[body.arm]
            tcp = (self.data.oMi[hand.hand_joint] * hand.tcp).translation
            self._placed.pop(name, None)  # elsewhere than in the scene
            self._place_body(name, "", hinges.at_hand(body.home, body.axis, body.range_rad, body.point, tcp))

    def touches_any(self) -> bool:
        """Whether a pair is too near at the present configuration; it is `hit` then."""
        bodies, data = self.bodies, self.geometry_data
        if self.boxes is None:
            self.tell_coal()
            touches = bool(pin.computeCollisions(bodies.model, self.data, self._manager, self._callback, self.q))
            self.hit = self._callback.collisionPairIndex
            return touches
        near = [pair for pair in self.boxes.undecided(self.q, self.varying) if pair not in self._left_out]
        if near:
            self.place()
        for pair in near:
            if pin.computeCollision(bodies.geometry, data, pair):
                self.hit = pair
                return True
        return False

    def hits(self) -> list[int]:
        """All pairs that are too near at the present configuration."""
        data = self.geometry_data
        if self.boxes is not None:
            self.place()
            near = self.boxes.undecided(self.q, self.varying)
            return [n for n in near if pin.computeCollision(self.bodies.geometry, data, n)]
        self.tell_coal()
        pin.computeCollisions(self.bodies.model, self.data, self.bodies.geometry, data, self.q, False)
        active = np.flatnonzero(self.pairs.active).tolist()
        return [n for n in active if data.collisionResults[n].isCollision()]

    def ask(self) -> Collision | None:
        return self.describe(self.hit) if self.touches_any() else None

    def describe(self, pair: int) -> Collision:
        i, j = self.bodies.pairs[pair]
        nearest = self.nearest(pair)
        x, y, z = (float(n) for n in 0.5 * (nearest.points[0] + nearest.points[1]))
        first, second = self.bodies.pieces[i], self.bodies.pieces[j]
        if first.kind == "movable" and second.kind in ("arm", "base"):
            first, second = second, first
        return Collision(first.label, second.label, nearest.distance_m, (x, y, z), float(self.pairs.margin[pair]))

    def nearest(self, pair: int) -> Nearest:
        """Where the two bodies of a pair are nearest to each other, or deepest in one another."""
        result, numbers = coal.DistanceResult(), self.bodies.pairs[pair]
        a, b = (self.bodies.geometry.geometryObjects[n].geometry for n in numbers)
        placements = (self.geometry_data.oMg[n] for n in numbers)
        at, bt = (coal.Transform3s(one.rotation, one.translation) for one in placements)
        distance_m = float(coal.distance(a, at, b, bt, coal.DistanceRequest(), result))
        points = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
        return Nearest(distance_m, points, np.array(result.normal))

    def joints_before(self, arm: str, piece: int) -> int:
        """How many joints of an arm move a piece where it is now."""
        known, joint = self._joints_before, self.bodies.geometry.geometryObjects[piece].parentJoint
        if (arm, joint) not in known:
            slots, joints = self.bodies.arms[arm].joints, self.bodies.model.joints
            known[arm, joint] = sum(joints[n].idx_q in slots for n in self.bodies.model.supports[joint] if n)
        return known[arm, joint]

    def distance_m(self, pair: int) -> float:
        return float(pin.computeDistance(self.bodies.geometry, self.geometry_data, pair).min_distance)

    def leave_out(self, pair: int) -> None:
        """Let no check find this pair, until it is counted again."""
        self._left_out.add(pair)
        self.geometry_data.deactivateCollisionPair(pair)

    def count_again(self, pair: int) -> None:
        self._left_out.discard(pair)
        self.geometry_data.activateCollisionPair(pair)

    def levers_of_pairs(self, slots: list[int]) -> Array:
        """The levers of an arm's joints on the distance of each pair, [pairs][joints]."""
        known = self._pair_levers.get(slots[0])
        if known is None:
            levers = self.levers[:, slots]
            known = self._pair_levers[slots[0]] = of_pairs(levers[self.table.first], levers[self.table.second])
        return known

    def place(self) -> None:
        """Moves all pieces to the present configuration."""
        self.tell_coal()
        bodies, data = self.bodies, self.geometry_data
        pin.updateGeometryPlacements(bodies.model, self.data, bodies.geometry, data, self.q)

    def _place_bodies(self, scene: Scene) -> None:
        """Sets the openings, and the poses and parents of the bodies that are elsewhere than in the scene before."""
        for name, slots in self.bodies.arms.items():
            opening = scene.openings_m.get(name, self._cell.arm(name).gripper.max_opening_m)
            self.q[slots.fingers] = 0.5 * opening
        for owner, built in self._built_pose.items():
            held = scene.held.get(owner)
            pose = scene.poses.get(owner, built) if held is None else held.pose
            wanted = ("" if held is None else held.arm, pose if pose is built else np.asarray(pose).tolist())
            if self._placed.get(owner) != wanted:
                self._placed.pop(owner, None)
                self._place_body(owner, *wanted)
                self._placed[owner] = wanted

    def _place_body(self, owner: str, holder: str, pose: Floats) -> None:
        """Places the pieces of a body: in the world, or in the hand of an arm."""
        parent, at = 0, bodies.se3(pose)
        if holder:
            hand = self.bodies.arms[holder]
            parent, at = hand.hand_joint, hand.tcp * at
        pieces = self.table.pieces_of.get(owner, [])
        if not pieces:
            return
        if parent or self.levers[pieces[0]].any():  # all of them have the same
            self.levers[pieces] = levers(self.bodies.model, parent, at.translation, self.radius_m.get(owner, 0.0))
            self._pair_levers.clear()
        self._elsewhere[owner] = parent, at
        if self.boxes is not None:
            self.boxes.place(pieces, parent, at)

    def _switch(self, scene: Scene) -> None:
        """Sets the active pairs and the margins of a scene."""
        arms = [scene.moving] if scene.moving else list(self.bodies.arms)
        self.varying = [slot for name in arms for slot in self.bodies.arms[name].joints]
        held = in_hands(scene)
        unsure, close = tuple(scene.pose_tolerance_m.items()), tuple(scene.close.items())
        lists = map(tuple, (scene.ignore, scene.near, scene.keep_out))
        rules = (scene.moving, held, unsure, close, *lists, scene.clearance_m, scene.arms_apart_m)
        pairs = self._pairs_of_scene.get(rules)
        if pairs is None:
            if len(self._pairs_of_scene) >= KEPT_SCENES:
                del self._pairs_of_scene[next(iter(self._pairs_of_scene))]
            pairs = self._pairs_of_scene[rules] = self.table.of_scene(scene)
        if pairs is not self.pairs:
            self._put_in_force(pairs)

    def _put_in_force(self, pairs: CollisionPairs) -> None:
        if self.boxes is not None:
            self.boxes.use(pairs.numbers, pairs.kept)
        self.pairs = pairs

    def tell_coal(self) -> None:
        """Brings coal up to the scene. Where boxes decide a whole job it is never needed."""
        for owner, (parent, at) in self._elsewhere.items():
            items, pieces = self.bodies.geometry.geometryObjects, self.bodies.pieces
            for n in self.table.pieces_of.get(owner, ()):
                items[n].parentJoint, items[n].placement = parent, at * pieces[n].in_owner
        self._elsewhere.clear()
        pairs, before = self.pairs, self._pairs_of_coal
        if pairs is before:
            return
        # Set as matrices: a loop over 1700 pairs would take 5 ms.
        if before is None or not np.array_equal(before.active, pairs.active):
            self.geometry_data.setActiveCollisionPairs(self.bodies.geometry, pairs.active_matrix)
        self.geometry_data.setSecurityMargins(self.bodies.geometry, pairs.margin_matrix)
        self._pairs_of_coal = pairs

    def _measure_bodies(self) -> None:
        """Sets the levers, sizes and built poses of all bodies."""
        pieces = self.bodies.pieces
        items = self.bodies.geometry.geometryObjects
        balls = [ball(item.geometry, piece.in_owner) for item, piece in zip(items, pieces, strict=True)]
        joints = [item.parentJoint for item in items]
        self.levers = np.array(
            [levers(self.bodies.model, joint, *around) for joint, around in zip(joints, balls, strict=True)]
        )
        #: radius of a ball around the origin of each owner, for a body that is held
        self.radius_m = {
            owner: max(math.hypot(*balls[n][0]) + balls[n][1] for n in numbers)
            for owner, numbers in self.table.pieces_of.items()
        }
        self._built_pose = {seat.name: np.asarray(seat.frame.pose).tolist() for seat in self._cell.seats}
        self._built_pose |= {n.name: np.asarray(self._cell.object_pose(n.name)).tolist() for n in self._cell.objects}
        self._built_pose |= {region.name: np.asarray(region.frame.pose).tolist() for region in self._cell.regions}
