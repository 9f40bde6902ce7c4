"""The kinds of steps of a script, and what each of them reads. Pure.

The columns, words and figures of a kind are the fields of its type (`rtc.protocol.messages.step`). Figures that the
type does not have stand for values of the binder's program, the stop class or the cell: those that a step reads are
those of its stop rows and the ones named here. A test compares these names with the code of the workers.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, cast, get_args

import msgspec

from rtc.programs import expressions, words_of_packages
from rtc.programs.extension_names import CAMERA
from rtc.programs.schema import BinderProgram, ScriptStep, StopRow
from rtc.protocol import messages as m
from rtc.protocol.messages import ArmStep, BaseStep, HandStep, LookStep, PathStep, Step
from rtc.protocol.spelling import unknown

Problems = Iterator[tuple[str, str]]  # place, problem

#: `do` of a step -> its kind; of a path and of the operator's steps the kind depends on other columns
KINDS: dict[str, type[BaseStep]] = {str(kind.__struct_config__.tag): kind for kind in get_args(Step)}
CURVES: dict[str, type[BaseStep]] = {
    "move_circle": m.CircleStep,
    "move_spiral": m.PatternStep,
    "move_raster": m.PatternStep,
}
CHOSEN = ("circle", "pattern", "share", "installed")  # no `do` of a script
DOES = tuple(name for name in KINDS if name not in CHOSEN)
#: columns of a script that not every kind of step has
COLUMNS = ("to", "stop", "space", "value", "op", "name")
#: fields that the elaborator writes
WRITTEN = (
    "way",
    "cameras",
    "body",
    "overrides",
    "extra",
    "label",
    "who",
    "arm",
    "expect",
    "keep",
    "trims",
    "action",
    *COLUMNS,
)

#: word -> its values
CHOICES = {"until": ("ends", "watched"), "operator_has": ("hand", "spindle"), "leaves": ("seat",)}
#: effect of success, or of a failure (`missed`) -> the kinds of steps that can have it
EFFECTS: dict[str, tuple[type[BaseStep], ...]] = {
    **dict.fromkeys(("felt", "tilted", "passed", "landed"), (m.MoveStep,)),
    **dict.fromkeys(("taken", "pinched", "let_go", "let_drift"), (HandStep,)),
    **dict.fromkeys(("still_held", "verified"), (ArmStep,)),
    **dict.fromkeys(("sighted", "unseen"), (LookStep,)),
    **dict.fromkeys(("turned", "tightened", "free"), (m.TurnStep, m.OperateStep)),
    **dict.fromkeys(("head_felt", "clicked", "latched", "demated"), (m.MoveStep,)),
    "handed": (m.HandOverStep,),
    "pointed": (m.OperateStep,),
}
#: figure -> the effects that read it
OF_EFFECTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("felt_m", "lever_m"), ("felt",)),
    **dict.fromkeys(("apart_m", "tilt_m"), ("tilted",)),
    "aside_m": ("passed", "landed"),
    **dict.fromkeys(("pad_m", "centre_n_m"), ("taken", "pinched")),
    "play_m": ("taken", "sighted"),
    **dict.fromkeys(("seen_m", "seen_rad", "seated_m", "at_rest", "within_rad"), ("sighted",)),
}
#: values that steps of these kinds read, besides those of their stop rows
OF_PRIMITIVES = ("time_factor", "time_margin_s", "report_factor", "report_margin_s")
VALUES: dict[type[BaseStep], tuple[str, ...]] = {
    ArmStep: (
        *OF_PRIMITIVES,
        *("speed_m_s", "force_n", "torque_nm", "contact_n", "feel_force_n", "lost_contact_n", "slip_n", "lost_m"),
        *("jam_m", "jam_n", "back_off_m", "joint_margin_rad", "fast_factor", "fast_m_s", "squeeze_factor"),
        *("squeeze_n", "range_margin_m", "turned_rad", "turn_m", "spring_factor", "laden_wn_rad_s", "press_m_s"),
        *("met_share", "slowest_m_s", "kept_factor", "impact_s", "least_kg"),
    ),
    PathStep: (
        *("settle_s", "laden_settle_s", "blend_s", "touch_s", "unload_s", "acceleration_m_s2"),
        *("laden_acceleration_m_s2", "joint_margin_deg", "partner_n_m"),
    ),
    m.SharedStep: ("turn_rad_s", "near_m", "duration_s"),
    HandStep: ("hand_n", "force_s_n", "free_s", "hand_settle_s", "hand_within_s"),
    m.OperateStep: ("turn_rad_s", "near_m", "duration_s", "reach_m", "spindle_rad_s"),
    m.TurnStep: ("spindle_rad_s", "felt_nm", "joint_margin_deg", "acceleration_m_s2", "laden_acceleration_m_s2"),
    LookStep: (*OF_PRIMITIVES, "picture_s", "window_s", "start_s", "every_s", "most_every_s"),
}


def kind_of(step: ScriptStep) -> type[BaseStep] | None:
    """The kind of a step of a script; None if no code performs it."""
    if step.do == "move":
        return CURVES.get(step.space, m.MoveStep)
    if step.do == "operate" and step.to:
        return m.SharedStep
    if words_of_packages.added(step.do):
        return m.InstalledStep
    return KINDS[step.do] if step.do in DOES else None


def step_of(step: ScriptStep, **fields: Any) -> Step:
    """The step of this kind, with the columns of the script and these fields."""
    kind = kind_of(step)
    assert kind is not None, step.do  # others were refused
    columns = {name: getattr(step, name) for name in COLUMNS if name in kind.__struct_fields__}
    if kind is m.InstalledStep:
        columns["action"] = step.do
    return cast(Step, kind(**columns, **fields))


def figures_of(kind: type[BaseStep]) -> set[str]:
    """The figures that a kind of step has of its own."""
    return {field.name for field in msgspec.structs.fields(kind) if field.type in (float, float | None)}


def words_of(kind: type[BaseStep]) -> set[str]:
    """The words that act on a kind of step."""
    return {f.name for f in msgspec.structs.fields(kind) if f.type in (str, list[str]) and f.name not in WRITTEN}


def values_of(kind: type[BaseStep], rows: Collection[StopRow]) -> set[str]:
    """The values that a script may replace for a kind of step with these stop rows."""
    named = {name for base in kind.__mro__ for name in VALUES.get(base, ())}
    of_rows = {name for row in rows if row.limit is not None for name in expressions.names(row.limit)}
    return named | of_rows - {"held_width_m", "time_limit_s"}  # which are measured, or follow from the step


def stop_rows(step: ScriptStep, kind: type[BaseStep], binder: BinderProgram) -> list[StopRow]:
    """F of a step: the rows of its stop class, or of that of its hand."""
    of_hand = step.op if kind is m.GripStep else "open" if kind is m.ProcedureStep else ""
    found = binder.stop_classes.get(binder.hand.get(of_hand, "") if of_hand else step.stop)
    return [*(found.stops if found else ()), *(binder.holding if issubclass(kind, ArmStep) else ())]


def problems(step: ScriptStep, place: str) -> Problems:
    """The columns and words of a step that its kind does not read, and those that it lacks."""
    kind = kind_of(step)
    if kind is None:
        yield f"{place}.do", unknown("action", step.do, DOES) + words_of_packages.why_unknown(step.do)
        return
    what, fields = f"{step.do} {step.space}".strip(), msgspec.structs.fields(kind)
    names = {field.name for field in fields}
    for column in COLUMNS:
        if getattr(step, column) and column not in names:
            yield f"{place}.{column}", f"a step {what} does not read {column}: leave it out"
    for word in step.words:
        if word not in words_of(kind):
            yield f"{place}.words.{word}", unknown("word that acts", word, words_of(kind))
        elif step.words[word] not in CHOICES.get(word, (step.words[word],)):
            yield f"{place}.words.{word}", unknown(f"value of {word}", step.words[word], CHOICES[word])
    for name in (field.name for field in fields if field.required and field.name not in ("label", "action")):
        if not (getattr(step, name, None) or name in step.words or name in step.args):
            yield place, f"a step {what} needs {name}"
    if (step.who == CAMERA) is not (kind is LookStep):
        yield f"{place}.who", f"{step.who} does not perform {what}; a {CAMERA} performs look, and nothing else"
    yield from _of_effects(step, kind, place)
    yield from ((f"{place}{part}", problem) for part, problem in _together(step, kind))


def _together(step: ScriptStep, kind: type[BaseStep]) -> Problems:
    """What a step states, or lacks, beside something else that it states: (part of the step, problem)."""
    args, words = step.args, step.words
    if kind is LookStep:
        for name in ("within_m", "within_rad"):
            if name in args and "seat" not in words:
                yield f".args.{name}", f"{name} is of a seat, which `words` does not name"
        if "duration_s" in args and "pictures" in args:
            yield ".args.pictures", "a look that lasts duration_s takes pictures all the time"
    if kind is m.TurnStep and ("by_turns" in args) is ("to_turns" in args):
        yield "", "a step turn needs by_turns or to_turns, and not both"
    if kind is m.SharedStep and "within_m" not in args:
        yield "", "a path that the operator shares needs within_m"
    if kind is m.OperateStep:
        read = {"hand": ("grip_n", "least_m", "most_m"), "spindle": ("by_turns",)}
        has = words.get("operator_has", "")
        for name in ("by_turns", "grip_n", "least_m", "most_m", "width_m"):
            if name in args and name not in read.get(has, ()):
                yield f".args.{name}", f"{name} has no effect where the operator has {has or 'the arm alone'}"
        yield from (("", f"{has} needs {name}") for name in read.get(has, ()) if name not in args)


def _of_effects(step: ScriptStep, kind: type[BaseStep], place: str) -> Problems:
    """Effects that a step cannot have, and figures of effects that it does not have."""
    effects = {word: step.words[word] for word in ("effect", "missed") if step.words.get(word)}
    for word, effect in effects.items():
        if words_of_packages.added(effect):
            continue
        if effect not in EFFECTS:
            problem = unknown("effect", effect, EFFECTS) + words_of_packages.why_unknown(effect)
            yield f"{place}.words.{word}", problem
        elif not issubclass(kind, EFFECTS[effect]):
            known = [name for name, kinds in EFFECTS.items() if issubclass(kind, kinds)]
            yield f"{place}.words.{word}", unknown("effect", effect, known)
    for name in step.args:
        if name in OF_EFFECTS and not {*OF_EFFECTS[name]} & {*effects.values()}:
            yield f"{place}.args.{name}", f"{name} is read by the effect {' or '.join(OF_EFFECTS[name])} alone"
