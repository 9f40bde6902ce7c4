"""The choice of a trim: the program names who chooses, in order; the first answer is followed (R86, R145). Pure.

`stack` takes the first entry of the step, as in the paper. `rules` and `search` read tables of the program
(`rtc.programs.recovery`). Other names are trimmers of installed packages. An answer counts only if its entries are on
offer: they fit the failure, and this step has not used them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.programs import expressions
from rtc.programs.compatibility import row_of
from rtc.programs.recovery import RESERVE, RULES, SEARCH, STACK, Failure, Offers, matching, searched
from rtc.programs.schema import Bounds
from rtc.protocol.messages import TrimOffer
from rtc.protocol.outcomes import StopReason
from workers.conditions import reflexes
from workers.tasks.analyze_task import AnalyzeTask

NAMELESS = TrimOffer(skill="")  # an entry of the sentence (AND TRY)


def chosen(task: AnalyzeTask, reason: StopReason, failure: str) -> tuple[list[int], str]:
    """The entries that may correct this failure; no entries if none can. And words about the choice, if it was not
    that of the stack: who has chosen, and which trimmers of packages have failed."""
    offers = _offers(task, reason)
    failed = Failure(row_of(task.step), reason, failure)
    words = ""
    for name in task.program.trimmers:
        try:
            entries = BUILT_IN[name](task, failed, offers) if name in BUILT_IN else _of_package(name, task, offers)
        except PluginError as error:
            words += f"; {error}"
            continue
        if entries and {*entries} <= offers.keys():
            return entries, words if name == STACK else f"{words}; chosen by {name}"
    return [], words


def _offers(task: AnalyzeTask, reason: StopReason) -> dict[int, TrimOffer]:
    asked = reflexes.find_requested(task.context.reflexes, task.report)
    if asked is not None and not asked.trim:  # the sentence stops here, and names nothing to try
        return {}
    used, fits = task.data.trims_used, task.context.fits
    entries = [entry for entry in task.step.trims if entry not in used and reason in fits.get(entry, [reason])]
    return {entry: task.context.offers.get(entry, NAMELESS) for entry in entries}


def _first_of_stack(_: AnalyzeTask, __: Failure, offers: Offers) -> list[int]:
    return [entry for entry in offers if entry <= RESERVE][:1]


def _by_rules(task: AnalyzeTask, failed: Failure, offers: Offers) -> list[int]:
    figures = failure_figures(task)
    rules = matching(task.program, failed, offers)
    return next(([entry] for rule, entry in rules if all(_holds(one, figures) for one in rule.when)), [])


def failure_figures(task: AnalyzeTask) -> dict[str, float]:
    """The figures of the conditions of a rule; the names are `extension_names.FAILURE_FIGURES`."""
    report = task.report
    measured = {"measured": report.measured or 0.0, "limit": report.limit or 0.0, "tried": len(task.data.trims_used)}
    measured |= {"force_n": report.peak_force_n, "torque_nm": report.peak_torque_nm, "took_s": report.duration_s}
    return {**task.values, **measured, "hand_width_m": report.hand_width_m, "hand_force_n": report.hand_force_n}


def _holds(condition: Bounds, figures: dict[str, float]) -> bool:
    value = expressions.number(condition.of, figures)
    least = condition.at_least is None or value >= expressions.number(condition.at_least, figures)
    return least and (condition.at_most is None or value <= expressions.number(condition.at_most, figures))


def _by_search(task: AnalyzeTask, failed: Failure, offers: Offers) -> list[int]:
    return searched(task.program.search, failed.reason, offers)


def _of_package(name: str, task: AnalyzeTask, offers: Offers) -> list[int]:
    if not offers:
        return []
    with registry.guarded(registry.TRIMMERS, name):
        entry = registry.installed(registry.TRIMMERS)[name](task.data, list(offers))
        return [] if entry is None else [operator.index(entry)]


BUILT_IN: dict[str, Callable[[AnalyzeTask, Failure, Offers], list[int]]] = {
    STACK: _first_of_stack,
    RULES: _by_rules,
    SEARCH: _by_search,
}
