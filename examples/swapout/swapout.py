"""Demo of the whole task: the module swap-out in physics, 40 sentences, several of them in progress at once.

`swapout.txt` has the sentences. A line is given as soon as the lines that it depends on have ended (`lines`); the
cluster finds out which may be performed at once. The result is checked against the simulator's truth. BOLT-2 slips in
the driver (C12), so the operator, who is a program here, loosens it (C13), and holds the module level before the
bay (C27). A part of the task, or a run in which something goes wrong, is some of the lines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from rich.console import Console

from examples.swapout import lines as planner
from examples.swapout.filming import Film
from examples.swapout.injections import CELL, GOOD, HALFWAY, HALTED, STRIPPED, Injection, Scene
from examples.swapout.lines import Course, Line
from examples.swapout.scripted_operator import DIALOGUES, Act, ScriptedOperator
from rtc.apps.demos.narrator import Narrator
from rtc.apps.demos.own_cluster import own_cluster
from rtc.apps.demos.pictures import DemoPictures
from rtc.client.client import Client
from rtc.drawing.renderer import Renderer
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.causes import Collides
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.protocol.rehearsal import RehearsedStep
from rtc.protocol.sentence import BOTH_ARMS
from rtc.spatial import geometry, hinges
from rtc.wording import commands

LINES = Path(__file__).with_suffix(".txt")
SLIPS = "C12"  # its bolt slips until the operator has the driver
TESTS = ("C1", "C2")
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
    "C14": "2-bolts-loose",
    "C20": "3-handed-over",
    "C25": "4-both-arms",
    "C28": "5-inserted",
    "C36": "6-closed",
}
VIEW = "above"
IDLE_S = 3600.0  # longest time without the end of a line, on a machine with many busy processes
SEATED_M, SEATED_DEG = 0.002, 1.0
STORED_M, CLOSED_DEG, TIGHT_M, TIGHT_NM = 0.005, 3.0, 0.0002, 3.4
TRUE_M, TRUE_DEG = 0.005, 2.0
COLUMNS = 90  # of the time line
OFF_S, OFF_SHARE = 0.1, 0.05  # a measured duration against a predicted one
# of a caption: the arm, which is named before it, and what belongs to the way of doing it
LEFT_OUT = re.compile(
    r" \S+-END-EFF| FROM \S+-ARM TO \S+-ARM| WITH \S+| GUARDED| (MAINTAIN|UNLESS|UNTIL|REPORT|VIA|THROUGH) .*"
)


class Part(NamedTuple):
    """Some of the lines."""

    about: str
    cell: str
    lines: list[str]  # labels, in order
    event: Injection  # what goes wrong on the way, and how it must be taken
    after: Mapping[str, str] = MappingProxyType({})  # as AFTER, instead of it
    at_once: tuple[str, ...] = ()  # labels of lines of which at least two must be in execution at once
    closed: bool = True  # the lines lead to the end of the task, which is then checked
    frame_s: float = 1.5  # of simulated time, between two frames of the film

    def wanted(self, label: str) -> tuple[OutcomeKind, ...]:
        """How a line should end. The test of the left arm finds that it cannot; what lasts is aborted by a line."""
        if label == self.event.at:
            return self.event.ends
        if label == "C1":
            return (OutcomeKind.REFUSED,)
        return (OutcomeKind.ABORTED,) if label in LASTING else GOOD


WHOLE = Part(
    "A satellite with an old module behind a door and two bolts, the new module in a rack, two arms",
    CELL,
    [f"C{n}" for n in range(1, 41) if f"C{n}" not in TESTS],
    STRIPPED,
    at_once=("C5 C6 C7 C8 C9", "C21 C22 C23 C24"),
    frame_s=3.0,
)
PARTS = {
    "insertion": Part(
        "The bay is open and empty: both arms carry the new module there; it is inserted, and the door closed",
        HALFWAY,
        ["C4", "C22", "C24", "C25", "C26", "C27", "C28", "C29", "C30", "C35", "C36", "C37", "C38", "C39"],
        HALTED,
        after={"C36": "C39", "C39": "C30"},  # the right arm stands before the door, and does not take the driver
        at_once=("C35 C39",),
    ),
}


def run(console: Console, speed: str = "1", out: Path = Path("out"), *, test: bool = False, part: str = "") -> bool:
    """Run the demo; True if every check passed. Writes pictures and a film to `out`; ends all processes.

    `test`: all lines on paper first. `part`: name of a part."""
    narrator = Narrator(console)
    show(narrator, part or "swapout", PARTS[part] if part else WHOLE, speed, out, test)
    return narrator.passed()


def show(narrator: Narrator, name: str, part: Part, speed: str, out: Path, test: bool = False) -> None:
    """Perform a part on a cluster of its own, film it, and check it. `name`: of the film."""
    every, cell = planner.read(LINES.read_text()), Cell.load(part.cell)
    narrator.chapter(part.about)
    with Renderer() as renderer, Film(out / f"{name}.gif", cell.name, part.frame_s) as film:
        pictures = DemoPictures(out, renderer, cell.name)
        with own_cluster(cell=cell.name, speed=speed) as run_dir, Client(run_dir) as rtc, film.shooting(run_dir):
            tried = every if part is WHOLE else [line for line in every if line.label in part.lines]
            predicted = on_paper(narrator, rtc, tried) if test else {}
            tested = hypotheses(narrator, rtc, every) if part is WHOLE else {}
            course = perform(narrator, Scene(run_dir, rtc), part, every, pictures, film)
            course.ends |= tested
            lines = [line for line in every if line.label in (*part.lines, *tested)]
            show_tracks(narrator, lines, course, cell)
            show_durations(narrator, lines, course, predicted)
            if part.closed:
                narrator.chapter("The criteria")
                check(narrator, rtc, cell, part, lines, course)
            if part is WHOLE:
                check_surrender(narrator, course)
        film.check(narrator)  # the longer wait, with its progress; the pictures are drawn meanwhile
        pictures.check(narrator)


def perform(
    narrator: Narrator, scene: Scene, part: Part, every: list[Line], pictures: DemoPictures, film: Film
) -> Course:
    """The lines of a part, with the operator's help; at one of them something goes wrong."""
    cell, event = Cell.load(part.cell), part.event
    operator = ScriptedOperator(scene.run_dir, cell)
    task = [line for line in every if line.label not in TESTS]
    needed = planner.among(part.lines, planner.waits(task, cell, {**AFTER, **part.after}))
    lines = [line for line in task if line.label in part.lines]
    if event.text:
        lines = [line._replace(text=event.text) if line.label == event.at else line for line in lines]
    captions = Captions(cell)

    def begun(line: Line) -> None:
        narrator.line(f"{line.label:>4}  {line.text}", "dim")
        film.caption = captions.begins(line)
        event.begins(scene, line)
        if line.label in DIALOGUES:
            operator.begin(line.label)

    def ended(line: Line, end: m.CommandEnded) -> bool:
        kind = end.outcome.kind
        film.caption = captions.ends(line)
        narrator.line(f"{line.label:>4}  {end.command} {kind.value} after {end.took_s:.1f} s  {end.outcome.message}")
        if line.label in PICTURES and part.closed:
            title = f"{line.label} {LEFT_OUT.sub('', line.text)}: {kind.value}"
            pictures.take(PICTURES[line.label], scene.rtc.truth(), VIEW, title)
        if line.label in DIALOGUES:
            check_dialogue(narrator, line.label, operator.end(line.label))
        wanted = part.wanted(line.label)
        if line.label == event.at or kind not in wanted:
            words = " or ".join(one.value for one in wanted)
            narrator.check(f"{line.label} ended {kind.value}, wanted {words}", kind in wanted)
        if kind not in wanted:
            for link in commands.why(scene.rtc.trace(end.command)):
                narrator.line(link, "dim")
        if line.label == event.at and kind in wanted:
            film.caption = f"{event.about};\nhow it is taken"
            event.check(narrator, scene, giving.course)
        return kind in wanted

    narrator.line(f"in this run: {event.about}; cell {cell.name}, lines {' '.join(part.lines)}")
    narrator.chapter("The lines; each is given as soon as those it depends on have ended")
    giving = planner.Planner(
        scene.rtc, needed, LASTING, begun, lambda line, note: event.notes(scene, line, note), ended
    )
    return giving.perform(lines, IDLE_S)


class Captions:
    """The text below the film: what each arm is commanded to do."""

    def __init__(self, cell: Cell) -> None:
        self._words = words_of(cell)
        self._lines = dict.fromkeys(sorted(self._words), Line("", ""))

    def begins(self, line: Line) -> str:
        return self._show(line, line)

    def ends(self, line: Line) -> str:
        return self._show(line, Line("", ""))

    def _show(self, of: Line, now: Line) -> str:
        self._lines |= {arm: now for arm, words in self._words.items() if any(word in of.text for word in words)}
        return "\n".join(f"{arm}  {line.label} {LEFT_OUT.sub('', line.text)}" for arm, line in self._lines.items())


def words_of(cell: Cell) -> dict[str, tuple[str, ...]]:
    """The words with which a line names each arm."""
    return {arm.name: (arm.name, arm.end_effector, BOTH_ARMS) for arm in cell.arms}


def on_paper(narrator: Narrator, rtc: Client, every: list[Line]) -> dict[str, list[RehearsedStep]]:
    """All lines on paper, each after those before it: nothing moves, and nothing is written.

    Returns the predicted steps of the feasible ones, by label."""
    narrator.chapter("The lines on paper")
    before, truth = rtc.world.view(), rtc.truth()
    labels = [line.label.replace("C", "C-") for line in every]  # as the sentences name them
    ends = rtc.test([line.text for line in every], labels, keep_going=True)
    for line, end in zip(every, ends, strict=True):
        narrator.line(f"{line.label:>4}  {end.outcome.kind.value}  {end.outcome.message[:120]}", "dim")
    after = rtc.world.view()
    still = (rtc.truth().joints, rtc.truth().poses) == (truth.joints, truth.poses)
    narrator.check(f"{len(ends)} lines tested; no arm has moved", still)
    narrator.check("the world database is as before", (after.version, after.facts) == (before.version, before.facts))
    return {
        line.label: end.outcome.rehearsal.steps
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
    bodies = set(refusal.cause.owners) if refusal and isinstance(refusal.cause, Collides) else set()
    narrator.check(f"C1: {found['C1'].outcome.message}", bodies == {"LEFT-ARM", "DOOR-2"})
    feasible = {label for label, end in found.items() if end.outcome.kind is OutcomeKind.SUCCEEDED}
    narrator.check("C2, and all that leads to it, is feasible", feasible == set(HYPOTHESIS) - {"C1"})
    moved = [event.command for event in ends if any(note.node == "MCM" for note in rtc.trace(event.command).notes)]
    narrator.check(f"sent to an arm: {', '.join(moved) or 'nothing'}", not moved)
    return {label: found[label] for label in TESTS}


def show_durations(
    narrator: Narrator, lines: list[Line], course: Course, predicted: Mapping[str, list[RehearsedStep]]
) -> None:
    """Predicted on paper before the task, beside what the steps took: simulated seconds.

    A step that ends at a touch ends where the body is, which no prediction knows; so both sums are shown without such
    steps too. A way around obstacles is searched anew when its line is performed: it may be another one."""
    if not predicted:
        return
    narrator.chapter("Durations in s: predicted before the task, measured; both again for steps that end at their goal")
    every: list[tuple[str, AtGoal]] = []
    for line in lines:
        ahead, took = predicted.get(line.label, []), course.measured.get(line.label, [])
        if not took or not ahead:
            continue
        known = at_goals(ahead, took)
        every += [(line.label, one) for one in known]
        sums = [sum(step.predicted_s for step in ahead), sum(took_s for _, took_s in took)]
        sums += [sum(one.predicted_s for one in known), sum(one.measured_s for one in known)]
        narrator.line(f"{line.label:>4} {''.join(f'{one:7.1f}' for one in sums)}  {LEFT_OUT.sub('', line.text)}", "dim")
    off = [(label, one) for label, one in every if one.off]
    narrator.line(f"of {len(every)} steps that end at their goal {len(off)} differ by more than 0.1 s and 5 %")
    for label, one in off:
        narrator.line(f"{label:>4} {one.predicted_s:7.1f}{one.measured_s:7.1f}  {one.label}", "dim")


class AtGoal(NamedTuple):
    """A step that ended at its goal."""

    label: str
    predicted_s: float
    measured_s: float

    @property
    def off(self) -> bool:
        return abs(self.measured_s - self.predicted_s) > max(OFF_S, OFF_SHARE * self.predicted_s)


def at_goals(ahead: list[RehearsedStep], took: list[tuple[str, float]]) -> list[AtGoal]:
    """The steps that were predicted to end at their goal, as first performed. `took`: (words of the step, s)."""
    first = dict(reversed(took))
    return [
        AtGoal(step.label, step.predicted_s, first[step.label])
        for step in ahead
        if step.reason == StopReason.GOAL.value and step.predicted_s and step.label in first
    ]


def show_tracks(narrator: Narrator, lines: list[Line], course: Course, cell: Cell) -> None:
    """One row of time per arm, and one for the cameras: the lines in execution."""
    narrator.chapter(f"The time line: {course.now_s:.0f} s; of each line its number, where there is room")
    scale = COLUMNS / max(course.now_s, 1.0)
    for name, words in {**words_of(cell), "cameras": ("VIA CAMERA",)}.items():
        mine = [line.label for line in lines if any(word in line.text for word in words)]
        spans = {label: course.executing[label] for label in mine if label in course.executing}
        narrator.line(f"{name:>9} |{track(spans, scale)}|")


def track(spans: dict[str, list[float]], scale: float) -> str:
    """A row of COLUMNS characters: each span (s) with its number, if the next one leaves room for it."""
    row = [" "] * COLUMNS
    columns = [[min(COLUMNS - 1, int(scale * at)) for at in span] for span in spans.values()]
    for first, last in columns:
        row[first : last + 1] = "-" * (last + 1 - first)
    starts = [*sorted(first for first, _ in columns), COLUMNS + 1]
    for label, (first, _) in zip(spans, columns, strict=True):
        room = next(start for start in starts if start > first) - 1 - first
        number = label[1:] if len(label[1:]) <= room else "'"
        row[first : first + len(number)] = number
    return "".join(row)


def check_dialogue(narrator: Narrator, label: str, acts: Sequence[Act]) -> None:
    """The operator has erred and was refused; what was proved was believed."""
    for what, why in acts:
        narrator.line(f"{label:>4}  operator {what}{f': refused, {why}' if why else ''}", "dim")
    refused = [what for what, why in acts if why]
    ended = bool(acts) and acts[-1] == Act("DONE", "")
    narrator.check(
        f"{label}: refused {', '.join(refused) or 'nothing'}; the last DONE is believed", ended and "DONE" in refused
    )
    if label == "C13":
        narrator.check("C13: the operator may not close the fingers", "closes the hand" in refused)


def check_surrender(narrator: Narrator, course: Course) -> None:
    """The failure of C12 names the sentence of C13."""
    refusal = course.ends[SLIPS].outcome.refusal if SLIPS in course.ends else None
    offered = refusal.by_operator if refusal is not None else ""
    narrator.check(
        f"{SLIPS} has failed and offers: {offered or 'nothing'}", bool(offered) and offered == course.texts.get("C13")
    )


def check(narrator: Narrator, rtc: Client, cell: Cell, part: Part, lines: list[Line], course: Course) -> None:
    """The end of the task. `lines`: those of the part, and the tests."""
    truth = rtc.truth()
    wrong = [line.label for line in lines if line.label not in course.ends]
    wrong += [label for label, end in course.ends.items() if end.outcome.kind not in part.wanted(label)]
    narrator.check(f"{len(course.ends)} of {len(lines)} lines ended as they should; not: {wrong or 'none'}", not wrong)
    check_goal(narrator, cell, truth)
    check_beliefs(narrator, rtc, cell, truth)
    check_alone(narrator, lines, course, cell)
    for labels in part.at_once:
        most = course.together(labels.split())
        narrator.check(f"of {labels.replace(' ', ', ')}: {most} in execution at once", most >= 2)


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
    """The new module in the bay, the old one in the rack, its bolts tight, the door closed: in truth."""
    for module, seat, most_m in (("MACS-NEW", "BAY-2", SEATED_M), ("MACS-OLD", "RACK-2", STORED_M)):
        place = cell.seated_pose(seat)
        off_m = geometry.distance(truth.poses[module], place)
        off_deg = math.degrees(geometry.angle(truth.poses[module], place))
        what = f"{module} is {1e3 * off_m:.1f} mm and {off_deg:.2f} deg from its place in {seat}"
        narrator.check(what, off_m <= most_m and off_deg <= SEATED_DEG)
    for bolt in cell.seat("BAY-2").bolts:
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
