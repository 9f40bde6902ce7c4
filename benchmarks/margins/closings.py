"""Hands that close: on a bar, on nothing, with one finger against a wall, on a body that gives way. How strongly do
their fingers press, as a share of the command, while they stand and the force does not change?"""

from __future__ import annotations

from typing import Any, NamedTuple

import pybullet

from benchmarks.margins.variants import weak
from rtc.model.cells.cell import Cell
from rtc.protocol import primitive as p
from rtc.protocol.messages import EndReport
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.motion.goals import CHANGED, STEADY_S
from rtc.subsystems.motion.observation import REST_M, WINDOW_TICKS
from sim_mcm.arms.bullet_world import PhysicsWorld
from tests.workers.conftest import Physical

ARM, LIMIT_S = "RIGHT-ARM", 3.5
HALF_M = (0.004, 0.006, 0.010)  # of a bar
ASIDE_M = (0.0, 0.001, 0.002)  # of its middle from that of the hand


class Closing(NamedTuple):
    what: str
    force_n: float
    exerted: float  # share of the command that the hand exerts
    steady: float  # greatest mean force of the fingers while it stands, as a share of the command
    weaker: float  # force of the weaker finger then, as a share of the command
    gripped: bool  # the end says so: not at its width, but by its force


def _box(world: PhysicsWorld, tcp: Any, at: list[float], half: list[float], mass: float) -> int:
    """A box in the hand, in tool axes."""
    centre, turn = pybullet.multiplyTransforms(tcp[:3].tolist(), tcp[3:].tolist(), at, [0, 0, 0, 1])
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=world.client)
    body: int = pybullet.createMultiBody(mass, shape, -1, centre, turn, physicsClientId=world.client)
    pybullet.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=world.client)
    world.names[body] = "box"
    return body


def close(what: str, force_n: float, exerted: float, boxes: list[tuple[list[float], list[float], float]]) -> Closing:
    """Close the hand at 20 mm/s on these boxes (middle, half sizes (m, tool axes), mass (kg); 0: it does not move)."""
    subsystem = Physical(Cell.load("swapout"))
    try:
        arm: Any = subsystem.sim.arms[ARM]
        arm.command_hand = weak(arm.command_hand, exerted)
        executor = subsystem.executors[ARM]
        tcp = arm.tcp_pose(arm.read().joints)
        for box in boxes:
            _box(subsystem.sim.world, tcp, *box)  # type: ignore[attr-defined]
        return Closing(what, force_n, exerted, *_closed(subsystem, executor, force_n))
    finally:
        subsystem.close()


def _closed(subsystem: Physical, executor: Any, force_n: float) -> tuple[float, float, bool]:
    stops = [
        p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
        p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(LIMIT_S)),
    ]
    motion = p.HandMotion(width_m=0.0, force_n=force_n)
    executor.accept(
        p.Primitive(id="C-1.1", performer=ARM, trajectory=motion, control_law=p.ControlLaw(), stop_functions=stops), 0.0
    )
    widths: list[tuple[float, float]] = []
    level, since, best, weaker = 0.0, 0, 0.0, 0.0
    for tick in range(int(2000 * LIMIT_S)):
        ends = [one for one in subsystem.tick(0.001 * tick) if isinstance(one, EndReport)]
        sample = executor.sample
        pressed = 0.5 * sum(sample.finger_forces)
        if abs(pressed - level) > CHANGED * force_n:
            level, since = pressed, tick
        widths = [*widths[1 - WINDOW_TICKS :], sample.fingers]
        rests = all(max(side) - min(side) <= REST_M for side in zip(*widths, strict=True))
        if rests and tick - since >= 1000 * STEADY_S and pressed / force_n > best:
            best, weaker = pressed / force_n, min(sample.finger_forces) / force_n
        if ends:
            end = ends[0]
            gripped = end.reason.value == "goal" and end.limit == force_n
            if gripped:
                best, weaker = max(best, pressed / force_n), max(weaker, min(sample.finger_forces) / force_n)
            return best, weaker, gripped
    return best, weaker, False


def all_closings() -> list[Closing]:
    made = []
    for force_n in (20.0, 30.0, 45.0, 60.0):
        for exerted in (1.0, 0.9):
            for half in HALF_M:
                for aside in ASIDE_M:
                    bar = ([0.0, aside, 0.0], [0.05, half, 0.01], 0.0)
                    made.append(close("a bar", force_n, exerted, [bar]))
        made.append(close("nothing", force_n, 1.0, []))
        for far in (0.012, 0.020, 0.030):
            made.append(close("a wall beside it", force_n, 1.0, [([0.0, far + 0.01, 0.0], [0.05, 0.01, 0.01], 0.0)]))
        for mass in (0.05, 0.5, 5.0):
            made.append(close("a free body aside", force_n, 1.0, [([0.0, 0.015, 0.0], [0.05, 0.01, 0.01], mass)]))
    return made
