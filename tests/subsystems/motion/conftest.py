"""What the tests of the MCM share: a cell, primitives in one line, and an arm whose senses a test can set.

`SteeredArm` follows exactly, as `KinematicArm` does, but stands nowhere: what it feels is what the test says. It is
for conditions no cell would bring about together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import TICK_S, HandCommand, Motion, Near, Sample, Simulation, Traits
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.profiles import Follow
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms import control_laws
from sim_mcm.period import period

ARM, OTHER = "RIGHT-ARM", "LEFT-ARM"


class SteeredArm:
    def __init__(self, cell: Cell, name: str = ARM) -> None:
        self.traits = Traits.of(cell, name)
        self.model = ArmModel.of(cell, name)
        self.motion: Motion = (cell.arm(name).home_rad, [0.0] * 6, [0.0] * 6)
        self.wrench = [0.0] * 6
        self.forces = (0.0, 0.0)
        self.leaning: dict[str, float] = {}  # "LINK touches BODY" -> N
        self.meeting: dict[str, float] = {}  # with another arm
        self.around: list[Near] = []
        self.hand = HandCommand(0.08, 60.0, 0.05)
        self.width = 0.08
        self.lag = 0.0  # of the measured joints behind the commanded, rad
        self.commands: list[Motion] = []
        self.laws: list[p.ControlLaw] = []
        self.felt: list[list[float]] = []
        self.braked = False

    def read(self) -> Sample:
        half = 0.5 * self.width
        joints = [q - self.lag for q in self.motion[0]]
        return Sample(joints, self.motion[1], list(self.wrench), (half, half), (0.0, 0.0), self.forces)

    def follow(self, motion: Motion) -> None:
        self.motion = motion
        self.commands.append(motion)

    def brake(self, on: bool) -> None:
        self.braked = on

    def use_law(self, law: p.ControlLaw) -> None:
        control_laws.make(law, self.model, control_laws.known())
        self.laws.append(law)

    def feel(self, wrench: list[float]) -> None:
        self.felt.append(wrench)

    def command_hand(self, command: HandCommand) -> None:
        self.hand = command

    def tcp_pose(self, joints: Sequence[float]) -> Array:
        return self.model.fk(joints)

    def jacobian(self, joints: Sequence[float]) -> Array:
        return self.model.jacobian(joints)

    def near(self, within_m: float) -> list[Near]:
        return [one for one in self.around if one.distance_m < within_m]

    def fault(self) -> str:
        return ""

    def untouched(self) -> bool:
        return not (self.leaning or self.meeting)

    def touches(self) -> dict[str, float]:
        return dict(self.leaning)

    def arm_touches(self) -> dict[str, float]:
        return dict(self.meeting)

    def move_hand(self) -> None:
        """One tick of a hand with nothing in it."""
        most = self.hand.speed_m_s * TICK_S
        self.width += max(-most, min(most, self.hand.width_m - self.width))


def stop(
    reason: StopReason, when: p.Predicate, reflex: Reflex = Reflex.STOP, back_off_m: float = 0.0
) -> p.StopFunction:
    return p.StopFunction(reason=reason, when=when, reflex=reflex, back_off_m=back_off_m)


def complete(*stops: p.StopFunction, limit_s: float = 30.0) -> list[p.StopFunction]:
    """F with a goal and a time limit added."""
    return [*stops, stop(StopReason.GOAL, p.GoalReached()), stop(StopReason.TIMEOUT, p.TimeAbove(limit_s))]


def joint_path(start: Sequence[float], end: Sequence[float], duration_s: float) -> p.JointTrajectory:
    still = [[0.0] * len(start)] * 2
    return p.JointTrajectory(
        space="joint",
        time_s=[0.0, duration_s],
        positions=[list(start), list(end)],
        velocities=still,
        accelerations=still,
    )


def line_path(model: ArmModel, start: Array, goal: Array, speed_m_s: float, knots: int = 40) -> p.JointTrajectory:
    """A straight line of the tcp with a quintic law of time, knots with their exact velocities."""
    begin = model.fk(start)
    length, turn = geometry.distance(begin, goal), geometry.rotation_vector(begin, goal)
    duration_s = max(1.875 * length / speed_m_s, np.sqrt(5.77 * length), 0.2)
    times = np.linspace(0.0, duration_s, knots + 1)
    joints = [np.asarray(start, dtype=float)]
    for t in times[1:] / duration_s:
        there = geometry.interpolate_all(begin, goal, np.array([t**3 * (10 + t * (6 * t - 15))]))[0]
        found = model.ik(there, near=joints[-1])
        assert found, "the test's line cannot be reached"
        joints.append(found[0])
    positions = np.array(joints)
    rates = 30.0 * ((times / duration_s) * (times / duration_s - 1.0)) ** 2 / duration_s
    twist = np.concatenate((np.asarray(goal[:3]) - begin[:3], turn))
    velocities = np.array(
        [np.linalg.solve(model.jacobian(q), twist * rate) for q, rate in zip(positions, rates, strict=True)]
    )
    accelerations = np.gradient(velocities, times, axis=0, edge_order=2)
    velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    return p.JointTrajectory(
        space="task",
        time_s=times.tolist(),
        positions=positions.tolist(),
        velocities=velocities.tolist(),
        accelerations=accelerations.tolist(),
    )


def primitive(
    trajectory: p.Trajectory, *stops: p.StopFunction, id: str = "C-7.1", performer: str = ARM, **more: object
) -> p.Primitive:
    limit_s = float(more.pop("limit_s", 30.0))  # type: ignore[arg-type]
    return p.Primitive(
        id=id,
        performer=performer,
        trajectory=trajectory,
        stop_functions=complete(*stops, limit_s=limit_s),
        **more,  # type: ignore[arg-type]
    )


class Rig:
    """An executor with a steered arm, ticked by hand."""

    def __init__(self, cell: Cell) -> None:
        self.arm = SteeredArm(cell)
        self.executor = Executor(self.arm)
        self.sent: list[m.Started | m.ProgressReport | m.EndReport] = []
        self.home = cell.arm(ARM).home_rad
        self.away = [self.home[0] + 0.5, *self.home[1:]]

    def accept(self, wanted: p.Primitive) -> m.Started | m.ProgressReport | m.EndReport:
        answers = self.executor.accept(wanted, 0.0)
        self.sent += answers
        assert len(answers) == 1
        return answers[0]

    def tick(self, ticks: int = 1) -> list[m.Started | m.ProgressReport | m.EndReport]:
        sent = []
        for _ in range(ticks):
            sent += self.executor.tick(0.0)
            self.arm.move_hand()
        self.sent += sent
        return sent

    def until_end(self, limit: int = 60_000) -> m.EndReport:
        for _ in range(limit):
            for message in self.tick():
                if isinstance(message, m.EndReport):
                    return message
        raise AssertionError(f"no end report in {limit} ticks; {self.executor.state}")

    def swing(self, *stops: p.StopFunction, duration_s: float = 1.0, **more: object) -> p.Primitive:
        """Half a radian with the first joint."""
        return primitive(joint_path(self.home, self.away, duration_s), *stops, **more)


class Bench:
    """A subsystem with the arms of a simulation, its broker's ear, and a clock."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.subsystem = McmSubsystem(simulation.arms, pid=1)
        self.now_s = 100.0
        self.tick_s = TICK_S  # by our clock; more on a busy machine
        self.sent: list[tuple[bytes, m.Message]] = []

    def handle(
        self, message: m.Execute | m.HaltOrder | m.ReportAck, sender: bytes = BROKER
    ) -> list[tuple[bytes, m.Message]]:
        sent = self.subsystem.handle(message, sender, self.now_s)
        self.sent += sent
        return sent

    def tick(self, ticks: int = 1) -> list[tuple[bytes, m.Message]]:
        sent = []
        for _ in range(ticks):
            sent += period(self.subsystem.tick, self.simulation, self.now_s)
            self.now_s += self.tick_s
        self.sent += sent
        return sent

    def perform(self, wanted: p.Primitive, limit: int = 60_000, watch: Callable[[], None] | None = None) -> m.EndReport:
        """Execute it, acknowledge its end report, and return that."""
        sent = self.handle(m.Execute(primitive=wanted))
        for _ in range(limit):
            for _, message in sent:
                if isinstance(message, m.EndReport) and message.primitive == wanted.id:
                    self.handle(m.ReportAck(primitive=wanted.id))
                    return message
            sent = self.tick()
            if watch is not None:
                watch()
        raise AssertionError(f"no end report of {wanted.id} in {limit} ticks")


@pytest.fixture(scope="session")
def cell() -> Cell:
    return Cell.load("swapout")


@pytest.fixture
def rig(cell: Cell) -> Rig:
    return Rig(cell)


@pytest.fixture(scope="session")
def rig_of(cell: Cell) -> Callable[[], Rig]:
    """For tests that need several."""
    return lambda: Rig(cell)


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """The builders, for tests in other files."""
    return SimpleNamespace(
        stop=stop,
        complete=complete,
        joint_path=joint_path,
        line_path=line_path,
        primitive=primitive,
        Rig=Rig,
        Bench=Bench,
        SteeredArm=SteeredArm,
        Follow=Follow,
    )
