"""What to do if cameras do not see a body, or see it elsewhere. Pure."""

from __future__ import annotations

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import Advice, Alternative, fill_in
from rtc.protocol.messages import LookStep, WorldChange
from workers.mechanisms.mechanism import About
from workers.planning import in_seat, trust
from workers.planning.lines_of_sight import hiders
from workers.tasks.analyze_task import AnalyzeTask

FAR = [0.0, 0.0, -1000.0, 0.0, 0.0, 0.0, 1.0]  # pose of what is before nothing


def unseen(task: AnalyzeTask, about: About) -> Advice:
    """Of a body that is covered, what uncovers it. Mounted on another body, it is where that is. In a hand, the fingers
    tell whether it is there."""
    query, clears, body = task.query, task.program.clears, task.evaluation.body
    if body and (cover := _uncovered(task, body, about)):
        return cover
    carrier = query.bodies.get(body) if task.report.sighting is None else None  # else it is where it is believed
    if carrier and query.world.get(f"{carrier}.sighting") is None and query.cameras(carrier):
        return fill_in(clears.get("carrier", []), {"carrier": carrier})  # no camera has looked for it
    if not body or not query.held_by(body):
        return []
    return trust.remedy(query, f"{body}.grasp", {"grasp": clears.get("unseen_in_hand", [])})


def _uncovered(task: AnalyzeTask, body: str, about: About) -> Advice:
    """How to take away what is before a body, if a camera then sees it: a door is opened, an arm goes away."""
    query, clears = task.query, task.program.clears
    cameras = task.step.cameras if isinstance(task.step, LookStep) else []
    if query.held_by(body):
        return []
    for name in hiders(query, cameras, body)[1]:
        door = any(thing.name == name and thing.hinge is not None for thing in query.cell.objects)
        if door:
            gone = WorldChange(key=f"{name}.frame", value=FAR)
            row = "before_it" if query.held_by(name) else "closed"
        elif name in query.model.arms and not query.holding(name):
            gone = WorldChange(key=f"{name}.joints", value=list(query.cell.arm(name).home_rad))
            row = "arm_before_it"
        else:
            continue
        if hiders(query.after([gone]), cameras, body)[0]:
            return fill_in(clears.get(row, []), {**about(query, name), "before": name})
    return []


def out_first(task: AnalyzeTask) -> Advice:
    """Sentences before a body can go elsewhere: a hand takes it, or a second hand lets go of it, or it leaves the slot
    that it is still in. Empty if none is needed."""
    query, body, sighting = task.query, task.evaluation.body, task.report.sighting
    arm, sentences = query.held_by(body) if body else "", list[str]()
    if arm and query.hinge(body) is None:
        if sharing := query.sharers(arm):
            sentences = [f"RELEASE {body} WITH {hand_in_words(sharing[0])}"]
        elif seat := query.slot_at(query.frame(body)):
            sentences = [in_seat.way_out_in_words(query, arm, seat)]
    elif not arm and sighting is not None:
        slot = query.slot_at(sighting.pose)
        out = [in_seat.way_out_in_words(query, "", slot, sighting.pose, thing=body)] if slot else []
        sentences = [f"GRASP {body}", *out]
    return [Alternative(sentences=sentences)]


def found_at(task: AnalyzeTask) -> list[str]:
    """The sentence that checks a body where it was seen, which is not the seat of the sentence. Empty if no hand and no
    seat has it, or if it was believed to be elsewhere."""
    query, body = task.query, task.evaluation.body
    place = hand_in_words(query.held_by(body)) or query.seat(body) if body and task.seen_as_believed else ""
    return [f"VERIFY {body} AT {place}"] if place else []
