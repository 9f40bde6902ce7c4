"""Clusters whose journal or world is lost, with a stranger in them; and the old behaviour, put back, is found."""

from __future__ import annotations

from collections import Counter

from broker.router.subsystem_messages import SubsystemMessages
from rtc.world import server
from tests.simulation import losses
from tests.simulation.losses import LossyCluster

SEEDS = 120


def problem_of(seed: int, faults: Counter[str] | None = None) -> str:
    cluster = LossyCluster(seed)
    try:
        cluster.run()
    except AssertionError as error:
        return str(error) or repr(error)
    finally:
        if faults is not None:
            faults.update(cluster.faults)
        cluster.close()
    return ""


def first_problem(seeds: int = 600) -> str:
    return next(filter(None, map(problem_of, range(seeds))))


def test_no_loss_and_no_stranger_makes_anything_untrue():
    faults: Counter[str] = Counter()
    for seed in range(SEEDS):
        problem = problem_of(seed, faults)
        assert not problem, f"seed {seed}: {problem}"
    assert min(faults[kind] for kind in ("journal", "world lost", "stranger")) > SEEDS / 10  # as in test_cluster


def test_a_broker_that_does_not_notice_its_loss_is_found(monkeypatch):
    monkeypatch.setattr(losses, "lost_batches", lambda *_: None)
    assert first_problem()


def test_a_broker_that_takes_any_mcm_is_found(monkeypatch):
    monkeypatch.setattr(
        SubsystemMessages,
        "_name_of_sender",
        lambda self, peer, message, now: peer.decode().removesuffix("@token"),
    )
    assert first_problem()


def test_a_world_that_trusts_itself_after_a_loss_is_found(monkeypatch):
    monkeypatch.setattr(server, "make_suspect", lambda store, *_: store.version)
    assert "and the world trusts" in first_problem()
