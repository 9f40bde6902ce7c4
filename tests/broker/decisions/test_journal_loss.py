"""A journal that lacks turns of its run: what was promised in them gets a true end, and no number is used twice."""

from __future__ import annotations

import pytest

from broker.__main__ import lost_batches
from broker.decisions import events as received
from broker.decisions.effects import PublishNote, ReportEnd, SendPrimitive, TellClient
from broker.decisions.state import State
from broker.persistence.journal import Journal
from rtc.protocol.messages import Accepted, Declined, NoteKind
from rtc.protocol.outcomes import OutcomeKind
from rtc.runtime.handover import Handover
from rtc.runtime.settings import Settings
from tests.broker.harness import Harness, go_on

LIFE = "bbbb"


def loses(s: Harness, accepted: int = 0) -> None:
    s.handle(received.JournalLost, why="the journal was lost", life=LIFE, accepted=accepted)


def asks(s: Harness, request: str, text: str = "X", **more: object) -> None:
    s.handle(received.CommandReceived, client="ann", request=request, text=text, **more)


def test_the_numbers_go_on_above_the_highest_that_is_known():
    s = Harness()
    loses(s, accepted=17)
    assert s.parsed() == "C-18"


def test_primitives_get_names_of_another_life():
    s = Harness()
    loses(s)
    command = s.elaborated()
    (job,) = [e for e in s.log if getattr(e, "job", "") == s.state.commands[command].job.id]
    assert f"{command}.1@{LIFE}".encode() in bytes(job.input)


@pytest.mark.parametrize("phase", ["parsed", "elaborated", "executing", "analyzing"])
def test_what_is_live_ends_as_failed_and_tells_why(phase):
    s = Harness()
    command = getattr(s, phase)()
    loses(s)
    if phase == "executing":
        assert s.phase(command) == "halting"  # what it moves is stopped first
        s.rests(f"stop-{command}")
    if phase in ("executing", "analyzing"):
        s.answers(command, go_on())  # the last analysis, which leaves its facts suspect
    outcome = s.outcome(command)
    assert outcome.kind is OutcomeKind.FAILED
    assert "the journal was lost" in outcome.message  # wording: why


def test_a_command_that_is_live_uses_no_number_of_a_job_again():
    s = Harness()
    command = s.executing()
    loses(s)
    s.rests(f"stop-{command}")
    assert int(s.state.commands[command].job.id.partition("/")[2]) > 10_000


def test_a_client_that_waits_for_a_lost_command_receives_its_true_end():
    s = Harness()
    loses(s)
    asks(s, "r17", known_as="C-17")
    answers = [e.message for e in s.log if isinstance(e, TellClient)]
    assert Accepted(request="r17", command="C-17") in answers
    outcome = s.outcome("C-17")
    assert outcome.kind is OutcomeKind.FAILED
    assert "how far it came is not known" in outcome.message  # wording: why
    assert s.parsed() == "C-18"  # and its number is not given out again
    assert not any(isinstance(e, SendPrimitive) for e in s.log)


def test_asked_twice_it_ends_once():
    s = Harness()
    loses(s)
    asks(s, "r17", known_as="C-17")
    asks(s, "r17", known_as="C-17")
    assert len([e for e in s.log if isinstance(e, ReportEnd)]) == 1


def test_what_was_sent_before_the_loss_is_not_begun():
    s = Harness()
    sent_at_s = s.now
    loses(s, accepted=4)
    asks(s, "r5", sent_at_s=sent_at_s)
    assert s.outcome("C-5").kind is OutcomeKind.FAILED
    asks(s, "r6", sent_at_s=s.now + 1)
    assert s.phase("C-6") == "parsing"


def test_a_halt_sent_before_the_loss_is_obeyed():
    s = Harness()
    command = s.executing()
    loses(s)
    asks(s, "h", text="HALT", known_as="C-7")
    assert s.phase(command) == "halting"
    assert s.phase("C-7") == "halting"  # it keeps its number


def test_a_number_far_out_is_not_believed():
    s = Harness()
    loses(s)
    asks(s, "r", known_as="C-999999999999")
    assert s.outcome("C-1").kind is OutcomeKind.FAILED


@pytest.mark.parametrize("known_as", ["C-1", "C-2", "C-1000000", "C-0", "C-x", "C-" + "9" * 40])
def test_without_a_loss_the_number_of_another_request_is_declined(known_as):
    """Neither a foreign command nor the counter of commands is changed; nothing is ended that was never begun."""
    s = Harness()
    live = s.executing()
    s.handle(received.CommandReceived, client="eve", request="r", text="X", known_as=known_as)
    (answer,) = [e.message for e in s.log if isinstance(e, TellClient) and e.client == "eve"]
    assert isinstance(answer, Declined)
    assert answer.refusal.clears
    assert (live, s.phase(live)) == ("C-1", "executing")
    assert s.parsed() == "C-2"


def test_a_halt_under_a_foreign_number_is_obeyed_under_the_next():
    s = Harness()
    command = s.executing()
    asks(s, "h", text="HALT", known_as="C-1000000")
    assert s.phase(command) == s.phase("C-2") == "halting"


def test_the_mcm_knows_numbers_too():
    s = Harness()
    loses(s)
    s.handle(received.SubsystemConnected, subsystem="MCM", pid=1, performers=["RIGHT-ARM"], outstanding=["C-17.2@aaaa"])
    assert s.parsed() == "C-18"


def test_listeners_of_the_events_are_informed():
    s = Harness()
    loses(s)
    s.handle(received.ListenersChanged, listening=True)
    (note,) = [e.note for e in s.log if isinstance(e, PublishNote) and not e.note.command]
    assert note.kind is NoteKind.JOURNAL_LOST


# --- noticing it ------------------------------------------------------------------------------------------


@pytest.fixture
def given(tmp_path):
    return Handover.make(Settings(run_dir=str(tmp_path), run="r"), b"k", "t")


class Life:
    """One broker of a run: its journal, and what the role remembers."""

    def __init__(self, given, life="aaaa"):
        self.path = given.settings.path / "journal.db"
        self.given = given
        self.journal = Journal.open(self.path, "r", State(life=life))
        _, self.state = self.journal.last_snapshot()
        self.lost = lost_batches(self.journal, self.state, given, 5.0, "cccc")
        self.journal.written = lambda batch: given.save_counters("broker", self.state.life.encode(), batch, 7)

    def turns(self, n):
        for _ in range(n):
            self.journal.append([received.TimerFired(at_s=1.0, timer="x")], [])
        return self


def test_a_journal_that_is_whole_lost_nothing(given):
    Life(given).turns(3).journal.close()
    assert Life(given, "bbbb").lost is None


def test_a_journal_that_is_new_in_an_old_run_was_lost(given):
    first = Life(given).turns(3)
    first.journal.close()
    first.path.unlink()
    lost = Life(given, "bbbb").lost
    assert (lost.why, lost.accepted) == ("the journal was lost", 7)


def test_a_journal_that_is_older_than_it_was_lost_batches(given):
    first = Life(given).turns(3)
    first.journal.db.execute("DELETE FROM turns WHERE n > 1")
    first.journal.close()
    assert Life(given).lost.why == "the journal lost its last 2 batches"


def test_of_a_journal_that_was_condensed_nothing_is_missing(given):
    first = Life(given).turns(3)
    first.journal.snapshot(first.state)
    first.journal.tidy()
    first.journal.close()
    assert Life(given).lost is None
