"""Demo of the whole task: the module swap-out in physics, 40 sentences, several of them in progress at once.

`swapout.txt` has the sentences. A line is given as soon as the lines that it depends on have ended (`lines`); the
cluster finds out which may be performed at once. The result is checked against the simulator's truth. BOLT-2 slips in
the driver (C12), so the operator, who is a program here, loosens it (C13); he also holds the module level before the
bay (C27).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from rtc.apps.demos import lines as planner
from rtc.apps.demos.grasp import Pictures
from rtc.apps.demos.injections import CELL, GOOD, INJECTIONS, Injection, Scene
from rtc.apps.demos.lines import Course, Line
from rtc.apps.demos.narrator import Narrator
from rtc.apps.demos.own_cluster import own_cluster
from rtc.apps.demos.scripted_operator import BOLT, DIALOGUES, Act, ScriptedOperator
from rtc.client.client import Client
from rtc.drawing.renderer import Renderer
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.faults import StrippedBolt
from rtc.protocol.outcomes import OutcomeKind
from rtc.spatial import geometry, hinges

LINES = Path(__file__).with_suffix(".txt")
SLIPS = "C12"  # its bolt slips until the operator has the driver
TESTS = ("C1", "C2")
ON_PAPER = "O9"
#: C1 and C2 ask about later states: C1 when the door is open and the bolts are loose, C2 when C16 has grasped as well
HYPOTHESIS = ("C5", "C7", "C19", "C6", "C10", "C11", "C12", "C15", "C1", "C16", "C2")
LASTING = {"C8": "C18", "C23": "C40"}  # a line that lasts until the other one ends it
#: what no name in a sentence shows
AFTER = {
    "C9": "C7",  # the door hides the module
    "C10": "C7",  # the arm at the door moves beside the bolts
    "C15": "C14",  # VERIFY of a bolt uses the driver
    "C18": "C17",
    "C19": "C18",
    "C23": "C20",
    "C27": "C26",  # until then two hands hold the module
    "C28": "C26",
    "C35": "C34",
    "C38": "C37",
    "C39": "C37",
    "C40": "C39",
}
PICTURES = {
    "C7": "1-door-open",
    "C12": "2-bolts-loose",
    "C20": "3-handed-over",
    "C25": "4-both-arms",
    "C28": "5-inserted",
    "C36": "6-closed",
}
IDLE_S = 3600.0  # longest time without the end of a line, on a machine with many busy processes
SEATED_M, SEATED_DEG = 0.002, 1.0
STORED_M, CLOSED_DEG, TIGHT_M, TIGHT_NM = 0.005, 3.0, 0.0002, 3.4
TRUE_M, TRUE_DEG = 0.005, 2.0
COLUMNS = 90  # of the time line


def run(console: Console, speed: str = "1", out: Path = Path("out"), *, test: bool = False, inject: str = "") -> bool:
    """Run the demo; True if every check passed. Writes pictures to `out`; ends all processes.

    `test`: all 40 lines on paper first. `inject`: name of what goes wrong; then only the lines that lead to it."""
    narrator = Narrator(console)
    cell = Cell.load(INJECTIONS[inject].cell if inject in INJECTIONS else CELL)
    every = planner.read(LINES.read_text())
    narrator.chapter("A satellite with an old module behind a door and two bolts, the new module in a rack, two arms")
    with Renderer() as renderer:
        pictures = Pictures(out, renderer)
        with own_cluster(cell=cell.name, speed=speed) as run_dir, Client(run_dir) as rtc:
            if inject == ON_PAPER:
                hypotheses(narrator, rtc, every)
            elif inject:
                _injected(narrator, Scene(run_dir, rtc), cell, every, INJECTIONS[inject])
            else:
                operator, predicted = ScriptedOperator(run_dir, cell), on_paper(narrator, rtc, every) if test else {}
                _whole(narrator, rtc, cell, every, pictures, operator, predicted)
        pictures.check(narrator)
    return narrator.passed()


def _whole(
    narrator: Narrator,
    rtc: Client,
    cell: Cell,
    every: list[Line],
    pictures: Pictures,
    operator: ScriptedOperator,
    predicted: dict[str, float],
) -> None:
    tested = hypotheses(narrator, rtc, every)
    lines = [line for line in every if line.label not in TESTS]
    course = perform_with_operator(narrator, rtc, cell, lines, pictures, operator)
    course.ends |= tested
    show_tracks(narrator, lines, course, cell)
    show_durations(narrator, lines, course, predicted)
    narrator.chapter("The criteria")
    check_surrender(narrator, course)
    check(narrator, rtc, cell, every, course)


def perform_with_operator(
    narrator: Narrator, rtc: Client, cell: Cell, lines: list[Line], pictures: Pictures, operator: ScriptedOperator
) -> Course:
    def begun(line: Line) -> None:
        if line.label == SLIPS:
            rtc.inject(StrippedBolt(bolt=BOLT))
        if line.label in DIALOGUES:
            operator.begin(line.label)

    def ended(line: Line, end: m.CommandEnded) -> bool:
        if line.label in PICTURES:
            pictures.take(PICTURES[line.label], rtc.truth())
        if line.label in DIALOGUES:
            check_dialogue(narrator, line.label, operator.end(line.label))
        return as_wanted(line.label, end.outcome.kind)

    return _perform(narrator, rtc, cell, lines, begun, lambda *_: None, ended)


def _injected(narrator: Narrator, scene: Scene, cell: Cell, every: list[Line], what: Injection) -> None:
    of = {line.label: line for line in every}
    of[what.at] = of[what.at]._replace(text=what.text or of[what.at].text)
    lines = [of[label] for label in what.lines]
    narrator.line(f"{what.about}; cell {cell.name}, lines {', '.join(line.label for line in lines)}")

    def ended(line: Line, end: m.CommandEnded) -> bool:
        lasts = (OutcomeKind.ABORTED,) if line.label in LASTING else GOOD
        wanted = what.ends if line.label == what.at else lasts
        words = " or ".join(kind.value for kind in wanted)
        return narrator.check(
            f"{line.label} ended {end.outcome.kind.value}, wanted {words}", end.outcome.kind in wanted
        )

    course = _perform(narrator, scene.rtc, cell, lines, partial(what.begins, scene), partial(what.notes, scene), ended)
    if what.at in course.ends:
        what.check(narrator, scene, course)


def _perform(
    narrator: Narrator,
    rtc: Client,
    cell: Cell,
    lines: list[Line],
    on_begin: Callable[[Line], None],
    on_note: Callable[[Line, m.ProgressNote], None],
    on_end: Callable[[Line, m.CommandEnded], bool],
) -> Course:
    def begun(line: Line) -> None:
        narrator.line(f"{line.label:>4}  {line.text}", "dim")
        on_begin(line)

    def ended(line: Line, end: m.CommandEnded) -> bool:
        result = f"{end.outcome.kind.value} after {end.took_s:.1f} s  {end.outcome.message}"
        narrator.line(f"{line.label:>4}  {end.command} {result}")
        return on_end(line, end)

    narrator.chapter("The lines; each is given as soon as those it depends on have ended")
    needed = planner.waits(lines, cell, AFTER)
    return planner.Planner(rtc, needed, LASTING, begun, on_note, ended).perform(lines, IDLE_S)


def on_paper(narrator: Narrator, rtc: Client, every: list[Line]) -> dict[str, float]:
    """All lines on paper, each after those before it: nothing moves, and nothing is written.

    Returns the predicted durations of the feasible ones: label -> s."""
    narrator.chapter("The lines on paper")
    before, truth = rtc.world.view(), rtc.truth()
    ends = rtc.test([line.text for line in every], [line.label for line in every], keep_going=True)
    for line, end in zip(every, ends, strict=True):
        narrator.line(f"{line.label:>4}  {end.outcome.kind.value}  {end.outcome.message[:120]}", "dim")
    after = rtc.world.view()
    still = (rtc.truth().joints, rtc.truth().poses) == (truth.joints, truth.poses)
    narrator.check(f"{len(ends)} lines tested; no arm has moved", still)
    narrator.check("the world database is as before", (after.version, after.facts) == (before.version, before.facts))
    return {
        line.label: end.outcome.rehearsal.predicted_s
        for line, end in zip(every, ends, strict=True)
        if end.outcome.rehearsal is not None and end.outcome.kind is OutcomeKind.SUCCEEDED
    }


def hypotheses(narrator: Narrator, rtc: Client, every: list[Line]) -> dict[str, m.CommandEnded]:
    """C1 and C2, which are O9 too: the open door prevents the grasp of the left arm; the right arm can do the task.

    Returns the ends of both. Nothing moves."""
    narrator.chapter("Which arm takes the old module out: the two tests, in the states that their lines before lead to")
    texts = {line.label: line.text for line in every}
    ends = rtc.test([texts[label] for label in HYPOTHESIS], keep_going=True)
    found = dict(zip(HYPOTHESIS, ends, strict=True))
    for label, end in found.items():
        narrator.line(f"{label:>4}  {texts[label].removeprefix('TEST ')}: {end.outcome.message}", "dim")
    refusal = found["C1"].outcome.refusal
    bodies = {str(refusal.detail.get(key, "")).split(" ")[0] for key in ("body_a", "body_b")} if refusal else set()
    narrator.check(f"C1: {found['C1'].outcome.message}", bodies == {"LEFT-ARM", "DOOR-2"})
    feasible = {label for label, end in found.items() if end.outcome.kind is OutcomeKind.SUCCEEDED}
    narrator.check("C2, and all that leads to it, is feasible", feasible == set(HYPOTHESIS) - {"C1"})
    moved = [event.command for event in ends if any(note.node == "MCM" for note in rtc.trace(event.command).notes)]
    narrator.check(f"sent to an arm: {', '.join(moved) or 'nothing'}", not moved)
    return {label: found[label] for label in TESTS}


def as_wanted(label: str, kind: OutcomeKind) -> bool:
    """The test of the left arm finds that it cannot, and a stripped bolt cannot be loosened; what lasts until it is
    ended is aborted."""
    if label == "C1":
        return kind is OutcomeKind.REFUSED
    if label == SLIPS:
        return kind is OutcomeKind.FAILED
    return kind is (OutcomeKind.ABORTED if label in LASTING else OutcomeKind.SUCCEEDED)


def show_durations(narrator: Narrator, lines: list[Line], course: Course, predicted: dict[str, float]) -> None:
    """Predicted on paper before the task, beside what the steps took: simulated seconds."""
    if predicted:
        narrator.chapter("Durations in s: predicted before the task, and measured in the steps")
    for line in lines:
        if line.label in predicted and line.label in course.measured_s:
            ahead, took = predicted[line.label], course.measured_s[line.label]
            narrator.line(f"{line.label:>4}  {ahead:6.1f} {took:6.1f}  {line.text.partition(' MAINTAIN')[0]}", "dim")


def show_tracks(narrator: Narrator, lines: list[Line], course: Course, cell: Cell) -> None:
    """One row of time per arm, and one for the cameras: the number of the line in execution."""
    narrator.chapter(f"The time line: {course.now_s:.0f} s; of each line its number")
    scale = COLUMNS / max(course.now_s, 1.0)
    for name, words in [*((arm.name, (arm.name, arm.end_effector, "BOTH-ARMS")) for arm in cell.arms),
                        ("cameras", ("VIA CAMERA",))]:  # fmt: skip
        row = [" "] * COLUMNS
        for line in lines:
            if line.label not in course.executing or not any(word in line.text for word in words):
                continue
            first, last = (min(COLUMNS - 1, int(scale * at)) for at in course.executing[line.label])
            row[first : last + 1] = (line.label[1:] + "-" * COLUMNS)[: last + 1 - first]
        narrator.line(f"{name:>9} |{''.join(row)}|")


def check_dialogue(narrator: Narrator, label: str, acts: Sequence[Act]) -> None:
    """The operator has erred and was refused, and what he has proved was believed."""
    for what, why in acts:
        narrator.line(f"{label:>4}  operator {what}{f': refused, {why}' if why else ''}", "dim")
    refused = [what for what, why in acts if why]
    ended = bool(acts) and acts[-1] == Act("DONE", "")
    narrator.check(
        f"{label}: refused {', '.join(refused) or 'nothing'}; the last DONE is believed", ended and "DONE" in refused
    )
    if label == "C13":
        narrator.check("C13: the fingers are not his to close", "closes the hand" in refused)


def check_surrender(narrator: Narrator, course: Course) -> None:
    """The failure of C12 names the sentence of C13."""
    refusal = course.ends[SLIPS].outcome.refusal if SLIPS in course.ends else None
    offered = refusal.by_operator if refusal is not None else ""
    narrator.check(
        f"{SLIPS} has failed and offers: {offered or 'nothing'}", bool(offered) and offered == course.texts.get("C13")
    )


def check(narrator: Narrator, rtc: Client, cell: Cell, lines: list[Line], course: Course) -> None:
    truth = rtc.truth()
    wrong = [line.label for line in lines if line.label not in course.ends]
    wrong += [label for label, end in course.ends.items() if not as_wanted(label, end.outcome.kind)]
    narrator.check(f"{len(course.ends)} of {len(lines)} lines ended as they should; not: {wrong or 'none'}", not wrong)
    check_goal(narrator, cell, truth)
    check_beliefs(narrator, rtc, cell, truth)
    check_alone(narrator, lines, course, cell)
    for phase, labels in {"2": range(5, 10), "5": range(21, 25)}.items():
        most = course.together([f"C{n}" for n in labels])
        narrator.check(f"phase {phase}: {most} lines in execution at once", most >= 2)


def check_alone(narrator: Narrator, lines: list[Line], course: Course, cell: Cell) -> None:
    """No two lines about one arm were in execution at once."""
    most = {
        arm.name: course.together(
            [line.label for line in lines if arm.name in line.text or arm.end_effector in line.text]
        )
        for arm in cell.arms
    }
    narrator.check(f"lines in execution at once for one arm: {most}", all(number == 1 for number in most.values()))


def check_goal(narrator: Narrator, cell: Cell, truth: m.SimTruthReply) -> None:
    """The new module in the bay, the old one in the rack, the bolts tight, the door closed: in truth."""
    for module, seat, most_m in (("MACS-NEW", "BAY-2", SEATED_M), ("MACS-OLD", "RACK-2", STORED_M)):
        place = cell.seated_pose(seat)
        off_m = geometry.distance(truth.poses[module], place)
        off_deg = math.degrees(geometry.angle(truth.poses[module], place))
        what = f"{module} is {1e3 * off_m:.1f} mm and {off_deg:.2f} deg from its place in {seat}"
        narrator.check(what, off_m <= most_m and off_deg <= SEATED_DEG)
    for bolt in ("BOLT-1", "BOLT-2"):
        out_m = geometry.distance(truth.poses[bolt], cell.object(bolt).frame.pose)
        torque_nm = truth.tight_nm[bolt]
        what = f"{bolt} is {1e3 * out_m:.2f} mm out, tightened to {torque_nm:.2f} N.m"
        narrator.check(what, out_m <= TIGHT_M and torque_nm >= TIGHT_NM)
    door = cell.object("DOOR-2")
    assert door.hinge is not None
    angle = math.degrees(hinges.angle_of(door.frame.pose, door.hinge.axis, truth.poses["DOOR-2"]))
    narrator.check(f"the door stands at {angle:.1f} deg", angle <= CLOSED_DEG)


def check_beliefs(narrator: Narrator, rtc: Client, cell: Cell, truth: m.SimTruthReply) -> None:
    """Each valid frame of an object agrees with the truth."""
    facts = {fact.key: fact for fact in rtc.world.view(keys=[f"{thing.name}.frame" for thing in cell.objects]).facts}
    off = {}
    for key, fact in facts.items():
        name = key.partition(".")[0]
        if fact.validity is m.Validity.VALID and name in truth.poses:
            pair = fact.value, truth.poses[name]
            off[name] = geometry.distance(*pair), math.degrees(geometry.angle(*pair))
    wrong = [
        f"{name} {1e3 * far:.1f} mm {deg:.1f} deg" for name, (far, deg) in off.items() if far > TRUE_M or deg > TRUE_DEG
    ]
    narrator.check(
        f"{len(off)} valid poses agree with the truth; not: {', '.join(wrong) or 'none'}", bool(off) and not wrong
    )


INJECTED = sorted([*INJECTIONS, ON_PAPER])
