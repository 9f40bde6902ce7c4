"""Some hundred simulated clusters; the same seed gives the same log; and broken rules are found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from broker.decisions import decide
from broker.decisions.command import termination
from broker.decisions.command.table import COMMAND
from broker.decisions.events import (
    BrokerRestarted,
    HaltConfirmed,
    JobFinished,
    PrimitiveEnded,
    PrimitiveStarted,
    Stimulus,
    SubsystemConnected,
)
from broker.router import core, loop, subsystem_messages
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.messages import Phase
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.reports import not_begun
from rtc.subsystems.motion.subsystem import McmSubsystem
from tests.simulation.__main__ import Result, run
from tests.simulation.cluster import Cluster
from tests.simulation.processes import Mcm

SEEDS = 75  # the campaign `simulation` has thousands


def first_problem(found_at: int, seeds: int = 600) -> Result:
    """The first seed in which something is wrong, sought from where it was last found."""
    for seed in range(found_at, found_at + seeds):
        result = run(seed)
        if result.problem:
            return result
    raise AssertionError(f"{seeds} seeds, and nothing wrong is found")


def test_clusters_lose_repeat_and_misreport_nothing():
    faults, outcomes = Counter(), Counter()
    for seed in range(SEEDS):
        result = run(seed)
        assert not result.problem, f"{result.problem}\n  python -m tests.simulation --seed {seed} --log"
        faults += result.faults
        outcomes += result.outcomes
    assert min(faults[kind] for kind in ("broker", "worker", "MCM", "world")) > SEEDS / 10  # things did go wrong,
    assert outcomes["succeeded"] > SEEDS / 2  # and much went well all the same
    assert {"failed", "refused", "halted", "lost_subsystem"} <= set(outcomes)


def test_a_seed_gives_the_same_log_every_time():
    logs = []
    for _ in range(2):
        lines: list[str] = []
        run(26, lines.append)
        logs.append(lines)
    assert logs[0] == logs[1]
    assert len(logs[0]) > 20


def test_the_same_events_in_the_same_order_at_any_speed_of_the_simulation(monkeypatch):
    """The event line of a command does not depend on the clock (R13): reasons, trims, figures and their order."""

    def events_at(speed: float) -> list[tuple[str, ...]]:
        monkeypatch.setattr(Mcm, "TICK_S", 0.004 / speed)
        cluster = Cluster(3)
        broker, client, seen = cluster.broker, cluster.clients[0], []
        assert broker is not None
        journalled = cluster.journalled

        def collect(events, records):
            seen.extend(
                in_words(event) for event in events if not isinstance(event, HaltConfirmed | SubsystemConnected)
            )
            journalled(events, records)

        cluster.journalled = collect
        until(cluster, lambda: "MCM" in broker.state.subsystems)
        client.submit("DO LEFT swing late-mended hold")
        client.submit("DO RIGHT late-skipped swing AFTER C-1")
        client.submit("DO LEFT late AFTER C-2")
        until(cluster, lambda: len(client.results) == 3)
        return seen

    def in_words(event) -> tuple[str, ...]:
        words = (type(event).__name__,)
        match event:
            case PrimitiveEnded(report=report):
                return (*words, report.primitive, report.reason, f"{report.duration_s:.3f}", f"{report.joints}")
            case JobFinished():
                return (*words, event.job)
        return (*words, event.start.primitive if isinstance(event, PrimitiveStarted) else "")

    slow, real, fast = (events_at(speed) for speed in (0.2, 1.0, 5.0))
    assert slow == real == fast
    reasons = {words[2] for words in real if words[0] == "PrimitiveEnded"}
    assert reasons == {StopReason.GOAL, StopReason.TIMEOUT}


def test_a_waiting_report_is_handled_before_the_timer_that_waits_for_it():
    """A broker that stood still for seconds, and finds more than it reads in one turn."""
    cluster = Cluster(3)
    broker, mcm, client = cluster.broker, cluster.mcm, cluster.clients[0]
    assert broker is not None
    assert mcm is not None
    until(cluster, lambda: "MCM" in broker.state.subsystems)
    client.submit("DO LEFT hold")
    client.submit("DO RIGHT hold")
    until(cluster, lambda: len([c for c in broker.state.commands.values() if c.phase is m.Phase.EXECUTING]) == 2)
    broker.stopped = mcm.stopped = True
    for primitive in ["C-1.1"] * 20 + ["C-2.1"]:
        report = not_begun(primitive, "LEFT-ARM", "", at_s=0.0, reason=StopReason.GOAL)
        broker.sockets["subsystems"].arrive(mcm.line, wire.frames(report))
    cluster.clock.now_s += 30.0
    broker.resume()
    until(cluster, lambda: broker.state.accepted == 2 and not broker.sockets["subsystems"].readable)
    assert {c.phase for c in broker.state.commands.values()} == {m.Phase.ANALYZING}


def until(cluster: Cluster, done: Callable[[], bool]) -> None:
    for _ in range(5000):
        if done():
            return
        cluster.clock.step()
    raise AssertionError("it does not come to that")


# --- rules broken on purpose: some seed finds each ---------------------------------------------------


def test_an_mcm_that_forgets_what_it_has_done_is_found(monkeypatch):
    end = McmSubsystem._end

    def forgetful(self, report, now_s):
        sent = end(self, report, now_s)
        self._ended.clear()
        self._kept.clear()
        return sent

    monkeypatch.setattr(McmSubsystem, "_end", forgetful)
    assert first_problem(139).problem


def test_a_restart_that_gives_nothing_out_again_is_found(monkeypatch):
    monkeypatch.setitem(decide.HANDLERS, BrokerRestarted, lambda turn, event: None)
    assert first_problem(21).problem


def test_a_broker_that_acts_before_it_remembers_is_found(monkeypatch):
    """Effects out before the journal has the events: a crash between them leaves an action without a record."""

    def hasty(self, now):
        events, self.core.events = self.core.events, []
        effects = [effect for event in events for effect in decide.decide(self.core.state, event)]
        self.egress.perform(effects)
        self.core.journal.append(events, [e.record for e in effects if type(e).__name__ == "ReportEnd"])
        self.egress.assign_jobs(now)

    monkeypatch.setattr(loop.Router, "_settle", hasty)
    assert first_problem(134).problem


def test_a_broker_that_does_not_listen_to_halts_of_its_mcm_is_found(monkeypatch):
    monkeypatch.setitem(subsystem_messages.HANDLERS, m.HaltOrder, lambda *_: None)
    assert first_problem(25).problem


def test_a_client_that_is_cut_off_by_an_impostor_is_found(monkeypatch):
    monkeypatch.setattr(core, "NO_HANDOVER", ())
    assert "not over after" in first_problem(1).problem


def test_an_mcm_that_obeys_a_halt_once_by_its_name_is_found(monkeypatch):
    obey = McmSubsystem._halt

    def only_once(self, order, peer, now_s):
        known = (peer != BROKER, order.halt) in vars(self).setdefault("seen", set())
        self.seen.add((peer != BROKER, order.halt))
        return [] if known and peer != BROKER else obey(self, order, peer, now_s)

    monkeypatch.setattr(McmSubsystem, "_halt", only_once)
    assert "was received, and" in first_problem(25).problem


def test_an_mcm_that_reports_rest_from_memory_is_found(monkeypatch):
    monkeypatch.setattr(McmSubsystem, "_is_still_true", lambda self, halt, reached: True)
    assert "reported at rest, and executing" in first_problem(25).problem


def test_a_broker_that_forgets_what_happened_while_the_world_was_away_is_found(monkeypatch):
    cell = (Phase.ANALYZING, Stimulus.UNAVAILABLE)
    monkeypatch.setitem(COMMAND.cells, cell, COMMAND.cells[cell]._replace(action=termination.refuse))
    assert "and the world trusts" in first_problem(15).problem
