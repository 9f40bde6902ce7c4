"""Sentences and their records: the 59 samples, equal records for equal meanings, and what no text can do."""

import math
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.language.parse import default_grammar, parse
from rtc.language.refuse import MAX_CHARACTERS
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import Condition, Constraint, Destination, ParsedCommand, Quantity, ReflexItem, Report
from rtc.protocol.units import UNITS

GRAMMAR = default_grammar()
SAMPLES = dict(line.split(": ", 1) for line in Path(__file__).with_name("samples.txt").read_text().splitlines())


def record(sentence: str | bytes) -> ParsedCommand:
    result = parse(GRAMMAR, sentence)
    assert isinstance(result, ParsedCommand), result
    return result


def task(verb: str, **fields: object) -> ParsedCommand:
    return ParsedCommand(kind="task", verb=verb, **fields)  # type: ignore[arg-type]


def reflex(condition: Condition, action: str, **fields: object) -> ReflexItem:
    return ReflexItem(condition=condition, action=action, **fields)  # type: ignore[arg-type]


def beyond(measure: str, bound: str, value: float, unit: str, along: str | None = None) -> Condition:
    return Condition(measure=measure, bound=bound, quantity=Quantity(value, unit), along=along)  # type: ignore[arg-type]


def slot(name: str, value: float | None = None, unit: str = "", of: str | None = None) -> Constraint:
    return Constraint(slot=name, name=of, value=None if value is None else Quantity(value, unit))


LEFT, RIGHT, BOTH = "LEFT-ARM", "RIGHT-ARM", "BOTH-ARMS"

#: The whole record of every sample.
RECORDS = {
    "S1": task(
        "GRASP",
        hand=LEFT,
        object="MACS-OLD",
        grasp_point="HANDLE-A",
        guarded=True,
        constraints=[
            slot("AVOID-NEIGHBORS"),
            slot("AVOID-TASK-REGION"),
            slot("POSE-DURING-MOTION"),
            slot("SAFE-WORK-RANGE"),
            slot("SPEED"),
        ],
    ),
    "S2": task("GRASP", hand=RIGHT, object="OBJECT", performer="OPERATOR"),
    "S3": task("MOVE", hand=RIGHT, place=Destination(neighborhood_of="OBJECT")),
    "S4": task("MOVE", hand=RIGHT, place=Destination(grasp_point_of="OBJECT")),
    "S5": task(
        "GRASP",
        hand=RIGHT,
        object="MACS-OLD",
        grasp_point="HANDLE-A",
        constraints=[
            slot("AVOID-NEIGHBORS", 0.03, "m"),
            slot("AVOID-TASK-REGION", of="SOLAR-ARRAY"),
            slot("SAFE-WORK-RANGE", of="BAY-2-RANGE"),
            slot("SPEED", 0.1, "m/s"),
        ],
        reflexes=[reflex(beyond("FORCE", "above", 20, "N"), "stop", trim="RELOCATE")],
    ),
    "S6": task("GRASP", object="MACS-OLD", guarded=True),
    "S7": task(
        "MOVE",
        hand=LEFT,
        path="joint",
        place=Destination(joints=[0, -math.pi / 4, math.pi / 2, 0, math.pi / 4, 0]),
    ),
    "S8": task("MOVE", hand=RIGHT, place=Destination(name="BAY-2-FRONT")),
    "S9": task(
        "MOVE",
        hand=RIGHT,
        path="straight_line",
        place=Destination(position=[0.6, -0.2, 0.35]),
        constraints=[slot("POSE-DURING-MOTION", of="LEVEL"), slot("TIME-LIMIT", 20, "s")],
        reflexes=[reflex(Condition(event="COLLISION"), "back_off", by=Quantity(0.02, "m"))],
    ),
    "S10": task(
        "MOVE", hand="GANTRY", place=Destination(name="RACK-FRONT"), through=["CLEAR-POINT-1", "CLEAR-POINT-2"]
    ),
    "S11": task(
        "MOVE",
        hand=RIGHT,
        place=Destination(by=Quantity(0.05, "m"), along="TOOL-Z"),
        constraints=[slot("SPEED", 0.02, "m/s")],
        reflexes=[reflex(beyond("FORCE", "above", 10, "N", "TOOL-Z"), "stop")],
    ),
    "S12": task("APPROACH", hand=RIGHT, object="BOLT-1"),
    "S13": task("RETRACT", hand=RIGHT, amount=Quantity(0.1, "m"), constraints=[slot("AVOID-NEIGHBORS")]),
    "S14": task(
        "LIFT",
        hand=BOTH,
        object="MACS-NEW",
        amount=Quantity(0.1, "m"),
        reflexes=[reflex(beyond("GRIP-FORCE", "below", 15, "N"), "stop", trim="REGRASP")],
    ),
    "S15": task(
        "PUSH",
        hand=LEFT,
        object="DOOR-2",
        amount=Quantity(0.03, "m"),
        constraints=[slot("FORCE-LIMIT", 15, "N")],
    ),
    "S16": task(
        "PULL",
        hand=RIGHT,
        object="CONNECTOR-J4",
        constraints=[slot("FORCE-LIMIT", 40, "N")],
        reflexes=[reflex(Condition(event="NO-CONTACT"), "stop")],
    ),
    "S17": task("PLACE", hand=RIGHT, object="MACS-OLD", target="RACK-2", guarded=True),
    "S18": task(
        "INSERT",
        hand=RIGHT,
        object="MACS-NEW",
        target="BAY-2",
        constraints=[slot("FORCE-LIMIT", 30, "N"), slot("STIFFNESS", 400, "N/m")],
        reflexes=[
            reflex(beyond("TORQUE", "above", 3, "N.m"), "back_off", by=Quantity(0.01, "m"), trim="REALIGN"),
            reflex(Condition(event="TIMEOUT"), "stop"),
        ],
    ),
    "S19": task(
        "EXTRACT",
        hand=RIGHT,
        object="MACS-OLD",
        target="BAY-2",
        reflexes=[reflex(beyond("FORCE", "above", 60, "N"), "comply", trim="WIGGLE")],
    ),
    "S20": task("ALIGN", hand=RIGHT, object="MACS-NEW", target="BAY-2", constraints=[slot("POSE-DURING-MOTION")]),
    "S21": task(
        "LOOSEN",
        hand=RIGHT,
        object="BOLT-1",
        amount=Quantity(6, "turn"),
        constraints=[slot("TORQUE-LIMIT", 4, "N.m")],
    ),
    "S22": task(
        "TIGHTEN",
        hand=RIGHT,
        object="BOLT-1",
        until=beyond("TORQUE", "above", 3.4, "N.m"),
        reflexes=[reflex(Condition(event="SLIP"), "stop", trim="REGRASP")],
    ),
    "S23": task("TURN", hand=LEFT, object="CRANK-1", amount=Quantity(-math.pi / 2, "rad")),
    "S24": task(
        "OPEN",
        hand=LEFT,
        object="DOOR-2",
        amount=Quantity(math.pi / 2, "rad"),
        reflexes=[reflex(Condition(event="JOINT-LIMIT"), "stop", trim="REPOSE")],
    ),
    "S25": task("CLOSE", hand=RIGHT, constraints=[slot("GRIP-FORCE", 25, "N")]),
    "S26": task("OPEN", hand=RIGHT, amount=Quantity(0.07, "m")),
    "S27": task(
        "CARRY",
        hand=BOTH,
        object="PANEL-1",
        target="RACK-3",
        through=["CLEAR-POINT-1"],
        constraints=[slot("GRIP-FORCE", 30, "N"), slot("POSE-DURING-MOTION", of="LEVEL")],
        reflexes=[reflex(Condition(event="OBJECT-LOST"), "stop")],
    ),
    "S28": task("HANDOFF", hand=RIGHT, to_hand=LEFT, object="MACS-OLD", guarded=True),
    "S29": task("STOW", hand=LEFT),
    "S30": task("HOLD", hand=LEFT, duration_s=30, constraints=[slot("STIFFNESS", 800, "N/m")]),
    "S31": task("LOCATE", object="MACS-OLD", performer="CAMERA-1", report=Report(items=["POSE"])),
    "S32": task(
        "TRACK",
        object="SATELLITE",
        duration_s=60,
        performer="CAMERA-2",
        report=Report(items=["POSE"], every_s=0.5),
    ),
    "S33": task("VERIFY", object="MACS-OLD", hand=RIGHT),
    "S34": task(
        "MOVE",
        hand=RIGHT,
        place=Destination(name="BAY-2-FRONT"),
        constraints=[slot("SHARED", of="WRIST")],
        report=Report(items=["JOINTS", "FORCES"]),
    ),
    "S35": task(
        "MOVE",
        hand=LEFT,
        place=Destination(name="DOOR-2-FRONT"),
        constraints=[slot("SHARED")],
        performer="OPERATOR",
    ),
    "S36": task("RELEASE", object="MACS-OLD", reflexes=[reflex(Condition(event="CONTACT"), "release")]),
    "S37": task("STOW", hand=RIGHT, after="C-12"),
    "S38": task("LOCATE", object="BOLT-2", together_with="C-9"),
    "S39": task("GRASP", hand=LEFT, object="TOOL-1", now=True),
    "S40": task("EXTRACT", test=True, hand=LEFT, object="MACS-OLD", target="BAY-2"),
    "S41": ParsedCommand(kind="control", verb="HALT", object="ALL"),
    "S42": ParsedCommand(kind="control", verb="HALT", object="ALL"),
    "S43": ParsedCommand(kind="control", verb="HALT", hand=LEFT),
    "S44": ParsedCommand(kind="control", verb="PAUSE", object="C-7"),
    "S45": ParsedCommand(kind="control", verb="RESUME", object="C-7"),
    "S46": ParsedCommand(kind="control", verb="ABORT", object="C-7"),
    "S47": ParsedCommand(kind="data", verb="SHOW", object="RESOURCES"),
    "S48": ParsedCommand(kind="data", verb="SHOW", hand=RIGHT),
    "S49": ParsedCommand(kind="data", verb="DESCRIBE", object="INSERT-SCRIPT"),
    "S50": ParsedCommand(kind="data", verb="SET", object="MACS-NEW", attribute="MASS", value=[2.1], value_unit="kg"),
    "S51": ParsedCommand(
        kind="data", verb="SET", object="BOLT-2", attribute="FRAME", value=[0.715, 0.12, 0.28], value_unit="m"
    ),
    "S52": ParsedCommand(kind="data", verb="SET", object="GRASP-STRATEGY", attribute="DEFAULT", value=["CENTERING"]),
    "S53": ParsedCommand(kind="data", verb="LOAD", object="CENTERING-GRASP", target="ELABORATOR"),
    "S54": ParsedCommand(kind="operator", verb="GIVE", hand=RIGHT),
    "S55": ParsedCommand(kind="operator", verb="TAKE", hand=RIGHT),
    "S56": ParsedCommand(kind="operator", verb="DONE"),
    "S57": ParsedCommand(kind="operator", verb="CANNOT", reason="bolt head is stripped"),
    "S58": task(
        "APPROACH",
        object="DOOR-2",
        grasp_point="LATCH-PULL",
        reflexes=[reflex(beyond("DISTANCE", "below", 0.02, "m"), "stop")],
    ),
    "S59": task(
        "MOVE",
        hand="GANTRY",
        place=Destination(name="STATION-B"),
        constraints=[slot("AVOID-TASK-REGION", of="ANTENNA"), slot("SPEED", 0.05, "m/s")],
    ),
}


def test_every_sample_has_its_record_here() -> None:
    assert set(RECORDS) == set(SAMPLES)


@pytest.mark.parametrize("number", SAMPLES)
def test_sample(number: str) -> None:
    assert record(SAMPLES[number]) == RECORDS[number]


@pytest.mark.parametrize("number", SAMPLES)
def test_sample_in_other_letters_and_as_bytes(number: str) -> None:
    sentence = SAMPLES[number]
    quoted = '"' in sentence  # the words in quotes keep their letters
    other = sentence if quoted else sentence.lower().replace("-", "_").replace(" _", " -")
    assert record(other) == record(sentence)
    assert record(f"\t{sentence},  -- as before\r\n".encode()) == record(sentence)


@pytest.mark.parametrize("number", SAMPLES)
def test_record_survives_the_wire(number: str) -> None:
    parsed = record(SAMPLES[number])
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(parsed), type=ParsedCommand) == parsed


EQUAL = [
    ("GRASP RIGHT-END-EFF MACS-OLD HANDLE-A", "grasp Macs_old handle_a with right_arm."),
    ("GRASP RIGHT-END-EFF MACS-OLD HANDLE-A", "GRASP MACS-OLD AT HANDLE-A WITH RIGHT-END-EFF"),
    ("GRASP X MAINTAIN SPEED 10 CM/S AND AVOID-NEIGHBORS", "GRASP X MAINTAIN AVOID-NEIGHBORS SPEED 0.1 M/S"),
    ("LIFT X BY 10 CM", "lift x by 100mm"),
    ("MOVE LEFT-ARM TO POSITION 60 -20 35 CM", "MOVE LEFT-ARM TO POSITION 0.6 M, -0.2 M, 350 MM"),
    ("MOVE LEFT-ARM TO POSITION 60 -20 35 CM", "MOVE LEFT-END-EFF TO POSITION 0.6 -0.2 0.35 M"),
    ("MOVE LEFT-ARM TO JOINTS 0 180 DEG", "MOVE LEFT-ARM TO JOINTS -0 RAD 180.0 DEG"),
    ("RELEASE X", "UNGRASP X"),
    ("STOW LEFT-ARM", "park left_end_eff"),
    ("SHOW RESOURCES", "Query resources."),
    ("TEST STOW LEFT-ARM", "SIMULATE STOW LEFT-ARM"),
    ("TEST STOW LEFT-ARM", "TEST TEST SIMULATE STOW LEFT-ARM"),
    ("RETRACT LEFT-ARM", "DEPART LEFT-ARM"),
    ("HALT", "STOP"),
    ("HALT ALL", "stop."),
    ("HALT LEFT-ARM", "STOP LEFT-END-EFF"),
    ("TEST HALT", "TEST STOP"),
    ("MOVE LEFT-ARM TO P MAINTAIN SHARED WRIST", "MOVE LEFT-ARM TO P MAINTAIN SHARED ORIENTATION"),
    ("GRASP X MAINTAIN SPEED 50 PERCENT", "GRASP X MAINTAIN SPEED 50%"),
    ("TRACK S REPORT EVERY 0.5 SEC", "TRACK S REPORT EVERY 2 HZ"),
    (
        "STOW LEFT-ARM REPORT WHEN CONTACT AND POSE AND WHEN FORCE ALONG Z EXCEEDS 1 N",
        "STOW LEFT-ARM REPORT POSE AND WHEN CONTACT AND WHEN FORCE ALONG Z EXCEEDS 1 N",
    ),
    ("TRACK S REPORT POSE AND EVERY 500 MS", "TRACK S REPORT EVERY 0.5 S AND POSE"),
    ("LOOSEN B BY 1 TURN", "LOOSEN B BY +1.0 TURNS"),
    ("OPEN RIGHT-END-EFF", "OPEN RIGHT-END-EFF WITH RIGHT-ARM"),
    ("SET A B 1 2 CM", "SET A B 1 CM 2 CM -- twice the unit"),
    ("HALT C-7", "halt c_7 ."),
]


@pytest.mark.parametrize(("one", "other"), EQUAL)
def test_equal_meanings_give_equal_records(one: str, other: str) -> None:
    assert record(one) == record(other)
    assert msgspec.json.encode(record(one)) == msgspec.json.encode(record(other))


DIFFERENT = [
    ("GRASP X WITH LEFT-ARM", "GRASP X WITH RIGHT-ARM"),
    ("TEST STOW LEFT-ARM", "STOW LEFT-ARM"),
    ("MOVE LEFT-ARM TO P STRAIGHT-LINE", "MOVE LEFT-ARM TO P"),
    ("MOVE LEFT-ARM TO P THROUGH A THROUGH B", "MOVE LEFT-ARM TO P THROUGH B THROUGH A"),
    ("LOOSEN B BY 1 TURN", "LOOSEN B BY 360 DEG"),  # a turn is counted, an angle measured
    ("PAUSE", "PAUSE LEFT-ARM"),
    ('CANNOT "Bolt"', 'CANNOT "bolt"'),
]


@pytest.mark.parametrize(("one", "other"), DIFFERENT)
def test_different_meanings_give_different_records(one: str, other: str) -> None:
    assert record(one) != record(other)


def test_grip_force_is_a_limit_and_a_measure() -> None:
    parsed = record("LIFT X MAINTAIN GRIP-FORCE 30 N UNLESS GRIP-FORCE BELOW 15 N THEN STOP")
    assert parsed.constraints == [slot("GRIP-FORCE", 30, "N")]
    assert parsed.reflexes == [reflex(beyond("GRIP-FORCE", "below", 15, "N"), "stop")]


def test_a_force_along_an_axis_has_a_sign() -> None:
    parsed = record("MOVE LEFT-ARM TO P UNLESS FORCE ALONG Z BELOW -5 N THEN STOP")
    assert parsed.reflexes[0].condition == beyond("FORCE", "below", -5, "N", "Z")


def test_a_list_of_numbers_may_be_as_long_as_a_sentence() -> None:
    numbers = "1 " * 980
    place = record(f"MOVE LEFT-ARM TO JOINTS {numbers}").place
    assert place is not None
    assert place.joints == [1.0] * 980


def test_deeply_nested_tests_are_one_test() -> None:
    assert record("TEST " * 390 + "HALT") == record("TEST HALT")


def test_comment_characters_within_quotes_are_words() -> None:
    assert record('CANNOT "no -- the bolt, is stripped."').reason == "no -- the bolt, is stripped."


@pytest.mark.parametrize("unit", UNITS)
def test_every_unit_is_known_to_the_grammar(unit: str) -> None:
    parsed = record(f"SET A B 1 {unit}")
    assert parsed.value_unit == UNITS[unit].si


@pytest.mark.parametrize(
    "sentence", ["TURN CRANK-1 BY 999 DEG", "SET DIAL ANGLE 999 DEG", "SET X ATTITUDE 0 0 360 DEG"]
)
def test_an_angle_that_counts_turns_or_is_a_whole_turn_is_accepted(sentence):
    assert record(sentence).kind in ("task", "data")


# --- whatever the text -----------------------------------------------------------------------------------

PIECES = [
    *GRAMMAR.vocabulary.reserved,
    *("MACS-OLD", "x", "10", "-4.5 cm", "7 N", "3 sec", '"no"', ",", ".", "--", '"', "1e999", "é"),
]


def check_settled(sentence: str | bytes) -> None:
    result = parse(GRAMMAR, sentence)
    if isinstance(result, ParsedCommand):
        assert msgspec.msgpack.decode(msgspec.msgpack.encode(result), type=ParsedCommand) == result
        return
    assert isinstance(result, Refusal)
    assert result.reason is RefusalReason.SENTENCE
    assert result.column is not None
    assert 0 <= result.column <= min(len(sentence), MAX_CHARACTERS)
    assert result.expected
    assert result.message.isprintable()  # wording: whatever was typed
    msgspec.msgpack.encode(result)


@given(st.lists(st.sampled_from(PIECES), max_size=25))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_any_words_give_a_record_or_a_located_refusal(words: list[str]) -> None:
    check_settled(" ".join(words))


@given(st.sampled_from(sorted(SAMPLES.values())), st.data())
@settings(max_examples=300, deadline=None, derandomize=True)
def test_a_sample_with_words_swapped_gives_a_record_or_a_located_refusal(sample: str, data: st.DataObject) -> None:
    words = sample.split()
    for _ in range(data.draw(st.integers(1, 3))):
        i = data.draw(st.integers(0, len(words) - 1))
        words[i] = data.draw(st.sampled_from(PIECES))
    check_settled(" ".join(words))


@given(st.text(max_size=200))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_any_text_gives_a_record_or_a_located_refusal(text: str) -> None:
    check_settled(text)


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_any_bytes_give_a_record_or_a_located_refusal(data: bytes) -> None:
    check_settled(data)


@pytest.mark.parametrize(
    "sentence",
    [
        "A" * 10_000,
        "1 " * 5_000,
        "TEST " * 2_000,
        '"' * 10_000,
        "-" * 10_000,
        "MOVE LEFT-ARM TO JOINTS " + "1 " * 9_000,
        "9" * 2_000,
        "5" + " " * 1_990 + "X",
        "A-" * 1_000,
        "GRASP X " + "UNLESS SLIP THEN STOP " * 80 + "UNLES",
    ],
    ids=lambda s: s[:12],
)
def test_monstrous_sentences_are_settled(sentence: str) -> None:
    check_settled(sentence)


@pytest.mark.parametrize(
    ("sentence", "column"),
    [
        ("MOVE RIGHT-ARM TO POSITION 60,5 -20 CM", 29),
        ("MOVE RIGHT-ARM TO JOINTS 0 110,5 -160 0 50 0 DEG", 30),
        ("LIFT MACS-NEW BY 1,5 CM", 18),
    ],
)
def test_a_decimal_comma_is_refused_where_it_stands(sentence: str, column: int) -> None:
    refused = parse(GRAMMAR, sentence)
    assert isinstance(refused, Refusal)
    assert refused.column == column


def test_commas_separate_numbers_with_a_blank_or_a_sign() -> None:
    assert record("MOVE RIGHT-ARM TO POSITION 60, -20, 35 CM") == record("MOVE RIGHT-ARM TO POSITION 60 -20 35 CM")
    assert record("MOVE RIGHT-ARM TO POSITION 60,-20 , 35 CM") == record("MOVE RIGHT-ARM TO POSITION 60 -20 35 CM")


@pytest.mark.parametrize("reason", ["", "  "])
def test_an_operator_states_a_reason_that_has_words(reason: str) -> None:
    found = parse(default_grammar(), f'CANNOT "{reason}"')
    assert isinstance(found, Refusal)
    assert found.column == 7
