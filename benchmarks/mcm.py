"""Does the simulated MCM keep 1 kHz beside busy workers, and how much faster than real time can it run?

The MCM process is the real one; one socket stands for the broker. A tick is late if it begins more than a period (1 ms)
after it was due. It is measured at `--speed 1`, while one busy process per core runs at the workers' niceness. The
real-time factor is the simulated seconds per second at `--speed max`, with both arms moving, and with one of them
gripping. The limit of both is the speed of the physics library's step alone, in the same run and motion. For comparison
it is also measured with both arms at rest. Ratios to that limit are of processor times of the main thread, so that
other work on the machine has no part in them.

    python -m benchmarks.mcm [--seconds 20] [--mcm bullet|kinematic]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import zmq

from benchmarks.report import finish, question
from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.protocol.wire import frames, reader
from rtc.runtime.settings import Settings, prepare_run_dir
from rtc.spatial import geometry
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import CellState
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.bullet_world import STEP_S
from sim_mcm.period import period
from sim_mcm.state_file import StateFile

ARMS = ("RIGHT-ARM", "LEFT-ARM")
WORKERS_NICENESS = 5
LIMIT_S = 300.0
SWING_RAD, SWING_S = 0.4, 4.0  # of the first joint, in each direction
ROUNDS = 5  # of free motion and the step alone, alternating; the round of the median ratio is reported
STEPS = 100  # physics steps between two readings of the clock
HANDLE, MODULE = "HANDLE-A", "MACS-NEW"
RIGID = p.ControlLaw()
SOFT = p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=[400.0] * 3 + [12.0] * 3))

_decode = reader(m.SubsystemToBroker)
_look = reader(m.Telemetry)


class RunningMcm:
    """A running MCM, and the socket that receives its reports."""

    def __init__(self, mcm: str, speed: float, folder: str, state: CellState | None = None) -> None:
        """`state`: where arms and objects are at the start; without it where the cell has them."""
        settings = self.settings = Settings(run_dir=str(prepare_run_dir(Path(folder))), mcm=mcm, speed=speed)
        settings.save()
        if state is not None:
            StateFile(settings.path, settings.run, "MCM").save(state)
        command = [sys.executable, "-m", "sim_mcm", "--run-dir", folder]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert self.process.stdout is not None
        if self.process.stdout.readline() != b"ready\n":
            raise SystemExit("the MCM did not come up")
        self.context = zmq.Context()
        self.broker = self.context.socket(zmq.ROUTER)
        self.broker.bind(settings.endpoint("subsystems"))
        self.telemetry = self.context.socket(zmq.SUB)
        self.telemetry.setsockopt(zmq.CONFLATE, 0)
        self.telemetry.connect(settings.endpoint("telemetry"))
        self.telemetry.subscribe(b"")
        self.wait(m.SubsystemHello)
        self._count = 0

    def wait(self, kind: type, primitive: str = "") -> m.Message:
        limit_s = time.monotonic() + LIMIT_S
        while time.monotonic() < limit_s:
            if self.broker.poll(1000):
                message = _decode(self.broker.recv_multipart()[1:])
                if isinstance(message, m.HaltOrder):  # of a client; acknowledged, as a broker does
                    self.order(message)
                if isinstance(message, kind) and getattr(message, "primitive", "") == primitive:
                    return message
        raise SystemExit(f"the MCM did not answer within {LIMIT_S:.0f} s")

    def begin(self, arm: str, trajectory: p.Trajectory, law: p.ControlLaw = RIGID) -> str:
        self._count += 1
        order = execute(f"C-1.{self._count}", arm, trajectory, law)
        self.order(order)
        return order.primitive.id

    def order(self, order: m.Execute | m.HaltOrder | m.ReportAck) -> None:
        self.broker.send_multipart([b"MCM", *frames(order)])

    def end(self, primitive: str) -> m.EndReport:
        report = self.wait(m.EndReport, primitive)
        assert isinstance(report, m.EndReport)
        self.order(m.ReportAck(primitive=primitive))
        return report

    def processor_s(self) -> float:
        """Processor time of the main thread so far."""
        pid = self.process.pid
        return 1e-9 * int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text(encoding="utf-8").split()[0])

    def look(self) -> m.Telemetry:
        """The newest telemetry."""
        while self.telemetry.poll(0):
            self.telemetry.recv_multipart()
        return _look(self.telemetry.recv_multipart())

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(10)
        self.context.destroy(linger=0)


@contextlib.contextmanager
def station(mcm: str, speed: float) -> Iterator[RunningMcm]:
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        made = RunningMcm(mcm, speed, folder)
        try:
            yield made
        finally:
            made.close()


@contextlib.contextmanager
def busy_cores() -> Iterator[None]:
    """One busy process per core, at the niceness of workers."""
    burn = f"import os; os.nice({WORKERS_NICENESS})\nwhile True: sum(range(10000))"
    burners = [subprocess.Popen([sys.executable, "-c", burn]) for _ in os.sched_getaffinity(0)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


def execute(name: str, arm: str, trajectory: p.Trajectory, law: p.ControlLaw = RIGID) -> m.Execute:
    stops = [
        _stop(StopReason.GOAL, p.GoalReached()),
        _stop(StopReason.TIMEOUT, p.TimeAbove(600.0)),
        _stop(StopReason.COLLISION, p.BodyTouch()),
        _stop(StopReason.JOINT_LIMIT, p.JointMarginBelow(0.01)),
        _stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=60.0)),
    ]
    return m.Execute(
        primitive=p.Primitive(id=name, performer=arm, trajectory=trajectory, stop_functions=stops, control_law=law)
    )


def _stop(reason: StopReason, when: p.Predicate) -> p.StopFunction:
    return p.StopFunction(reason=reason, when=when)


def _path(knots: list[list[float]], each_s: float) -> p.JointTrajectory:
    still = [[0.0] * len(knots[0])] * len(knots)
    times = [n * each_s for n in range(len(knots))]
    return p.JointTrajectory(space="joint", time_s=times, positions=knots, velocities=still, accelerations=still)


def swings(cell: Cell, arm: str, duration_s: float) -> p.JointTrajectory:
    """Motions of the first joint to and fro, in free space."""
    home = cell.arm(arm).home_rad
    away = [home[0] - SWING_RAD * (1 if arm == ARMS[0] else -1), *home[1:]]
    count = max(2, 2 * round(duration_s / SWING_S / 2))
    return _path([home if n % 2 == 0 else away for n in range(count + 1)], SWING_S)


def late_percent(mcm: str, cell: Cell, seconds: float, busy: bool, law: p.ControlLaw = RIGID) -> tuple[float, int]:
    """Share of late ticks while both arms move in real time, and the number of ticks."""
    with station(mcm, 1.0) as made, busy_cores() if busy else contextlib.nullcontext():
        begun = [made.begin(arm, swings(cell, arm, seconds + 10.0), law) for arm in ARMS]
        time.sleep(1.0)
        before = made.look()
        time.sleep(seconds)
        after = made.look()
        assert len(begun) == len(ARMS)
    ticks = after.ticks - before.ticks
    return 100.0 * (after.late_ticks - before.late_ticks) / ticks, ticks


class Factors(NamedTuple):
    """Simulated seconds per second, and per second of the processor."""

    real_time: float
    processor: float


def free_factor(mcm: str, cell: Cell, seconds: float) -> Factors:
    """Both arms move freely."""
    with station(mcm, 0.0) as made:
        begun = [made.begin(arm, swings(cell, arm, 10.0 * seconds)) for arm in ARMS]
        began_s, spent_s = time.perf_counter(), made.processor_s()
        reports = [made.end(primitive) for primitive in begun]
        took_s, spent_s = time.perf_counter() - began_s, made.processor_s() - spent_s
    assert all(report.reason is StopReason.GOAL for report in reports), reports
    simulated_s = max(report.duration_s for report in reports)
    return Factors(simulated_s / took_s, simulated_s / spent_s)


def bare_resting_factor(cell: Cell, seconds: float) -> float:
    """Simulated seconds per second of the processor in the physics library's step alone, both arms at rest."""
    world = BulletCell(cell).world
    steps, began_s = 0, time.thread_time()
    while (took_s := time.thread_time() - began_s) < seconds:
        for _ in range(STEPS):
            world.step()
        steps += STEPS
    return steps * STEP_S / took_s


def bare_factor(cell: Cell, seconds: float) -> float:
    """The same while both arms move freely; the rest of each tick is not counted."""
    world = BulletCell(cell)
    subsystem = McmSubsystem(world.arms)
    for n, arm in enumerate(ARMS):
        subsystem.handle(execute(f"C-1.{n + 1}", arm, swings(cell, arm, seconds)), BROKER, 0.0)
    return _stepped(world, subsystem, len(ARMS))


def _stepped(world: BulletCell, subsystem: McmSubsystem, primitives: int) -> float:
    """Simulated seconds per second of the physics step alone, until so many primitives have ended. The rest of a period
    is that of the MCM: without the catches, for example, a module would never leave its seat."""
    steps, took_s = 0, 0.0
    step = world.world.step

    def timed_step() -> None:
        nonlocal steps, took_s
        began_s = time.thread_time()
        step()
        took_s += time.thread_time() - began_s
        steps += 1

    world.world.step = timed_step  # type: ignore[method-assign]
    try:
        while primitives:
            ends = period(subsystem.tick, world, steps * STEP_S)
            primitives -= sum(isinstance(message, m.EndReport) for _, message in ends)
            if steps * STEP_S > LIMIT_S:
                raise SystemExit(f"the motion has not ended within {LIMIT_S:.0f} s of simulated time")
    finally:
        del world.world.step  # type: ignore[method-assign]
    return steps * STEP_S / (took_s - steps * _clock_s())


def _clock_s(calls: int = 10_000) -> float:
    """The time that a reading of the clock adds to what it measures."""
    return sum(-(time.thread_time() - time.thread_time()) for _ in range(calls)) / calls


def grasp_and_carry(cell: Cell, seconds: float) -> list[p.Trajectory]:
    """Grasp a module with the right arm, lift it, and carry it to and fro in the air for these seconds."""
    arm = ARMS[0]
    model = ArmModel.of(cell, arm)
    handle = geometry.compose(cell.object_pose(MODULE), cell.object(MODULE).grasp_point(HANDLE).frame.pose)
    joints = [cell.arm(arm).home_rad]
    for back_m, up_m in ((0.1, 0.0), (0.0, 0.0), (0.0, 0.3), (0.15, 0.3)):
        pose = geometry.translate(handle, (-back_m, 0.0, up_m))
        joints.append(model.ik(pose, near=joints[-1])[0].tolist())
    home, front, at, above, aside = joints
    count = max(2, 2 * round(seconds / SWING_S / 2))
    carry = _path([above if n % 2 == 0 else aside for n in range(count + 1)], SWING_S)
    close = p.HandMotion(width_m=0.0, force_n=30.0)
    return [_path([home, front], 3.0), _path([front, at], 2.0), close, _lift(model, at, handle), carry]


def gripping_factor(mcm: str, cell: Cell, seconds: float) -> Factors:
    """The right arm carries a module, and the left arm rests."""
    *grasp, carry = grasp_and_carry(cell, 5.0 * seconds)
    with station(mcm, 0.0) as made:
        for step in grasp:
            report = made.end(made.begin(ARMS[0], step))
            if report.reason is not StopReason.GOAL:
                raise SystemExit(f"the grasp failed: {report.reason} {report.message}")
        carried = made.begin(ARMS[0], carry)
        began_s, spent_s = time.perf_counter(), made.processor_s()
        report = made.end(carried)
        took_s, spent_s = time.perf_counter() - began_s, made.processor_s() - spent_s
    assert report.reason is StopReason.GOAL, report
    assert 0.018 < report.hand_width_m < 0.022, "the module was lost"
    return Factors(report.duration_s / took_s, report.duration_s / spent_s)


def _free_and_bare(mcm: str, cell: Cell, seconds: float, physics: bool) -> tuple[Factors, float | None]:
    """One after the other, so that both meet the same machine."""
    return free_factor(mcm, cell, seconds), bare_factor(cell, seconds) if physics else None


def bare_gripping_factor(cell: Cell, seconds: float) -> float:
    """The physics step alone while an arm carries; the rest of each tick is not counted."""
    world = BulletCell(cell)
    subsystem = McmSubsystem(world.arms)
    factor = 0.0
    for n, trajectory in enumerate(grasp_and_carry(cell, seconds)):
        subsystem.handle(execute(f"C-1.{n + 1}", ARMS[0], trajectory), BROKER, 0.0)
        factor = _stepped(world, subsystem, 1)
    return factor


def _lift(model: ArmModel, start: list[float], handle: geometry.Array, height_m: float = 0.3) -> p.JointTrajectory:
    """A trajectory straight up out of the rack, with dense knots."""
    knots = [start]
    for n in range(1, 31):
        pose = geometry.translate(handle, (0.0, 0.0, height_m * _smooth(n / 30)))
        knots.append(model.ik(pose, near=knots[-1])[0].tolist())
    each_s = 4.0 / 30
    rates = [[(b - a) / (2 * each_s) for a, b in zip(k0, k1, strict=True)] for k0, k1 in zip(knots, knots[2:])]  # noqa: B905
    still = [0.0] * len(start)
    return p.JointTrajectory(
        space="task",
        time_s=[n * each_s for n in range(31)],
        positions=knots,
        velocities=[still, *rates, still],
        accelerations=[still] * 31,
    )


def _smooth(x: float) -> float:
    return x**3 * (10 + x * (6 * x - 15))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=20.0, help="approximate wall-clock time for each figure")
    options.add_argument("--mcm", default="bullet")
    given = options.parse_args()
    cell = Cell.load("swapout")
    question("mcm", f"does the {given.mcm} MCM keep 1 kHz beside busy workers, and how fast can it run?")
    rows: list[tuple[str, str]] = []

    def measured(label: str, text: str) -> None:
        rows.append((label, text))
        print(f"  {label}: {text}", flush=True)

    idle, ticks = late_percent(given.mcm, cell, given.seconds, busy=False)
    measured("late ticks, machine idle", f"{idle:.3f} % of {ticks}")
    late, ticks = late_percent(given.mcm, cell, given.seconds, busy=True)
    measured("late ticks, all cores busy", f"{late:.3f} % of {ticks}")
    soft = None
    if given.mcm == "bullet":  # exact arms cannot comply
        soft, ticks = late_percent(given.mcm, cell, given.seconds, busy=True, law=SOFT)
        measured("late ticks, all cores busy, both arms under impedance", f"{soft:.3f} % of {ticks}")
    physics = given.mcm == "bullet"
    pairs = [_free_and_bare(given.mcm, cell, given.seconds / ROUNDS, physics) for _ in range(ROUNDS)]
    if physics:
        pairs.sort(key=lambda pair: pair[0].processor / (pair[1] or 1.0))
        rounds = ", ".join(f"{free.processor / (bare or 1.0):.2f}" for free, bare in pairs)
        measured(f"ratio of both arms moving in {ROUNDS} rounds", rounds)
    free, bare = pairs[ROUNDS // 2]
    gripping = gripping_factor(given.mcm, cell, given.seconds)
    resting = bare_gripping = None
    if physics:
        resting = bare_resting_factor(cell, given.seconds / 4)
        bare_gripping = bare_gripping_factor(cell, given.seconds / 2)
    for label, factor, step in (("both arms moving", free, bare), ("one arm gripping", gripping, bare_gripping)):
        measured(f"real-time factor, {label}", f"{factor.real_time:.1f}; {factor.processor:.1f} with its own core")
        if step is not None:
            words = f"{step:.1f}; ratio {factor.processor / step:.2f}"
            measured(f"real-time factor of the physics step alone, {label}", words)
    if resting is not None:
        words = f"{resting:.1f}; ratio of both arms moving {free.processor / resting:.2f}"
        measured("real-time factor of the physics step alone, both arms at rest", words)
    finish(
        "mcm",
        {
            "late_ticks_percent": late,
            "late_ticks_idle_percent": idle,
            "real_time_factor": free.real_time,
            "real_time_factor_gripping": gripping.real_time,
            "real_time_factor_bare": bare,
            "late_ticks_compliant_percent": soft,
            "real_time_factor_bare_gripping": bare_gripping,
            "real_time_factor_bare_resting": resting,
            "ratio_resting": None if resting is None else free.processor / resting,
            "ratio": None if bare is None else free.processor / bare,
            "ratio_gripping": None if bare_gripping is None else gripping.processor / bare_gripping,
        },
        rows,
    )


if __name__ == "__main__":
    main()
