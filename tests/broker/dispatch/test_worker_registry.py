"""Who gets the job, and what becomes of jobs whose worker is gone."""

from __future__ import annotations

import msgspec

from broker.decisions.effects import DispatchJob
from broker.dispatch.worker_registry import BATCH_MAX, DEADLINE_S, QUEUE_LIMIT_S, SILENCE_S, WorkerRegistry
from rtc.protocol.messages import WorkerKind

BINDER = WorkerKind.BINDER


def job(n: int, kind: WorkerKind = BINDER, attempt: int = 1, client: str = "") -> DispatchJob:
    data = msgspec.Raw(b"\xc0")
    return DispatchJob(job=f"C-{n}/1", attempt=attempt, kind=kind, program="", cell="", input=data, client=client)


def registry(*names: str, mean_s: float = 0.1) -> WorkerRegistry:
    r = WorkerRegistry()
    for node, name in enumerate(names):
        r.register(name, node, BINDER, 100 + node, now=0.0)
        r.workers[name].mean_s = mean_s
    return r


def given_out(r: WorkerRegistry, now: float = 0.0) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for worker, jobs in r.assign(now):
        out.setdefault(worker, []).extend(j.job for j in jobs)
    return out


def test_slow_jobs_go_one_to_a_worker_and_the_rest_wait():
    r = registry("a", "b")
    for n in range(3):
        r.submit(job(n), 0.0)
    assert given_out(r) == {"a": ["C-0/1"], "b": ["C-1/1"]}
    r.answered("b", "C-1/1", 1, 0.1, 0.1)
    assert given_out(r) == {"b": ["C-2/1"]}


def test_quick_jobs_go_in_batches_and_one_batch_ahead():
    r = registry("a", mean_s=0.0001)
    for n in range(100):
        r.submit(job(n), 0.0)
    assert len(given_out(r)["a"]) == 40  # twice 2 ms of work
    assert r.workers["a"].batch_size <= BATCH_MAX


def test_a_job_goes_only_to_its_kind():
    r = registry("a")
    r.submit(job(1, WorkerKind.PARSER), 0.0)
    assert given_out(r) == {}
    assert len(r.queues[WorkerKind.PARSER]) == 1


def test_of_a_lost_workers_jobs_only_the_first_was_in_its_hands():
    r = registry("a", mean_s=0.0001)
    for n in range(3):
        r.submit(job(n), 0.0)
    given_out(r)
    r.answered("a", "C-0/1", 1, 0.0001, 0.01)
    assert [(lost.job.job, lost.in_hand) for lost in r.remove("a")] == [("C-1/1", True), ("C-2/1", False)]
    assert r.remove("a") == []


def test_a_worker_that_says_hello_again_has_lost_what_it_held():
    r = registry("a")
    r.submit(job(1), 0.0)
    given_out(r)
    assert [lost.job.job for lost in r.register("a", 0, BINDER, 101, now=1.0)] == ["C-1/1"]


def test_a_cancelled_job_is_never_assigned_and_its_holder_is_informed():
    r = registry("a")
    r.submit(job(1), 0.0)
    r.submit(job(2), 0.0)
    given_out(r)
    assert r.cancel("C-1/1") == "a"
    assert r.cancel("C-2/1") == ""
    r.answered("a", "C-1/1", 1, 0.1, 0.1)
    assert given_out(r) == {}


def test_a_job_cancelled_and_given_out_anew_is_wanted():
    r = registry("a")
    r.submit(job(1), 0.0)
    r.cancel("C-1/1")
    r.submit(job(1, attempt=2), 0.0)
    assert "C-1/1" in given_out(r)["a"]


def test_hung_is_a_job_beyond_its_deadline_or_an_idle_worker_that_is_silent():
    r = registry("a", "b")
    r.submit(job(1), 0.0)
    given_out(r)
    assert [w.name for w, _ in r.hung(SILENCE_S + 0.1)] == ["b"]
    r.mark_alive("b", DEADLINE_S[BINDER])
    assert [(w.name, why) for w, why in r.hung(DEADLINE_S[BINDER] + 0.1)] == [
        ("a", "hung: job C-1/1 in hand for 15.1 s")
    ]


def test_a_late_answer_to_an_earlier_attempt_frees_nothing():
    r = registry("a")
    r.submit(job(1, attempt=2), 0.0)
    given_out(r)
    r.answered("a", "C-1/1", 1, 0.1, 0.1)
    assert [(lost.job.attempt, lost.in_hand) for lost in r.remove("a")] == [(2, True)]


def test_a_job_cancelled_after_its_answer_leaves_no_trace():
    r = registry("a")
    r.submit(job(1), 0.0)
    given_out(r)
    r.answered("a", "C-1/1", 1, 0.1, 0.1)
    assert r.cancel("C-1/1") == ""
    r.submit(job(2), 0.0)
    r.cancel("C-2/1")
    r.waited_too_long(QUEUE_LIMIT_S + 1)
    assert not any(r.queues.values())


def test_a_worker_that_hung_before_this_broker_came_is_found_by_its_silence():
    r = registry("a")
    limit_s = DEADLINE_S[BINDER]
    assert not r.never_registered("a", 0.0, limit_s + 1)
    assert not r.never_registered("binder@6", 0.0, limit_s - 1)
    assert r.never_registered("binder@6", 0.0, limit_s + 1)
    assert not r.never_registered("MCM", 0.0, 1000.0)


def test_a_job_without_a_worker_is_returned_at_the_limit():
    r = WorkerRegistry()
    r.submit(job(1), 0.0)
    assert r.waited_too_long(QUEUE_LIMIT_S - 1) == []
    assert [j.job for j in r.waited_too_long(QUEUE_LIMIT_S + 1)] == ["C-1/1"]


def test_in_a_moving_queue_no_job_waits_too_long():
    r = registry("a", mean_s=0.4)
    for n in range(300):
        r.submit(job(n), 0.0)
    now, refused = 0.0, []
    while given := given_out(r, now):
        now += 0.4
        r.answered("a", given["a"][0], 1, 0.4, now)
        refused += r.waited_too_long(now)
    assert now > 1.5 * QUEUE_LIMIT_S
    assert refused == []


def test_a_line_that_moved_once_is_not_waited_in_for_ever():
    r = registry("a")
    r.submit(job(1), 0.0)
    r.submit(job(2), 0.0)
    given_out(r)
    r.answered("a", "C-1/1", 1, 0.4, 30.0)
    r.remove("a")
    assert r.waited_too_long(QUEUE_LIMIT_S + 29.0) == []
    assert [j.job for j in r.waited_too_long(QUEUE_LIMIT_S + 31.0)] == ["C-2/1"]


def test_the_answers_of_one_kind_say_nothing_of_another():
    r = registry("a")
    r.submit(job(1, WorkerKind.PARSER), 0.0)
    r.submit(job(2), 0.0)
    given_out(r)
    r.answered("a", "C-2/1", 1, 0.4, QUEUE_LIMIT_S)
    assert [j.job for j in r.waited_too_long(QUEUE_LIMIT_S + 1)] == ["C-1/1"]


def test_an_unknown_worker_name():
    r = WorkerRegistry()
    assert not r.mark_alive("ghost", 0.0)
    r.answered("ghost", "C-1/1", 1, 0.1, 0.1)
    assert r.workers == {}


def test_clients_take_turns():
    """One with thousands of commands keeps another's waiting for one job."""
    r = registry()
    for n in range(100):
        r.submit(job(n, client="many"), 0.0)
    for n in (200, 201):
        r.submit(job(n, client="few"), 1.0)
    r.register("a", 0, BINDER, 1, 2.0)
    order = []
    while given := given_out(r, 2.0):
        order += given["a"]
        r.answered("a", order[-1], 1, 0.1, 2.0)
    assert order[:5] == ["C-0/1", "C-200/1", "C-1/1", "C-201/1", "C-2/1"]
    assert len(order) == len(set(order)) == 102


def test_a_missing_answer_is_distinguished():
    r = registry("a", "b")
    r.submit(job(1), 0.0)
    assert given_out(r) == {"a": ["C-1/1"]}
    assert not r.answered("b", "C-1/1", 1, 0.1, 0.0)
    assert not r.answered("a", "C-1/1", 2, 0.1, 0.0)
    assert not r.answered("c", "C-1/1", 1, 0.1, 0.0)
    assert r.answered("a", "C-1/1", 1, 0.1, 0.0)
