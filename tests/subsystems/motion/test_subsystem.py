"""The MCM towards the broker and towards callers of halts: nothing twice, nothing lost, nothing begun after a halt."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.protocol.wire import frames
from rtc.runtime.halt_admission import PER_S
from rtc.subsystems.base.broker_link import invalid_order
from rtc.subsystems.base.subsystem import BROKER, MAX_FENCES, OPEN_HALTS, REPEAT_S, REST_LIMIT_S
from sim_mcm.arms.kinematic_arm import KinematicCell

ARM, OTHER, CALLER, ANOTHER = "RIGHT-ARM", "LEFT-ARM", b"x.estop", b"y.estop"


@pytest.fixture
def bench(cell, make):
    return make.Bench(KinematicCell(cell))


@pytest.fixture
def swing(cell, make):
    def build(id: str = "C-7.1", performer: str = ARM, duration_s: float = 1.0) -> p.Primitive:
        home = cell.arm(performer).home_rad
        return make.primitive(make.joint_path(home, [home[0] + 0.3, *home[1:]], duration_s), id=id, performer=performer)

    return build


def kinds(sent: list[tuple[bytes, m.Message]], kind: type) -> list[m.Message]:
    return [message for _, message in sent if isinstance(message, kind)]


# --- primitives --------------------------------------------------------------------------------------------


def test_an_end_report_is_repeated_until_it_is_acknowledged(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing()))
    sent = bench.tick(1100 + int(3.5 * REPEAT_S * 1000))
    reports = kinds(sent, m.EndReport)
    assert len(reports) == 4
    assert all(report == reports[0] for report in reports)
    assert bench.subsystem.outstanding == ["C-7.1"]

    bench.handle(m.ReportAck(primitive="C-7.1"))
    assert kinds(bench.tick(2000), m.EndReport) == []
    assert bench.subsystem.outstanding == []


def test_the_same_primitive_is_never_executed_twice(bench, swing) -> None:
    order = m.Execute(primitive=swing())
    bench.handle(order)
    bench.tick(500)
    assert bench.handle(order) == []  # it is being done
    bench.tick(700)
    report = kinds(bench.sent, m.EndReport)[0]
    assert bench.handle(order) == [(BROKER, report)]  # it has been done
    bench.handle(m.ReportAck(primitive="C-7.1"))
    assert bench.handle(order) == [(BROKER, report)]  # and stays done after the acknowledgement
    assert bench.subsystem.idle


def test_the_messages_of_a_motion_do_not_depend_on_its_duration(cell, make, swing) -> None:
    """R57. Only EVERY sends more of a longer motion."""
    when = [p.ReportCondition(n=n, when=p.TimeAbove(0.1 * n)) for n in range(3)]
    sent = {}
    for n, (duration_s, reporting) in enumerate(
        [(1.0, p.Reporting()), (5.0, p.Reporting()), (1.0, p.Reporting(when=when)), (5.0, p.Reporting(when=when))]
    ):
        bench = make.Bench(KinematicCell(cell))
        bench.perform(msgspec.structs.replace(swing(f"C-{n}.1", duration_s=duration_s), reporting=reporting))
        sent[duration_s, bool(reporting.when)] = [type(message) for _, message in bench.sent]
    plain = [m.Started, m.EndReport]
    assert sent[1.0, False] == sent[5.0, False] == plain
    assert sent[1.0, True] == sent[5.0, True] == [m.Started, *[m.ProgressReport] * 3, m.EndReport]


@pytest.mark.parametrize("ticks", [500, 1100], ids=["while it is done", "when it is done"])
def test_another_primitive_of_a_known_id_is_refused_and_not_answered_from_memory(bench, swing, ticks: int) -> None:
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(ticks)
    (answer,) = kinds(bench.handle(m.Execute(primitive=swing(duration_s=2.0))), m.EndReport)
    assert answer.reason is StopReason.REFUSED


def test_two_arms_work_at_the_same_time(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1", ARM)))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER)))
    reports = kinds(bench.tick(1010), m.EndReport)
    assert {report.primitive for report in reports} == {"C-7.1", "C-8.1"}


def test_a_busy_arm_refuses_and_goes_on(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1")))
    (answer,) = kinds(bench.handle(m.Execute(primitive=swing("C-8.1"))), m.EndReport)
    assert answer.reason is StopReason.REFUSED
    assert answer.primitive == "C-8.1"
    reasons = {report.primitive: report.reason for report in kinds(bench.tick(1010), m.EndReport)}
    assert reasons["C-7.1"] is StopReason.GOAL


def test_an_unknown_performer_is_refused_by_name(bench, swing, make) -> None:
    wanted = make.primitive(p.HoldStill(), performer="THIRD-ARM")
    (answer,) = kinds(bench.handle(m.Execute(primitive=wanted)), m.EndReport)
    assert answer.reason is StopReason.REFUSED
    assert all(name in answer.message for name in ("THIRD-ARM", "RIGHT-ARM", "LEFT-ARM"))  # wording: the names


def test_hello_tells_what_is_under_way_and_says_kept_reports_again(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1")))
    bench.tick(1100)
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER)))
    bench.tick(10)

    (_, hello), *reports = bench.handle(m.HelloWanted())  # a broker that does not know us

    assert isinstance(hello, m.SubsystemHello)
    assert hello.performers == [ARM, OTHER]
    assert set(hello.outstanding) == {"C-7.1", "C-8.1"}
    assert not hello.at_rest
    assert [report.primitive for _, report in reports] == ["C-7.1"]


# --- halts -------------------------------------------------------------------------------------------------


def test_a_halt_of_all_stops_both_arms_and_tells_when(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1", ARM)))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER)))
    bench.tick(500)
    called = bench.now_s
    halt = m.HaltOrder(halt="H-1")
    ((peer, passed_on),) = bench.handle(halt, CALLER)  # passed on, because the broker may not have it
    assert (peer, passed_on.received_at_s) == (BROKER, called)
    assert msgspec.structs.replace(passed_on, call="", received_at_s=0.0) == halt

    sent = bench.tick(300)

    (started,), (rest,) = kinds(sent, m.HaltStarted), kinds(sent, m.HaltAtRest)
    assert (started.received_at_s, started.decelerating_at_s) == (called, called)  # in the very next tick
    assert started.moving == [ARM, OTHER]
    assert rest.at_rest
    assert called < rest.at_s < called + 0.2
    assert rest.own_s == pytest.approx(rest.at_s - called, abs=0.002)
    assert {peer for peer, message in sent if isinstance(message, m.HaltStarted | m.HaltAtRest)} == {CALLER}
    assert [report.reason for report in kinds(sent, m.EndReport)] == [StopReason.HALT] * 2


@pytest.mark.parametrize(
    ("scope", "moving"),
    [("ALL", [ARM, OTHER]), (ARM, [ARM]), (OTHER, [OTHER]), ("C-7", [ARM]), ("C-77", [OTHER]), ("C-9", [])],
)
def test_a_halt_stops_what_is_in_its_scope_and_nothing_else(bench, swing, scope: str, moving: list[str]) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1", ARM)))
    bench.handle(m.Execute(primitive=swing("C-77.1", OTHER)))
    bench.tick(500)
    sent = bench.handle(m.HaltOrder(halt="H-1", scope=scope), CALLER) + bench.tick(1500)

    assert kinds(sent, m.HaltStarted)[0].moving == moving
    halted = [report.performer for report in kinds(sent, m.EndReport) if report.reason is StopReason.HALT]
    gone_on = {report.performer for report in kinds(sent, m.EndReport) if report.reason is StopReason.GOAL}
    assert sorted(set(halted)) == sorted(moving)
    assert gone_on == {ARM, OTHER} - set(moving)


def test_a_halt_of_an_unknown_arm_is_not_reported_at_rest(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1", ARM)))
    bench.tick(500)
    ((peer, declined),) = bench.handle(m.HaltOrder(halt="H-1", scope="RIGHT-AMR"), CALLER)

    assert peer == CALLER
    assert isinstance(declined, m.Declined)
    assert (declined.request, declined.refusal.expected) == ("H-1", ["ALL", ARM, OTHER])


def test_a_halt_of_an_idle_arm_is_answered_at_once(bench) -> None:
    _, started, rest = (message for _, message in bench.handle(m.HaltOrder(halt="H-1"), CALLER))
    assert isinstance(started, m.HaltStarted)
    assert isinstance(rest, m.HaltAtRest)
    assert (started.moving, rest.at_rest) == ([], True)


def test_the_same_halt_from_two_sides_is_one_halt_and_both_are_answered(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(500)
    bench.handle(m.HaltOrder(halt="H-1"), CALLER)
    first = bench.tick(3)
    (late,) = bench.handle(m.HaltOrder(halt="H-1"), BROKER)
    rest = bench.tick(300)

    (started,) = kinds(first, m.HaltStarted)
    assert late == (BROKER, started)
    assert [peer for peer, message in rest if isinstance(message, m.HaltAtRest)] == [CALLER, BROKER]
    again = bench.handle(m.HaltOrder(halt="H-1"), ANOTHER)
    assert [message for peer, message in again if peer == ANOTHER] == [started, *kinds(rest, m.HaltAtRest)[:1]]


# A halt whose name was used before: it is obeyed, and the earlier answers are not repeated as current ones.


@pytest.mark.parametrize("peer", [CALLER, ANOTHER, BROKER])
@pytest.mark.parametrize("scope_before", ["ALL", ARM, OTHER, "C-7"])
def test_a_halt_whose_name_was_used_before_stops_what_moves_now(bench, make, peer, scope_before) -> None:
    bench.handle(m.HaltOrder(halt="THE-BUTTON", scope=scope_before), CALLER)
    bench.tick(10)
    for order in kinds(bench.sent, m.HaltOrder):
        bench.handle(order, BROKER)
    for n in (7, 8):  # and so for every press
        here = list(bench.simulation.arms[ARM].joints)
        path = make.joint_path(here, [here[0] + 0.3, *here[1:]], 1.0)
        bench.handle(m.Execute(primitive=make.primitive(path, id=f"C-{n}.1")))
        bench.tick(500)
        assert fastest(bench) > 0.1
        sent = bench.handle(m.HaltOrder(halt="THE-BUTTON"), peer)
        assert kinds(sent, m.HaltAtRest) == []  # it moves
        sent = bench.tick(400)
        assert fastest(bench) == pytest.approx(0.0, abs=1e-6)
        (rest,) = [message for to, message in sent if to == peer and isinstance(message, m.HaltAtRest)]
        assert (rest.at_rest, rest.performers) == (True, [ARM, OTHER])
        (report,) = {report.primitive: report.reason for report in kinds(sent, m.EndReport)}.items()
        assert report == (f"C-{n}.1", StopReason.HALT)
        bench.handle(m.ReportAck(primitive=f"C-{n}.1"))
        for order in kinds(bench.sent, m.HaltOrder):
            bench.handle(order, BROKER)


def test_a_halt_of_all_under_the_open_name_of_a_halt_of_one_arm_stops_the_other_too(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing("C-7.1", ARM)))
    bench.handle(m.Execute(primitive=swing("C-8.1", OTHER)))
    bench.tick(500)
    bench.handle(m.HaltOrder(halt="1", scope=OTHER), CALLER)
    bench.tick(3)
    bench.handle(m.HaltOrder(halt="1"), ANOTHER)
    sent = bench.tick(400)
    assert fastest(bench) == pytest.approx(0.0, abs=1e-6)
    answers = {peer: message.performers for peer, message in sent if isinstance(message, m.HaltAtRest)}
    assert answers == {CALLER: [OTHER], ANOTHER: [ARM, OTHER]}  # each gets the answer to its own halt


def test_the_broker_that_knows_of_one_halt_need_not_know_of_another_of_its_name(bench, swing) -> None:
    """Given a halt that the broker has received, when another halt of the same name bypasses it, then primitives that
    the broker sent before it knows of the second do not begin."""
    first = bench.handle(m.HaltOrder(halt="1"), CALLER)
    second = bench.handle(m.HaltOrder(halt="1"), ANOTHER)
    for order in kinds(first, m.HaltOrder):
        bench.handle(order, BROKER)
    bench.handle(m.HaltOrder(halt="1", call="7-1"), BROKER)  # the broker got the first one from its caller too
    (report,) = kinds(bench.handle(m.Execute(primitive=swing("C-9.1"))), m.EndReport)
    assert report.reason is StopReason.HALT
    for order in kinds(second, m.HaltOrder):
        bench.handle(order, BROKER)
    assert kinds(bench.handle(m.Execute(primitive=swing("C-9.2"))), m.Started)


def test_each_order_is_answered_with_its_number(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(500)
    bench.handle(m.HaltOrder(halt="1", call="7-1"), BROKER)
    bench.handle(m.HaltOrder(halt="1", call="7-2"), BROKER)
    sent = bench.tick(400)
    for kind in (m.HaltStarted, m.HaltAtRest):
        assert [message.call for message in kinds(sent, kind)] == ["7-1", "7-2"]


def fastest(bench) -> float:
    return max(abs(v) for e in bench.subsystem.executors.values() for v in e.arm.read().velocities)


def test_a_halt_during_a_stop_waits_for_rest(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(500)
    bench.handle(m.HaltOrder(halt="H-1"), CALLER)
    bench.tick(10)
    bench.handle(m.HaltOrder(halt="H-2"), ANOTHER)
    sent = bench.tick(300)
    (rest,) = [message for peer, message in sent if peer == ANOTHER and isinstance(message, m.HaltAtRest)]
    assert rest.at_rest
    assert len(kinds(sent, m.EndReport)) == 1


def test_rest_that_does_not_come_is_reported(cell, make) -> None:
    class Pushed:
        """Two arms, one of which is pushed from outside."""

        def __init__(self) -> None:
            self.arms = {ARM: make.SteeredArm(cell, ARM), OTHER: make.SteeredArm(cell, OTHER)}

        def step(self) -> None:
            arm = self.arms[ARM]
            arm.motion = ([q + 1e-4 for q in arm.motion[0]], [0.1] * 6, arm.motion[2])

    bench = make.Bench(Pushed())
    bench.tick(5)
    bench.handle(m.HaltOrder(halt="H-1"), CALLER)
    (rest,) = kinds(bench.tick(int(REST_LIMIT_S * 1000) + 10), m.HaltAtRest)
    assert not rest.at_rest


def test_an_arm_that_a_busy_machine_slows_down_is_awaited_until_it_rests(bench, swing) -> None:
    bench.tick_s = 0.05
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(500)
    called_s = bench.now_s
    bench.handle(m.HaltOrder(halt="H-1"), CALLER)
    (rest,) = kinds(bench.tick(int(REST_LIMIT_S * 1000)), m.HaltAtRest)
    assert rest.at_rest
    assert rest.at_s - called_s > REST_LIMIT_S


def test_what_was_sent_in_ignorance_of_a_halt_does_not_begin_after_it(bench, swing) -> None:
    bench.handle(m.HaltOrder(halt="H-1"), CALLER)
    blind = m.Execute(primitive=swing("C-7.2"))
    (report,) = kinds(bench.handle(blind), m.EndReport)
    assert report.reason is StopReason.HALT
    assert report.primitive == "C-7.2"
    assert bench.subsystem.idle


def test_a_halt_called_past_the_broker_is_reported_with_every_hello_until_the_broker_knows_of_it(bench) -> None:
    halt = m.HaltOrder(halt="H-1", called_at_s=99.0)
    bench.handle(halt, CALLER)
    (repeated,) = kinds(bench.subsystem.hello(), m.HaltOrder)
    assert msgspec.structs.replace(repeated, call="", received_at_s=0.0) == halt
    bench.handle(repeated, BROKER)
    assert kinds(bench.subsystem.hello(), m.HaltOrder) == []


def test_once_the_broker_knows_of_a_halt_a_new_primitive_works_at_once(bench, swing) -> None:
    bench.handle(m.HaltOrder(halt="H-2"), CALLER)
    bench.tick(500)
    bench.handle(m.HaltOrder(halt="H-2"), BROKER)
    home = list(bench.simulation.arms[ARM].joints)
    hold = p.Primitive(
        id="C-9.1", performer=ARM, trajectory=p.HoldStill(duration_s=0.1), stop_functions=swing().stop_functions
    )
    assert kinds(bench.handle(m.Execute(primitive=hold)), m.Started)
    assert list(bench.simulation.arms[ARM].joints) == home


def test_rest_is_confirmed_after_the_end_has_been_reported(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(500)
    bench.handle(m.HaltOrder(halt="H-1"), BROKER)
    order = [type(message) for _, message in bench.tick(300)]
    assert order.index(m.EndReport) < order.index(m.HaltAtRest)
    home = bench.simulation.arms[ARM].joints
    hold = msgspec.structs.replace(swing("C-8.1"), trajectory=p.HoldStill(duration_s=0.1))
    assert kinds(bench.handle(m.Execute(primitive=hold)), m.Started)  # it can be given something new at once
    assert list(bench.simulation.arms[ARM].joints) == list(home)


def test_a_primitive_meant_for_the_process_before_is_passed_over(bench, swing) -> None:
    sent = bench.handle(m.Execute(primitive=swing(), pid=bench.subsystem.pid + 1))
    assert [type(message) for _, message in sent] == [m.SubsystemHello]  # its sender does not know us
    assert bench.subsystem.idle
    assert kinds(bench.handle(m.Execute(primitive=swing(), pid=bench.subsystem.pid)), m.Started)


def test_a_halt_of_one_command_leaves_another_commands_orders_alone(bench, swing) -> None:
    bench.handle(m.HaltOrder(halt="H-1", scope="C-7"), CALLER)
    other = m.Execute(primitive=swing("C-8.1"))
    assert kinds(bench.handle(other), m.Started)


# --- callers who mean harm -----------------------------------------------------------------------------------


def test_a_name_used_up_beforehand_does_not_keep_the_brokers_halt_from_stopping(bench, swing) -> None:
    """Given a caller at the estop socket that used the name of a halt before anything moved."""
    order = m.HaltOrder(halt="stop-C-7", scope="C-7")
    bench.subsystem.handle(order, CALLER, bench.now_s)
    bench.handle(order)
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(100)
    bench.handle(order)
    (report,) = kinds(bench.tick(600), m.EndReport)[:1]
    assert report.reason is StopReason.HALT


def test_a_caller_with_many_open_halts_is_obeyed_and_declined(bench, swing) -> None:
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(100)
    sent = [bench.subsystem.handle(m.HaltOrder(halt=f"H-{n}"), CALLER, bench.now_s) for n in range(OPEN_HALTS + 3)]
    declined = [messages for messages in sent if kinds(messages, m.Declined)]
    assert len(declined) == 3
    assert all(kinds(messages, m.HaltOrder) for messages in declined)  # the broker gets each
    ended = [message for peer, message in bench.tick(600) if isinstance(message, m.HaltAtRest) and peer == CALLER]
    assert len(ended) == OPEN_HALTS


def test_scopes_beyond_number_become_all(bench, swing) -> None:
    """Until the broker has answered nothing begins; afterwards everything does, and nothing was kept for ever."""
    last = [m.HaltOrder(halt=f"H-{n}", scope=f"C-{n}") for n in range(MAX_FENCES + 5)]
    for n, order in enumerate(last):
        bench.subsystem.handle(order, b"%d" % n, bench.now_s)
    (report,) = kinds(bench.handle(m.Execute(primitive=swing("C-9999.1"))), m.EndReport)
    assert report.reason is StopReason.HALT
    for order in last:
        bench.handle(order)
    bench.handle(m.Execute(primitive=swing("C-9998.1")))
    reports = {report.primitive: report.reason for report in kinds(bench.tick(1100), m.EndReport)}
    assert reports["C-9998.1"] is StopReason.GOAL
    assert kinds(bench.subsystem.hello(), m.HaltOrder) == []


def test_a_stream_of_halts_stops_at_once_and_reaches_the_broker_as_one(bench, swing) -> None:
    for n in range(PER_S):
        bench.subsystem.handle(m.HaltOrder(halt=f"H-{n}", scope="C-1"), CALLER, bench.now_s)
    bench.handle(m.HaltOrder(halt=f"H-{PER_S - 1}", scope="C-1"))
    bench.handle(m.Execute(primitive=swing()))
    bench.tick(50)
    for n in range(20):
        sent = bench.subsystem.handle(m.HaltOrder(halt=f"H-x{n}"), CALLER, bench.now_s)
        assert [(peer, type(message)) for peer, message in sent] == [(CALLER, m.Declined)]
    sent = bench.tick(600)
    assert kinds(sent, m.EndReport)[0].reason is StopReason.HALT
    assert [order.halt for order in kinds(sent, m.HaltOrder)] == ["H-x19"]
    bench.handle(m.HaltOrder(halt="H-x19"))
    assert kinds(bench.subsystem.hello(), m.HaltOrder) == []


# --- primitives that are none ------------------------------------------------------------------------------


def _frames(change) -> list[bytes]:
    """An Execute whose primitive has been changed on its way."""
    body = msgspec.to_builtins(m.Execute(primitive=_still()))
    change(body["primitive"])
    return frames(body)


def _still() -> p.Primitive:
    stops = [
        p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
        p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(5.0)),
    ]
    return p.Primitive(id="C-7.1", performer=ARM, trajectory=p.HoldStill(duration_s=1.0), stop_functions=stops)


AFTER = {"primitive": "C-6.1", "path_s": 1.0, "within_s": 9.0}
LOAD = {"mass_kg": 1e308, "com_m": [float("nan")] * 3, "inertia_kg_m2": [-1.0] * 6}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda body: body.update(stop_functions=[]), "F is not complete"),
        (lambda body: body.update(trajectory={"type": "no-such-thing"}), "not a primitive"),
        (lambda body: body.update(control_law={"load": LOAD}), "a load"),
        (lambda body: body["stop_functions"][1].update(when={"type": "time-above", "limit_s": 1e300}), "a time limit"),
        (lambda body: body.pop("trajectory"), "missing required field"),
        (lambda body: body.update(not_before_s=9.0), "not_before_s"),  # a newer key, at several depths
        (lambda body: body.update(start_after=[{**AFTER, "and_still": True}]), "and_still"),
        (lambda body: body["stop_functions"][0].update(only_if="CONTACT"), "only_if"),
        (lambda body: body["trajectory"].update(at_most_m_s=0.1), "at_most_m_s"),
        (lambda body: body.update(control_law={"compliance": {"stiffness": [1.0] * 6, "fade_s": 1.0}}), "fade_s"),
    ],
)
def test_what_does_not_decode_is_refused_with_the_id_that_can_be_read(bench, change, words: str) -> None:
    order = invalid_order(_frames(change))
    assert order is not None
    ((peer, report),) = bench.handle(order)
    assert (peer, report.primitive, report.performer, report.reason) == (BROKER, "C-7.1", ARM, StopReason.REFUSED)
    assert words in report.message  # wording: what is wrong with the order
    assert len(report.joints) == 6
    assert bench.subsystem.outstanding == ["C-7.1"]  # until it is acknowledged
    assert bench.handle(order) == [(BROKER, report)]


def test_an_order_with_a_newer_key_is_refused(bench) -> None:
    body = msgspec.to_builtins(m.Execute(primitive=_still())) | {"not_before_s": 9.0}
    order = invalid_order(frames(body))
    assert order is not None
    ((_, report),) = bench.handle(order)
    assert (report.primitive, report.reason) == ("C-7.1", StopReason.REFUSED)
    assert bench.subsystem.idle


def test_what_decodes_or_has_no_id_is_not_answered_so() -> None:
    assert invalid_order(_frames(lambda body: None)) is None
    assert invalid_order(_frames(lambda body: body.update(id="", stop_functions=[]))) is None
    assert invalid_order(frames(m.Heartbeat(name="broker"))) is None


@pytest.mark.parametrize("name", ["X-9.1", "", "C-7", "C-7.1/2", "7.1"])
def test_an_id_that_no_halt_would_find_is_refused(bench, swing, name: str) -> None:
    (report,) = kinds(bench.handle(m.Execute(primitive=swing(name))), m.EndReport)
    assert report.reason is StopReason.REFUSED
    assert report.primitive == name
    assert bench.subsystem.idle
