"""Does a compliant arm give way, press and touch as commanded?

Both arms in pybullet, in one process, in simulated time; no broker and no sockets. Four questions:

* stiffness: the tool is pushed with a known force; commanded against measured stiffness along three axes;
* force: a set-point is held for seconds against the satellite's face at several places of it;
* approach: the hand meets the face, or a handle sideways, at rising speed with a stop at 10 N; the peak of the wrist
  force under position control and under impedance, and at the speed that the binder allows for 10 N;
* cost: processor time of one tick of each control law.

    python -m benchmarks.force [--places 4]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator

import numpy as np
import pybullet

from benchmarks.report import RESULTS, finish, percentile, question
from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.period import period
from workers.tasks import impact

ARMS = ("RIGHT-ARM", "LEFT-ARM")
SEED = 10
PALM = 7  # link in the URDF of both arms
STIFFNESS_N_M = (200.0, 400.0, 1000.0, 2000.0, 5000.0)
SET_POINTS_N = (5.0, 10.0, 20.0)
LIMIT_N = 10.0
SPEEDS_M_S = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
TIP_M = 0.015  # of the fingertips beyond the tcp
IMPACT_S, TURN_M = 0.0011, 0.173  # of the binder's program
MODULE, HANDLE = "MACS-NEW", "HANDLE-A"


class Station:
    """A simulated MCM and one arm of it."""

    def __init__(self, cell: Cell, arm: str) -> None:
        self.cell, self.arm = cell, arm
        self.world = BulletCell(cell)
        self.mcm = McmSubsystem(self.world.arms, pid=1)
        self.executor = self.mcm.executors[arm]
        self.model = ArmModel.of(cell, arm)
        self._count = 0
        self._now_s = 0.0

    def tick(self, ticks: int = 1) -> Iterator[m.Message]:
        for _ in range(ticks):
            sent = period(self.mcm.tick, self.world, self._now_s)
            self._now_s += TICK_S
            yield from (message for _, message in sent)

    def begin(self, trajectory: p.Trajectory, *stops: p.StopFunction, law: p.ControlLaw | None = None) -> str:
        self._count += 1
        always = [_stop(StopReason.GOAL, p.GoalReached()), _stop(StopReason.TIMEOUT, p.TimeAbove(300.0))]
        primitive = p.Primitive(
            id=f"C-1.{self._count}",
            performer=self.arm,
            trajectory=trajectory,
            stop_functions=[*always, *stops],
            control_law=law or p.ControlLaw(),
        )
        for _, message in self.mcm.handle(m.Execute(primitive=primitive), BROKER, self._now_s):
            assert isinstance(message, m.Started), message
        return primitive.id

    def end(self, primitive: str, watch: Callable[[], None] | None = None) -> m.EndReport:
        while True:
            for message in self.tick():
                if isinstance(message, m.EndReport) and message.primitive == primitive:
                    self.mcm.handle(m.ReportAck(primitive=primitive), BROKER, self._now_s)
                    return message
            if watch is not None:
                watch()

    def line(
        self, offset: Array, speed_m_s: float, *stops: p.StopFunction, law: p.ControlLaw | None = None
    ) -> m.EndReport:
        """Move the tcp by `offset` (world, m) in a straight line."""
        start = self.executor.command[0]
        pose = geometry.translate(self.model.fk(start), offset)
        return self.end(self.begin(straight(self.model, start, pose, speed_m_s), *stops, law=law))

    def to(self, pose: Array, duration_s: float = 3.0) -> None:
        """Move the tcp to a pose, in joint space."""
        start = self.executor.command[0]
        goal = self.model.ik(pose, near=start)[0].tolist()
        still = [[0.0] * len(start)] * 2
        path = p.JointTrajectory(
            space="joint", time_s=[0.0, duration_s], positions=[start, goal], velocities=still, accelerations=still
        )
        report = self.end(self.begin(path))
        assert report.reason is StopReason.GOAL, report

    @property
    def tcp(self) -> Array:
        return self.model.fk(self.executor.sample.joints)

    def close(self) -> None:
        self.world.world.close()


def straight(model: ArmModel, start: list[float], goal: Array, speed_m_s: float, knots: int = 30) -> p.JointTrajectory:
    """A line of the tcp from rest to rest, with `speed_m_s` at its middle."""
    begin = model.fk(start)
    duration_s = max(1.875 * geometry.distance(begin, goal) / speed_m_s, 0.3)
    share = np.linspace(0.0, 1.0, knots + 1)
    joints = [np.asarray(start, dtype=float)]
    for s in (share**3 * (10 + share * (6 * share - 15)))[1:]:
        joints.append(model.ik(geometry.interpolate_all(begin, goal, np.array([s]))[0], near=joints[-1])[0])
    rates = 30.0 * (share * (share - 1.0)) ** 2 / duration_s
    twist = np.concatenate((np.asarray(goal[:3]) - begin[:3], geometry.rotation_vector(begin, goal)))
    speeds = np.array([np.linalg.solve(model.jacobian(q), twist * r) for q, r in zip(joints, rates, strict=True)])
    times = duration_s * share
    accelerations = np.gradient(speeds, times, axis=0, edge_order=2)
    accelerations[[0, -1]] = 0.0
    return p.JointTrajectory(
        space="task",
        time_s=times.tolist(),
        positions=np.array(joints).tolist(),
        velocities=speeds.tolist(),
        accelerations=accelerations.tolist(),
    )


def _stop(reason: StopReason, when: p.Predicate) -> p.StopFunction:
    return p.StopFunction(reason=reason, when=when)


def impedance(stiffness_n_m: float, force_n: float | None = None) -> p.ControlLaw:
    """The law with a stiffness, or with a force set-point along tool z."""
    wrench = [None, None, force_n, None, None, None] if force_n is not None else []
    figures = [stiffness_n_m] * 3 + [TURN_M**2 * stiffness_n_m] * 3
    return p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=figures, wrench=wrench))


# --- stiffness ---------------------------------------------------------------------------------------------


def stiffness_errors(cell: Cell) -> tuple[list[float], list[float]]:
    """(error of the measured stiffness, overshoot) in percent for both arms, five stiffnesses, three axes."""
    errors, overshoots = [], []
    for arm in ARMS:
        station = Station(cell, arm)
        for stiffness in STIFFNESS_N_M:
            for axis in range(3):
                error, overshoot = _one_stiffness(station, stiffness, axis)
                errors.append(error)
                overshoots.append(overshoot)
        station.close()
    return errors, overshoots


def _one_stiffness(station: Station, stiffness: float, axis: int, push_n: float = 5.0) -> tuple[float, float]:
    name = station.begin(p.HoldStill(duration_s=4.0), law=impedance(stiffness))
    list(station.tick(2))
    start, arm = station.tcp, station.world.arms[station.arm]
    push, moved = np.eye(3)[axis] * push_n, []
    for _ in range(3000):
        pybullet.applyExternalForce(
            arm.body, PALM, push.tolist(), station.tcp[:3].tolist(), pybullet.WORLD_FRAME,
            physicsClientId=station.world.world.client,
        )  # fmt: skip
        list(station.tick())
        moved.append(float(station.tcp[axis] - start[axis]))
    station.end(name)
    rest = float(np.mean(moved[-200:]))
    return 100.0 * (push_n / rest / stiffness - 1.0), 100.0 * (max(moved) / rest - 1.0)


# --- force -------------------------------------------------------------------------------------------------


def before_the_wall(cell: Cell, arm: str, place: tuple[float, float], gap_m: float) -> Station:
    """A station whose fingertips point at a `place` (distance to the side, z) of the satellite's face, `gap_m` away."""
    station = Station(cell, arm)
    home, side = station.tcp, -1.0 if arm == ARMS[0] else 1.0
    station.to(geometry.make_pose((home[0], side * place[0], place[1]), home[3:]))
    face = cell.object_pose("SATELLITE")[0]
    station.world.displace("SATELLITE", [station.tcp[0] + TIP_M + gap_m - face, 0.0, 0.0, 0.0, 0.0, 0.0])
    return station


def held_forces(cell: Cell, places: list[tuple[float, float]]) -> tuple[list[float], list[float], list[float]]:
    """(error of the mean force in percent, its rms in percent, peak of the first touch in N)."""
    errors, ripples, peaks = [], [], []
    for arm in ARMS:
        for place in places:
            for wanted in SET_POINTS_N:
                station = before_the_wall(cell, arm, place, 0.003)
                felt: list[float] = []
                name = station.begin(p.HoldStill(duration_s=6.0), law=impedance(1000.0, wanted))
                report = station.end(name, lambda felt=felt, s=station: felt.append(-s.executor.wrench[2]))  # type: ignore[misc]
                assert report.reason is StopReason.GOAL, report
                settled = felt[3000:5900]
                errors.append(100.0 * (float(np.mean(settled)) / wanted - 1.0))
                ripples.append(100.0 * float(np.std(settled)) / wanted)
                peaks.append(max(felt))
                station.close()
    return errors, ripples, peaks


# --- approach ----------------------------------------------------------------------------------------------


def peaks_by_speed(cell: Cell, places: list[tuple[float, float]], law: p.ControlLaw | None) -> dict[float, list[float]]:
    """Peak force (N) on the face by speed (m/s), with a stop at LIMIT_N."""
    found: dict[float, list[float]] = {}
    for speed in SPEEDS_M_S:
        way = max(0.03, 0.6 * speed)  # half of it stretches the spring beyond the limit
        for place in places:
            station = before_the_wall(cell, ARMS[0], place, 0.5 * way)
            found.setdefault(speed, []).append(_meet(station, (way, 0.0, 0.0), speed, law))
            station.close()
    return found


def allowed_peaks(cell: Cell, places: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """(speeds in m/s that the binder allows for LIMIT_N, their peaks in N)."""
    speeds, peaks = [], []
    for arm in ARMS:
        for place in places:
            station = before_the_wall(cell, arm, place, 0.003)
            joints = station.executor.sample.joints
            expected = impact.impact(station.model, joints, [1.0, 0.0, 0.0], 0.0, IMPACT_S, 0.1, LIMIT_N)
            assert expected is not None
            speeds.append(expected.safe_speed_m_s)
            peaks.append(_meet(station, (0.006, 0.0, 0.0), expected.safe_speed_m_s, None))
            station.close()
    return speeds, peaks


def handle_peaks(cell: Cell) -> dict[float, list[float]]:
    """Peak force (N) of a finger of the open hand that meets a handle sideways, by speed (m/s)."""
    found: dict[float, list[float]] = {}
    pose = geometry.compose(cell.object_pose(MODULE), cell.object(MODULE).grasp_point(HANDLE).frame.pose)
    for speed in SPEEDS_M_S[1:]:
        station = Station(cell, ARMS[0])
        station.to(geometry.translate(pose, (-0.1, 0.0, 0.0)))
        station.line(np.array((0.1, 0.0, 0.0)), 0.05)
        found[speed] = [_meet(station, (0.0, 0.04, 0.0), speed, None)]
        station.close()
    return found


def _meet(station: Station, way: tuple[float, float, float], speed: float, law: p.ControlLaw | None) -> float:
    stop = _stop(StopReason.CONTACT, p.ForceAbove(limit_n=LIMIT_N))
    report = station.line(np.array(way), speed, stop, law=law)
    assert report.reason is StopReason.CONTACT, (report.reason, report.message, speed)
    return report.peak_force_n


# --- cost --------------------------------------------------------------------------------------------------


def cost_us(cell: Cell, law: p.ControlLaw, calls: int = 5000) -> float:
    """Processor time of one call of the servo (microseconds)."""
    station = Station(cell, ARMS[0])
    station.begin(p.HoldStill(duration_s=10.0), law=law)
    list(station.tick(5))
    arm = station.world.arms[ARMS[0]]
    sample = arm.read()
    began_s = time.process_time()
    for _ in range(calls):
        arm._servo.torque(sample.joints, sample.velocities)
    took_s = time.process_time() - began_s
    station.close()
    return 1e6 * took_s / calls


def draw(rows: dict[str, dict[float, list[float]]], allowed: tuple[list[float], list[float]]) -> None:
    """results/force.png; skipped without matplotlib."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return
    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    for label, peaks in rows.items():
        speeds = sorted(peaks)
        middle = [1e3 * speed for speed in speeds]
        axes.plot(middle, [float(np.median(peaks[s])) for s in speeds], marker="o", label=label)
        axes.fill_between(middle, [min(peaks[s]) for s in speeds], [max(peaks[s]) for s in speeds], alpha=0.2)
    axes.scatter(
        [1e3 * s for s in allowed[0]],
        allowed[1],
        marker="x",
        color="black",
        label="wall, at the speed the binder allows for 10 N",
    )
    axes.axhline(LIMIT_N, linestyle=":", color="grey")
    axes.set(xscale="log", yscale="log", xlabel="speed (mm/s)", ylabel="peak of the wrist force (N)")
    axes.set_title("Stop at 10 N: peak force by speed of approach")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(RESULTS / "force.png", dpi=120)


def _worst(values: list[float]) -> float:
    return max(values, key=abs)


def _by_speed(peaks: dict[float, list[float]]) -> str:
    return ", ".join(f"{1e3 * s:g} mm/s {float(np.median(n)):.0f} N" for s, n in sorted(peaks.items()))


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--places", type=int, default=4, help="number of places on the satellite's face")
    given = words.parse_args()
    cell = Cell.load("swapout")
    random = np.random.default_rng(SEED)
    places = [(float(y), float(z)) for y, z in random.uniform((0.25, 0.75), (0.33, 0.92), (given.places, 2))]
    question("force", "does a compliant arm give way, press and touch as commanded?", seed=SEED)
    rows: list[tuple[str, str]] = []

    def measured(label: str, text: str) -> None:
        rows.append((label, text))
        print(f"  {label}: {text}", flush=True)

    errors, overshoots = stiffness_errors(cell)
    measured("stiffness 200 to 5000 N/m, measured against commanded", f"worst {_worst(errors):+.2f} % of {len(errors)}")
    measured("overshoot of a sudden push", f"worst {max(overshoots):.2f} %")
    off, ripples, touches = held_forces(cell, places)
    measured(
        "force held on a wall, 5 to 20 N", f"worst {_worst(off):+.2f} % of {len(off)}; rms worst {max(ripples):.1f} %"
    )
    measured("peak of the touch before it", f"p50 {percentile(touches, 50):.0f} N, worst {max(touches):.0f} N")
    rigid = peaks_by_speed(cell, places, None)
    measured("peak on a wall, position control, median", _by_speed(rigid))
    soft = peaks_by_speed(cell, places, impedance(1000.0))
    measured("peak on a wall, 1000 N/m, median", _by_speed(soft))
    speeds, peaks = allowed = allowed_peaks(cell, places)
    slow, fast = 1e3 * min(speeds), 1e3 * max(speeds)
    measured("peak at the speed allowed for 10 N", f"worst {max(peaks):.1f} N at {slow:.2f} to {fast:.2f} mm/s")
    handle = handle_peaks(cell)
    measured("peak on a handle, sideways", _by_speed(handle))
    costs = {
        "position": cost_us(cell, p.ControlLaw()),
        "impedance": cost_us(cell, impedance(1000.0)),
        "force": cost_us(cell, impedance(1000.0, 0.5)),
    }
    measured("processor time of a tick and arm", ", ".join(f"{name} {us:.1f} us" for name, us in costs.items()))
    draw({"wall, position control": rigid, "wall, 1000 N/m": soft, "handle, sideways": handle}, allowed)
    finish(
        "force",
        {
            "stiffness_error_percent": max(map(abs, errors)),
            "stiffness_overshoot_percent": max(overshoots),
            "force_error_percent": max(map(abs, off)),
            "force_ripple_percent": max(ripples),
            "guarded_peak_n": max(peaks),
            "impedance_tick_us": costs["impedance"],
            "position_tick_us": costs["position"],
        },
        rows,
    )


if __name__ == "__main__":
    main()
