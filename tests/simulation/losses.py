"""A simulated cluster that loses its journal or its world database, and in which a stranger wants to be the MCM.

These are the real ones: the broker's notice of a loss, the Decision Unit's answer to it, the doubt of the world
database, and the identity that bears a token.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Sequence
from typing import Any

from broker.__main__ import lost_batches
from broker.decisions.state import State
from broker.persistence.journal import SCHEMA, Journal
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.versions import VERSION
from rtc.runtime.handover import Handover
from rtc.world import server
from rtc.world.lease import DOUBT, sign
from rtc.world.server import Server
from rtc.world.store import Store
from tests.simulation import network
from tests.simulation.cluster import KEY, Cluster
from tests.simulation.cluster_faults import FAULTS
from tests.simulation.processes import ARMS
from tests.simulation.simulated_broker import SETTINGS, Broker

server.MOVED |= {"done"}  # the attribute of the simulated arms


class LossyCluster(Cluster):
    LIFE = "first"
    TESTS = False

    def __init__(self, seed: int, log_line: Callable[[str], None] | None = None) -> None:
        super().__init__(seed, log_line)
        _write_cell(self.world.store)

    def hand_over(self) -> Handover:
        return Handover.make(SETTINGS, KEY, "token")

    @property
    def faults_there_are(self) -> Sequence[Callable[[Any], None]]:
        return LOSSES

    def broker_begins(self, broker: Broker, journal: Journal) -> None:
        state, now_s = broker.state, self.clock.now_s
        lost = lost_batches(journal, state, self.handed, now_s, f"life{broker.pid}")
        journal.written = lambda batch: self.handed.save_counters("broker", state.life.encode(), batch, state.accepted)
        if lost is not None:
            self.log(f"broker {broker.pid} notices: {lost.why}")
            self.world.answer(m.Doubt(request="d", lease=sign(KEY, f"{DOUBT}{lost.life}", []), why=lost.why), now_s)
            self.world.store.save()
            broker.router.enqueue(lost)

    def _impostor(self) -> None:
        """Not here: one that connects to the next broker first has the identity there (tests/simulation/cluster.py)."""

    def lose_journal(self) -> None:
        self._db = sqlite3.connect(":memory:", isolation_level=None)
        self._db.executescript(SCHEMA)
        Journal(self._db).snapshot(State(life=f"after{self.clock.now_s:.4f}"))

    def lose_world(self) -> None:
        """As its next process begins: with what the cell says, and everything in doubt."""
        store, version = Store(":memory:"), self.world.store.version
        store.version = version
        _write_cell(store)
        server.make_suspect(store, f"{DOUBT}{version}", "the world began anew", (), self.clock.now_s)
        store.save()
        self.world = Server(store, KEY)

    def _true(self, record: m.CommandRecord) -> None:
        """The progress of a command that the journal lost is unknown."""
        assert record.outcome is not None
        if self.faults["journal"] and record.outcome.kind is OutcomeKind.FAILED and "journal" in record.outcome.message:
            self.log(f"    {record.command} ends: {record.outcome.message}")
            self.records[record.command] = record
        elif self.faults["journal"] and "this step moved nothing" in record.outcome.message:
            self.records[record.command] = record  # a broker that has lost all meets the MCM anew
        else:
            super()._true(record)

    def _check_world(self) -> None:
        """A world that was lost or in doubt has not written all; but it must not trust what is not so."""
        for arm in ARMS:
            last = self.world.store.facts.get(f"{arm}.done")
            moved = [p for p in self.ledger.begun if self._arm_of(p) == arm]
            if moved and (last is None or (last.validity is m.Validity.VALID and last.value != moved[-1])):
                self.wrong(f"{arm} did {moved[-1]} last, and the world trusts {last and last.value}")

    def close(self) -> None:
        os.close(self.handed.fd)


def _write_cell(store: Store) -> None:
    store.write("cell", [m.WorldChange(key=f"{arm}.done", value="cell") for arm in ARMS], "cell", 0.0)


def _lose_journal(cluster: LossyCluster) -> None:
    if cluster.broker is not None and cluster.broker.alive:
        cluster.faults["journal"] += 1
        cluster.faults["broker"] += 1
        cluster.kill(cluster.broker, "and its journal is deleted")
        cluster.lose_journal()


def _lose_world(cluster: LossyCluster) -> None:
    cluster.faults["world lost"] += 1
    cluster.log("the world database begins anew")
    cluster.lose_world()


def _stranger(cluster: LossyCluster) -> None:
    """A stranger uses the identity MCM, and reports that all is at rest."""
    cluster.faults["stranger"] += 1
    cluster.log("a stranger calls itself MCM")
    line = network.Dealer(cluster.clock, b"MCM", lambda parts: None)
    cluster.attach("subsystems", line)
    line.send(wire.frames(m.SubsystemHello(protocol=VERSION, name="MCM", pid=1, performers=list(ARMS))))
    for halt in ("stop-C-1", "stop-C-2", "H-0"):
        rest = m.HaltAtRest(halt=halt, subsystem="MCM", at_s=0.0, at_rest=True, performers=list(ARMS))
        line.send(wire.frames(rest))
    cluster.clock.after(0.05, line.close)


LOSSES = (*FAULTS, *(_lose_journal,) * 4, *(_lose_world,) * 2, *(_stranger,) * 4)
