"""Arms and cell in pybullet at 1 kHz: torques in; joint angles, wrench and contacts out.

Forces alone move things: friction between pressing fingers holds an object. docs/physics.md gives the reasons and the
measured values of the parameters. This module must not know primitives.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
import pybullet

from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.model.robot.finger_mass import finger_mass, require_stable
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.primitive import ControlLaw, Load
from rtc.protocol.spelling import unknown
from rtc.runtime.environment import physics_seed
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import (
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
from sim_mcm.arms import unrolled
from sim_mcm.arms.bolts import Bolts
from sim_mcm.arms.bullet_world import STEP_S, PhysicsWorld
from sim_mcm.arms.couplers import Couplers
from sim_mcm.arms.detents import Detents
from sim_mcm.arms.hand import SimulatedHand
from sim_mcm.arms.hand_weight import HandWeight, PadTwist
from sim_mcm.arms.joint_torques import JointTorques
from sim_mcm.arms.kinematic_arm import displaced, home_on, moves_along
from sim_mcm.arms.servo import Servo
from sim_mcm.arms.sockets import ConnectorSockets

FINGER_FRICTION = 1.0
SPINNING_FRICTION = 0.012  # m, of a soft pad; a smaller value lets a module turn between the pads
PERTURBED = 0.05  # share, of masses and friction, if RTC_PHYSICS_SEED is set
GRIPS_N = 1.0  # a hand whose fingers press less holds nothing
LOCKED_N = 1e4  # N or N.m, of a joint that is stuck or braked: more than any servo exerts
NOTHING: Mapping[str, float] = {}
TORQUE_CONTROL = pybullet.TORQUE_CONTROL
BODY_B, LINK_A, LINK_B, ON_B, NORMAL_ON_B, DISTANCE, NORMAL_FORCE = 2, 3, 4, 6, 7, 8, 9  # fields of a contact point


class BulletArm:
    """One arm of the world: its body, sensors and motors."""

    def __init__(self, world: PhysicsWorld, name: str, bolts: Bolts, couplers: Couplers) -> None:
        self._bolts, self._couplers = bolts, couplers
        self._name = name
        self._world = world
        self._client = world.client
        self._friction = 1.0  # of the pads, as a share
        self.others: list[BulletArm] = []  # the other arms of the world
        self._law: ControlLaw | None = None
        self._stuck: set[int] = set()  # joints
        self._fit("")

    def _fit(self, hand: str) -> None:
        """Be the arm with this hand in its coupler, at home; empty: with none."""
        name, world = self._name, self._world
        cell = self._cell = world.cell.with_hands({name: hand}) if hand else world.cell
        spec = cell.arm(name)
        self.traits = Traits.of(cell, name, hand)
        self._model = ArmModel.of(cell, name)
        self.body = world.load_arm(name, cell)
        links = self._indices(12)
        joints = self._indices(1)
        self._arm = [joints[joint] for joint in spec.joints]
        self._finger_joints = [joints[joint] for joint in spec.gripper.finger_joints]
        self.fingers = [links[link] for link in spec.gripper.finger_links]
        self._links = {n: link for link, n in links.items()}
        self._moved_by = self._joints_before()
        self._all = [*self._arm, *self._finger_joints]
        self._dof = len(self._arm)
        self._zeros = [0.0] * len(self._all)
        sensor = None if spec.sensor_joint is None else joints[spec.sensor_joint]
        self._split = unrolled.split_states(self._dof)
        self._read_from = [*self._all, self._all[-1] if sensor is None else sensor]
        of_hand = {*self.fingers, links[spec.gripper.palm_link], links.get(spec.tcp_link, -1)}
        self.upstream = {n: link for link, n in links.items() if n not in of_hand}
        self._wrench = _no_wrench if sensor is None else _wrench_at_tcp(cell, name, self._centre(sensor))
        self._under_gravity = any(world.cell.gravity_m_s2)
        self._prepare(spec, sensor)
        self._load: Load | None = None  # of the present control law
        self._hand_weight: HandWeight | None = None
        if sensor is not None and self._under_gravity:
            inertia = self._hand_inertia(sensor)
            self._hand_weight = HandWeight(inertia, world.cell.gravity_m_s2)
            self._pad_twist = PadTwist(self._model, inertia)
        self._driven: tuple[Sample, list[float]] | None = None  # sample and torques of the latest step
        self._braked = self._hand_braked = False
        self._zero_torques = [0.0] * self._dof
        self._points: Sequence[tuple[Any, ...]] | None = None  # contacts of the latest step
        self._servo = Servo(self._model, spec.home_rad)
        self._estimate = JointTorques(self._model) if sensor is None else None
        self._weightless = self._hand_weight is None and self._estimate is None  # the sensor reads the wrench itself
        self._finger_kg = finger_mass(cell, name).felt_kg
        self._hand = SimulatedHand(
            HandCommand(spec.gripper.max_opening_m, spec.gripper.max_force_n, spec.gripper.speed_m_s),
            spec.gripper.max_opening_m,
            self._finger_kg,
        )
        self._pressed = (0.0, 0.0)  # by the fingers, towards the middle
        self._sample = self.read()

    # --- interface to the executor ---------------------------------------------------------------------

    def read(self) -> Sample:
        states = pybullet.getJointStates(self.body, self._read_from, self._client)
        joints, speeds, fingers, finger_speeds, reaction = self._split(states)
        wrench = self._wrench(reaction)
        if not self._weightless:
            wrench = self._without_weight(wrench, joints, speeds)
        self._sample = sample = Sample(joints, speeds, wrench, fingers, finger_speeds, self._pressed)
        return sample

    def _without_weight(self, wrench: list[float], joints: list[float], speeds: list[float]) -> list[float]:
        """The wrench without the weight of hand and load, or the one estimated from the joint torques."""
        if self._hand_weight is not None:
            if min(self._pressed) > GRIPS_N and self._driven is not None and not (self._stuck or self._braked):
                before, torques = self._driven
                acceleration = (np.array(speeds) - before.velocities) / STEP_S
                wrench = self._pad_twist.added(wrench, before.joints, before.velocities, acceleration, torques)
            wrench = self._hand_weight.removed(wrench, self._model.fk(joints), self._load)
        if self._estimate is not None:
            wrench = [0.0] * 6 if self._braked else self._estimate.wrench(joints, speeds)
        return wrench

    def follow(self, motion: Motion) -> None:
        self._servo.wanted = motion

    def brake(self, on: bool) -> None:
        self._braked, self._hand_braked = on, on and not self.pressed_on()
        for joint, index in enumerate(self._arm):
            self._lock(index, on or joint in self._stuck)
        for finger in self._finger_joints:
            self._lock(finger, self._hand_braked)
        if self._estimate is not None:
            self._estimate.begin()

    def use_law(self, law: ControlLaw) -> None:
        self._servo.use_law(law, self._sample.joints)
        self._law, self._load = law, law.load
        if self._estimate is not None:
            self._estimate.carry(law.load)

    def feel(self, wrench: list[float]) -> None:
        self._servo.feel(wrench)

    def command_hand(self, command: HandCommand) -> None:
        self._hand.command = command

    def drive_spindle(self, command: SpindleCommand | None) -> None:
        self._bolts.drive(self.traits.name, command, self.pressed_on() if command is not None else set())

    def spindle(self) -> SpindleState:
        return self._bolts.state(self.traits.name)

    def couple(self, hand: str) -> str:
        before, world = self.traits.hand or "", self._world
        if hand == before:
            return ""
        if hand:
            at = world.pose(hand) if hand in world.objects else geometry.make_pose((0, 0, 0))
            if why := self._couplers.why_not(self._name, hand, at, self._sample.joints):
                return why
        self.mount(hand)
        if before:  # it stays where it is, and the jaws of the coupler are still closed on it
            world.lay_down(before, self._couplers.place(before, self._sample.joints))
            world.catch()  # before gravity has moved it
            half = 0.5 * self._couplers.point(before).width_m
            self._put([*self._sample.joints, half, half])
            self._hand.hold(2.0 * half)
            self._sample = self.read()
        return ""

    def mount(self, hand: str) -> None:
        """Be the arm with this hand in its coupler, where it is, at rest; the hand is no body of its own then."""
        joints, law = self._sample.joints, self._law
        if self.traits.hand:
            self._world.coupled.pop(self.traits.hand)
        if hand:
            self._world.take_up(hand, lambda: self._couplers.place(hand, self._sample.joints))
        self._world.unload_arm(self.body)
        self._fit(hand)
        half = 0.5 * self.traits.max_opening_m
        self._put([*joints, half, half])
        self._sample = self.read()
        still = [0.0] * len(joints)
        self._servo.wanted = (list(joints), still, still)
        if law is not None:
            self.use_law(law)
        for joint in self._stuck:
            self._lock(self._arm[joint], True)

    def tcp_pose(self, joints: Sequence[float]) -> Array:
        return self._model.fk(joints)

    def jacobian(self, joints: Sequence[float]) -> Array:
        return self._model.jacobian(joints)

    def fault(self) -> str:
        return self._servo.fault

    def untouched(self) -> bool:
        return not self._world.in_contact or not (self.touches() or self.arm_touches())

    def touches(self) -> Mapping[str, float]:
        points = self._contacts()
        if not points:
            return NOTHING
        found: dict[str, float] = {}
        for point in points:
            if point[LINK_A] in self.upstream and point[NORMAL_FORCE] > 0.0:
                words = f"{self.upstream[point[LINK_A]]} touches {self._world.names[point[BODY_B]]}"
                found[words] = found.get(words, 0.0) + point[NORMAL_FORCE]
        return found

    def arm_touches(self) -> Mapping[str, float]:
        points = self._contacts()
        if not points:
            return NOTHING
        found: dict[str, float] = {}
        for other in self.others:
            for point in points:
                if point[BODY_B] == other.body and point[NORMAL_FORCE] > 0.0:
                    mine, theirs = self.link_name(point[LINK_A]), other.link_name(point[LINK_B])
                    words = f"{self.traits.name} {mine} touches {other.traits.name} {theirs}"
                    found[words] = found.get(words, 0.0) + point[NORMAL_FORCE]
        return found or NOTHING

    def _contacts(self) -> Sequence[tuple[Any, ...]]:
        """Contact points of the latest step; this arm is body A. Asked for several times in a tick, read once."""
        if self._points is None:
            points = self._world.in_contact and pybullet.getContactPoints(self.body, physicsClientId=self._client)
            self._points = points or ()
        return self._points

    def link_name(self, index: int) -> str:
        return self._links.get(index, "base")

    def near(self, within_m: float) -> Sequence[Near]:
        pressed_on = self.pressed_on()
        load = pressed_on & self._world.free_bodies
        found = self._near(self.body, {self.body, *pressed_on}, within_m)
        for body in load:
            holders = {arm.body for arm in (self, *self.others) if arm is self or body in arm.pressed_on()}
            found += self._near(body, {*load, *holders}, within_m)
            found += self._near_own(body, within_m)
        return found

    def _near(self, body: int, but: set[int], within_m: float) -> list[Near]:
        """Bodies near this arm, or what it holds, without some of them."""
        found, moves = [], (0, self._dof)
        for other in self._world.around(body, within_m) - but:
            for point in pybullet.getClosestPoints(body, other, within_m, physicsClientId=self._client):
                if body == self.body:
                    moves = (0, self._moved_by[point[LINK_A]])
                if moves[1] and point[DISTANCE] < within_m:
                    found.append(self._nearness(point, body, self._world.names[other], moves))
        return found

    def _near_own(self, load: int, within_m: float) -> Iterator[Near]:
        """Links of this arm that the load may come near to."""
        for point in pybullet.getClosestPoints(load, self.body, within_m, physicsClientId=self._client):
            behind = self._moved_by[point[LINK_B]]
            if behind < self._dof and point[DISTANCE] < within_m:
                name = f"{self.traits.name} {self.link_name(point[LINK_B])}"
                yield self._nearness(point, load, name, (behind, self._dof))

    def _nearness(self, point: tuple[Any, ...], body: int, name: str, moves: tuple[int, int]) -> Near:
        mine = self.link_name(point[LINK_A]) if body == self.body else self._world.names[body]
        return Near(point[DISTANCE], point[ON_B], mine, name, point[NORMAL_ON_B], moves)

    # --- simulation step --------------------------------------------------------------------------------

    def drive(self) -> None:
        """Apply the motor torques of this tick; pybullet keeps them for one step."""
        sample, self._points = self._sample, None
        torques = self._zero_torques if self._braked else self._servo.torque(sample.joints, sample.velocities)
        if not self._weightless:
            self._driven = sample, torques
            if self._estimate is not None:
                self._estimate.drive(torques)
        left, right, self._pressed = self._hand.forces(sample.fingers, sample.finger_speeds)
        if self._hand_braked:
            left, right, self._pressed = 0.0, 0.0, (0.0, 0.0)
        zeros = self._zeros
        pybullet.setJointMotorControlArray(  # keywords take longer
            self.body, self._all, TORQUE_CONTROL, zeros, zeros, [*torques, left, right], zeros, zeros, self._client
        )

    def pressed_on(self) -> set[int]:
        """Bodies in contact with both fingers."""
        by_finger = []
        for finger in self.fingers:
            points = pybullet.getContactPoints(bodyA=self.body, linkIndexA=finger, physicsClientId=self._client)
            by_finger.append({point[BODY_B] for point in points or () if point[NORMAL_FORCE] > 0.0})
        return by_finger[0] & by_finger[1]

    def mass_matrix(self, joints: Sequence[float]) -> Array:
        """Mass matrix of pybullet's model, fingers closed and left out. Tests compare it with the control law's
        model."""
        full = pybullet.calculateMassMatrix(self.body, [*joints, 0.0, 0.0], physicsClientId=self._client)
        return np.asarray(full)[: self._dof, : self._dof]

    def state(self) -> ArmState:
        sample, hand = self._sample, self._hand
        return ArmState(
            joints=sample.joints,
            fingers=sample.fingers,
            hand=hand.command,
            opening_m=hand.wanted_m,
            coupled=self.traits.hand or "",
        )

    def restore(self, state: ArmState) -> None:
        self._sample = msgspec.structs.replace(self._sample, joints=list(state.joints))
        if state.coupled != (self.traits.hand or ""):
            self.mount(state.coupled)
        self._put([*state.joints, *state.fingers])
        still = [0.0] * len(state.joints)
        self._servo.wanted = (list(state.joints), still, still)
        self._hand = SimulatedHand(state.hand, state.opening_m, self._finger_kg)
        if self._estimate is not None:
            self._estimate.begin()

    # --- construction ----------------------------------------------------------------------------------

    def _indices(self, field: int) -> dict[str, int]:
        """Name -> index; field 1 of pybullet's joint info is the joint's name, 12 that of its child link."""
        count = pybullet.getNumJoints(self.body, physicsClientId=self._client)
        infos = [pybullet.getJointInfo(self.body, n, physicsClientId=self._client) for n in range(count)]
        return {info[field].decode(): info[0] for info in infos}

    def _joints_before(self) -> dict[int, int]:
        """Link -> how many joints of the arm move it."""
        count = {-1: 0}
        for n in range(pybullet.getNumJoints(self.body, physicsClientId=self._client)):
            parent = pybullet.getJointInfo(self.body, n, physicsClientId=self._client)[16]
            count[n] = count[parent] + (n in self._arm)
        return count

    def _prepare(self, spec: parts.Arm, sensor: int | None) -> None:
        client = self._client
        for link in range(-1, pybullet.getNumJoints(self.body, physicsClientId=client)):
            pybullet.changeDynamics(
                self.body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client
            )
        self.rub(self._friction)
        # pybullet's default velocity motor locks every joint until it is disabled.
        pybullet.setJointMotorControlArray(
            self.body, self._all, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(self._all), physicsClientId=client
        )
        if sensor is not None:
            pybullet.enableJointForceTorqueSensor(self.body, sensor, True, physicsClientId=client)
        half = 0.5 * spec.gripper.max_opening_m
        self._put([*spec.home_rad, half, half])

    def _centre(self, link: int) -> pin.SE3:
        """The pose of a link's centre of mass and principal axes, in the link's axes."""
        com, turn = pybullet.getDynamicsInfo(self.body, link, physicsClientId=self._client)[3:5]
        return pin.SE3(geometry.to_matrix([*com, *turn]))

    def _hand_inertia(self, sensor: int) -> pin.Inertia:
        """Inertia of the links beyond the sensor, in tool axes about the tcp; of fingers where they are now."""
        client, found = self._client, pin.Inertia.Zero()
        joints = [pybullet.getJointState(self.body, n, physicsClientId=client)[0] for n in self._arm]
        tcp = pin.SE3(geometry.to_matrix(self._model.fk(joints)))
        beyond = {sensor}
        for n in range(sensor, pybullet.getNumJoints(self.body, physicsClientId=client)):
            if n != sensor and pybullet.getJointInfo(self.body, n, physicsClientId=client)[16] not in beyond:
                continue
            beyond.add(n)
            mass, _, diagonal, *_ = pybullet.getDynamicsInfo(self.body, n, physicsClientId=client)
            state = pybullet.getLinkState(self.body, n, computeForwardKinematics=1, physicsClientId=client)
            at = pin.SE3(geometry.to_matrix([*state[0], *state[1]]))
            found += tcp.actInv(at).act(pin.Inertia(mass, np.zeros(3), np.diag(diagonal)))
        return found

    def rub(self, factor: float) -> None:
        """Scale the friction of the pads. Under gravity they stick: a point of contact that does not slide is pulled
        back to where it was, so what the solver leaves over in a step does not add up (decision 0130). Without gravity
        they do not: the wrist sensor would miss what the pads then hold."""
        self._friction = factor
        for finger in self.fingers:
            pybullet.changeDynamics(
                self.body,
                finger,
                lateralFriction=factor * FINGER_FRICTION,
                spinningFriction=SPINNING_FRICTION,
                frictionAnchor=int(self._under_gravity),
                physicsClientId=self._client,
            )

    def stick(self, joint: int, stuck: bool) -> None:
        """The joint is held against its servo."""
        (self._stuck.add if stuck else self._stuck.discard)(joint)
        self._lock(self._arm[joint], stuck or self._braked)

    def _lock(self, joint: int, locked: bool) -> None:
        """Hold a joint of the body by a motor with zero speed, or let it go."""
        pybullet.setJointMotorControl2(
            self.body,
            joint,
            pybullet.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=LOCKED_N if locked else 0.0,
            physicsClientId=self._client,
        )

    def _put(self, values: Sequence[float]) -> None:
        """Set the positions of joints (rad) and fingers (m), at rest."""
        self._driven = self._points = None
        for joint, value in zip(self._all, values, strict=True):
            pybullet.resetJointState(self.body, joint, value, 0.0, physicsClientId=self._client)


class BulletCell:
    """The whole cell in pybullet. Raises ProgramError if no servo would hold one of its hands still."""

    def __init__(self, cell: cells.Cell) -> None:
        self.cell = require_stable(cell)
        self.world = PhysicsWorld(cell)
        self.bolts = Bolts(self.world)
        couplers = Couplers(cell)
        self.arms = {arm.name: BulletArm(self.world, arm.name, self.bolts, couplers) for arm in cell.arms}
        self._all = tuple(self.arms.values())
        for arm in self._all:
            arm.others = [other for other in self._all if other is not arm]
        self._detents = Detents(self.world, self.bolts.fasten)
        self.world.let_go, self.world.catch = self._detents.let_go, self._detents.look
        self._sockets = ConnectorSockets(self.world)
        if seed := physics_seed():
            self._perturb(seed)
        self._settle()

    def _perturb(self, seed: str) -> None:
        """Let masses and friction differ from the cell file by up to `PERTURBED`, each by itself."""

        def drawn(what: str) -> float:
            return 1.0 + random.Random(f"{seed}/{self.cell.name}/{what}").uniform(-PERTURBED, PERTURBED)

        for name in sorted(self.world.movable):
            self.world.weigh(name, drawn(f"mass of {name}"))
            self.world.rub(name, drawn(f"friction of {name}"))
        for name, arm in self.arms.items():
            arm.rub(drawn(f"pads of {name}"))

    def _settle(self) -> None:
        """Take the first steps after a reset, in which the sensors read some tenths of a newton too much."""
        for _ in range(5):
            for arm in self.arms.values():
                arm.read()
            self.step()

    def step(self) -> None:
        for arm in self._all:
            arm.drive()
        self.bolts.step()
        self._sockets.step()
        self.world.step()
        self.world.look_for_contacts()
        self._detents.step()

    def truth(self) -> dict[str, dict[str, list[float]]]:
        samples = {name: arm.read() for name, arm in self.arms.items()}
        return {
            "poses": {name: self.world.pose(name).tolist() for name in self.world.objects},
            "seats": {name: seat.home.tolist() for name, seat in self.world.seats.items()},
            "velocities": {name: self.world.velocity(name) for name in self.world.objects},
            "tcp": {name: self.arms[name].tcp_pose(sample.joints).tolist() for name, sample in samples.items()},
            "joints": {name: sample.joints for name, sample in samples.items()},
            "fingers": {name: list(sample.fingers) for name, sample in samples.items()},
            "tight_nm": self.bolts.tight(),
        }

    def held(self) -> dict[str, list[str]]:
        bodies = {name: arm.pressed_on() for name, arm in self.arms.items()}
        return {
            arm: sorted(name for name in self.world.movable if self.world.objects[name].id in pressed_bodies)
            for arm, pressed_bodies in bodies.items()
        }

    def state(self) -> CellState:
        world = self.world
        return CellState(
            arms={name: arm.state() for name, arm in self.arms.items()},
            poses={name: world.pose(name).tolist() for name in world.objects}
            | {name: seat.home.tolist() for name, seat in world.seats.items()},
        )

    def restore(self, state: CellState) -> None:
        self._detents.let_go_all()
        for name, seat in self.world.seats.items():
            seat.home = np.array(state.poses[name])
            self.world.place(seat, seat.home)
        for name, arm in self.arms.items():
            arm.restore(state.arms[name])
        for name, body in self.world.objects.items():
            thing = self.cell.object(name)
            if thing.mounted_on is not None:
                body.home = home_on(self.cell, thing, state.poses[thing.mounted_on])
            self.world.lay_down(name, state.poses[name])
        self.bolts.look()
        self._sockets.forget()
        self._detents.look()
        self._settle()

    def displace(self, name: str, offset: Sequence[float]) -> str:
        if name in self.world.seats:
            alone = self.world.seats[name]
            alone.home = displaced(alone.home, offset)
            self.world.place(alone, alone.home)
            return ""
        if name not in self.world.objects:
            return unknown("object or seat", name, [*self.world.objects, *self.world.seats])
        if name in self.world.coupled:
            return f"{name} is in the coupler of an arm"
        poses = {one: self.world.pose(one) for one in self.world.objects}
        poses |= {seat: body.home for seat, body in self.world.seats.items()}
        along, held = moves_along(self.cell, name, poses), self.held().items()
        for one in (name, *along):
            if holders := [arm for arm, names in held if one in names]:
                return f"{one} is held by {', '.join(holders)}"
        before = poses[name]
        after = displaced(before, offset)
        self._detents.let_go(name)
        self.world.place(self.world.objects[name], after)
        for one in along:
            self._detents.let_go(one)
            body = self.world.seats.get(one) or self.world.objects[one]
            body.home = geometry.compose(after, geometry.relative(before, body.home))
            self.world.place(body, geometry.compose(after, geometry.relative(before, poses[one])))
        return ""

    def stick(self, arm: str, joint: int, stuck: bool) -> None:
        self.arms[arm].stick(joint, stuck)

    def jam(self, seat: str, jammed: bool) -> None:
        self._detents.jam(seat, jammed)

    def blunt(self, seat: str, blunted: bool) -> str:
        return self.world.blunt(seat, blunted)

    def change_physics(self, mass: float, friction: float) -> str:
        for name in self.world.movable:
            self.world.weigh(name, mass)
        for arm in self.arms.values():
            arm.rub(friction)
        return ""

    def strip(self, bolt: str, stripped: bool = True) -> str:
        """Strip a bolt, or mend it. Returns the reason of a refusal, or ''."""
        return self.bolts.strip(bolt, stripped)

    def close(self) -> None:
        self.world.close()


def _no_wrench(reading: tuple[float, ...]) -> list[float]:
    """Of an arm without a wrist sensor."""
    return [0.0] * 6


def _wrench_at_tcp(cell: cells.Cell, name: str, centre: pin.SE3) -> Callable[[tuple[float, ...]], list[float]]:
    """Return the map from pybullet's sensor reading to the wrench on the hand, in tool axes, about the tcp.

    pybullet reads MINUS the force on the link beyond the joint, in the principal axes of that link's inertia, and its
    torque about the link's centre of mass. `centre`: their pose in the link, which is the identity in our own URDFs.
    """
    spec = cell.arm(name)
    model = pin.buildModelFromXML(cell.urdf(name))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    sensor, tcp = (data.oMf[model.getFrameId(frame)] for frame in (spec.sensor_joint, spec.tcp_link))
    at = tcp.actInv(sensor * centre)  # pose of what is read in tool axes
    x, y, z = at.translation.tolist()
    if not np.allclose(at.rotation, np.eye(3)):
        matrix = -at.toDualActionMatrix()
        return lambda reading: (matrix @ reading).tolist()

    def on_axis(reading: tuple[float, ...]) -> list[float]:
        fx, fy, fz, tx, ty, tz = reading
        return [-fx, -fy, -fz, z * fy - tx, -ty - z * fx, -tz]

    def shift(reading: tuple[float, ...]) -> list[float]:
        fx, fy, fz, tx, ty, tz = reading
        return [-fx, -fy, -fz, -tx - (y * fz - z * fy), -ty - (z * fx - x * fz), -tz - (x * fy - y * fx)]

    return on_axis if x == y == 0.0 else shift  # most sensors are on the tool's axis; it saves 0.4 us per tick
