"""The names that programs may use for code: what the workers have registered under each, so that a program which asks
for anything else is refused when it is loaded, not when somebody needs it.

The code itself is in `workers`; a test holds every registry against its row here. Pure data.
"""

from __future__ import annotations

from collections.abc import Iterable

from rtc.cell import Numbers

#: elaborator: what a script may need of the world
NEEDS = ("hand_empty", "object_free", "object_held", "object_seated", "seat_free", "width_known")
#: elaborator: where a plan may start
STARTS = ("grasp_point", "destination", "stow", "seat")
#: directions; WAY-OUT is that of the target seat, for plans alone
AXES = ("TOOL-X", "TOOL-Y", "TOOL-Z", "X", "Y", "Z", "UP", "DOWN", "LEFT", "RIGHT", "FORWARD", "BACK")
PLAN_AXES = (*AXES, "WAY-OUT")
#: the fourth column of a script
SPACES = ("move_joint", "move_task")
#: elaborator: figures that are no row of the command-object table: the cell's, the hand's, and what a sentence says
FIGURES = (
    *Numbers.__struct_fields__,
    *("opening_m", "hand_width_m", "grasp_width_m", "mass_kg", "duration_s", "seat_depth_m", "detent_n"),
    *("unsure_x_m", "unsure_y_m", "unsure_z_m", "unsure_rad"),  # of the grasp point, in the axes of the tool there
    *(f"{said}_{unit}" for said in ("amount", "by", "to") for unit in ("m", "rad", "turns", "s", "n")),
)
#: what stands for somebody in the resources of a script
ROLES = ("active_arm", "active_object", "its_seat", "target")
#: what may stand in braces in the words of a script; the last two in those of SET
PLACEHOLDERS = (
    *("arm", "object", "point", "target", "destination", "axis", "out", "way_out", "amount", "time"),
    *("attribute", "value"),
)
#: the same in what an analyzer says of a failure
FAILURE_PLACEHOLDERS = (
    *("reason", "measured", "limit", "unit", "message", "arm", "object", "point", "target"),
    *("width", "wanted", "off"),
)
#: words of a step that act
WORDS = ("axis", "effect", "missed", "needs", "seat")
#: figures of a step that are no value of the binder's program
ARGS = (
    *("by_m", "by_rad", "width_m", "least_m", "most_m", "grip_n", "duration_s", "within_m"),
    *("speed_m_s", "force_n", "contact_n", "torque_nm"),
    *("beyond_m", "felt_m", "lever_m", "aside_m", "pad_m", "centre_n_m", "play_m"),  # of what is felt
    *("needs_m", "needs_rad"),  # how well known must be what is held
)
#: who performs steps
PERFORMERS = ("active_arm",)
#: binder: how a step becomes a primitive
ACTIONS = ("motion", "hand", "still", "assign", "told", "procedure")
PROCEDURES = ("open_hand", "lay_down_plan")
#: binder: the conditions of F
PREDICATES = (
    "goal-reached",
    "time-above",
    "force-above",
    "torque-above",
    "speed-above",
    "following-error-above",
    "joint-margin-below",
    "body-touch",
    "grip-force-below",
    "hand-width-below",
)
#: analyzer: what success has changed, and what of a report may be kept
EFFECTS = ("taken", "let_go", "let_drift", "still_held", "verified", "felt", "pinched", "passed", "landed")
KEPT = ("report.trip_pose", "report.pose", "report.hand_width")


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """No such name, and which there are."""
    return f"no {what} {name}; there are {', '.join(sorted(known))}"
