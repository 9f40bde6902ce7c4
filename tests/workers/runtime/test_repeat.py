"""A recorded job is repeated with what it had read, and any difference of its answer is found."""

from __future__ import annotations

import pytest

from rtc.programs import loader
from rtc.protocol import wire
from rtc.protocol.messages import Job, JobDone, JobRefused, ParserInput, RecordedJob, WorkerKind, WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.world.store import Store, world_at
from workers.parser import parse
from workers.runtime.repeat import Repeater, difference

GRAMMAR = loader.default(WorkerKind.PARSER)


def answer_of(text):
    product = parse.run(parse.compile(GRAMMAR), None, None, ParserInput(text=text))
    if isinstance(product, Refusal):
        return JobRefused(id="C-1/1", attempt=1, refusal=product)
    return JobDone(id="C-1/1", attempt=1, product=wire.raw(product))


def repeated(text, answer, tmp_path):
    job = Job(id="C-1/1", attempt=1, program="grammar", input=wire.raw(ParserInput(text=text)))
    recorded = RecordedJob(kind=WorkerKind.PARSER, job=job, answer=answer)
    return Repeater({"grammar": GRAMMAR}, tmp_path / "world.db").repeat(recorded).difference


@pytest.mark.parametrize("text", ["STOW LEFT-ARM", "GRAPS MACS-NEW"])
def test_the_same_job_gives_the_same_bytes(text, tmp_path):
    assert repeated(text, answer_of(text), tmp_path) == ""


def test_another_product_and_another_kind_of_answer_are_found(tmp_path):
    assert "$.hand" in repeated("STOW LEFT-ARM", answer_of("STOW RIGHT-ARM"), tmp_path)
    assert repeated("STOW LEFT-ARM", answer_of("GRAPS MACS-NEW"), tmp_path)
    assert repeated("GRAPS MACS-NEW", answer_of("STOW LEFT-ARM"), tmp_path)
    refusal = Refusal(reason=RefusalReason.STATE, message="other words")
    assert "$.message" in difference(
        JobRefused(id="C-1/1", attempt=1, refusal=refusal), Refusal(reason=RefusalReason.STATE, message="words")
    )


def test_the_world_is_read_as_it_was_at_a_version(tmp_path):
    store = Store(tmp_path / "world.db")
    for n in range(1, 4):
        changes = [WorldChange(key="A.pose", value=n)] + [WorldChange(key="B.pose", value=n)] * (n == 2)
        store.write(f"job-{n}", changes, "test", 0.0)
    store.save()
    assert {key: fact.value for key, fact in world_at(tmp_path / "world.db", 1).facts.items()} == {"A.pose": 1}
    assert {key: fact.value for key, fact in world_at(tmp_path / "world.db", 2).facts.items()} == {
        "A.pose": 2,
        "B.pose": 2,
    }
