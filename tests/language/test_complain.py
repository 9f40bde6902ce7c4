"""Wrong sentences: the place of each error, the message, what would have been right, what was probably meant.

The mark ¦ stands before the first offending character.
"""

import pytest

from rtc.language import dictionary
from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal, RefusalReason

GRAMMAR = default_grammar()
VERBS = sorted(dictionary.verbs())
HANDS = ["ARM", "BOTH-ARMS", "LEFT-ARM", "LEFT-END-EFF", "RIGHT-ARM", "RIGHT-END-EFF"]
QUANTITY = "a quantity such as 10 CM"
NUMBERS = ["a number", QUANTITY]
END = "the end of the sentence"
AFTER_TASK = ["AFTER", "NOW", "REPORT", "TOGETHER-WITH", "VIA", END]
AFTER_OBJECT = ["AFTER", "GUARDED", "MAINTAIN", "NOW", "REPORT", "TOGETHER-WITH", "UNLESS", "VIA", "WITH", END]
AFTER_STEP = [*sorted({"ALONG", "JOINT-MOTION", "STRAIGHT-LINE", "THROUGH", *AFTER_OBJECT} - {"WITH", END}), END]
AFTER_OBJECT_STEP = [*(word for word in AFTER_OBJECT if word != "WITH")]
EVENTS = ["CLEARANCE", "COLLISION", "CONTACT", "DISTANCE", "FORCE", "GRIP-FORCE", "JOINT-LIMIT", "NO-CONTACT",
          "NO-PROGRESS", "OBJECT-LOST", "SLIP", "TIMEOUT", "TORQUE", "TURN"]  # fmt: skip
SLOTS = ["AVOID-NEIGHBORS", "AVOID-TASK-REGION", "FORCE-LIMIT", "GRIP-FORCE", "POSE-DURING-MOTION",
         "SAFE-WORK-RANGE", "SHARED", "SPEED", "STIFFNESS", "TIME-LIMIT", "TORQUE-LIMIT"]  # fmt: skip
A_LENGTH, AN_ANGLE, A_FORCE = "a length such as 10 CM", "an angle such as 90 DEG", "a force such as 20 N"
A_TORQUE, A_TIME, TURNS = "a torque such as 3 NM", "a time such as 30 SEC", "a number of turns such as 6 TURNS"
SPEEDS = ["a speed such as 10 CM/S", "a turning speed such as 20 DEG/S", "a percentage such as 50 PERCENT"]
WORDS = ["words of letters, digits and '-'"]

#: sentence, expected, nearest, words of the message
WRONG = [
    # no sentence at all
    ("¦", VERBS, [], "no command"),
    ("¦   ", VERBS, [], "no command"),
    ("¦ . ", VERBS, [], "no command"),
    ("¦-- only a comment", VERBS, [], "no command"),
    ("TEST¦", VERBS, [], "no command"),
    # no verb
    ("¦GRAPS MACS-OLD", VERBS, ["GRASP"], "GRAPS is not a verb"),
    ("¦unplug MACS-OLD", VERBS, [], "UNPLUG is not a verb"),
    ("TEST ¦EXTRAKT MACS-OLD FROM BAY-2", VERBS, ["EXTRACT"], "EXTRAKT is not a verb"),
    ("¦SPEED 10 CM/S", VERBS, [], "SPEED is not a verb"),
    ("¦10 CM", VERBS, [], "10 CM is not a verb"),
    ("¦UNGRAPS MACS-OLD", VERBS, ["UNGRASP"], "UNGRAPS is not a verb"),
    ("¦FOO BAR", VERBS, [], "FOO is not a verb"),  # FOR is near, and cannot begin a sentence
    # two words for one; a direction without its ALONG
    ("MOVE ¦RIGHT ARM TO RACK-1", HANDS, ["RIGHT-ARM"], "RIGHT cannot stand here"),
    ("MOVE LEFT-ARM BY 5 CM ¦TOOL-Z", AFTER_STEP, ["ALONG TOOL-Z"], "TOOL-Z cannot stand here"),
    ("MOVE LEFT-ARM BY 5 DEG ¦ABOUT Z", AFTER_STEP, ["ALONG"], "ABOUT cannot stand here"),
    # letters and dashes of other alphabets
    ("ST¦ÖW LEFT-ARM", WORDS, [], "The character Ö cannot stand here."),
    ("¦ÄÖÜ", WORDS, [], "The character Ä cannot stand here."),
    ("STOW LEFT-¦ÄRM", WORDS, [], "The character Ä cannot stand here."),
    ("MOVE LEFT-ARM TO X STRAIGHT-LINE ¦THROUGH Y", AFTER_OBJECT_STEP, [], "Write THROUGH and its place before"),
    ("STOW LEFT¦\u2013ARM", WORDS, [], "The character \u2013 cannot stand here. Did you mean -?"),
    ("STOW LEFT¦\u2212ARM", WORDS, [], "Did you mean -?"),
    # it ends too early
    ("GRASP¦", ["a name", "LEFT-END-EFF", "RIGHT-END-EFF"], [], "after GRASP"),
    ("GRASP¦  . -- what?", ["a name", "LEFT-END-EFF", "RIGHT-END-EFF"], [], "after GRASP"),
    ("MOVE¦", HANDS, [], "after MOVE"),
    ("MOVE LEFT-ARM¦", ["BY", "TO", "TO-GRASP-POINT-OF", "TO-NEIGHBORHOOD-OF"], [], "after LEFT-ARM"),
    ("move right_arm to¦", ["a name", "JOINTS", "POSITION"], [], "after TO"),
    ("GRASP MACS-OLD WITH ARM¦", ["a name"], [], "after ARM"),
    ("INSERT MACS-NEW¦", ["INTO"], [], "after MACS-NEW"),
    ("GRASP MACS-OLD MAINTAIN¦", SLOTS, [], "after MAINTAIN"),
    ("GRASP MACS-OLD UNLESS¦", EVENTS, [], "after UNLESS"),
    ("GRASP MACS-OLD UNLESS SLIP¦", ["THEN"], [], "after SLIP"),
    ("GRASP MACS-OLD UNLESS FORCE¦", ["ALONG", "BELOW", "EXCEEDS"], [], "after FORCE"),
    ("SET MACS-NEW MASS¦", ["a name", QUANTITY, "a number"], [], "after MASS"),
    ("HOLD LEFT-ARM UNLESS FORCE EXCEEDS¦", [A_FORCE], [], "after EXCEEDS"),
    ("HOLD LEFT-ARM UNLESS TURN BELOW ¦FOO", [AN_ANGLE, TURNS], [], "FOO cannot stand here"),
    ("STOW LEFT-ARM REPORT EVERY¦", [A_TIME, "a rate such as 10 HZ"], [], "after EVERY"),
    ("MOVE LEFT-ARM BY¦", [A_LENGTH, AN_ANGLE], [], "after BY"),
    ("CANNOT¦", ['a text in quotes such as "bolt head is stripped"'], [], "after CANNOT"),
    # a word in the wrong place
    ("MOVE ¦MACS-OLD TO BAY-2", HANDS, [], "MACS-OLD cannot stand here, after MOVE"),
    ("STOW ¦PANDA", HANDS, [], "If it is an arm, write ARM PANDA."),
    ("GRASP ¦MOVE", ["a name", "LEFT-END-EFF", "RIGHT-END-EFF"], [], "MOVE is a reserved word"),
    ("RELEASE ¦RIGHT-ARM", ["a name"], [],
     "RELEASE needs the name of an object; RIGHT-ARM is an arm"),
    ("LOCATE MACS-OLD VIA ¦SPEED", ["a name", "OPERATOR-INTERVENTION"], [], "SPEED is a reserved word"),
    ("SET MACS-NEW ¦HELD_BY RIGHT-ARM", ["GRASP MACS-NEW, to take it", "VERIFY MACS-NEW AT the arm that holds it"], [],
     "HELD_BY is measured"),
    ("STOW ¦PARK", HANDS, [], "PARK cannot stand here"),
    ("HALT ALL ¦ALL", [END], [], "ALL cannot stand here, after ALL"),
    ("DONE ¦DONE", [END], [], "after DONE"),
    ("GRASP MACS-OLD WITH ¦RIHGT-ARM GUARDED", HANDS, ["RIGHT-ARM"], "RIHGT-ARM cannot stand here"),
    ("GRASP MACS-OLD HANDLE-A ¦MANTAIN SPEED", AFTER_OBJECT, ["MAINTAIN"], "MANTAIN cannot stand here"),
    ("STOW LEFT-ARM ¦AFTR C-3", [w for w in AFTER_OBJECT if w != "WITH"], ["AFTER"], "AFTR cannot stand"),
    ("GRASP MACS-OLD NOW ¦REPORT POSE", [END], [], "after NOW"),
    ("STOW LEFT-ARM ¦REPORT EVERY 1 SEC AND EVERY 2 SEC", [], [], "EVERY is given twice"),
    ("GRASP MACS-OLD REPORT ¦SPEED", ["a name", "EVERY", "FORCES", "JOINTS", "POSE", "WHEN"], [], "after REPORT"),
    ("TRACK SATELLITE ¦MAINTAIN SPEED", ["AFTER", "FOR", *AFTER_TASK[1:]], [], "after SATELLITE"),
    ("GIVE RIGHT-ARM ¦OPERATOR", ["TO"], [], "after RIGHT-ARM"),
    ("MOVE LEFT-ARM TO P UNLESS SLIP THEN ¦HALT", ["BACK-OFF", "COMPLY", "RELEASE", "STOP"], [], "after THEN"),
    # a misspelt word that passed as a name
    ("GRASP MACS-OLD ¦MANTAIN SPEED 10 CM/S", ["a name", *AFTER_OBJECT[:1], "AT", *AFTER_OBJECT[1:]], ["MAINTAIN"],
     "MANTAIN is read as a name"),
    ("GRASP ¦LEFT-END-EF MACS-OLD HANDLE-A", ["a name", "LEFT-END-EFF", "RIGHT-END-EFF"], ["LEFT-END-EFF"],
     "LEFT-END-EF is read as a name"),
    # numbers and units
    ("LIFT MACS-OLD BY ¦10", [A_LENGTH], [], "10 has no unit"),
    ("LIFT MACS-OLD BY ¦10 WITH LEFT-ARM", [A_LENGTH], [], "10 has no unit"),
    ("LIFT MACS-OLD BY 10 ¦CMM", ["a unit such as CM"], ["CM", "MM"], "CMM is not a unit"),
    ("LIFT MACS-OLD BY 10 ¦furlongs", ["a unit such as CM"], [], "FURLONGS is not a unit"),
    ("LIFT MACS-OLD BY ¦10cmm WITH LEFT-ARM", NUMBERS, ["CM", "MM"], "10cmm is neither a number"),
    ("LIFT MACS-OLD BY ¦1.2.3 CM", NUMBERS, [], "1.2.3 is neither a number"),
    ("GRASP ¦7UP", NUMBERS, [], "7UP is neither a number"),
    ("MOVE LEFT-ARM TO JOINTS 1 2 ¦DEGG", ["a unit such as CM"], ["DEG"], "DEGG is not a unit"),
    ("MOVE LEFT-ARM TO JOINTS¦", ["a number", AN_ANGLE], [], "needs numbers"),
    ("MOVE LEFT-ARM TO JOINTS 10 DEG 20 DEG ¦30 40", ["30 40 DEG"], [], "30 has no unit"),
    ("MOVE LEFT-ARM TO JOINTS 1 2 ¦3 KG", [AN_ANGLE, A_LENGTH], [], "an angle or a length; 3 KG is a mass"),
    ("MOVE LEFT-ARM TO POSITION 40 -40 ¦90", [A_LENGTH], [], "90 has no unit"),
    ("MOVE LEFT-ARM TO POSITION 1 2 CM¦", ["x y z such as 60 -20 35 CM"], [], "three numbers, not 2"),
    ("MOVE LEFT-ARM TO POSITION 1 2 3 ¦4 CM", ["x y z such as 60 -20 35 CM"], [], "three numbers, not 4"),
    ("SET BOLT-2 FRAME 1 CM ¦2 N", [A_LENGTH, "an angle such as 90 DEG"], [], "2 N is a force"),
    ("SET X Y ¦1e999", ["a smaller number"], [], "too large"),
    ("LIFT X BY ¦1e400 M", ["a smaller number"], [], "too large"),
    ("MOVE LEFT-ARM BY ¦1e8 CM ALONG Z", [A_LENGTH], [], "too large"),
    ("MOVE LEFT-ARM BY ¦-99999999999999999999 CM ALONG Z", [A_LENGTH], [], "too large"),
    ("MOVE LEFT-ARM BY ¦-1e-320 CM ALONG Z", [A_LENGTH], [], "too small"),
    ("MOVE LEFT-ARM TO JOINTS 0 ¦1e308 0 DEG", [AN_ANGLE], [], "too large"),
    ("MOVE LEFT-ARM TO JOINTS 0 ¦1e308 0", [AN_ANGLE], [], "too large"),
    ("MOVE LEFT-ARM TO POSITION 0 ¦1e20 0 CM", [A_LENGTH], [], "too large"),
    ("HOLD LEFT-ARM FOR ¦1e308 SEC", [A_TIME], [], "too large"),
    ("STOW LEFT-ARM MAINTAIN SPEED ¦1e-320 CM/S", ["a speed such as 10 CM/S"], [], "too small"),
    # the wrong kind of quantity
    ("GRASP X MAINTAIN SPEED ¦10 N", SPEEDS, [], "SPEED takes a speed or a turning speed or"),
    ("GRASP X MAINTAIN SPEED ¦10 CM", SPEEDS, [], "10 CM is a length"),
    ("LIFT X BY ¦5 SEC", [A_LENGTH], [], "LIFT BY takes a length; 5 SEC is a time"),
    ("LOOSEN X BY ¦5 CM", [TURNS, AN_ANGLE], [], "5 CM is a length"),
    ("OPEN RIGHT-END-EFF BY ¦90 DEG", [A_LENGTH], [], "90 DEG is an angle"),
    ("HOLD LEFT-ARM FOR ¦5 CM", [A_TIME], [], "FOR takes a time"),
    ("GRASP X MAINTAIN AVOID-NEIGHBORS BY ¦3 N", [A_LENGTH], [], "AVOID-NEIGHBORS takes a length"),
    ("GRASP X MAINTAIN FORCE-LIMIT ¦3 NM", [A_FORCE], [], "3 NM is a torque"),
    ("GRASP X UNLESS FORCE EXCEEDS ¦3 NM THEN STOP", [A_FORCE], [], "FORCE EXCEEDS takes a force"),
    ("GRASP X UNLESS SLIP THEN BACK-OFF BY ¦2 DEG", [A_LENGTH], [], "BACK-OFF BY takes a length"),
    ("TIGHTEN X UNTIL TORQUE EXCEEDS ¦3 N", [A_TORQUE], [], "3 N is a force"),
    ("MOVE LEFT-ARM BY ¦3 N", [A_LENGTH, AN_ANGLE], [], "MOVE BY takes a length or an angle"),
    ("TRACK X REPORT EVERY ¦3 CM", [A_TIME, "a rate such as 10 HZ"], [], "EVERY takes a time or a rate"),
    # numbers out of sense
    ("GRASP X MAINTAIN SPEED ¦-10 CM/S", SPEEDS[:1], [], "SPEED -10 CM/S makes no sense"),
    ("GRASP X MAINTAIN SPEED ¦0 CM/S", SPEEDS[:1], [], "more than nothing"),
    ("GRASP X MAINTAIN SPEED ¦150 PERCENT", ["100 PERCENT"], [], "at most 100 PERCENT"),
    ("RETRACT LEFT-ARM BY ¦-5 CM", [A_LENGTH], [], "RETRACT BY -5 CM makes no sense"),
    ("LIFT X BY ¦0 CM", [A_LENGTH], [], "LIFT BY 0 CM makes no sense: it must be not nothing"),
    ("HOLD LEFT-ARM FOR 2 ¦MIN", ["a unit of time such as SEC"], [], "MIN is not a unit"),
    ("HOLD LEFT-ARM FOR ¦-1 SEC", [A_TIME], [], "FOR -1 SEC makes no sense"),
    ("GRASP X MAINTAIN AVOID-NEIGHBORS BY ¦0 CM", [A_LENGTH], [], "must be more than nothing"),
    ("GRASP X UNLESS FORCE EXCEEDS ¦-5 N THEN STOP", [A_FORCE], [], "must be more than nothing"),
    ("GRASP X UNLESS FORCE EXCEEDS ¦0 N THEN STOP", [A_FORCE], [], "must be more than nothing"),
    ("GRASP X UNLESS FORCE BELOW ¦0 N THEN STOP", [A_FORCE], [], "must be more than nothing"),
    ("SET X ATTITUDE 0 ¦999 0 DEG", [AN_ANGLE], [], "from -360 to 360 DEG"),
    ("SET X ATTITUDE ¦-6.3 RAD", [AN_ANGLE], [], "from -360 to 360 DEG"),
    ("SET X FRAME 80 77 60 CM 0 0 ¦999 DEG", [AN_ANGLE], [], "from -360 to 360 DEG"),
    ("MOVE LEFT-ARM BY ¦181 DEG ALONG TOOL-Z", [AN_ANGLE], [], "from -180 to 180 DEG"),
    # repeated, or contradictory
    ("GRASP X MAINTAIN SPEED 10 CM/S AND ¦SPEED 5 CM/S", ["each constraint once"], [], "SPEED is repeated"),
    (
        "GRASP X MAINTAIN AVOID-TASK-REGION A AND ¦AVOID-TASK-REGION A",
        ["each constraint once"],
        [],
        "AVOID-TASK-REGION is repeated",
    ),
    ("GRASP X MAINTAIN SPEED, SHARED, ¦SHARED WRIST", ["each constraint once"], [], "SHARED is repeated"),
    ("OPEN RIGHT-END-EFF WITH ¦LEFT-ARM", ["RIGHT-ARM"], [], "RIGHT-ARM is named first, then LEFT-ARM"),
    ("HANDOFF X FROM LEFT-ARM TO ¦LEFT-END-EFF", ["another hand"], [], "cannot hand X to itself"),
    # characters
    ("GRASP X¦; HALT", WORDS, [], "The character ; cannot stand here"),
    ("GRASP MACS¦-", WORDS, [], "The character - can"),
    ("GRASP A¦__B", WORDS, [], "The character _ can"),
    ("GRASP X¦. WITH LEFT-ARM", WORDS, [], "The character . can"),
    ("GRASP MÄCS-OLD".replace("Ä", "¦Ä"), WORDS, [], "The character Ä can"),
    ('CANNOT ¦"bolt head', ['a closing "'], [], "not closed"),
    ('CANNOT "x" ¦"y"', [END], [], "cannot stand here"),
    ("GRASP ¦\x07X", ["readable text"], [], "U+0007"),
    ("GRASP X ¦\x00", ["readable text"], [], "U+0000"),
    ("GRASP X -- \x1b[2J".replace("\x1b", "¦\x1b"), ["readable text"], [], "U+001B"),
    ("GRASP¦\u00a0X", ["readable text"], [], "U+00A0"),
    ("HALT¦\nHALT", [END], [], "one line"),
]  # fmt: skip


def refused(sentence: str | bytes) -> Refusal:
    result = parse(GRAMMAR, sentence)
    assert isinstance(result, Refusal), result
    assert result.reason is RefusalReason.SENTENCE
    assert result.where == f"column {result.column}"
    return result


@pytest.mark.parametrize(("marked", "expected", "nearest", "words"), WRONG, ids=[c[0] for c in WRONG])
def test_wrong_sentence(marked: str, expected: list[str], nearest: list[str], words: str) -> None:
    refusal = refused(marked.replace("¦", ""))

    assert refusal.column == marked.index("¦")
    assert refusal.expected == expected
    assert refusal.nearest == nearest
    assert words in refusal.message  # wording: what stands beside the caret


def test_bytes_that_are_no_text_are_located_in_characters() -> None:
    refusal = refused("GRASP é".encode() + b"\xff X")
    assert refusal.column == len("GRASP é")
    assert "0xFF" in refusal.message  # wording: what stands beside the caret


def test_a_cut_character_is_located_where_it_begins() -> None:
    assert refused("GRASP é".encode()[:-1]).column == len("GRASP ")


@pytest.mark.parametrize("sentence", ["GRASP " + "X" * 1995, b"X" * 2001, "HALT" + " " * 2000, "é" * 5000])
def test_a_sentence_that_is_too_long_is_located_at_the_limit(sentence: str | bytes) -> None:
    refusal = refused(sentence)
    assert refusal.column == 2000
    assert refusal.expected == ["at most 2,000 characters"]


def test_the_longest_sentence_is_still_one() -> None:
    assert not isinstance(parse(GRAMMAR, "GRASP " + "X" * 1994), Refusal)


def test_control_bytes_come_before_everything_else() -> None:
    assert refused("GRAPS\x07").column == 5  # a text that cannot be printed is not judged as a sentence


def test_messages_quote_only_the_beginning_of_long_words() -> None:
    refusal = refused("X" * 1500)
    assert refusal.message == "X" * 37 + "... is not a verb of the language."  # wording: cut


def test_columns_hold_in_upper_and_lower_case_and_behind_tabs() -> None:
    assert refused("grasp\tmacs_old , , mantain speed").column == len("grasp\tmacs_old , , ")


@pytest.mark.parametrize(
    "sentence",
    [
        "MOVE LEFT-ARM TO POSITION 60 CM 0 0",
        "SET MACS-NEW FRAME 60 CM 0 0",
        "MOVE LEFT-ARM TO JOINTS 10 DEG 20 30 40 50 60",
    ],
)
def test_the_numbers_that_are_expected_are_accepted_when_they_are_typed(sentence: str) -> None:
    """One number with its unit was expected; then the next number had none."""
    refusal = refused(sentence)
    typed = sentence[: refusal.column] + refusal.expected[0]
    assert not isinstance(parse(GRAMMAR, typed), Refusal)
