"""A new program until its first job succeeds, its roll-back, and the commands that keep the old one."""

from __future__ import annotations

import pytest

from broker.decisions.events import (
    ProgramInstalled,
)
from broker.decisions.program_rollout import taken
from broker.decisions.state import RolloutPhase
from rtc.protocol.messages import NoteKind, WorkerKind
from rtc.protocol.outcomes import RefusalReason
from tests.broker.harness import Harness, bound, record, script


def test_a_new_program_whose_first_job_fails_is_rolled_back():
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new")
    s.says("X")
    assert s.state.commands["C-1"].job.program == "new"
    assert s.loses_worker("C-1") == ["note C-1 parsing", "job C-1/1 parser #2"]
    assert s.state.commands["C-1"].job.program == "old"
    assert s.state.programs["parser"] == "old"
    stated = s.state.commands["C-1"].notes[-1]
    assert (stated.kind, stated.about, stated.warning) == (NoteKind.PROGRAM_FAILED, "parser", True)
    assert (stated.program, stated.message in s.state.rollouts["parser"].why) == ("new", True)  # wording: last words
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="newer")
    assert not s.state.rollouts["parser"].why


@pytest.mark.parametrize("fail", [Harness.loses_worker, lambda s, c: s.declines(c, RefusalReason.PROGRAM)])
def test_what_else_was_under_way_with_a_program_that_was_rolled_back_is_done_again_with_the_old_one(fail):
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new")
    s.says("X")
    s.says("Y")
    fail(s, "C-1")
    assert fail(s, "C-2") == ["note C-2 parsing", "job C-2/1 parser #2"]
    assert s.state.commands["C-2"].job.program == "old"
    assert s.state.commands["C-2"].job.deaths == ()
    assert "C-1" in s.state.rollouts["parser"].why  # it names the first
    assert fail(s, "C-2")[0] == ("note C-2 parsing" if fail is Harness.loses_worker else "note C-2 ended")
    assert s.state.counts["programs_rolled_back"] == 1


def test_the_file_of_a_program_is_known_and_after_a_roll_back_that_of_the_one_before():
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old", file="good.lark")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new", file="bad.lark")
    s.says("X")
    assert taken(s.state, "parser", s.state.programs["parser"]).file == "bad.lark"
    s.loses_worker("C-1")
    assert taken(s.state, "parser", s.state.programs["parser"]).file == "good.lark"
    for n in range(100):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=f"p{n}", file="many.lark")
    assert [one.digest for one in s.state.program_history["parser"]] == [f"p{n}" for n in range(68, 100)]


def test_back_from_a_new_program_is_to_one_that_has_done_a_job():
    s = Harness()
    for digest in ("old", "new", "newer"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
    s.says("X")
    s.loses_worker("C-1")
    assert s.state.programs["parser"] == "old"
    for digest in ("new", "old"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
    assert s.state.rollouts["parser"].phase is RolloutPhase.PROVEN


def test_back_is_to_the_last_program_that_has_worked_though_it_was_left_meanwhile():
    s = Harness()
    for digest in ("default", "good", "other"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
        s.parsed()  # each does a job well
    for digest in ("good", "bad"):
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest=digest)
    s.says("X")
    s.loses_worker("C-4")
    assert s.state.programs["parser"] == "good"


def test_a_new_program_whose_first_job_is_done_stays():
    s = Harness()
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="old")
    s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="new")
    s.parsed()
    s.says("X")
    s.loses_worker("C-2")
    assert s.state.programs["parser"] == "new"


def install(s, digest, *kinds):
    for kind in kinds or WorkerKind:
        s.handle(ProgramInstalled, kind=kind, digest=digest)


def test_a_running_command_keeps_the_programs_it_began_with():
    s = Harness()
    install(s, "old")
    s.says("X")
    install(s, "new")
    s.says("Y")
    assert s.state.commands["C-2"].job.program == "new"
    used = [s.state.commands["C-1"].job]
    s.answers("C-1", record())
    used.append(s.state.commands["C-1"].job)
    s.answers("C-1", script())
    used.append(s.state.commands["C-1"].job)
    s.answers("C-1", bound("C-1.1"))
    s.reports("C-1")
    used.append(s.state.commands["C-1"].job)
    assert [(job.worker, job.program) for job in used] == [(kind, "old") for kind in WorkerKind]


def test_a_failure_with_a_program_that_had_worked_is_not_tried_with_the_one_loaded_meanwhile():
    s = Harness()
    install(s, "old")
    s.says("X")
    install(s, "new")
    assert s.declines("C-1", RefusalReason.PROGRAM)[0] == "note C-1 ended"
    assert s.state.programs["parser"] == "new"


def test_a_roll_back_reaches_the_live_commands_that_began_with_the_program():
    s = Harness()
    install(s, "old")
    install(s, "new", WorkerKind.PARSER)
    s.says("X")
    s.says("Y")
    s.loses_worker("C-1")
    assert [s.state.commands[c].programs["parser"] for c in ("C-1", "C-2")] == ["old", "old"]
    install(s, "newer", WorkerKind.PARSER)
    s.loses_worker("C-2")
    assert s.state.commands["C-2"].job.program == "old"
