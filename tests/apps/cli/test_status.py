"""What `rtc status` makes of a broker's answer: few rows, names that people know."""

from __future__ import annotations

from rtc.apps.cli.status import collision_checks_in_words, folded, programs_in_words
from rtc.protocol.messages import ProcessRow, ProgramFile, Status, WorkerRow


def row(name: str, state: str = "ready", restarts: int = 0) -> ProcessRow:
    return ProcessRow(name=name, state=state, restarts=restarts, pid=7)


def test_templates_are_one_row_and_those_in_trouble_their_own() -> None:
    rows = [row("template"), row("broker"), row("broker-template", restarts=2), row("MCM-template", "looping")]
    names = {one.name: one for one in folded(rows)}

    assert list(names) == ["broker", "MCM-template", "2 templates"]
    assert names["2 templates"].restarts == 2
    assert names["2 templates"].pid == 0


def test_programs_are_named_by_file_and_age() -> None:
    loaded = {"elaborator": ProgramFile(file="my_lift.yaml", age_s=185.0)}

    assert programs_in_words(Status(program_files=loaded)) == (
        "elaborator my_lift.yaml (loaded 3 min ago), the others: default programs"
    )
    assert programs_in_words(Status()) == "all as they come with rtc"


def test_collision_checks_are_those_of_the_workers_that_plan_and_slower_ones_are_named() -> None:
    parser = WorkerRow(name="parser@0", kind="parser")
    quick = WorkerRow(name="binder@2", kind="binder", abilities=["boxes"])
    slow = WorkerRow(name="elaborator@1", kind="elaborator")

    assert collision_checks_in_words(Status(workers=[parser])) == ""
    assert "coal alone" not in collision_checks_in_words(Status(workers=[parser, quick]))
    assert "elaborator@1" in collision_checks_in_words(Status(workers=[quick, slow]))
    assert "coal alone" in collision_checks_in_words(Status(workers=[slow]))
