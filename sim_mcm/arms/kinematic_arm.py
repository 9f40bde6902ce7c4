"""Kinematic arms: they follow their command exactly, among rigid shapes, without physics.

Fast (microseconds per tick) and exact for all except dynamics: joints, frames and contacts of the hand. If a command
would move palm or fingers into an object or seat, the arm keeps its last free position. The wrist sensor then shows the
depth of the command as the force of a stiff spring, so guarded moves find contact. Fingers stop on an object between
them, press with the commanded force, and carry it. A carried object meets the bottom and the catch of a seat
(`kinematic_seats`). Two arms that touch stop, and clearances are watched (`kinematic_watch`). Left out: inertia,
friction, slip, objects that give way, contacts of other links or of a held object with objects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin

from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.model.robot import hulls
from rtc.model.robot.bodies import COAL_SHAPES
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.primitive import ControlLaw
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import (
    TICK_S,
    ArmState,
    CellState,
    HandCommand,
    Motion,
    Near,
    Sample,
    SpindleCommand,
    SpindleState,
    Traits,
)
from sim_mcm.arms import control_laws
from sim_mcm.arms.couplers import Couplers
from sim_mcm.arms.hand import FINGER_N_M
from sim_mcm.arms.kinematic_seats import Seats
from sim_mcm.arms.kinematic_watch import Watch

SPRING_N_M = 50_000.0  # 1 mm of depth gives 50 N; at 20 mm/s each tick adds 1 N
PRESSED_N = 1.0  # force of a contact of two arms, which exact arms do not feel
REACH_M = 0.16  # greatest distance of a part of the hand from the tcp
NOWHERE = geometry.make_pose((0.0, 0.0, 0.0))
SEATED_M = 0.02  # maximum distance from the seated place at which a module counts as seated


class PlacedShape(msgspec.Struct):
    """One convex shape of an object or seat."""

    owner: str  # name of the object or seat
    geometry: Any
    local: Array  # 4 x 4, in the axes of its owner
    radius_m: float
    placed: Any = None  # coal.Transform3s, world
    row: int = 0  # index in the table of all centres


class Touch(msgspec.Struct, frozen=True):
    owner: str
    point: Array  # world
    force: Array  # on the hand, world, N


class KinematicCell:
    """The cell's objects and seats as rigid shapes, with the arms."""

    def __init__(self, cell: cells.Cell) -> None:
        self.cell = cell
        self.poses: dict[str, Array] = {thing.name: cell.object_pose(thing.name) for thing in cell.objects}
        self.poses |= {seat.name: seat.frame.pose for seat in cell.seats}
        self._homes = {thing.name: thing.frame.pose for thing in cell.objects if thing.hinge is not None}
        self.seats = Seats(cell, self.poses)
        self.carried: dict[str, tuple[str, Array]] = {}  # object -> arm, pose in tcp axes
        self.couplers = Couplers(cell)
        self.coupled: dict[str, str] = {}  # hand -> the arm that has it in its coupler
        self.pieces: dict[str, list[PlacedShape]] = {}
        shapes = {thing.name: thing.shapes for thing in cell.objects} | {seat.name: seat.shapes for seat in cell.seats}
        for owner, kinds in shapes.items():
            self.pieces[owner] = [_piece(owner, shape) for shape in kinds]
        self._all = [piece for pieces in self.pieces.values() for piece in pieces]
        self._radii = np.array([piece.radius_m for piece in self._all])
        self._centres = np.zeros((len(self._all), 3))
        for row, piece in enumerate(self._all):
            piece.row = row
        self._sizes = {owner: _size_m(pieces) for owner, pieces in self.pieces.items()}
        self._moved = set(self.pieces)  # owners whose pieces are not yet where their pose is
        self.watch = Watch(cell, self.poses, self.carried)
        self.fixed = {thing.name for thing in cell.objects if thing.fixed} | {seat.name for seat in cell.seats}
        self.arms = {arm.name: KinematicArm(self, arm.name) for arm in cell.arms}

    def step(self) -> None:
        for arm in self.arms.values():
            arm.step()
        for name, (arm_name, grasp) in self.carried.items():
            carrier = self.arms[arm_name]
            if not carrier.turned_rad:
                continue
            hand = carrier.pose
            self.poses[name] = self._hung(name, hand, grasp) if name in self._homes else geometry.compose(hand, grasp)
            self._moved.add(name)
            lever_m = LEVER_M + math.hypot(*grasp[:3]) + self._sizes[name]
            for arm in self.arms.values():
                if arm is not carrier:
                    arm.use_clearance(lever_m * carrier.turned_rad)

        for name, arm_name in self.coupled.items():
            if self.arms[arm_name].turned_rad:
                self.poses[name] = self.couplers.place(name, self.arms[arm_name].joints)
                self._moved.add(name)

    def couple(self, arm: str, before: str, hand: str) -> None:
        """The arm has this hand in its coupler instead of the one before; empty: none. What it lets go of stays."""
        joints = self.arms[arm].joints
        if before:
            del self.coupled[before]
            self.poses[before] = geometry.normalise(self.couplers.place(before, joints))
        if hand:
            self.carried.pop(hand, None)
            self.coupled[hand] = arm
            self.poses[hand] = self.couplers.place(hand, joints)
        self._moved |= {name for name in (before, hand) if name}
        hands = {by: name for name, by in self.coupled.items()}
        self.watch.use(self.cell.with_hands(hands).without_objects(self.coupled) if hands else self.cell)
        for one in self.arms.values():
            one.forget_clearance()

    def _hung(self, name: str, hand: Array, grasp: Array) -> Array:
        """The pose of an object with a hinge, turned to where the hand that holds it is."""
        hinge, home = self.cell.object(name).hinge, self._homes[name]
        assert hinge is not None
        return hinges.at_hand(home, hinge.axis, hinge.range_rad, geometry.inverse(grasp)[:3], hand[:3])

    def _hang(self) -> None:
        """Take over the poses of objects with hinges: where at angle 0 they would be."""
        for name, home in self._homes.items():
            hinge = self.cell.object(name).hinge
            assert hinge is not None
            least, most = hinge.range_rad
            angle = min(max(hinges.angle_of(home, hinge.axis, self.poses[name]), least), most)
            self._homes[name] = hinges.turned(self.poses[name], hinge.axis, -angle)

    def near(self, point: Array, arm: str, margin_m: float = 0.0) -> list[PlacedShape]:
        """Pieces within reach (plus margin) of a hand at `point` (m, world), without those that `arm` carries."""
        while self._moved:
            self._place(self._moved.pop())
        away = np.sqrt(((self._centres - point) ** 2).sum(axis=1)) - self._radii
        carried = {name for name, (by, _) in self.carried.items() if by == arm} | self.coupled.keys()
        found = (self._all[n] for n in np.flatnonzero(away < REACH_M + margin_m))
        return [piece for piece in found if piece.owner not in carried]

    def truth(self) -> dict[str, dict[str, list[float]]]:
        names = [thing.name for thing in self.cell.objects]
        return {
            "poses": {name: self.poses[name].tolist() for name in names},
            "seats": {seat.name: self.poses[seat.name].tolist() for seat in self.cell.seats},
            "velocities": {name: [0.0] * 6 for name in names},
            "tcp": {name: arm.pose.tolist() for name, arm in self.arms.items()},
            "joints": {name: list(arm.joints) for name, arm in self.arms.items()},
            "fingers": {name: list(arm.fingers) for name, arm in self.arms.items()},
        }

    def held(self) -> dict[str, list[str]]:
        return {arm: [name for name, (by, _) in self.carried.items() if by == arm] for arm in self.arms}

    def state(self) -> CellState:
        return CellState(
            arms={name: arm.state() for name, arm in self.arms.items()},
            poses={name: pose.tolist() for name, pose in self.poses.items()},
            carried={name: (arm, grasp.tolist()) for name, (arm, grasp) in self.carried.items()},
        )

    def restore(self, state: CellState) -> None:
        self.poses |= {name: np.array(pose) for name, pose in state.poses.items()}
        self.carried.clear()
        self.carried |= {name: (arm, np.array(grasp)) for name, (arm, grasp) in state.carried.items()}
        for name in self._homes:
            thing = self.cell.object(name)
            if thing.mounted_on is not None:
                self._homes[name] = home_on(self.cell, thing, self.poses[thing.mounted_on])
        self._hang()
        self._moved |= set(self.pieces)
        for name, arm in self.arms.items():
            arm.restore(state.arms[name])

    def displace(self, name: str, offset: Sequence[float]) -> str:
        if name not in self.poses:
            return unknown("object or seat", name, self.poses)
        if name in self.carried:
            return f"{name} is held by {self.carried[name][0]}"
        if name in self.coupled:
            return f"{name} is in the coupler of {self.coupled[name]}"
        before = self.poses[name]
        after = displaced(before, offset)
        along = moves_along(self.cell, name, self.poses)
        if held := [other for other in along if other in self.carried]:
            return f"{held[0]} is held by {self.carried[held[0]][0]}"
        for owner in (name, *along):
            moved = geometry.compose(after, geometry.relative(before, self.poses[owner]))
            self.poses[owner] = geometry.normalise(moved)  # else errors grow with each displacement
            if owner in along and owner in self._homes:
                self._homes[owner] = geometry.compose(after, geometry.relative(before, self._homes[owner]))
            self._moved.add(owner)
        self._hang()
        for arm in self.arms.values():
            arm.forget_clearance()
        return ""

    def stick(self, arm: str, joint: int, stuck: bool) -> None:
        self.arms[arm].stick(joint, stuck)

    def jam(self, seat: str, jammed: bool) -> None:
        self.seats.jam(seat, jammed)
        for arm in self.arms.values():
            arm.forget_clearance()

    def blunt(self, seat: str, blunted: bool) -> str:
        return "a seat without lips is simulated for arms with physics (rtc up --mcm bullet)"

    def strip(self, bolt: str, stripped: bool = True) -> str:
        return "exact arms turn no bolts; arms with physics do (rtc up --mcm bullet)"

    def change_physics(self, mass: float, friction: float) -> str:
        return "kinematic arms have neither mass nor friction"

    def _place(self, owner: str) -> None:
        at = geometry.to_matrix(self.poses[owner])
        for piece in self.pieces[owner]:
            matrix = at @ piece.local
            piece.placed = coal.Transform3s(matrix[:3, :3], matrix[:3, 3])
            self._centres[piece.row] = matrix[:3, 3]


def displaced(pose: Array, offset: Sequence[float]) -> Array:
    """`pose` moved by x y z (m) and turned by roll pitch yaw (rad), in world axes, about its own origin."""
    turned = geometry.compose(geometry.from_rpy((0, 0, 0), offset[3:]), (0.0, 0.0, 0.0, *pose[3:].tolist()))
    return geometry.make_pose(pose[:3] + np.asarray(offset[:3]), turned[3:])


def home_on(cell: cells.Cell, thing: parts.Object, body: geometry.Floats) -> Array:
    """The frame of an object that is mounted on another one with this pose: at angle 0, or tight."""
    assert thing.mounted_on is not None
    return geometry.compose(body, geometry.relative(cell.object_pose(thing.mounted_on), thing.frame.pose))


def moves_along(cell: cells.Cell, name: str, poses: Mapping[str, Array]) -> list[str]:
    """What moves with an object that is displaced: the seat that it sits in, what is mounted on it, and what sits in
    the seats there. With a seat alone nothing moves. `poses`: of all objects and seats, world."""
    objects = {thing.name: thing for thing in cell.objects}
    if name not in objects:
        return []
    mounted = [part.name for part in cell.mounted(name)]
    seats = [seat.name for seat in cell.seats if seat.name in mounted]
    inside = [one for one in objects if any(_sits_in(cell, one, seat, poses) for seat in seats)]
    own = objects[name].seat
    return [*([own] if own is not None and _sits_in(cell, name, own, poses) else []), *mounted, *inside]


def _sits_in(cell: cells.Cell, name: str, seat: str, poses: Mapping[str, Array]) -> bool:
    place = geometry.compose(poses[seat], cell.seat(seat).module_frame.pose)
    return geometry.distance(poses[name], place) < SEATED_M


class KinematicArm:
    def __init__(self, world: KinematicCell, name: str) -> None:
        self._world, self._name = world, name
        spec = self._fit("")
        self._laws = control_laws.known()
        self.joints = list(spec.home_rad)
        self._velocities = [0.0] * len(self.joints)
        self._stuck: dict[int, float] = {}  # joint -> where it is stuck (rad)
        self._wanted = (self.joints, self._velocities)
        self._finger_speeds = [0.0, 0.0]
        self._pressed_n = [0.0, 0.0]
        self._stretched = False  # whether the spring of the fingers has its force: only its limit changes then
        self._pose: Array | None = None  # of the tcp; computed on demand
        self._hand_busy = True  # its command is not yet complete
        self._clear_m = 0.0  # distance that the hand can move without touching anything
        self._clear_of_seats_m = 0.0  # distance that it can move until a seat acts on what it carries
        self.turned_rad = 0.0  # by all joints together, in the latest step
        self._wrench = [0.0] * 6

    def _fit(self, hand: str) -> parts.Arm:
        """Be the arm with this open hand in its coupler; empty: with none."""
        name, whole = self._name, self._world.cell
        cell = whole.with_hands({name: hand}) if hand else whole
        spec = cell.arm(name)
        self.traits = msgspec.structs.replace(Traits.of(cell, name, hand), rigid=True)
        self._model = ArmModel.of(cell, name)
        self._parts = _hand_parts(cell, name)
        self._open(spec.gripper.max_opening_m)
        return spec

    def _open(self, width_m: float) -> None:
        """The fingers are this far open, and stay so."""
        self.fingers = [0.5 * width_m, 0.5 * width_m]
        self._hand = HandCommand(width_m, self.traits.max_grip_n, self.traits.hand_speed_m_s)

    # --- interface to the executor ---------------------------------------------------------------------

    def read(self) -> Sample:
        return Sample(
            self.joints,
            self._velocities,
            self._wrench,
            (self.fingers[0], self.fingers[1]),
            (self._finger_speeds[0], self._finger_speeds[1]),
            (self._pressed_n[0], self._pressed_n[1]),
        )

    def follow(self, motion: Motion) -> None:
        joints, speeds, _ = motion
        if self._stuck:
            joints = [self._stuck.get(n, q) for n, q in enumerate(joints)]
            speeds = [0.0 if n in self._stuck else v for n, v in enumerate(speeds)]
        self._wanted = joints, speeds

    def brake(self, on: bool) -> None:
        """It moves only as commanded."""

    def use_law(self, law: ControlLaw) -> None:
        if law.compliance is not None:
            why = "an exact arm cannot comply; arms with physics can (rtc up --mcm bullet)"
            raise ValueError(f"control law {law.name}: {why}")
        control_laws.make(law, self._model, self._laws)  # only checked: this arm is exact

    def stick(self, joint: int, stuck: bool) -> None:
        if stuck:
            self._stuck[joint] = self.joints[joint]
        else:
            self._stuck.pop(joint, None)

    def feel(self, wrench: list[float]) -> None: ...

    def command_hand(self, command: HandCommand) -> None:
        self._hand = command
        self._hand_busy = True

    def drive_spindle(self, command: SpindleCommand | None) -> None:
        if command is not None:
            raise ValueError("exact arms turn no bolts; arms with physics do (rtc up --mcm bullet)")

    def spindle(self) -> SpindleState:
        return SpindleState()

    def couple(self, hand: str) -> str:
        before, world = self.traits.hand or "", self._world
        if hand == before:
            return ""
        if hand and (why := world.couplers.why_not(self._name, hand, world.poses.get(hand, NOWHERE), self.joints)):
            return why
        self.mount(hand)
        if before:  # the jaws of the coupler are still closed on it
            self._open(world.couplers.point(before).width_m)
        return ""

    def mount(self, hand: str) -> None:
        """Be the arm with this hand in its coupler, where it is."""
        before = self.traits.hand or ""
        self._fit(hand)
        self._pose, self._pressed_n, self._stretched, self._hand_busy = None, [0.0, 0.0], False, True
        self._world.couple(self._name, before, hand)

    def tcp_pose(self, joints: Sequence[float]) -> Array:
        return self._model.fk(joints)

    def jacobian(self, joints: Sequence[float]) -> Array:
        return self._model.jacobian(joints)

    def fault(self) -> str:
        return ""

    def untouched(self) -> bool:
        return not self.arm_touches()

    def touches(self) -> Mapping[str, float]:
        return {}  # left out, see the module docstring

    def arm_touches(self) -> Mapping[str, float]:
        name = self.traits.name
        return {f"{name} touches {other}": PRESSED_N for other in self._world.watch.touching(name, self._all_joints())}

    def near(self, within_m: float) -> Sequence[Near]:
        return self._world.watch.near(self.traits.name, within_m, self._all_joints())

    def _all_joints(self) -> dict[str, list[float]]:
        return {name: arm.joints for name, arm in self._world.arms.items()}

    @property
    def pose(self) -> Array:
        """Present pose of the tcp, world frame."""
        if self._pose is None:
            self._pose = self._model.fk(self.joints)
        return self._pose

    def state(self) -> ArmState:
        a, b = self.fingers
        return ArmState(
            joints=list(self.joints),
            fingers=(a, b),
            hand=self._hand,
            opening_m=a + b,
            coupled=self.traits.hand or "",
        )

    def restore(self, state: ArmState) -> None:
        self.joints = list(state.joints)
        if state.coupled != (self.traits.hand or ""):
            self.mount(state.coupled)
        self.fingers, self._pose = list(state.fingers), None
        self._velocities = [0.0] * len(self.joints)
        self._wanted = (self.joints, self._velocities)
        self.command_hand(state.hand)
        self._stretched = True  # it goes on gripping what it held
        self.forget_clearance()

    # --- simulation step --------------------------------------------------------------------------------

    def step(self) -> None:
        joints, velocities = self._wanted
        before, self.turned_rad = self.joints, 0.0
        self._step(joints, velocities)
        if self.joints is not before:
            self.turned_rad = _turned_rad(before, self.joints)

    def _step(self, joints: list[float], velocities: list[float]) -> None:
        if self._stays_clear(joints):
            if joints != self.joints:
                self.joints, self._pose = joints, None
            self._velocities = velocities
            return
        wanted = self._model.fk(joints)
        may_touch = self._hand_busy or self._clear_m <= 0.0
        touches = list(self._touches(wanted)) if may_touch else []
        seats, blocked = self._seats(wanted, joints == self.joints)
        free = not (touches or blocked)
        if free:
            self.joints, self._velocities, self._pose = joints, velocities, wanted
        else:  # keep the last free position
            self._velocities = [0.0] * len(joints)
        self._move_fingers()
        if free and not self._hand_busy:  # no one asks for the clearances of a busy hand
            if may_touch:
                self._clear_m = self._clearance(wanted)
            away_m = map(self._world.seats.away_m, self._held(wanted).values())
            self._clear_of_seats_m = min(away_m, default=CLEAR_M)
        self._wrench = [a + b for a, b in zip(self._feel(wanted, touches), seats, strict=True)]

    def _held(self, tcp: Array) -> dict[str, Array]:
        """Poses of the objects that this arm carries, for the tcp pose `tcp`."""
        mine = {name: grasp for name, (arm, grasp) in self._world.carried.items() if arm == self.traits.name}
        return {name: geometry.compose(tcp, grasp) for name, grasp in mine.items()}

    def _seats(self, tcp: Array, still: bool) -> tuple[list[float], bool]:
        """(wrench on the hand from seats, through carried objects, in tool axes; whether a seat's bottom blocks)."""
        force, torque, blocked = np.zeros(3), np.zeros(3), False
        for name, pose in self._held(tcp).items():
            for felt in self._world.seats.feel(name, pose, still):
                push = felt.force * (SPRING_N_M * felt.depth_m if felt.depth_m else 1.0)
                force, torque = force + push, torque + np.cross(pose[:3] - tcp[:3], push)
                blocked = blocked or felt.depth_m > 0.0
        if not force.any():
            return [0.0] * 6, False
        turn = geometry.to_matrix(tcp)[:3, :3].T
        return [*(turn @ force).tolist(), *(turn @ torque).tolist()], blocked

    def forget_clearance(self) -> None:
        """Objects have moved: compute the clearance again."""
        self._clear_m = self._clear_of_seats_m = 0.0

    def use_clearance(self, moved_m: float) -> None:
        """What another arm carries has moved by at most this."""
        self._clear_m -= moved_m

    def _stays_clear(self, joints: Sequence[float]) -> bool:
        """Whether the hand cannot touch anything on the way to these joints, no seat acts on what it carries, and its
        fingers rest."""
        if self._hand_busy:
            return False
        if joints is not self.joints:
            moved_m = LEVER_M * _turned_rad(self.joints, joints)
            self._clear_m -= moved_m
            self._clear_of_seats_m -= moved_m
        return self._clear_m > 0.0 and self._clear_of_seats_m > 0.0

    def _clearance(self, pose: Array) -> float:
        tcp = geometry.to_matrix(pose)
        least, near = CLEAR_M, self._world.near(pose[:3], self.traits.name, CLEAR_M)
        travels = dict(zip(FINGERS, self.fingers, strict=True))
        for part, shape, place in self._parts:
            matrix = tcp @ place(travels.get(part, 0.0))
            at = coal.Transform3s(matrix[:3, :3], matrix[:3, 3])
            for piece in near:
                least = min(
                    least, coal.distance(shape, at, piece.geometry, piece.placed, DISTANCE, coal.DistanceResult())
                )
        return least

    def _move_fingers(self) -> None:
        name, command = self.traits.name, self._hand
        missing = command.width_m - sum(self.fingers)
        carrying = [thing for thing, (arm, _) in self._world.carried.items() if arm == name]
        if carrying and missing <= 0.0:
            self._grip(command)
            self._hand_busy = not self._stretched
            return
        if carrying and (less_n := min(self._pressed_n) - _force_of_a_tick(command)) > 0.0:
            self._press(less_n, less_n)
            return
        for thing in carrying:
            del self._world.carried[thing]
        met: list[set[str]] = [set(), set()]
        before = list(self.fingers)
        share = max(-0.5 * command.speed_m_s * TICK_S, min(0.5 * command.speed_m_s * TICK_S, 0.5 * missing))
        for n, finger in enumerate(FINGERS):
            if missing < 0.0:
                met[n] = {touch.owner for touch in self._touches(self.pose, finger, self.fingers[n] + share)}
            if not met[n]:
                self.fingers[n] = max(0.0, min(0.5 * self.traits.max_opening_m, self.fingers[n] + share))
        self._finger_speeds = [(now - then) / TICK_S for now, then in zip(self.fingers, before, strict=True)]
        self._hand_busy = abs(missing) > 1e-9
        between = met[0] & met[1]
        if between:
            self._grip(command)
            self._attach(min(between))
        else:
            self._stretched = False
            aside = 0.5 * FINGER_N_M * (self.fingers[0] - self.fingers[1])
            self._press(aside if met[0] else 0.0, -aside if met[1] else 0.0)

    def _grip(self, command: HandCommand) -> None:
        """With what is between the fingers. As long as with physics, the force grows to that of the command."""
        grown_n = min(self._pressed_n) + _force_of_a_tick(command)
        force_n = command.force_n if self._stretched else min(command.force_n, grown_n)
        self._stretched = force_n == command.force_n
        self._press(force_n, force_n)

    def _press(self, a_n: float, b_n: float) -> None:
        self._pressed_n = [max(0.0, a_n), max(0.0, b_n)]
        if a_n > 0.0 and b_n > 0.0:
            self._finger_speeds = [0.0, 0.0]

    def _attach(self, name: str) -> None:
        if name not in self._world.fixed and name not in self._world.carried:
            grasp = geometry.relative(self.pose, self._world.poses[name])
            self._world.carried[name] = (self.traits.name, grasp)

    def _touches(self, pose: Array, only: str = "", travel: float | None = None) -> Iterator[Touch]:
        """Contacts of palm and fingers (or of one finger at another travel) for the tcp pose `pose`."""
        near = self._world.near(pose[:3], self.traits.name)
        if not near:
            return
        tcp = geometry.to_matrix(pose)
        travels = dict(zip(FINGERS, self.fingers, strict=True))
        for part, shape, place in self._parts:
            if only not in ("", part):
                continue
            matrix = tcp @ place(travels.get(part, 0.0) if travel is None else travel)
            at = coal.Transform3s(matrix[:3, :3], matrix[:3, 3])
            for piece in near:
                result = coal.CollisionResult()
                if coal.collide(shape, at, piece.geometry, piece.placed, REQUEST, result):
                    contact = result.getContact(0)  # the normal points from the first shape to the second
                    force = -SPRING_N_M * abs(contact.penetration_depth) * contact.normal
                    yield Touch(piece.owner, contact.pos, force)

    def _feel(self, pose: Array, touches: list[Touch]) -> list[float]:
        pressing = self._pressed_n[0] > 0.0 or self._pressed_n[1] > 0.0
        if pressing:  # off-centre fingers push the hand sideways
            return [0.0, FINGER_N_M * (self.fingers[0] - self.fingers[1]), 0.0, 0.0, 0.0, 0.0]
        if not touches:
            return [0.0] * 6
        force, torque = np.zeros(3), np.zeros(3)
        for touch in touches:
            force += touch.force
            torque += np.cross(touch.point - pose[:3], touch.force)
        turn = geometry.to_matrix(pose)[:3, :3].T
        return [*(turn @ force).tolist(), *(turn @ torque).tolist()]


def _force_of_a_tick(command: HandCommand) -> float:
    """By how much the force of the fingers changes in a tick: their setpoint moves, and stretches their spring."""
    return 0.5 * FINGER_N_M * command.speed_m_s * TICK_S


def _turned_rad(before: Sequence[float], after: Sequence[float]) -> float:
    """By all joints together."""
    return sum(abs(a - b) for a, b in zip(before, after, strict=True))


FINGERS = ("finger-a", "finger-b")
LEVER_M = 1.2  # greatest distance of a part of the hand from a joint axis
CLEAR_M = 0.10  # greater clearances are not computed
DISTANCE = coal.DistanceRequest()
REQUEST = coal.CollisionRequest()
REQUEST.enable_contact = True
REQUEST.num_max_contacts = 1


def _hand_parts(cell: cells.Cell, arm: str) -> list[tuple[str, Any, Callable[[float], Array]]]:
    """(name, coal shape, finger travel -> 4 x 4 in tcp axes) of palm and fingers, from the URDF's collision shapes."""
    spec = cell.arm(arm)
    model = pin.buildModelFromXML(cell.urdf(arm))
    shapes = hulls.shapes(model, cell.urdf(arm), cell.texts)
    data, shape_data = model.createData(), shapes.createData()
    names = {spec.gripper.palm_link: "palm", **dict(zip(spec.gripper.finger_links, FINGERS, strict=True))}
    found: list[tuple[str, Any, Callable[[float], Array]]] = []
    at_zero, at_one = (_placements(model, data, shapes, shape_data, spec, travel) for travel in (0.0, 0.01))
    for n, shape in enumerate(shapes.geometryObjects):
        link = model.frames[shape.parentFrame].name
        if link in names:
            begin, way = at_zero[n], (at_one[n] - at_zero[n]) / 0.01
            found.append((names[link], shape.geometry, _sliding(begin, way)))
    return found


def _sliding(begin: Array, way: Array) -> Callable[[float], Array]:
    return lambda travel: begin + travel * way


def _placements(model: Any, data: Any, shapes: Any, shape_data: Any, spec: parts.Arm, travel: float) -> list[Array]:
    q = pin.neutral(model)
    for joint in spec.gripper.finger_joints:
        q[model.joints[model.getJointId(joint)].idx_q] = travel
    pin.framesForwardKinematics(model, data, q)
    pin.updateGeometryPlacements(model, data, shapes, shape_data)
    tcp = data.oMf[model.getFrameId(spec.tcp_link)].inverse()
    return [(tcp * placement).homogeneous for placement in shape_data.oMg]


def _size_m(pieces: Sequence[PlacedShape]) -> float:
    """No point of the pieces is farther from the frame of their owner."""
    return max((float(np.linalg.norm(piece.local[:3, 3])) + piece.radius_m for piece in pieces), default=0.0)


def _piece(owner: str, shape: parts.AnyShape) -> PlacedShape:
    made = COAL_SHAPES[type(shape)](shape)
    made.computeLocalAABB()
    return PlacedShape(owner, made, geometry.to_matrix(shape.frame.pose), float(made.aabb_radius))
