"""Evaluators, trimmers and sensors of installed packages."""

from __future__ import annotations

import select
import time
from types import SimpleNamespace

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.plugins import guard, registry
from rtc.plugins.guard import PluginError
from rtc.programs import loader
from rtc.protocol.outcomes import ProgramError, RefusalReason, StopReason
from rtc.sensing.detector import TagDetector
from rtc.subsystems.perception import sensor_watch
from rtc.subsystems.perception.camera_thread import CameraThread, Exposure, _Order
from tests.plugins.toy_packages import Install
from tests.workers.conftest import bench  # noqa: F401
from workers.analyzer import analyze

PREFERS = "def score(option):\n    return float(option.candidate.point.name != {!r})\n"


@pytest.mark.parametrize("point", ["HANDLE-A", "HANDLE-B"])
def test_an_evaluator_ranks_the_ways_to_do_a_command(install: Install, bench, point: str) -> None:  # noqa: F811
    install(registry.EVALUATORS, "prefers", "score", PREFERS.format(point))
    bench.load("elaborator", "evaluators: [prefers]")
    assert bench.elaborate("GRASP MACS-NEW WITH RIGHT-ARM").context.grasp_point == point


@pytest.mark.parametrize(
    ("chosen", "expected"), [(3, [3]), (9, [2]), (None, [2]), ("__import__('numpy').int64(3)", [3]), ("3.0", [2])]
)
def test_a_named_trimmer_chooses_among_the_trims_of_the_step(install: Install, bench, chosen, expected) -> None:  # noqa: F811
    """Trim 9 is not of this step, so the stack is asked next."""
    install(registry.TRIMMERS, "picks", "choose", f"def choose(data, entries):\n    return {chosen}\n")
    bench.load("analyzer", "trimmers: [picks, stack]")
    bench.subsystem.instead["C-1.5"] = StopReason.FORCE_LIMIT
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").trims[:1] == expected


def test_fields_of_a_package_reach_it(install: Install, bench) -> None:  # noqa: F811
    """Keys x-... of a branch and of a step. Without such a package they are refused."""
    branch = "decision_tree: [{verb: STOW, script: stow, x-wear: 0.5}]"
    step = "skill: wait\nsteps: [{do: hold, stop: hold, label: w, args: {duration_s: 1}, x-calm: [1, 2]}]"
    for text in (branch, step, branch.replace("x-wear", "wear"), "x-wear: 1"):
        with pytest.raises(ProgramError):
            bench.load("elaborator", text)

    wear = "def score(option):\n    option.branch.extra['x-wear']\n    return 0.0\n"
    install(registry.EVALUATORS, "wear", "score", wear)
    install(registry.TRIMMERS, "calm", "choose", "def choose(data, entries):\n    return None\n")
    bench.load("elaborator", f"{branch}\nevaluators: [wear]")
    bench.load("elaborator", step + "\n")
    assert bench.elaborate("STOW RIGHT-ARM").context.script == "stow"  # the evaluator has found its field
    bench.load("elaborator", "script: stow\ncase: 1\nuses: [hand]\nsteps: [{do: piece, name: wait}]")
    assert bench.elaborate("STOW RIGHT-ARM").steps[0].extra == {"x-calm": [1, 2]}


CARRIES = """
from msgspec.structs import replace
def put(data, script):
    steps = [replace(step, extra={"x-wear": [0.5, {"n": n}]}) for n, step in enumerate(script.steps)]
    return replace(script, steps=steps)
def add(data, bound):
    if bound.evaluation is None:
        return bound
    step = replace(data.step, extra={**data.step.extra, "x-bound": data.primitive_id})
    return replace(bound, evaluation=replace(bound.evaluation, step=step))
def show(data, assessed):
    return replace(assessed, message=str(data.evaluation.step.extra))
"""


def test_data_of_a_package_pass_from_stage_to_stage(install: Install, bench) -> None:  # noqa: F811
    """A phase of the elaborator puts them into a step; those of binder and analyzer find them, with what was added."""
    for kind, phase in (("elaborator", "put"), ("binder", "add"), ("analyzer", "show")):
        install(registry.PHASES, phase, phase, CARRIES)
        bench.load(kind, f"phases: [{phase}]")
    (assessed,) = bench.do("HOLD RIGHT-ARM FOR 1 SEC").assessments
    carried = str({"x-wear": [0.5, {"n": 0}], "x-bound": "C-1.1"})
    assert assessed.message == carried  # wording: the last phase shows there what has come to it


PHASES = """
from msgspec.structs import replace
from rtc.protocol.outcomes import RefusalReason, Refused
def number(data, script):
    return replace(script, notes=[*script.notes, str(len(script.notes))])
def name(data, script):
    return replace(script, notes=[*script.notes, data.parsed.verb])
def refuse(data, bound):
    if "x-heavy" in data.step.extra:
        raise Refused.because(RefusalReason.NOT_ALLOWED, "too heavy", clears="take less")
    return bound
def fail(data, product):
    return {}["no such key"]
def forget(data, product):
    return None
def hang(data, product):
    while True:
        pass
def wait(data, product):
    __import__("time").sleep(600.0)
"""


@pytest.mark.parametrize("order", [["number", "name"], ["name", "number"], ["name"]])
def test_products_pass_through_the_phases_of_the_program_in_its_order(install: Install, bench, order) -> None:  # noqa: F811
    plain = len(bench.elaborate("STOW RIGHT-ARM").notes)
    for phase in ("number", "name"):
        install(registry.PHASES, phase, phase, PHASES)
    bench.load("elaborator", f"phases: {order}")
    expected = {"number": str(plain + order.index("number") if "number" in order else 0), "name": "STOW"}
    assert bench.elaborate("STOW RIGHT-ARM").notes[plain:] == [expected[phase] for phase in order]


@pytest.mark.parametrize(
    ("phase", "kind", "reason"),
    [
        ("refuse", "binder", RefusalReason.NOT_ALLOWED),
        ("fail", "binder", RefusalReason.PROGRAM),
        ("forget", "analyzer", RefusalReason.PROGRAM),
        ("hang", "elaborator", RefusalReason.PROGRAM),
        ("wait", "binder", RefusalReason.PROGRAM),
    ],
)
def test_a_phase_that_refuses_fails_forgets_or_hangs_refuses_the_sentence(
    install: Install,
    bench,  # noqa: F811
    monkeypatch,
    phase,
    kind,
    reason,
) -> None:
    monkeypatch.setitem(registry.LIMITS_S, registry.PHASES, 0.05)
    guard.begin_anew()
    install(registry.PHASES, phase, phase, PHASES)
    bench.load(kind, f"phases: [{phase}]")
    step = "{do: hold, stop: hold, label: w, args: {duration_s: 1}, x-heavy: 1}"
    bench.load("elaborator", f"script: stow\ncase: 1\nuses: [hand]\nsteps: [{step}]")
    refused = bench.do("STOW RIGHT-ARM").refusal
    assert refused is not None
    assert refused.reason is reason


@pytest.mark.parametrize("kind", ["elaborator", "binder", "analyzer"])
def test_an_unknown_phase_is_refused_with_its_program(bench, kind: str) -> None:  # noqa: F811
    with pytest.raises(ProgramError):
        bench.load(kind, "phases: [no-such-phase]")


@pytest.mark.parametrize("code", ["import no_such_library", None])
def test_a_trimmer_that_cannot_be_loaded_is_refused_with_its_program(install: Install, code: str | None) -> None:
    if code:
        install(registry.TRIMMERS, "picks", "choose", code)
    with pytest.raises(ProgramError):
        analyze.compile(loader.merge("analyzer", loader.default("analyzer"), "t.yaml", b"trimmers: [picks]"))


FINDS = """
import numpy as np
from rtc.sensing.detector import DetectedTag
def find(camera, image):
    return [DetectedTag(17, np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]]))] if camera == "CAMERA-1" else []
"""


@pytest.mark.parametrize(("camera", "marks"), [("CAMERA-1", [17]), ("CAMERA-3", [])])
def test_a_sensor_adds_marks_to_a_picture(install: Install, cell: Cell, camera: str, marks: list[int]) -> None:
    install(registry.SENSORS, "toy", "find", FINDS)
    grey = np.full((48, 64, 3), 128, dtype=np.uint8)
    cameras = SimpleNamespace(photograph=lambda *_: Exposure(1.0, [grey], None), release=lambda: None)
    thread = CameraThread(cell, lambda: cameras)
    found = thread._evaluated(_Order(camera, {}), cameras, TagDetector())
    assert [mark.tag for mark in found.marks] == marks


@pytest.mark.parametrize("code", ["raise SystemExit(1)", "return float('nan')", "return 'x'", "return None"])
def test_an_evaluator_that_fails_is_named(install: Install, bench, code: str) -> None:  # noqa: F811
    install(registry.EVALUATORS, "EVIL", "score", f"def score(option):\n    {code}\n")
    bench.load("elaborator", "evaluators: [EVIL]")
    with pytest.raises(PluginError, match="evaluator EVIL"):
        bench.elaborate("STOW RIGHT-ARM")


def test_a_trimmer_that_fails_is_named_and_the_next_one_is_asked(install: Install, bench) -> None:  # noqa: F811
    install(registry.TRIMMERS, "EVIL", "choose", "def choose(data, entries):\n    raise SystemExit(1)\n")
    bench.load("analyzer", "trimmers: [EVIL, stack]")
    bench.subsystem.instead["C-1.5"] = StopReason.FORCE_LIMIT
    done = bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    assert done.trims[:1] == [2]
    assert any("trimmer EVIL" in one.message for one in done.assessments)  # wording: whose code has failed


MARK = "from rtc.sensing.detector import DetectedTag\nimport numpy as np\n"


@pytest.mark.parametrize(
    "code",
    [
        "raise SystemExit(1)",
        "return [DetectedTag(17, np.full((4, 2), np.nan))]",
        "return [DetectedTag(1.5, np.ones((4, 2)))]",
    ],
)
def test_a_sensor_that_fails_is_named_in_the_look(install: Install, cell: Cell, code: str) -> None:
    install(registry.SENSORS, "EVIL", "find", f"{MARK}def find(camera, image):\n    {code}\n")
    grey = np.full((48, 64, 3), 128, dtype=np.uint8)
    cameras = SimpleNamespace(photograph=lambda *_: Exposure(1.0, [grey], None), release=lambda: None)
    thread = CameraThread(cell, lambda: cameras)
    thread.look("CAMERA-1")
    assert select.select([thread.wake_fd], [], [], 20.0)[0]
    found = thread.result().found
    thread.close()
    assert "sensor EVIL" in found.why


def test_a_sensor_that_hangs_is_cut_off_and_named(install: Install, cell: Cell, monkeypatch) -> None:
    monkeypatch.setattr(sensor_watch, "LIMIT_S", 0.05)
    install(registry.SENSORS, "EVIL", "find", "def find(camera, image):\n    while True:\n        pass\n")
    grey = np.full((48, 64, 3), 128, dtype=np.uint8)
    cameras = SimpleNamespace(photograph=lambda *_: Exposure(1.0, [grey], None), release=lambda: None)
    thread, announced = CameraThread(cell, lambda: cameras), list[str]()
    watch = sensor_watch.SensorWatch(announced.append)
    thread.look("CAMERA-1")
    while not select.select([thread.wake_fd], [], [], 0.02)[0]:
        assert watch.look(time.monotonic()) == ""
    found = thread.result().found
    thread.close()
    guard.tell(None)
    assert "sensor EVIL" in found.why
    assert ", line " in found.why
    assert "sensor EVIL" in announced[-1]


@pytest.mark.parametrize("field", ["notes=[object()]", "steps=7", "notes=['\\ud800']"])
def test_a_phase_whose_product_cannot_be_read_is_named(install: Install, bench, field: str) -> None:  # noqa: F811
    code = f"from msgspec.structs import replace\ndef odd(data, product):\n    return replace(product, {field})\n"
    install(registry.PHASES, "odd", "odd", code)
    bench.load("elaborator", "phases: [odd]")
    refused = bench.elaborate("STOW RIGHT-ARM")
    assert (refused.reason, refused.where) == (RefusalReason.PROGRAM, "odd")
