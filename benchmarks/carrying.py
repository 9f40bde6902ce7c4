"""Two arms that carry one module in a running MCM, both under impedance, halted while they move.

The MCM process is the real one; one socket stands for the broker, another for a client that halts. The module stands
between the open hands in a state file; both hands close. Then every motion moves it 100 mm up or down along a straight
line, and a halt at a random moment stops it. Each halt is checked: both arms were moving, came to rest, and still hold
the module.
"""

from __future__ import annotations

import random
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import zmq

from benchmarks.force import straight
from benchmarks.mcm import ARMS, RunningMcm, execute
from rtc.client.halt import RANK
from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.protocol.wire import frames, reader
from rtc.runtime.priority import real_time
from rtc.runtime.process import real_time_io
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import ArmState, CellState, HandCommand
from sim_mcm.arms.bullet_arm import BulletCell

MODULE = "MACS-NEW"
HANDLES = dict(zip(ARMS, ("HANDLE-A", "HANDLE-B"), strict=True))
MIDDLE_M = (0.46, 0.0, 0.6)  # between the handles at the start
SOFT = p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=[600.0] * 3 + [30.0] * 3))
GRIP_N = 30.0
WAY_M, SPEED_M_S = 0.1, 0.1
MIN_DELAY_S, MAX_DELAY_S = 0.4, 1.2  # of a halt, after the start of a motion of 1.9 s
WIDTH_M = 0.02  # of the bar that each hand holds
MARGIN_RAD = 0.05

_answer = reader(m.SubsystemToBroker)


def between_the_hands(cell: Cell) -> CellState:
    """The module upright in the air, with a handle between the fingers of each open hand."""
    world = BulletCell(cell)
    state = world.state()
    world.close()
    points = {arm: cell.object(MODULE).grasp_point(name).frame.pose for arm, name in HANDLES.items()}
    level = geometry.make_pose((0, 0, 0), (0.0, 2**-0.5, 0.0, 2**-0.5))
    module = geometry.make_pose((0, 0, 0), geometry.compose(level, geometry.inverse(points[ARMS[0]]))[3:])
    hands = [geometry.compose(module, point)[:3] for point in points.values()]
    module = geometry.translate(module, np.asarray(MIDDLE_M) - 0.5 * (hands[0] + hands[1]))
    state.poses[MODULE] = module.tolist()
    for arm, point in points.items():
        spec, tcp = cell.arm(arm), geometry.compose(module, point)
        joints = ArmModel.of(cell, arm).ik(tcp.tolist(), spec.home_rad, MARGIN_RAD)[0].tolist()
        width = spec.gripper.max_opening_m
        hand = HandCommand(width, spec.gripper.max_force_n, spec.gripper.speed_m_s)
        state.arms[arm] = ArmState(joints=joints, fingers=(0.5 * width, 0.5 * width), hand=hand, opening_m=width)
    return state


class Carrying:
    """A running MCM whose arms hold the module, and the halt socket of a client."""

    def __init__(self, cell: Cell, folder: str, rng: random.Random) -> None:
        state = between_the_hands(cell)
        self._models = {arm: ArmModel.of(cell, arm) for arm in ARMS}
        self._joints = {arm: state.arms[arm].joints for arm in ARMS}
        self._rng, self._motions = rng, 0
        self.mcm = RunningMcm("bullet", 1.0, folder, state)
        self._context = zmq.Context()
        self._rank = RANK if real_time_io(self._context, RANK) else 0  # as `rtc halt` has
        self._client = self._context.socket(zmq.DEALER)
        self._client.connect(self.mcm.settings.endpoint("estop"))
        for arm in ARMS:
            report = self.mcm.end(self.mcm.begin(arm, p.HandMotion(width_m=0.0, force_n=GRIP_N)))
            assert report.reason is StopReason.GOAL, report

    def halt_once(self) -> tuple[float, float, float]:
        """Move the module, halt both arms on the way. Returns the latency until both decelerate, the part of it until
        the MCM received the halt, and the time of the call (s)."""
        up = WAY_M if self._motions % 2 == 0 else -WAY_M
        self._motions += 1
        name = f"C-2.{self._motions}"
        self.mcm.order(m.Execute(primitive=self._both(name, np.array((0.0, 0.0, up)))))
        self.mcm.wait(m.Started, name)
        time.sleep(self._rng.uniform(MIN_DELAY_S, MAX_DELAY_S))
        with real_time(self._rank):
            halt = m.HaltOrder(halt=f"H-{self._motions}", scope="ALL", called_at_s=time.monotonic())
            self._client.send_multipart(frames(halt))
        started, rest = self._wait(m.HaltStarted), self._wait(m.HaltAtRest)
        report = self.mcm.end(name)
        assert isinstance(started, m.HaltStarted)
        assert isinstance(rest, m.HaltAtRest)
        assert report.partner is not None
        assert report.reason is StopReason.HALT, report
        assert rest.at_rest
        assert set(started.moving) == set(ARMS), started
        for arm, part in zip(ARMS, (report, report.partner), strict=True):
            assert abs(part.hand_width_m - WIDTH_M) < 0.002, "the module was lost"
            self._joints[arm] = part.joints
        called_at_s = halt.called_at_s
        return started.decelerating_at_s - called_at_s, started.received_at_s - called_at_s, called_at_s

    def _both(self, name: str, way: Array) -> p.Primitive:
        leading, other = (
            execute(name, arm, straight(model, self._joints[arm], self._along(arm, way), SPEED_M_S), SOFT).primitive
            for arm, model in self._models.items()
        )
        assert isinstance(other.trajectory, p.JointTrajectory)
        partner = p.Partner(
            performer=other.performer,
            trajectory=other.trajectory,
            control_law=SOFT,
            stop_functions=other.stop_functions,
        )
        return p.Primitive(
            id=name,
            performer=leading.performer,
            trajectory=leading.trajectory,
            stop_functions=leading.stop_functions,
            control_law=SOFT,
            partner=partner,
        )

    def _along(self, arm: str, way: Array) -> Array:
        return geometry.translate(self._models[arm].fk(self._joints[arm]), way)

    def _wait(self, kind: type) -> m.Message:
        while self._client.poll(10_000):
            message = _answer(self._client.recv_multipart())
            if isinstance(message, kind):
                return message
        raise SystemExit(f"the MCM sent no {kind.__name__}")

    def close(self) -> None:
        self._context.destroy(linger=0)
        self.mcm.close()


@contextmanager
def carrying(cell: Cell, rng: random.Random) -> Iterator[Carrying]:
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        made = Carrying(cell, folder, rng)
        try:
            yield made
        finally:
            made.close()
