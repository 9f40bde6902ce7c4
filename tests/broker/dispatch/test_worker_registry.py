"""Who gets the job, and what becomes of jobs whose worker is gone."""

from __future__ import annotations

import msgspec

from broker.decisions.effects import DispatchJob
from broker.dispatch.worker_registry import (
    BATCH_MAX,
    BUSY_SILENCE_S,
    DEADLINE_S,
    MAX_JOB_S,
    QUEUE_LIMIT_S,
    SILENCE_S,
    WorkerRegistry,
)
from rtc.protocol.messages import WorkerKind

BINDER = WorkerKind.BINDER


def job(n: int, kind: WorkerKind = BINDER, attempt: int = 1, client: str = "") -> DispatchJob:
    data = msgspec.Raw(b"\xc0")
    return DispatchJob(
        job=f"C-{n}/1", attempt=attempt, kind=kind, queue=kind, program="", cell="", input=data, client=client
    )


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


def beats(r: WorkerRegistry, name: str, until_s: float, share: float) -> float:
    """Heartbeats every half second, during a job that gets this share of a processor. Returns its processor time."""
    now = r.workers[name].since_s
    while now < until_s:
        now += 0.5
        r.mark_alive(name, now, share * (now - r.workers[name].since_s))
        assert r.hung(now) == []
    return share * (now - r.workers[name].since_s)


def in_hand(*names: str) -> WorkerRegistry:
    r = registry(*names)
    r.submit(job(1), 0.0)
    given_out(r)
    return r


def test_an_idle_worker_that_is_silent_hangs():
    r = in_hand("a", "b")
    assert [(w.name, why) for w, why in r.hung(SILENCE_S + 0.1)] == [("b", "hung: silent for 3.1 s")]


def test_a_job_on_a_busy_machine_does_not_hang_by_the_clock():
    r = in_hand("a")
    until_s = 8 * DEADLINE_S[BINDER]
    assert beats(r, "a", until_s, share=0.05) < DEADLINE_S[BINDER]
    assert r.answered("a", "C-1/1", 1, until_s, until_s)


def test_a_job_hangs_by_its_processor_time():
    r = in_hand("a")
    beats(r, "a", DEADLINE_S[BINDER] - 1.0, share=1.0)
    r.mark_alive("a", DEADLINE_S[BINDER] + 1.0, DEADLINE_S[BINDER] + 0.5)
    assert [why for _, why in r.hung(DEADLINE_S[BINDER] + 1.0)] == ["hung: job C-1/1 has used 15.5 s of processor time"]


def test_a_job_that_waits_for_nothing_hangs_as_soon_by_the_clock():
    """Its worker still reports, so the machine is not too busy for it."""
    r = in_hand("a")
    beats(r, "a", 2.0, share=0.05)
    for tenth in range(1, 154):
        r.mark_alive("a", 2.0 + 0.1 * tenth, 0.1)
    assert [why for _, why in r.hung(17.4)] == ["hung: job C-1/1 has not used the processor for 15.3 s"]


def test_a_worker_that_is_silent_with_a_job_hangs():
    r = in_hand("a")
    assert r.hung(BUSY_SILENCE_S - 0.1) == []
    assert [w.name for w, _ in r.hung(BUSY_SILENCE_S + 0.1)] == ["a"]


def test_no_job_takes_for_ever_however_busy_it_looks():
    r = in_hand("a")
    beats(r, "a", MAX_JOB_S, share=0.01)
    r.mark_alive("a", MAX_JOB_S + 0.1, 6.1)
    assert [w.name for w, _ in r.hung(MAX_JOB_S + 0.2)] == ["a"]


def test_the_processor_time_of_a_job_is_not_that_of_the_next():
    r = in_hand("a")
    end_s = 10.0
    beats(r, "a", end_s, share=1.0)
    r.answered("a", "C-1/1", 1, end_s, end_s)
    r.submit(job(2), end_s)
    assert list(r.assign(end_s))
    assert beats(r, "a", 2 * end_s, share=1.0) == end_s


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
    assert not r.never_registered("a", 0.0, BUSY_SILENCE_S + 1)
    assert not r.never_registered("binder@6", 0.0, BUSY_SILENCE_S - 1)
    assert r.never_registered("binder@6", 0.0, BUSY_SILENCE_S + 1)
    assert not r.never_registered("MCM", 0.0, 1000.0)


def test_a_job_waits_for_a_worker_that_makes_progress():
    r = in_hand("a")
    r.submit(job(2), 0.0)
    beats(r, "a", 2 * QUEUE_LIMIT_S, share=0.05)
    assert r.waited_too_long(2 * QUEUE_LIMIT_S) == []
    assert [j.job for j in r.waited_too_long(3 * QUEUE_LIMIT_S + 1)] == ["C-2/1"]


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
