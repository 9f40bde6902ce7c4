"""One candidate for performing a command: arm or camera, object, grasp point, target, and figures. Pure.

`figures` are the variables of a script's expressions. Sources in order of increasing priority: numbers of the cell, the
command-object table, the hand, the object, the sentence.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import msgspec

from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol.messages import Limits
from rtc.protocol.sentence import ParsedCommand
from rtc.protocol.units import in_words
from workers.planning.world_query import WorldQuery


class AskedTask(NamedTuple):
    """A sentence whose candidates are wanted, in the world as it is."""

    program: ElaboratorProgram
    scripts: Mapping[str, ScriptFile]
    parsed: ParsedCommand
    limits: Limits
    query: WorldQuery

    @property
    def of_verb(self) -> list[ScriptFile]:
        """The scripts of the verb."""
        return [self.scripts[row.script] for row in self.program.branches[self.parsed.verb]]


class TaskCandidate(msgspec.Struct, frozen=True, dict=True):
    query: WorldQuery
    program: ElaboratorProgram
    parsed: ParsedCommand
    limits: Limits
    hand: parts.Arm | None  # None: only a camera works
    thing: parts.Object | None
    point: parts.GraspPoint | None
    target: parts.Seat | None
    figures: dict[str, float]
    via: parts.Camera | None = None  # the camera of a command that only looks
    seat: parts.Seat | None = None  # what that camera looks for, if it is a seat
    partner: parts.Arm | None = None  # the second arm: of BOTH-ARMS, or the one that HANDOFF gives to
    meeting: parts.Place | None = None  # where the second arm takes the object; None: where the object is
    filler: str = ""  # the package that has computed the row of the command-object table; empty: the program states it

    @property
    def arm(self) -> parts.Arm:
        assert self.hand is not None, "a script without an arm needs none"
        return self.hand

    @property
    def body(self) -> str:
        """The object, or the seat that a camera looks for."""
        return self.thing.name if self.thing else self.seat.name if self.seat else ""

    @property
    def between(self) -> parts.GraspPoint | None:
        """The grasp point that the fingers go to, or else the one that they hold; None without one."""
        if self.point is not None or self.thing is None or not self.query.held_by(self.thing.name):
            return self.point
        return self.query.point_in_hand(self.thing.name)

    @cached_property
    def camera(self) -> parts.Camera | None:
        """The camera that looks for the object; None: none can see it."""
        return self.via or (next(iter(self.query.cameras(self.body)), None) if self.body else None)

    @cached_property
    def texts(self) -> dict[str, str]:
        """Values of {arm} and the other placeholders in the words of a script."""
        return {
            "arm": self.hand.name if self.hand else "",
            "object": self.body,
            "camera": self.via.name if self.via else "",
            "point": self.point.name if self.point else "",
            "target": self.target.name if self.target else "",
            "axis": (self.parsed.place.along if self.parsed.place else None) or "TOOL-Z",
            "destination": destination_in_words(self.parsed),
            "shared": self.parsed.shared or "",
            "way_out": self.query.way_out_of(self.target.name) if self.target else "",
            "out": self.query.way_out(self.thing.name) if self.thing else "",
            "amount": _amount_in_words(self.parsed),
            "through": " ".join(self.vias),
            "around": "allowed" if self.parsed.path is None and not self.vias else "",
            "meeting": self.meeting.name if self.meeting else "",
            "until": self.parsed.until.sentence if self.parsed.until else "",
            "time": _time_in_words(self.parsed, self.figures),
        }

    @property
    def vias(self) -> list[str]:
        """Names of the bindings of THROUGH, in order."""
        return [f"VIA-{n}" for n in range(1, len(self.parsed.through) + 1)]

    def fill_in(self, words: str) -> str:
        """Replace the placeholders in `words`."""
        if "{" not in words:
            return words
        for name, text in self.texts.items():
            words = words.replace("{" + name + "}", text)
        return words

    @property
    def roles(self) -> dict[str, str]:
        """Values of active_arm and the other roles in the resources of a script."""
        return {
            "active_arm": self.hand.name if self.hand else "",
            "partner_arm": self.partner.name if self.partner else "",
            "active_object": self.body,
            "camera": self.via.name if self.via else "",
            "target": self.target.name if self.target else "",
        }


def lets_go_first(script: ScriptFile, *, of_object: bool = False) -> bool:
    """Whether the hand of the script opens before the arm moves; `of_object`: and lets go of an object by that."""
    first = next((step for step in script.steps if step.op or step.to), None)
    return first is not None and first.op == "open" and (not of_object or first.words.get("effect") == "let_go")


def _amount_in_words(parsed: ParsedCommand) -> str:
    quantity = parsed.amount or parsed.to_value
    return in_words(quantity.value, quantity.unit) if quantity else ""


def _time_in_words(parsed: ParsedCommand, figures: dict[str, float]) -> str:
    """Duration of a command without an end of its own: for 30 s, or until halted, with the maximum."""
    if parsed.duration_s is not None:
        return f"for {in_words(parsed.duration_s, 's')}"
    limit_s = figures.get("duration_s")
    return "until halted" + (f", {limit_s / 60:g} min at most" if limit_s else "")


def destination_in_words(parsed: ParsedCommand) -> str:
    place = parsed.place
    if place is None:
        return f"before {parsed.target}" if parsed.target else ""
    if place.name:
        return place.name
    if place.joints:
        return "the joint values given"
    if place.position:
        return "x {:.3f} y {:.3f} z {:.3f} m".format(*place.position)
    if place.neighborhood_of:
        return f"the neighborhood of {place.neighborhood_of}"
    return f"the grasp point of {place.grasp_point_of}" if place.grasp_point_of else "a step from here"
