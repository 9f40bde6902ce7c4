"""Extension names: the names by which programs refer to code of the workers. Pure data.

A program with any other name is refused when it is loaded. The code itself is in `workers`; a test compares each
registry with its row here.
"""

from __future__ import annotations

from rtc.model.cells.parts import Numbers

#: elaborator: conditions of the world that a script may require
NEEDS = (
    *("hand_empty", "object_free", "other_handle", "object_held", "object_seated", "object_hinged"),
    *("seat_free", "width_known", "partner_empty", "object_in_target", "driver_held", "plug_fits", "in_socket"),
)
#: elaborator: anchors of plan lines
ANCHORS = ("grasp_point", "destination", "stow", "seat", "hinge", "meeting", "here", "bolt", "bolt_out")
#: Directions. WAY_OUT is the exit direction of a seat. In a line of a plan it is that of the target; in a line from
#: HERE it is that of the seat that the object is in, or UP if it is in none.
AXES = ("TOOL-X", "TOOL-Y", "TOOL-Z", "X", "Y", "Z", "UP", "DOWN", "LEFT", "RIGHT", "FORWARD", "BACK")
WAY_OUT = "WAY-OUT"
PLAN_AXES = (*AXES, WAY_OUT)
#: values of the column `space` of a script
SPACES = ("move_joint", "move_task", "move_both", "move_circle", "move_spiral", "move_raster")
#: elaborator: parameters from outside the command-object table: of the cell, the hand and the sentence
FIGURES = (
    *Numbers.__struct_fields__,
    *("opening_m", "max_grip_n", "hand_width_m", "grasp_width_m", "mass_kg", "duration_s", "seat_depth_m", "detent_n"),
    "hinged",  # 1: the object has a hinge; 0: it has none
    "held_elsewhere",  # 1: another hand holds the object; 0: none does
    "shared",  # 1: the second arm of the command holds the object too; 0: it does not, or there is none
    "meets",  # 1: the candidate has a place where both arms meet; 0: they meet where the object is
    "slot_m",  # way out until the object is free of the slot that it is in; 0: it is in none
    "has_spindle",  # 1: the object has a spindle: it is a driver; 0: it has none
    "threaded",  # 1: the object has a thread; 0: it has none
    *("out_turns", "thread_turns"),  # by how many turns a bolt is out, and by how many it is loose
    "thread_m",  # length of its thread
    *("contacts_m", "holds_n"),  # where a plug meets the contacts of its socket, and what its latch bears
    *("hinge_rad", "hinge_least_rad", "hinge_most_rad"),  # its angle, and its stops
    "hinge_lever_m",  # from the hinge to the grasp point in the hand
    "hinge_push",  # sign of the turn with which that point moves away from the hand
    "held_unsure_m",  # how far any point of the object for the target may be from its believed place
    *("unsure_x_m", "unsure_y_m", "unsure_z_m", "unsure_rad"),  # spread of the grasp point, in tool axes at that point
    "seen",  # 1: a camera can see the object, and the last look has found it; 0: it must be felt
    *(f"{clause}_{unit}" for clause in ("amount", "by", "to") for unit in ("m", "rad", "turns", "s", "n")),
)
HAND_LIMITS = ("opening_m", "max_grip_n")  # those of them that may limit others
#: roles that the resources of a script may name
ROLES = (
    *("active_arm", "partner_arm", "active_object", "its_seat", "target", "camera", "its_holder"),
    "its_content",  # of a seat
    "its_parts",  # what is mounted on a body, and what is in seats there
)
#: placeholders (in braces) in the texts of a script; `camera` and `body` are for steps that look; the last two are for
#: SET only
PLACEHOLDERS = (
    *("arm", "object", "point", "target", "destination", "axis", "out", "way_out", "amount", "time", "through"),
    *("meeting", "until", "shared", "around"),
    *("camera", "body"),
    *("attribute", "value"),
)
#: placeholders in the failure texts of the analyzer
FAILURE_PLACEHOLDERS = (
    *("reason", "measured", "limit", "unit", "message", "arm", "object", "point", "target"),
    *("width", "wanted", "off", "or_load", "or_mass", "excess", "grip", "speed", "short", "jam"),
    *("camera", "turned", "progress", "until", "mated"),
)
#: performers of steps
CAMERA = "camera"
PARTNER = "partner_arm"
PERFORMERS = ("active_arm", PARTNER, CAMERA)
#: binder: algorithms of steps `proc`
PROCEDURES = ("open_hand", "grasp_plan")
#: binder: predicates of F
PREDICATES = (
    "goal-reached",
    "time-above",
    "force-above",
    "torque-above",
    "torque-below",
    "speed-above",
    "following-error-above",
    "joint-margin-below",
    "body-touch",
    "grip-force-below",
    "hand-width-below",
    "no-progress",
    "turn-above",
    "unseen-above",
)
#: analyzer: figures of a failed step in the conditions of `rules`, besides `values`
FAILURE_FIGURES = (*("measured", "limit", "tried", "force_n", "torque_nm", "took_s", "hand_width_m", "hand_force_n"),)
#: analyzer: values of a report that a step may keep
KEPT_VALUES = ("report.trip_pose", "report.pose", "report.hand_width")
