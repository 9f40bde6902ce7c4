"""The cell's seats and objects as bodies in a pybullet client; shared by physics and rendering.

A seat or fixed object becomes one body per shape, so each shape has its own friction and name. A movable object is one
body; its origin is its centre of mass. This module must not know control or time.
"""

from __future__ import annotations

import math
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pybullet
import pybullet_data

from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.model.robot import hulls
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array

STEP_S = 0.001
SOLVER_ITERATIONS = 50  # chosen by `tests.campaigns.convergence` (decision 0131)
# With a larger residual the number of iterations varies from step to step, and a held object chatters.
SOLVER_RESIDUAL = 1e-7
# How far the sides of a contact point may move apart until it is dropped, as a share of the size of the smaller body:
# 0.1 mm for a finger. pybullet's default of 0.02 keeps points that a pad has left (decision 0039).
CONTACT_BREAKING = 0.002

NEARLY_NOTHING = "1e-9"  # kg, kg m2
SHAPE_LINK, SHAPE_TYPE, SHAPE_COLOUR = 1, 2, 7  # fields of pybullet's visual shape data
BLACK, PAINT = (0.0, 0.0, 0.0, 1.0), (0.82, 0.83, 0.84, 1.0)


HINGED = THREADED = 0  # the link of an object with a hinge or a thread
THREAD_N = 200.0  # that a thread holds along its axis
LIP = "lip"  # last word of the name of a shape that guides a module into its seat
AWAY = [0.0, 0.0, -100.0]  # where shapes are put that are not there
ASK_AGAIN = 32  # steps after a contact in which arms ask for their own contacts at once


class BulletBody:
    """An object or a seat of the cell, made of one or several pybullet bodies."""

    def __init__(
        self,
        name: str,
        pose: Array,
        pieces: list[tuple[int, Array]],
        hinge: parts.Hinge | None = None,
        thread: parts.Thread | None = None,
    ) -> None:
        self.name = name
        self.home = pose  # of an object with a hinge: at angle 0; of a bolt: tight
        self.parts = pieces  # (pybullet id, pose in the axes of the object or seat)
        self.id = pieces[0][0] if pieces else -1  # a movable object has only this one
        self.hinge = hinge
        self.thread = thread


class PhysicsWorld:
    """A pybullet client with the seats and objects of a cell in it."""

    def __init__(self, cell: cells.Cell, visual: bool = False) -> None:
        self.cell = cell
        self.client: int = pybullet.connect(pybullet.DIRECT)
        assert self.client >= 0, "pybullet could not create a client"
        self._visual = visual
        pybullet.setGravity(*cell.gravity_m_s2, physicsClientId=self.client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=STEP_S,
            numSolverIterations=SOLVER_ITERATIONS,
            solverResidualThreshold=SOLVER_RESIDUAL,
            contactBreakingThreshold=CONTACT_BREAKING,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,  # another client in this process may load a different URDF of the same name
            physicsClientId=self.client,
        )
        self._steps = 0
        self.in_contact = False  # whether any bodies may touch each other since the latest step
        self._ask_at = 0  # the first step after which all contacts are asked for
        self.names: dict[int, str] = {}  # pybullet id -> name for messages
        self._lips: dict[str, list[tuple[int, Array]]] = {}  # seat -> its lips that were put away
        self.seats = {seat.name: self._fixed(seat, seat.frame.pose) for seat in cell.seats}
        self.objects: dict[str, BulletBody] = {}
        for thing in cell.objects:
            self.objects[thing.name] = self._object(thing)
        self._weights: dict[str, tuple[Any, ...]] = {}  # of objects without a body: pybullet's dynamics that they had
        #: hands in couplers, which are parts of their arms: name -> where it is
        self.coupled: dict[str, Callable[[], Array]] = {}
        # Of the catches of seats: they let go of an object, or catch what rests in a seat.
        self.let_go: Callable[[str], None] = lambda name: None
        self.catch: Callable[[], None] = lambda: None
        self.free = {thing.name for thing in cell.objects if not thing.fixed and thing.hinge is None}
        self.threaded = {thing.name for thing in cell.objects if thing.thread is not None}
        self.movable = {thing.name for thing in cell.objects if not thing.fixed}
        self.free_bodies = {self.objects[name].id for name in self.free - self.threaded}

    def close(self) -> None:
        pybullet.disconnect(physicsClientId=self.client)

    def step(self) -> None:
        pybullet.stepSimulation(self.client)

    def look_for_contacts(self) -> None:
        """After each step. One list of all contacts replaces one per arm, as long as it is empty."""
        self._steps = steps = self._steps + 1
        if steps >= self._ask_at:
            found = pybullet.getContactPoints(-1, -1, -2, -2, self.client)  # of any bodies; keywords take longer
            self.in_contact = bool(found)
            if found:
                self._ask_at = steps + ASK_AGAIN

    def around(self, body: int, within_m: float) -> set[int]:
        """Bodies that may be within a distance of this one."""
        found: set[int] = set()
        for link in range(-1, pybullet.getNumJoints(body, self.client)):
            least, most = pybullet.getAABB(body, link, self.client)
            low, high = [x - within_m for x in least], [x + within_m for x in most]
            found |= {other for other, _ in pybullet.getOverlappingObjects(low, high, self.client) or ()}
        return found & self.names.keys()

    def load_arm(self, name: str, cell: cells.Cell | None = None) -> int:
        """Load an arm from its URDF text; returns the pybullet body id. `cell`: with a hand in its coupler."""
        urdf = (cell or self.cell).urdf(name)
        seen = _seen(urdf) if self._visual else without_visuals(urdf)
        body = load_urdf(self.client, seen, self.cell.texts, self.cell.arm(name).base.pose)
        self.names[body] = name
        if self._visual:
            self._paint(body)
        return body

    def unload_arm(self, body: int) -> None:
        del self.names[body]
        pybullet.removeBody(body, physicsClientId=self.client)

    def take_up(self, name: str, where: Callable[[], Array]) -> None:
        """An object becomes a part of an arm, and has no body of its own; `where` it is then."""
        self.let_go(name)
        self.coupled[name], body = where, self.objects[name].id
        self.free.discard(name)
        self.free_bodies.discard(body)
        self._weights[name] = pybullet.getDynamicsInfo(body, -1, physicsClientId=self.client)
        del self.names[body]
        pybullet.removeBody(body, physicsClientId=self.client)

    def lay_down(self, name: str, pose: geometry.Floats) -> None:
        """Set the pose of an object, at rest. One that was a part of an arm has a body of its own again, with the mass
        and friction that it had."""
        if name in self.coupled:
            return
        if (had := self._weights.pop(name, None)) is not None:
            self.objects[name] = self._object(self.cell.object(name))
            body = self.objects[name].id
            pybullet.changeDynamics(
                body, -1, mass=had[0], lateralFriction=had[1], localInertiaDiagonal=had[2], physicsClientId=self.client
            )
            self.free.add(name)
            self.free_bodies.add(body)
        self.place(self.objects[name], pose)

    def _paint(self, body: int) -> None:
        """Give a colour to the meshes whose file has none; pybullet shows them black."""
        for shape in pybullet.getVisualShapeData(body, physicsClientId=self.client):
            if shape[SHAPE_TYPE] == pybullet.GEOM_MESH and tuple(shape[SHAPE_COLOUR]) == BLACK:
                pybullet.changeVisualShape(body, shape[SHAPE_LINK], rgbaColor=PAINT, physicsClientId=self.client)

    def pose(self, name: str) -> Array:
        """Pose of an object, world frame."""
        if name in self.coupled:
            return self.coupled[name]()
        body = self.objects[name]
        if body.hinge is not None:
            return hinges.turned(body.home, body.hinge.axis, self.angle(name))
        if body.thread is not None:
            return geometry.compose(body.home, (0.0, 0.0, self.out_m(name), 0.0, 0.0, 0.0, 1.0))
        position, quaternion = pybullet.getBasePositionAndOrientation(body.id, physicsClientId=self.client)
        return geometry.compose(geometry.make_pose(position, quaternion), geometry.inverse(body.parts[0][1]))

    def position(self, name: str) -> Sequence[float]:
        """Position (m) of a movable object; ten times as fast as `pose`."""
        position, _ = pybullet.getBasePositionAndOrientation(self.objects[name].id, physicsClientId=self.client)
        found: Sequence[float] = position
        return found

    def angle(self, name: str) -> float:
        """Angle of an object with a hinge (rad)."""
        found: float = pybullet.getJointState(self.objects[name].id, HINGED, physicsClientId=self.client)[0]
        return found

    def out_m(self, name: str) -> float:
        """How far the head of a bolt is out."""
        found: float = pybullet.getJointState(self.objects[name].id, THREADED, physicsClientId=self.client)[0]
        return found

    def move_out(self, name: str, out_m: float) -> None:
        """Command the head of a bolt along its thread."""
        pybullet.setJointMotorControl2(
            self.objects[name].id,
            THREADED,
            pybullet.POSITION_CONTROL,
            targetPosition=out_m,
            force=THREAD_N,
            physicsClientId=self.client,
        )

    def velocity(self, name: str) -> list[float]:
        if name in self.coupled:
            return [0.0] * 6
        body = self.objects[name]
        if body.hinge is not None:
            rate = pybullet.getJointState(body.id, HINGED, physicsClientId=self.client)[1]
            return [0.0, 0.0, 0.0, *(rate * geometry.rotate(body.home, body.hinge.axis)).tolist()]
        linear, angular = pybullet.getBaseVelocity(self.objects[name].id, physicsClientId=self.client)
        return [*linear, *angular]

    def blunt(self, name: str, blunted: bool) -> str:
        """Put the lips of a seat away, or back. Returns the reason of a refusal, or ''."""
        seat, shapes = self.seats[name], self.cell.seat(name).shapes
        every = [*seat.parts, *self._lips.get(name, [])]
        lips = [part for part in every if self.names[part[0]].replace("-", " ").split()[-1] == LIP]
        if not lips:
            return f"{name} has no lips; its shapes are {', '.join(shape.name for shape in shapes)}"
        self._lips[name] = lips if blunted else []
        seat.parts = [part for part in every if part not in self._lips[name]]
        for part, _ in self._lips[name]:
            pybullet.resetBasePositionAndOrientation(part, AWAY, [0, 0, 0, 1], physicsClientId=self.client)
        self.place(seat, seat.home)
        return ""

    def weigh(self, name: str, factor: float) -> None:
        """Scale the mass and inertia of an object relative to the cell file; not of a part of an arm."""
        if name in self.coupled:
            return
        thing, body = self.cell.object(name), self.objects[name].id
        link = -1 if thing.hinge is None else HINGED
        pybullet.changeDynamics(body, link, mass=factor * thing.mass_kg, physicsClientId=self.client)
        if thing.inertia_kg_m2 is not None:  # else Bullet derives it from the mass
            inertia = [factor * n for n in thing.inertia_kg_m2]
            pybullet.changeDynamics(body, link, localInertiaDiagonal=inertia, physicsClientId=self.client)

    def rub(self, name: str, factor: float) -> None:
        """Scale the friction of an object from what it is."""
        for part, _ in self.objects[name].parts:
            for link in range(-1, pybullet.getNumJoints(part, physicsClientId=self.client)):
                now = pybullet.getDynamicsInfo(part, link, physicsClientId=self.client)[1]
                pybullet.changeDynamics(part, link, lateralFriction=factor * now, physicsClientId=self.client)

    def place(self, body: BulletBody, pose: geometry.Floats) -> None:
        """Set the pose of an object or seat, at rest. One with a hinge turns, and its hinge moves with the rest."""
        if body.hinge is not None:
            least, most = body.hinge.range_rad
            angle = min(max(hinges.angle_of(body.home, body.hinge.axis, pose), least), most)
            body.home = hinges.turned(pose, body.hinge.axis, -angle)
            pose = body.home
            pybullet.resetJointState(body.id, HINGED, angle, 0.0, physicsClientId=self.client)
        if body.thread is not None:
            out_m = float(geometry.relative(body.home, pose)[2])
            pose = body.home
            pybullet.resetJointState(body.id, THREADED, out_m, 0.0, physicsClientId=self.client)
            self.move_out(body.name, out_m)
        for part, local in body.parts:
            at = geometry.compose(pose, local).tolist()
            pybullet.resetBasePositionAndOrientation(part, at[:3], at[3:], physicsClientId=self.client)
            pybullet.resetBaseVelocity(part, [0, 0, 0], [0, 0, 0], physicsClientId=self.client)

    # --- construction ---------------------------------------------------------------------------------

    def _fixed(self, thing: parts.Seat | parts.Object, pose: Array) -> BulletBody:
        pieces = []
        for shape in thing.shapes:
            at = geometry.compose(pose, shape.frame.pose).tolist()
            part = pybullet.createMultiBody(
                baseMass=0,
                baseCollisionShapeIndex=self._collision([shape], placed=False),
                baseVisualShapeIndex=self._look([shape], placed=False),
                basePosition=at[:3],
                baseOrientation=at[3:],
                useMaximalCoordinates=1,  # the default, a multibody without joints, costs 0.5 us per step
                physicsClientId=self.client,
            )
            self.names[part] = f"{thing.name} {shape.name}"
            self._rub(part, shape)
            pieces.append((part, shape.frame.pose))
        if not pieces:  # a seat may have no shapes
            return BulletBody(thing.name, pose, [])
        return BulletBody(thing.name, pose, pieces)

    def _object(self, thing: parts.Object) -> BulletBody:
        pose = self.cell.object_pose(thing.name)
        if thing.thread is not None:
            return self._threaded(thing, thing.thread)
        if thing.fixed:
            return self._fixed(thing, pose)
        if thing.hinge is not None:
            return self._hinged(thing, thing.hinge)
        at = pose.tolist()
        body = pybullet.createMultiBody(
            baseMass=thing.mass_kg,
            baseCollisionShapeIndex=self._collision(thing.shapes, placed=True),
            baseVisualShapeIndex=self._look(thing.shapes, placed=True),
            basePosition=at[:3],
            baseOrientation=at[3:],
            physicsClientId=self.client,
        )
        self.names[body] = thing.name
        # A body has one friction. Take the greatest of its shapes: that shape is made to be gripped.
        self._rub(body, max(thing.shapes, key=lambda shape: shape.friction))
        if thing.inertia_kg_m2 is not None:
            pybullet.changeDynamics(
                body, -1, localInertiaDiagonal=list(thing.inertia_kg_m2), physicsClientId=self.client
            )
        return BulletBody(thing.name, pose, [(body, geometry.make_pose((0, 0, 0)))])

    def _hinged(self, thing: parts.Object, hinge: parts.Hinge) -> BulletBody:
        body = self._jointed(thing, pybullet.JOINT_REVOLUTE, hinge.axis)
        least, most = hinge.range_rad
        more = {} if thing.inertia_kg_m2 is None else {"localInertiaDiagonal": list(thing.inertia_kg_m2)}
        pybullet.changeDynamics(
            body, HINGED, jointLowerLimit=least, jointUpperLimit=most, jointDamping=0.0, **more,
            physicsClientId=self.client,
        )  # fmt: skip
        # A velocity motor of limited torque is dry friction; pybullet's default motor would lock the hinge.
        pybullet.setJointMotorControl2(
            body,
            HINGED,
            pybullet.VELOCITY_CONTROL,
            targetVelocity=0.0,
            force=hinge.friction_nm,
            physicsClientId=self.client,
        )
        pybullet.resetJointState(body, HINGED, math.radians(hinge.at_deg), 0.0, physicsClientId=self.client)
        return BulletBody(thing.name, thing.frame.pose, [(body, geometry.make_pose((0, 0, 0)))], hinge)

    def _threaded(self, thing: parts.Object, thread: parts.Thread) -> BulletBody:
        body = self._jointed(thing, pybullet.JOINT_PRISMATIC, (0.0, 0.0, 1.0))
        made = BulletBody(thing.name, thing.frame.pose, [(body, geometry.make_pose((0, 0, 0)))], thread=thread)
        self.objects[thing.name] = made
        self.move_out(thing.name, 0.0)
        return made

    def _jointed(self, thing: parts.Object, joint: int, axis: parts.Vec3) -> int:
        """A fixed base without shapes, and the object as its one link."""
        home = thing.frame.pose.tolist()
        body: int = pybullet.createMultiBody(
            baseMass=0,
            basePosition=home[:3],
            baseOrientation=home[3:],
            linkMasses=[thing.mass_kg],
            linkCollisionShapeIndices=[self._collision(thing.shapes, placed=True)],
            linkVisualShapeIndices=[self._look(thing.shapes, placed=True)],
            linkPositions=[[0.0, 0.0, 0.0]],
            linkOrientations=[[0.0, 0.0, 0.0, 1.0]],
            linkInertialFramePositions=[list(thing.centre_of_mass_m)],
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]],
            linkParentIndices=[0],
            linkJointTypes=[joint],
            linkJointAxis=[list(axis)],
            physicsClientId=self.client,
        )
        self.names[body] = thing.name
        self._rub(body, max(thing.shapes, key=lambda shape: shape.friction), 0)
        return body

    def _rub(self, body: int, shape: parts.AnyShape, link: int = -1) -> None:
        # With a damping in the same call, pybullet sets the friction of the base, whatever the link.
        client = self.client
        pybullet.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
        pybullet.changeDynamics(
            body,
            link,
            lateralFriction=shape.friction,
            spinningFriction=shape.spinning_friction,
            physicsClientId=client,
        )

    def _collision(self, shapes: Sequence[parts.AnyShape], placed: bool) -> int:
        made: int = pybullet.createCollisionShapeArray(
            **_columns(shapes, placed, "collisionFrame"), physicsClientId=self.client
        )
        return made

    def _look(self, shapes: Sequence[parts.AnyShape], placed: bool) -> int:
        if not self._visual:
            return -1
        columns = _columns(shapes, placed, "visualFrame")
        made: int = pybullet.createVisualShapeArray(
            **columns, rgbaColors=[list(shape.colour) for shape in shapes], physicsClientId=self.client
        )
        return made


def load_urdf(client: int, urdf: str, hull_texts: Mapping[str, str], base: Array) -> int:
    """Load an arm with a fixed base, as physics and pictures read it; returns the pybullet body id."""
    at = base.tolist()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(_embodied(urdf), encoding="utf-8")
        for hull in hulls.files(urdf):
            if hull in hull_texts:
                (Path(folder) / hull).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / hull).write_text(hull_texts[hull], encoding="utf-8")
        body: int = pybullet.loadURDF(
            str(file),
            basePosition=at[:3],
            baseOrientation=at[3:],
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_MATERIAL_COLORS_FROM_MTL,
            physicsClientId=client,
        )
    return body


def without_visuals(urdf: str) -> str:
    """The URDF without visuals, which physics does not need; their meshes may be missing here."""
    robot = ElementTree.fromstring(urdf)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return ElementTree.tostring(robot, encoding="unicode")


def _seen(urdf: str) -> str:
    """The URDF with visuals that can be drawn here: a link whose meshes are missing shows its collision shapes."""
    robot = ElementTree.fromstring(urdf)
    for link in robot.findall("link"):
        meshes = [mesh for visual in link.findall("visual") for mesh in visual.iter("mesh")]
        for mesh in meshes:
            mesh.set("filename", _known_here(str(mesh.get("filename"))))
        visuals = link.findall("visual")
        if visuals and all(Path(str(mesh.get("filename"))).is_file() for mesh in meshes):
            continue
        for visual in visuals:
            link.remove(visual)
        for collision in link.findall("collision"):
            shown = ElementTree.SubElement(link, "visual")
            shown.extend(part for part in collision if part.tag in ("origin", "geometry"))
            if (
                material := next((part for visual in visuals for part in visual.findall("material")), None)
            ) is not None:
                shown.append(material)
    return ElementTree.tostring(robot, encoding="unicode")


def _known_here(file: str) -> str:
    """The absolute path of a mesh; one of `package://pybullet_data/` is a file of that package."""
    prefix = "package://pybullet_data/"
    return str(Path(pybullet_data.getDataPath(), file.removeprefix(prefix))) if file.startswith(prefix) else file


def _embodied(urdf: str) -> str:
    """The URDF without massless frames: Bullet would give one kilogram to every link without inertia."""
    robot = ElementTree.fromstring(urdf)
    children = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}  # type: ignore[union-attr]
    parents = {joint.find("parent").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    for link in robot.findall("link"):
        if link.find("inertial") is not None:
            continue
        name = link.get("name")
        if name in children and name not in parents:
            robot.remove(link)
            robot.remove(children[name])
        else:  # the root is fixed, so any values will do; a frame between two links has next to nothing
            mass, inertia = (NEARLY_NOTHING, NEARLY_NOTHING) if name in children else ("1", "1")
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value=mass)
            ElementTree.SubElement(
                inertial, "inertia", ixx=inertia, ixy="0", ixz="0", iyy=inertia, iyz="0", izz=inertia
            )
    ElementTree.indent(robot)  # Bullet's parser needs line breaks
    return ElementTree.tostring(robot, encoding="unicode")


def _columns(shapes: Sequence[parts.AnyShape], placed: bool, prefix: str) -> dict[str, Any]:
    """Arguments of pybullet's shape arrays: one list per property, one entry per shape."""
    rows = [SHAPES[type(shape)](shape) for shape in shapes]
    poses = [shape.frame.pose.tolist() if placed else list(geometry.IDENTITY) for shape in shapes]
    return {
        "shapeTypes": [row[0] for row in rows],
        "halfExtents": [row[1] for row in rows],
        "radii": [row[2] for row in rows],
        "lengths": [row[3] for row in rows],
        f"{prefix}Positions": [pose[:3] for pose in poses],
        f"{prefix}Orientations": [pose[3:] for pose in poses],
    }


_NO_BOX = [0.0, 0.0, 0.0]
SHAPES: dict[type, Callable[[Any], tuple[int, list[float], float, float]]] = {
    parts.Box: lambda s: (pybullet.GEOM_BOX, [0.5 * n for n in s.size_m], 0.0, 0.0),
    parts.Cylinder: lambda s: (pybullet.GEOM_CYLINDER, _NO_BOX, s.radius_m, s.length_m),
    parts.Sphere: lambda s: (pybullet.GEOM_SPHERE, _NO_BOX, s.radius_m, 0.0),
    parts.Capsule: lambda s: (pybullet.GEOM_CAPSULE, _NO_BOX, s.radius_m, s.length_m),
}
