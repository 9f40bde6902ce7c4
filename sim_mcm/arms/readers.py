"""What pinocchio and Bullet make of one URDF, compared: `python -m sim_mcm.arms.readers`, for `rtc cell`.

Planning and control read an arm with pinocchio, physics reads it with Bullet. A value that they read differently is an
arm that falls or feels forces that are not there. It answers one line of JSON on stdin (`rtc.model.cells.two_readers`)
and ends. Postures are drawn, so that it need not know which value of a URDF could be meant.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pybullet

from rtc.model.cells.two_readers import Answer, ReaderDifference, ReaderInput
from rtc.model.robot import hulls
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.arms.bullet_world import load_urdf, without_visuals

SEED, POSTURES = 1, 5
GRAVITY = (0.0, 0.0, -9.81)
STEP_S = 1e-4
ACCELERATION = 2.0  # rad/s^2, m/s^2: of one joint after the other
SLACK = 0.02  # of it
# Of 49 published arms, adapted, 48 are below these thresholds, 47 below a tenth and 46 below a hundredth of them. The
# one above has links without mass. An axis of length 1.5 or 0.1 is beyond TURN_RAD a thousand times.
PLACE_M, TURN_RAD = 1e-4, 3e-4
TINY_KG_M2 = 1e-8  # more than a frame without mass gets
SHARE = 1e-3  # of a mass, a moment of inertia or a torque
SHAPE_M, SHAPE_SHARE = 0.012, 0.03  # of a box: Bullet's is 3 to 7 mm larger on each side; a wrong unit makes more
ENDLESS = 1e9  # the limits of a joint are compared up to here
NAME, LOWER, UPPER, EFFORT, VELOCITY, LINK, AXIS, PARENT = (
    1,
    8,
    9,
    10,
    11,
    12,
    13,
    16,
)  # fields of pybullet's joint info
TYPE, MASS, COM, COM_TURN, DIAGONAL = 2, 0, 3, 4, 2  # of joint info; of dynamics info


def differences(urdf: str, texts: Mapping[str, str], shapes: bool = True) -> list[ReaderDifference]:
    """What the two readers read differently. `texts`: hulls by file name; `shapes`: collision shapes are compared."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        return _Both(client, urdf, texts, shapes).differences()
    finally:
        pybullet.disconnect(client)


class _Joint(NamedTuple):
    """A joint that moves, as Bullet reads it."""

    number: int
    name: str
    link: str
    info: Sequence[Any]


class _Both:
    def __init__(self, client: int, urdf: str, texts: Mapping[str, str], shapes: bool) -> None:
        self._client, self._urdf, self._texts, self._shapes = client, urdf, texts, shapes
        self._model = pin.buildModelFromXML(urdf)
        self._model.gravity.linear[:] = GRAVITY
        self._data = self._model.createData()
        pybullet.setGravity(*GRAVITY, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(fixedTimeStep=STEP_S, enableFileCaching=0, physicsClientId=client)
        bare = without_visuals(urdf)
        self._body = load_urdf(client, bare if shapes else _without_shapes(bare), texts, np.array(geometry.IDENTITY))
        count = pybullet.getNumJoints(self._body, physicsClientId=client)
        self._infos = [pybullet.getJointInfo(self._body, n, physicsClientId=client) for n in range(count)]
        self._moving = [
            _Joint(n, info[NAME].decode(), info[LINK].decode(), info)
            for n, info in enumerate(self._infos)
            if info[TYPE] != pybullet.JOINT_FIXED
        ]
        for n in range(-1, count):
            pybullet.changeDynamics(
                self._body, n, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client
            )
        for joint in self._moving:  # pybullet's default motor would lock it
            pybullet.setJointMotorControl2(
                self._body, joint.number, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client
            )

    def differences(self) -> list[ReaderDifference]:
        """By the parts of the file; if all of them are alike, by what the whole arm does."""
        if missing := list(self._missing()):
            return missing
        found = [*self._limits(), *self._axes(), *self._bodies(), *self._frames()]
        found += self._solids() if self._shapes and not found else []
        return found or list(self._dynamics())

    def _missing(self) -> Iterator[ReaderDifference]:
        known = {joint.name for joint in self._moving}
        theirs = set(self._model.names[1:])
        for name in sorted(known ^ theirs):
            who = "pinocchio alone" if name in theirs else "Bullet alone"
            yield ReaderDifference(f"joint {name}", f"it moves for {who}", "a joint that both read alike")

    def _limits(self) -> Iterator[ReaderDifference]:
        model = self._model
        ours = {"lower": model.lowerPositionLimit, "upper": model.upperPositionLimit}
        ours |= {"effort": model.effortLimit, "velocity": model.velocityLimit}
        fields = {"lower": LOWER, "upper": UPPER, "effort": EFFORT, "velocity": VELOCITY}
        for joint in self._moving:
            at = model.joints[model.getJointId(joint.name)]
            if at.nq != 1:
                continue  # a continuous joint, which a cell may not have
            for word, field in fields.items():
                place = at.idx_q if field in (LOWER, UPPER) else at.idx_v
                mine, theirs = (float(np.clip(n, -ENDLESS, ENDLESS)) for n in (ours[word][place], joint.info[field]))
                if abs(mine - theirs) > SHARE * max(1e-3, abs(mine)):
                    yield _differ(f"joint {joint.name}", f"its {word}", f"{mine:g}", f"{theirs:g}")

    def _axes(self) -> Iterator[ReaderDifference]:
        """The axis of each joint, with its length, in the axes of the link."""
        neutral = self._put(np.zeros(len(self._moving)))
        for joint in self._moving:
            number = self._model.getJointId(joint.name)
            column = self._model.joints[number].idx_v
            jacobian = np.reshape(pin.computeJointJacobian(self._model, self._data, neutral, number), (6, -1))
            motion = jacobian[:, column]
            mine = motion[:3] + motion[3:]  # one of them is zero
            turn = pybullet.getDynamicsInfo(self._body, joint.number, physicsClientId=self._client)[COM_TURN]
            theirs = geometry.rotate(geometry.make_pose((0.0, 0.0, 0.0), turn), joint.info[AXIS])
            if float(np.linalg.norm(mine - theirs)) > TURN_RAD:
                yield _differ(
                    f"joint {joint.name}",
                    "its axis",
                    *(" ".join(f"{x + 0.0:.4g}" for x in one) for one in (mine, theirs)),
                )

    def _bodies(self) -> Iterator[ReaderDifference]:
        """The rigid body that each joint moves: the link of the joint with all that is fixed to it."""
        bodies = {joint.name: pin.Inertia.Zero() for joint in self._moving}
        owner: dict[int, tuple[str, pin.SE3]] = {}  # link -> the joint that moves it, and its pose in that joint's axes
        for n, info in enumerate(self._infos):
            mass, _, diagonal, com, turn, *_ = pybullet.getDynamicsInfo(self._body, n, physicsClientId=self._client)
            if info[TYPE] != pybullet.JOINT_FIXED:
                owner[n] = (info[NAME].decode(), pin.SE3.Identity())
            elif info[PARENT] in owner:
                name, at = owner[info[PARENT]]
                owner[n] = (name, at * self._fixed_pose(n))
            if n in owner:
                name, at = owner[n]
                own = pin.Inertia(max(mass, 1e-12), np.zeros(3), np.diag(diagonal))
                bodies[name] += at.act(pin.SE3(geometry.to_matrix([*com, *turn])).act(own))
        for joint in self._moving:
            mine, theirs = self._model.inertias[self._model.getJointId(joint.name)], bodies[joint.name]
            yield from _of_body(f"link {joint.link}", mine, theirs)

    def _fixed_pose(self, link: int) -> pin.SE3:
        """Of a link on a fixed joint, in its parent."""
        return _pose(self._state(self._infos[link][PARENT])).actInv(_pose(self._state(link)))

    def _state(self, link: int) -> Array:
        """Pose of a link, world frame."""
        if link < 0:
            position, turn = pybullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
            _, _, _, com, com_turn, *_ = pybullet.getDynamicsInfo(self._body, -1, physicsClientId=self._client)
            centre = geometry.make_pose(com, com_turn)
            return geometry.compose(geometry.make_pose(position, turn), geometry.inverse(centre))
        state = pybullet.getLinkState(self._body, link, computeForwardKinematics=1, physicsClientId=self._client)
        return geometry.make_pose(state[4], state[5])

    def _frames(self) -> Iterator[ReaderDifference]:
        """Where each joint puts its link; each joint is named once."""
        named: set[str] = set()
        for q in self._postures():
            pin.framesForwardKinematics(self._model, self._data, self._put(q))
            for n, info in enumerate(self._infos):
                name, link = info[NAME].decode(), info[LINK].decode()
                before = "" if info[PARENT] < 0 else self._infos[info[PARENT]][LINK].decode()
                mine = self._placed(before).actInv(self._placed(link))
                theirs = _pose(self._state(info[PARENT])).actInv(_pose(self._state(n)))
                off = pin.log6(mine.actInv(theirs))
                metres, radians = float(np.linalg.norm(off.linear)), float(np.linalg.norm(off.angular))
                if (metres > PLACE_M or radians > TURN_RAD) and name not in named:
                    named.add(name)
                    problem = (
                        f"pinocchio and Bullet put its link {1e3 * metres:.3g} mm and "
                        f"{np.degrees(radians):.3g} deg apart"
                    )
                    yield ReaderDifference(f"joint {name}", problem, "<origin> and <axis> that both read alike")

    def _placed(self, link: str) -> pin.SE3:
        """Pose of a link as pinocchio has it; "": the root."""
        frame = self._model.getFrameId(link, pin.FrameType.BODY) if link else 0
        if not link:
            roots = [n for n, one in enumerate(self._model.frames) if one.type == pin.FrameType.BODY]
            frame = roots[0]
        return self._data.oMf[frame]

    def _solids(self) -> Iterator[ReaderDifference]:
        """The box around the collision shapes of each link, in the axes of its inertia, as Bullet keeps it."""
        shapes = hulls.shapes(self._model, self._urdf, self._texts)
        full = self._put(np.zeros(len(self._moving)))
        pin.framesForwardKinematics(self._model, self._data, full)
        for n, info in enumerate(self._infos):
            link = info[LINK].decode()
            own = [item for item in shapes.geometryObjects if item.name.rsplit("_", 1)[0] == link]
            if not own:
                continue
            com, turn = pybullet.getDynamicsInfo(self._body, n, physicsClientId=self._client)[COM : COM_TURN + 1]
            centre = self._placed(link) * pin.SE3(geometry.to_matrix([*com, *turn]))
            boxes = [_box(item, centre.actInv(self._data.oMi[item.parentJoint] * item.placement)) for item in own]
            mine = np.array([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])
            theirs = self._box_seen(n)
            if float(np.abs(theirs - mine).max()) > SHAPE_M + SHAPE_SHARE * float((mine[1] - mine[0]).max()):
                yield _differ(f"link {link}", "the size of its collision shapes", _size(mine), _size(theirs))

    def _box_seen(self, link: int) -> Array:
        """The box around a link, world frame, in which the base is put so that the link has its axes."""
        state = pybullet.getLinkState(self._body, link, computeForwardKinematics=1, physicsClientId=self._client)
        base, turn = pybullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        there = geometry.relative(geometry.make_pose(state[0], state[1]), geometry.make_pose(base, turn)).tolist()
        pybullet.resetBasePositionAndOrientation(self._body, there[:3], there[3:], physicsClientId=self._client)
        pybullet.performCollisionDetection(physicsClientId=self._client)
        box = np.array(pybullet.getAABB(self._body, link, physicsClientId=self._client))
        pybullet.resetBasePositionAndOrientation(self._body, base, turn, physicsClientId=self._client)
        return box

    def _dynamics(self) -> Iterator[ReaderDifference]:
        """What physics does in one step from rest with the torques of an inverse dynamics: with those that carry the
        weight alone, nothing; with those that accelerate one joint, that. Each joint is named once."""
        order = [self._model.joints[self._model.getJointId(joint.name)].idx_v for joint in self._moving]
        still, named = np.zeros(self._model.nv), set[str]()
        for q in self._postures():
            full = self._put(q)
            upper = np.triu(np.reshape(pin.crba(self._model, self._data, full), (self._model.nv, -1)))
            mass = (upper + np.triu(upper, 1).T)[np.ix_(order, order)]
            weight = pin.rnea(self._model, self._data, full, still, still)[order]
            for n, joint in enumerate(self._moving):
                wanted = ACCELERATION * np.eye(len(q))[n]
                resting, moved = self._step(q, weight), self._step(q, weight + mass @ wanted)
                for words, mine, theirs in (
                    ("the acceleration under its weight, which its motor carries,", 0.0, resting[n]),
                    (f"the acceleration by {mass[n, n] * ACCELERATION:.3g} N.m more, or N,", ACCELERATION, moved[n]),
                ):
                    if not abs(theirs - mine) < SLACK and joint.name not in named:
                        named.add(joint.name)
                        yield _differ(f"joint {joint.name}", words, f"{mine:.3g}", f"{theirs:.3g}")

    def _step(self, q: Array, torques: Array) -> Array:
        """The accelerations of the joints in one step from rest."""
        self._put(q)
        joints = [joint.number for joint in self._moving]
        pybullet.setJointMotorControlArray(
            self._body, joints, pybullet.TORQUE_CONTROL, forces=torques.tolist(), physicsClientId=self._client
        )
        pybullet.stepSimulation(physicsClientId=self._client)
        states = pybullet.getJointStates(self._body, joints, physicsClientId=self._client)
        return np.array([state[1] for state in states]) / STEP_S

    def _postures(self) -> Iterator[Array]:
        lower = np.array([max(-3.0, joint.info[LOWER]) for joint in self._moving])
        upper = np.array([min(3.0, joint.info[UPPER]) for joint in self._moving])
        yield from np.random.default_rng(SEED).uniform(lower, np.maximum(lower, upper), (POSTURES, len(lower)))

    def _put(self, q: Array) -> Array:
        """Set all joints, in Bullet's order, at rest. Returns the configuration for pinocchio."""
        full: Array = pin.neutral(self._model)
        for joint, value in zip(self._moving, q.tolist(), strict=True):
            pybullet.resetJointState(self._body, joint.number, value, 0.0, physicsClientId=self._client)
            at = self._model.joints[self._model.getJointId(joint.name)]
            full[at.idx_q : at.idx_q + at.nq] = [value] if at.nq == 1 else [np.cos(value), np.sin(value)]
        return full


def _of_body(where: str, mine: pin.Inertia, theirs: pin.Inertia) -> Iterator[ReaderDifference]:
    if abs(mine.mass - theirs.mass) > SHARE * max(mine.mass, 1e-3):
        yield _differ(where, "its mass, with all that is fixed to it,", f"{mine.mass:.4g} kg", f"{theirs.mass:.4g} kg")
        return
    if float(np.linalg.norm(mine.lever - theirs.lever)) > PLACE_M:
        where_to = [" ".join(f"{1e3 * x:.1f}" for x in body.lever) + " mm" for body in (mine, theirs)]
        yield _differ(where, "its centre of mass", *where_to)
        return
    scale = float(np.linalg.norm(mine.inertia))
    if float(np.abs(mine.inertia - theirs.inertia).max()) > SHARE * scale + TINY_KG_M2:
        moments = [" ".join(f"{x:.3g}" for x in np.linalg.eigvalsh(body.inertia)) + " kg m2" for body in (mine, theirs)]
        yield _differ(where, "its moments of inertia, with all that is fixed to it,", *moments)


def _differ(where: str, what: str, mine: str, theirs: str) -> ReaderDifference:
    return ReaderDifference(
        where, f"{what} is {mine} for pinocchio and {theirs} for Bullet", "a value that both read alike"
    )


def _box(item: Any, at: pin.SE3) -> Array:
    """The box around a shape that is placed: that of the shape's own axes, turned; a sphere does not turn."""
    if isinstance(item.geometry, coal.Sphere):
        at = pin.SE3(np.eye(3), at.translation)
    item.geometry.computeLocalAABB()
    local = item.geometry.aabb_local
    middle, half = 0.5 * (local.max_ + local.min_), 0.5 * (local.max_ - local.min_)
    middle, half = at.rotation @ middle + at.translation, np.abs(at.rotation) @ half
    return np.array([middle - half, middle + half])


def _size(box: Array) -> str:
    return " x ".join(f"{1e3 * side:.0f}" for side in box[1] - box[0]) + " mm"


def _pose(pose: Array) -> pin.SE3:
    return pin.SE3(geometry.to_matrix(pose))


def _without_shapes(urdf: str) -> str:
    robot = ElementTree.fromstring(urdf)
    for link in robot.findall("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    return ElementTree.tostring(robot, encoding="unicode")


def answer(line: bytes) -> Answer:
    """The answer to a question, encoded."""
    question = msgspec.json.decode(line, type=ReaderInput)
    return Answer(differences(question.urdf, question.hulls, question.shapes))


def main() -> None:
    print(msgspec.json.encode(answer(sys.stdin.buffer.readline())).decode(), flush=True)


if __name__ == "__main__":
    main()
