"""The MCM as a real process, with a broker made of one socket: it goes on alone, and never chokes on bytes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import zmq

from rtc.client.halt import HaltLine
from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.protocol.versions import VERSION
from rtc.protocol.wire import PROTOCOL, frames, reader
from rtc.runtime.settings import Settings, prepare_run_dir
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import CellState, HandCommand
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.state_file import StateFile

pytestmark = [pytest.mark.slow, pytest.mark.untimed]
ARM, OTHER, LIMIT_S = "RIGHT-ARM", "LEFT-ARM", 20.0

_from_mcm = reader(m.SubsystemToBroker)


class Broker:
    """The broker's side of the subsystems' socket."""

    def __init__(self, context: zmq.Context, settings: Settings) -> None:
        self.socket = context.socket(zmq.ROUTER)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.ROUTER_HANDOVER, 1)
        self.socket.bind(settings.endpoint("subsystems"))

    def send(self, message: m.Message) -> None:
        self.socket.send_multipart([b"MCM", *frames(message)])

    def recv(self, kind: type, wanted: Callable[[m.Message], bool] = lambda _: True) -> m.Message:
        limit_s = time.monotonic() + LIMIT_S
        while (left_s := limit_s - time.monotonic()) > 0:
            if self.socket.poll(left_s * 1000):
                message = _from_mcm(self.socket.recv_multipart()[1:])
                if isinstance(message, kind) and wanted(message):
                    return message
        raise AssertionError(f"no {kind} in {LIMIT_S} s")


@contextmanager
def running(run_dir: Path, kind: str, speed: float, state: CellState | None = None) -> Iterator[SimpleNamespace]:
    """A process that begins in this state of the cell, or in the initial one."""
    prepare_run_dir(run_dir)
    settings = Settings(run_dir=str(run_dir), mcm=kind, speed=speed)
    settings.save()
    if state is not None:
        StateFile(run_dir, settings.run, "MCM").save(state)
    with (
        (run_dir / "MCM.log").open("wb") as log,
        subprocess.Popen(
            [sys.executable, "-m", "sim_mcm", "--run-dir", str(run_dir)], stdout=subprocess.PIPE, stderr=log
        ) as process,
        zmq.Context() as context,
    ):
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            yield SimpleNamespace(process=process, settings=settings, context=context)
        finally:
            process.kill()
            context.destroy(linger=0)


@contextmanager
def at_three_speeds(folder: Path, kind: str, state: CellState | None = None) -> Iterator[list[SimpleNamespace]]:
    """Three processes, slower than real time, as fast, and faster."""
    with ExitStack() as stack, ThreadPoolExecutor() as threads:
        clusters = [running(folder / f"{speed}", kind, speed, state) for speed in (0.2, 1.0, 5.0)]
        yield list(threads.map(stack.enter_context, clusters))


@pytest.fixture(params=["kinematic", "bullet"])
def mcm(request, tmp_path_factory) -> Iterator[SimpleNamespace]:
    with running(tmp_path_factory.mktemp("r"), request.param, 1.0) as made:
        yield made


@pytest.fixture
def swing(cell, make):
    def build(id: str, duration_s: float, *stops: p.StopFunction) -> p.Primitive:
        home = cell.arm(ARM).home_rad
        path = make.joint_path(home, [home[0] + 0.3, *home[1:]], duration_s)
        return make.primitive(path, *stops, id=id)

    return build


def test_a_primitive_from_execute_to_acknowledgement(mcm, swing) -> None:
    broker = Broker(mcm.context, mcm.settings)
    hello = broker.recv(m.SubsystemHello)
    assert hello.performers == [ARM, "LEFT-ARM"]
    assert hello.pid == mcm.process.pid

    broker.send(m.Execute(primitive=swing("C-1.1", 0.8)))
    assert broker.recv(m.Started).primitive == "C-1.1"
    first = broker.recv(m.EndReport)
    again = broker.recv(m.EndReport)
    assert first == again
    assert first.reason is StopReason.GOAL

    broker.send(m.ReportAck(primitive="C-1.1"))
    broker.send(m.HelloWanted())
    assert broker.recv(m.SubsystemHello, lambda hello: hello.outstanding == []).outstanding == []

    mcm.process.send_signal(signal.SIGTERM)
    assert mcm.process.wait(LIMIT_S) == 0


def test_without_a_broker_it_finishes_stops_on_halt_and_tells_all_to_the_next(mcm, swing, make) -> None:
    broker = Broker(mcm.context, mcm.settings)
    broker.recv(m.SubsystemHello)
    broker.send(m.Execute(primitive=swing("C-1.1", 30.0, make.stop(StopReason.CONTACT, p.TimeAbove(0.5)))))
    broker.recv(m.Started)
    broker.socket.close()  # in the middle of the motion

    halt_line = HaltLine(mcm.context, mcm.settings)
    result = halt_line.halt("LEFT-ARM")  # it rests, as the MCM knows: works when the broker is dead
    assert result.confirmed
    assert result.sent_to == ["estop"]
    assert not halt_line.halt("C-99").confirmed  # whether there is such a command only the broker knows

    broker = Broker(mcm.context, mcm.settings)
    hello = broker.recv(m.SubsystemHello, lambda hello: "C-1.1" in hello.outstanding)
    assert hello.outstanding == ["C-1.1"]
    report = broker.recv(m.EndReport)
    assert report.reason is StopReason.CONTACT  # the stop function tripped without a receiver
    assert report.measured == pytest.approx(0.5, abs=0.003)
    halt_line.close()


def test_a_halt_past_the_broker_stops_the_arm_and_is_reported_to_both(mcm, swing) -> None:
    broker = Broker(mcm.context, mcm.settings)
    broker.recv(m.SubsystemHello)
    broker.send(m.Execute(primitive=swing("C-1.1", 10.0)))
    broker.recv(m.Started)
    broker.recv(m.Heartbeat)

    halt_line = HaltLine(mcm.context, mcm.settings)
    result = halt_line.halt("ALL")

    assert result.confirmed
    assert result.moving == [ARM]
    assert result.latency_s is not None
    assert result.latency_s >= 0.0
    assert broker.recv(m.EndReport).reason is StopReason.HALT
    halt_line.close()


def test_messages_are_the_same_at_any_speed(tmp_path_factory, cell, make) -> None:
    """The order and the content of all messages about a motion, except their time stamps (R13)."""
    home = cell.arm(ARM).home_rad
    path = make.joint_path(home, [home[0] + 0.03, *home[1:]], 0.3)
    far = make.stop(StopReason.OUT_OF_RANGE, p.TcpFar(point=[0.0] * 3, distance_m=0.1))
    wanted = [
        make.primitive(path, id="C-1.1", reporting=p.Reporting(every_s=0.05)),
        make.primitive(p.HoldStill(), far, id="C-2.1"),
    ]
    with at_three_speeds(tmp_path_factory.mktemp("r"), "kinematic") as made:
        brokers = [Broker(one.context, one.settings) for one in made]
        for broker in brokers:
            broker.recv(m.SubsystemHello)
        seen: list[list[m.Message]] = [[] for _ in brokers]
        for primitive in wanted:
            for broker in brokers:
                broker.send(m.Execute(primitive=primitive))
            for broker, messages in zip(brokers, seen, strict=True):
                messages += about(broker, primitive.id)
    slow, real, fast = seen
    assert slow == real == fast
    assert [type(message) for message in real].count(m.ProgressReport) >= 6
    reasons = [message.reason for message in real if isinstance(message, m.EndReport)]
    assert reasons == [StopReason.GOAL, StopReason.OUT_OF_RANGE]


def test_physics_has_the_same_events_at_any_speed(tmp_path_factory, cell, make) -> None:
    """A touch with a back-off, reports on conditions, a grip, and a stop on a condition, by two arms at once (R13).

    The physics goes on between two orders, for as long as they take. So the figures agree within a tolerance.
    """
    state, model = hand_about_a_handle(cell), ArmModel.of(cell, ARM)
    start, home = state.arms[ARM].joints, cell.arm(OTHER).home_rad
    aside = [home[0] + 0.02, *home[1:]]
    here, there = model.fk(start), ArmModel.of(cell, OTHER).fk(aside)

    def farther(than_m: float, point: geometry.Array) -> p.TcpFar:
        return p.TcpFar(point=point[:3].tolist(), distance_m=than_m)

    def reports(*when: p.Predicate) -> p.Reporting:
        return p.Reporting(every_s=0.05, when=[p.ReportCondition(n=n, when=one) for n, one in enumerate(when)])

    touch = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=6.0), Reflex.BACK_OFF, 0.004)
    path = make.line_path(model, start, geometry.translate(here, (0.0, 0.012, 0.0)), 0.1)
    swing = make.joint_path(home, aside, 0.2)
    after = [p.StartAfter(primitive="C-1.1", path_s=0.05, within_s=10.0)]
    far = make.stop(StopReason.OUT_OF_RANGE, farther(0.010, there))
    back = make.joint_path(aside, [home[0] - 0.1, *home[1:]], 0.6)
    wanted = {
        ARM: [
            make.primitive(
                path, touch, id="C-1.1", reporting=reports(farther(0.002, here), p.ForceAbove(limit_n=50.0))
            ),
            make.primitive(p.HandMotion(width_m=0.0, force_n=20.0, speed_m_s=0.15), id="C-1.2"),
        ],
        OTHER: [
            make.primitive(swing, id="C-2.1", performer=OTHER, reporting=reports(), start_after=after),
            make.primitive(back, far, id="C-2.2", performer=OTHER, reporting=reports(farther(0.004, there))),
        ],
    }
    with at_three_speeds(tmp_path_factory.mktemp("r"), "bullet", state) as made, ThreadPoolExecutor() as threads:
        slow, real, fast = threads.map(lambda one: events(Broker(one.context, one.settings), wanted), made)
    for arm in wanted:
        assert [in_words(one) for one in slow[arm]] == [in_words(one) for one in real[arm]]
        assert [in_words(one) for one in fast[arm]] == [in_words(one) for one in real[arm]]
        for mine, reference in zip([*slow[arm], *fast[arm]], [*real[arm]] * 2, strict=True):
            assert_same_figures(mine, reference)
    ends = [message for messages in real.values() for message in messages if isinstance(message, m.EndReport)]
    reasons = [StopReason.CONTACT, StopReason.GOAL, StopReason.GOAL, StopReason.OUT_OF_RANGE]
    assert [message.reason for message in ends] == reasons
    assert ends[1].hand_width_m == pytest.approx(0.02, abs=1e-3)  # it has the handle
    for arm in wanted:  # one condition became true, the other did not
        reported = [message.condition for message in real[arm] if isinstance(message, m.ProgressReport)]
        assert set(reported) == {None, 0}
        assert reported.count(0) == 1


def about(broker: Broker, primitive: str) -> list[m.Message]:
    """All messages about a primitive up to its end report, without their times."""
    found: list[m.Message] = []
    while not found or not isinstance(found[-1], m.EndReport):
        message = broker.recv(m.Started | m.ProgressReport | m.EndReport, lambda one: one.primitive == primitive)
        found.append(msgspec.structs.replace(message, at_s=0.0))
    broker.send(m.ReportAck(primitive=primitive))
    return found


def hand_about_a_handle(cell: Cell) -> CellState:
    """The right hand stands about a handle, with 4 mm on either side."""
    state = KinematicCell(cell).state()
    handle = geometry.compose(cell.object_pose("MACS-NEW"), cell.object("MACS-NEW").grasp_point("HANDLE-A").frame.pose)
    arm = state.arms[ARM]
    arm.joints = ArmModel.of(cell, ARM).ik(handle, near=arm.joints)[0].tolist()
    arm.fingers, arm.opening_m, arm.hand = (0.014, 0.014), 0.028, HandCommand(0.028, 40.0, 0.15)
    return state


def events(broker: Broker, wanted: dict[str, list[p.Primitive]]) -> dict[str, list[m.Message]]:
    """All messages about primitives of each arm. An arm gets the next one when it has ended the one before."""
    broker.recv(m.SubsystemHello)
    left = {arm: list(primitives) for arm, primitives in wanted.items()}
    found: dict[str, list[m.Message]] = {arm: [] for arm in wanted}
    present = {arm: primitives.pop(0) for arm, primitives in left.items()}
    for primitive in present.values():
        broker.send(m.Execute(primitive=primitive))
    while present:
        message = broker.recv(m.Started | m.ProgressReport | m.EndReport)
        arm = next((arm for arm, primitive in present.items() if primitive.id == message.primitive), None)
        if arm is None:  # an end report is repeated until it is acknowledged
            continue
        found[arm].append(message)
        if isinstance(message, m.EndReport):
            broker.send(m.ReportAck(primitive=message.primitive))
            del present[arm]
            if left[arm]:
                present[arm] = left[arm].pop(0)
                broker.send(m.Execute(primitive=present[arm]))
    return found


def in_words(message: m.Message) -> tuple[object, ...]:
    match message:
        case m.EndReport():
            return message.primitive, message.reason, message.reflex, message.message
        case m.ProgressReport():
            return message.primitive, "progress", message.condition
    return message.primitive, type(message).__name__


def assert_same_figures(mine: m.Message, reference: m.Message) -> None:
    if isinstance(mine, m.ProgressReport):
        assert mine.reading.tcp_pose[:3] == pytest.approx(reference.reading.tcp_pose[:3], abs=2e-4)
    if isinstance(mine, m.EndReport):
        assert mine.joints == pytest.approx(reference.joints, abs=1e-3)
        assert mine.tcp_pose[:3] == pytest.approx(reference.tcp_pose[:3], abs=2e-4)
        assert mine.duration_s == pytest.approx(reference.duration_s, abs=0.003)
        assert mine.measured == pytest.approx(reference.measured, rel=0.05, abs=1e-4)
        assert mine.hand_width_m == pytest.approx(reference.hand_width_m, abs=1e-4)
        assert mine.hand_force_n == pytest.approx(reference.hand_force_n, abs=0.5)


def test_no_bytes_stop_it(mcm, swing) -> None:
    broker = Broker(mcm.context, mcm.settings)
    broker.recv(m.SubsystemHello)
    estop = mcm.context.socket(zmq.DEALER)
    estop.connect(mcm.settings.endpoint("estop"))
    bench = mcm.context.socket(zmq.DEALER)
    bench.connect(mcm.settings.endpoint("bench"))
    rubbish = [[b""], [b"x", b"y", b"z"], [PROTOCOL, b"\xc1\xff"], [b"RTC9", b"\x80"], [PROTOCOL, b"\x81" * 5000]]
    for parts in rubbish:
        broker.socket.send_multipart([b"MCM", *parts])
        estop.send_multipart(parts)
        bench.send_multipart(parts)
    broker.socket.send_multipart([b"MCM", *frames(m.SubsystemHello(protocol=VERSION, name="X", pid=1, performers=[]))])

    assert estop.poll(LIMIT_S * 1000)
    declined = reader(m.FromHalt)(estop.recv_multipart())
    assert isinstance(declined, m.Declined)
    bench.send_multipart(frames(m.SimTruth(request="1")))
    assert bench.poll(LIMIT_S * 1000)
    truth = reader(m.FromSim)(bench.recv_multipart())
    assert set(truth.joints) == {ARM, "LEFT-ARM"}
    bench.send_multipart(frames(m.SimDisplace(request="2", object="MACS-NEW", offset=[0.0, 0.001])))
    assert bench.poll(LIMIT_S * 1000)
    assert "six finite numbers" in reader(m.FromSim)(bench.recv_multipart()).error
    bench.send_multipart(frames(m.SimFactors(request="3", mass=1.5)))
    assert bench.poll(LIMIT_S * 1000)
    assert reader(m.FromSim)(bench.recv_multipart()).error in ("", "kinematic arms have neither mass nor friction")
    broker.send(m.Execute(primitive=swing("C-1.1", 0.8)))
    assert broker.recv(m.EndReport).reason is StopReason.GOAL


def test_telemetry_tells_where_the_arms_are_and_only_physics_loads_its_library(mcm, cell) -> None:
    loaded = Path(f"/proc/{mcm.process.pid}/maps").read_text(encoding="utf-8")
    assert "pinocchio" in loaded
    assert ("pybullet" in loaded) is (mcm.settings.mcm == "bullet")
    ear = mcm.context.socket(zmq.SUB)
    ear.connect(mcm.settings.endpoint("telemetry"))
    ear.subscribe(b"")
    assert ear.poll(LIMIT_S * 1000)
    telemetry = reader(m.Telemetry)(ear.recv_multipart())
    assert telemetry.arms[ARM].joints == pytest.approx(cell.arm(ARM).home_rad, abs=1e-3)
    assert telemetry.arms[ARM].primitive == ""
    assert telemetry.ticks > 0
