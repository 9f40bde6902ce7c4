"""A row that the command-object table lacks is asked of the fillers of the program (R89)."""

from __future__ import annotations

import msgspec
import pytest

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.protocol.messages import GripStep, Script
from rtc.protocol.outcomes import Refusal, RefusalReason
from tests.plugins.toy_packages import Install
from tests.workers.conftest import Bench, bench  # noqa: F401

SENTENCE = "GRASP MACS-NEW WITH RIGHT-ARM"
FILLS = "def fill(verb, thing, figures):\n    return {row} if (verb, thing.name) == ('GRASP', 'MACS-NEW') else None\n"


@pytest.fixture
def row(bench: Bench) -> dict[str, float]:  # noqa: F811
    """The row of GRASP for modules, which the program of the bench has no more."""
    document = msgspec.json.decode(bench.programs["elaborator"])
    table = document["command_object_table"]
    (found,) = (row for row in table if (row["verb"], row.get("kind")) == ("GRASP", "module"))
    # Its names stay known, as the scripts need them.
    found["name"], found["kind"] = "MACS-OLD", ""
    bench.programs["elaborator"] = msgspec.json.encode(document, order="deterministic")
    return found["values"]


def test_an_absent_row_is_computed_by_a_filler(install: Install, bench, row) -> None:  # noqa: F811
    """Without a filler it is refused. With one the script has the figures of the row, and the trace names it."""
    assert bench.elaborate(SENTENCE).reason is RefusalReason.NO_SCRIPT
    for name, factor in (("weak", 0.5), ("strong", 1.0)):
        values = {**row, "grip_n": factor * row["grip_n"]}
        install(registry.FILLERS, name, "fill", FILLS.format(row=values))
    assert bench.elaborate(SENTENCE).reason is RefusalReason.NO_SCRIPT  # none is named
    for named, factor in (("[strong, weak]", 1.0), ("[weak, strong]", 0.5)):
        bench.load("elaborator", f"fillers: {named}")
        script = bench.elaborate(SENTENCE)
        assert isinstance(script, Script), script
        (grip,) = {step.grip_n for step in script.steps if isinstance(step, GripStep)}
        assert grip == factor * row["grip_n"]
        first = "strong" if factor == 1.0 else "weak"
        assert [note.rpartition(": ")[2] for note in script.notes if "filler" in note] == [f"table filler {first}"]


def test_a_row_of_the_program_is_not_asked_of_a_filler(install: Install, bench) -> None:  # noqa: F811
    install(registry.FILLERS, "never", "fill", "def fill(verb, thing, figures):\n    raise RuntimeError\n")
    bench.load("elaborator", "fillers: [never]")
    assert isinstance(bench.elaborate(SENTENCE), Script)


def test_a_row_that_no_filler_has_is_refused(install: Install, bench, row) -> None:  # noqa: F811
    install(registry.FILLERS, "silent", "fill", "def fill(verb, thing, figures):\n    return None\n")
    bench.load("elaborator", "fillers: [silent]")
    refused = bench.elaborate(SENTENCE)
    assert (type(refused), refused.reason) == (Refusal, RefusalReason.NO_SCRIPT)


@pytest.mark.parametrize(
    "code",
    ["raise SystemExit(1)", "return 7", "return {'grip_n': float('nan')}", "return {str(n): 0.0 for n in range(101)}"],
)
def test_a_filler_that_fails_is_named(install: Install, bench, row, code: str) -> None:  # noqa: F811
    install(registry.FILLERS, "EVIL", "fill", f"def fill(verb, thing, figures):\n    {code}\n")
    bench.load("elaborator", "fillers: [EVIL]")
    with pytest.raises(PluginError, match="table filler EVIL"):
        bench.elaborate(SENTENCE)
