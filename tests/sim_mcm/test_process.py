"""The MCM as a real process, with a broker made of one socket: it goes on alone, and never chokes on bytes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import zmq

from rtc.client.halt import HaltLine
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.protocol.wire import PROTOCOL, frames, reader
from rtc.runtime.settings import Settings, prepare_run_dir

pytestmark = pytest.mark.slow
ARM, LIMIT_S = "RIGHT-ARM", 20.0

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
        raise AssertionError(f"no {kind.__name__} in {LIMIT_S} s")


@contextmanager
def running(run_dir: Path, kind: str, speed: float) -> Iterator[SimpleNamespace]:
    prepare_run_dir(run_dir)
    settings = Settings(run_dir=str(run_dir), mcm=kind, speed=speed)
    settings.save()
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
    broker.send(m.ReportAck(primitive=""))
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
    with ExitStack() as stack:
        folder = tmp_path_factory.mktemp("r")
        made = [stack.enter_context(running(folder / f"{speed}", "kinematic", speed)) for speed in (0.2, 1.0, 5.0)]
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


def about(broker: Broker, primitive: str) -> list[m.Message]:
    """All messages about a primitive up to its end report, without their times."""
    found: list[m.Message] = []
    while not found or not isinstance(found[-1], m.EndReport):
        message = broker.recv(m.Started | m.ProgressReport | m.EndReport, lambda one: one.primitive == primitive)
        found.append(msgspec.structs.replace(message, at_s=0.0))
    broker.send(m.ReportAck(primitive=primitive))
    return found


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
    broker.socket.send_multipart([b"MCM", *frames(m.SubsystemHello(name="X", pid=1, performers=[]))])

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
