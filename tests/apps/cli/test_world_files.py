"""Facts in files, and what differs between two states of the world."""

from __future__ import annotations

import msgspec
import pytest
import typer

from rtc.apps.cli.world_files import TRUE_M, TRUE_RAD, as_row, as_saved, beyond, differences, load, of_truth
from rtc.protocol import messages as m
from rtc.protocol.messages import SavedFact, Validity

UPRIGHT = [0.0, 0.0, 0.0, 1.0]


def frame(x_m: float, validity: Validity = Validity.VALID) -> SavedFact:
    return SavedFact(value=[x_m, 0.0, 0.0, *UPRIGHT], validity=validity)


def test_only_what_differs_is_shown_and_of_a_pose_by_how_much() -> None:
    before = {"A.frame": frame(0.0), "B.frame": frame(1.0), "A.seat": SavedFact(value="BAY-1")}
    after = {"A.frame": frame(0.02), "B.frame": frame(1.0), "A.seat": SavedFact(value="")}
    first, second = differences(before, after)
    assert (first.key, first.turned_rad) == ("A.frame", 0.0)
    assert first.off_m == pytest.approx(0.02)
    assert (second.key, second.off_m) == ("A.seat", None)
    assert as_row(first)["location"] == "A"


def test_another_validity_is_a_difference() -> None:
    (one,) = differences({"A.frame": frame(0.0)}, {"A.frame": frame(0.0, Validity.SUSPECT)})
    assert one.off_m == 0.0


def test_a_fact_of_one_of_them_only_differs() -> None:
    (one,) = differences({}, {"A.mass": SavedFact(value=2.0)})
    assert (one.key, one.before) == ("A.mass", None)


def test_the_truth_differs_only_beyond_what_is_never_met_exactly() -> None:
    truth = m.SimTruthReply(
        request="r",
        sim_s=0.0,
        poses={"A": [0.0005, 0.0, 0.0, *UPRIGHT], "B": [0.5, 0.0, 0.0, *UPRIGHT]},
        velocities={},
        tcp={},
        joints={"RIGHT-ARM": [0.001, 0.0]},
        fingers={"RIGHT-ARM": [0.04, 0.04]},
        held={"RIGHT-ARM": ["B"]},
    )
    believed = {
        "A.frame": frame(0.0),
        "B.frame": frame(0.0),
        "RIGHT-ARM.joints": SavedFact(value=[0.0, 0.0]),
        "RIGHT-ARM.hand_width": SavedFact(value=0.0801),
        "RIGHT-ARM.holding": SavedFact(value=""),
    }
    found = [one.key for one in differences(believed, of_truth(truth)) if beyond(one, TRUE_M, TRUE_RAD)]
    assert found == ["B.frame", "RIGHT-ARM.holding"]


def test_what_an_arm_changes_now_is_saved_as_suspect() -> None:
    fact = m.Fact(key="A.frame", value=None, validity=Validity.CHANGING, version=1, source="C-1", at_s=0.0)
    assert as_saved([fact])["A.frame"].validity is Validity.SUSPECT


def test_a_file_is_read_as_it_was_written_and_no_other_is_read(tmp_path) -> None:
    written = m.SavedWorld(cell="x", facts={"A.frame": frame(0.1, Validity.SUSPECT)})
    file = tmp_path / "world.json"
    file.write_bytes(msgspec.json.encode(written))
    assert load(file) == written
    file.write_text("{}")
    with pytest.raises(typer.Exit):
        load(file)


@pytest.mark.parametrize("value", [b"1" + 30 * b"0", b'"\xd6"'])
def test_a_file_with_a_value_that_no_message_can_have_is_refused(tmp_path, value: bytes) -> None:
    file = tmp_path / "facts.json"
    file.write_bytes(b'{"cell": "c", "facts": {"A.mass": {"value": ' + value + b"}}}")
    with pytest.raises(typer.Exit):
        load(file)


@pytest.mark.parametrize(
    "facts",
    ['"A.mass": {"value": 1}, "A.mass": {"value": 2}', '"A.mass": {"value": 1, "value": 2}'],
)
def test_a_key_that_is_given_twice_is_refused(facts: str, tmp_path, capsys) -> None:
    """The last one was taken, as of a cell file before `rtc cell check` looked."""
    file = tmp_path / "facts.json"
    file.write_text(f'{{"cell": "c", "facts": {{{facts}}}}}')
    with pytest.raises(typer.Exit):
        load(file)
    assert "is given twice" in capsys.readouterr().err
