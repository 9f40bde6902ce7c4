"""All faults of a user's cell file, URDF or SRDF, each with its place, its line and what was expected.

There are three stages: the file by itself; the models against the cell; the geometry (postures, places and seats with
collisions, limits and weights). A later stage runs only if the earlier ones found no error.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, cast, get_args, get_type_hints

import msgspec
import numpy as np

from rtc.apps.authoring import plausible, self_collisions, words_and_keys
from rtc.apps.authoring.inertias import GYRATION
from rtc.apps.authoring.robot_file import EXPAND, RobotFile, implausible, kinematics
from rtc.model.cells import cell as cells
from rtc.model.cells import extension, model_checks, two_readers, urdf_values
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Arm, Box, GraspPoint, Object
from rtc.model.cells.urdf import number
from rtc.model.cells.urdf_values import MOVING
from rtc.model.cells.yaml_reader import Unreadable
from rtc.model.robot import finger_mass, hulls
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Scene
from rtc.model.robot.kinematics import ArmModel
from rtc.programs.yaml_location import line_of_key, path_of
from rtc.protocol.outcomes import ProgramError, RtcError
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line

TRIANGLE_SLACK = 1e-9
PENETRATION_M = 0.002  # of two bodies at the beginning
ASKEW_DEG, WIDTH_M = 10.0, 0.004  # fingers that close askew, or at another width, are taken for a failed grasp
WEIGHT_SHARE = 0.9  # of the motor torque, as planning allows


WHY = {"Adjacent": "neighbours", "Default": "the fingers of one hand", "Always": "in contact in every posture"}


class Finding(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One fault. `where`: a path such as $.arms[0].home_deg, or a link of a URDF; `line`: from 1, 0 unknown."""

    severity: Literal["error", "warning"] = "error"
    file: str
    where: str
    problem: str
    expected: str = ""
    line: int = 0


def review(path: Path) -> tuple[list[Finding], Cell | None]:
    """All findings of a file; and the cell, if it can be loaded. Raises ProgramError for an unknown kind of file."""
    if path.is_dir():
        path = path / "cell.yaml"
    if path.suffix in (".yaml", ".yml"):
        return _cell(path)
    if path.suffix == ".urdf":
        return list(of_urdf(path)), None
    if path.suffix == ".srdf":
        return list(_srdf(path, path.with_suffix(".urdf"))), None
    if path.suffix == ".xacro":
        raise ProgramError(f"{path}: a URDF (.urdf) is checked; {EXPAND}")
    raise ProgramError(
        f"{path}: a cell (.yaml), a URDF (.urdf) or an SRDF (.srdf) is checked, not {path.suffix or 'this'}"
    )


# --- the cell file -------------------------------------------------------------------------------------


def _cell(path: Path) -> tuple[list[Finding], Cell | None]:
    folders = [path.parent]
    try:
        text = path.read_bytes()
        plain = extension.document_of(text, str(path))
        if isinstance(plain, dict) and "extends" in plain:
            plain, folders = extension.read(path, cells.file_of)
            text = b""  # a place in the merged document has no line
    except OSError as error:
        raise ProgramError(f"cannot read {path}: {error.strerror}") from error
    except Unreadable as error:
        problem, expected = (error.problem, "") if error.where else (f"not YAML: {error.problem}", "a cell file")
        where = error.where or "$"
        return [Finding(file=error.source, where=where, problem=problem, expected=expected, line=error.line)], None
    found = [_at(path, text, where, problem) for where, problem in _fields(plain)]
    found += [
        Finding(file=str(path), where=f"$.{where}", problem=problem, expected="one of them", line=line)
        for where, problem, line in words_and_keys.duplicate_keys(path.read_bytes())
    ]
    found += [_at(path, text, *row) for row in words_and_keys.faults(plain)]
    found += _models(path, plain, text, folders)
    if any(one.severity == "error" for one in found):
        return found, None
    try:
        cell = Cell.load(path)
    except ProgramError as error:
        return [*found, _at(path, text, "", str(error))], None
    found += _read_twice(cell, folders)
    found += [_at(path, text, *row) for row in plausible.of_cell(cell)]
    return found + [_at(path, text, *row) for row in _geometry(cell)], cell


def _read_twice(cell: Cell, folders: list[Path]) -> Iterator[Finding]:
    """What planning and physics read differently in the URDF of each arm."""
    for urdf in dict.fromkeys(one.urdf for arm in cell.arms for one in arm.with_each_hand):
        texts = {name: text for name, text in cell.texts.items() if name.endswith(hulls.SUFFIX)}
        file = _beside(folders, urdf)
        for where, problem, expected in two_readers.differences(cell.texts[urdf], texts, shapes=True):
            yield Finding(file=str(file), where=where, problem=problem, expected=expected, line=_line(file, where))


def _at(path: Path, text: bytes, where: str, problem: str, severity: str = "error", expected: str = "") -> Finding:
    place = f"$.{where}" if where else "$"
    return Finding(
        severity="warning" if severity == "warning" else "error",
        file=str(path),
        where=place,
        problem=problem,
        expected=expected,
        line=line_of_key(text, path_of(place)) if where and text else 0,
    )


def _fields(plain: Any) -> Iterator[tuple[str, str]]:
    """Faults of each part by itself; then, if there are none, of the references between the parts."""
    if not isinstance(plain, dict):
        yield "", f"a cell is a map with {', '.join(Cell.__struct_fields__)}"
        return
    types = get_type_hints(Cell)
    known = [name for name in Cell.__struct_fields__ if name != "texts"]
    parts: dict[str, Any] = {}
    faults = [(key, unknown("field", key, known)) for key in plain if key not in types]
    faults += [(key, "is missing") for key in ("name", "arms") if key not in plain]
    for key, value in plain.items():
        if key in types:
            parts[key], wrong = _converted(key, value, types[key])
            faults += wrong
    yield from faults
    if not faults:
        complete = {name: parts.get(name, _default(name)) for name in Cell.__struct_fields__}
        yield from cells.problems(cast(Cell, SimpleNamespace(**complete)))


def _default(field: str) -> Any:
    made = {f.name: f for f in msgspec.structs.fields(Cell)}[field]
    return made.default_factory() if made.default_factory is not msgspec.NODEFAULT else made.default


def _converted(key: str, value: Any, kind: Any) -> tuple[Any, list[tuple[str, str]]]:
    """(the typed value, faults). Of a list each part is converted alone, so that one fault hides no other."""
    inner = get_args(kind)
    if getattr(kind, "__origin__", None) is list and isinstance(value, list):
        rows = [_converted_one(f"{key}[{n}]", part, inner[0]) for n, part in enumerate(value)]
        return [row for row, _ in rows], [fault for _, wrong in rows for fault in wrong]
    return _converted_one(key, value, kind)


def _converted_one(where: str, value: Any, kind: Any) -> tuple[Any, list[tuple[str, str]]]:
    try:
        return msgspec.convert(value, kind), []
    except (msgspec.ValidationError, ValueError) as error:
        message, _, inner = str(error).partition(" - at `$")
        inside = inner.rstrip("`")
        given = _at_path(value, inside)
        if "got `str`" in message and isinstance(given, str):
            message = f"{given!r} is a text: {message[:1].lower()}{message[1:]}"
        wrong = [(f"{where}{inside}", words_and_keys.readable(message[:1].lower() + message[1:]))]
        return None, wrong + _unknown_fields(where, value, kind, message)


def _at_path(value: Any, inside: str) -> Any:
    """The part of a plain value at a path such as .frame.xyz[0]; None: there is none."""
    for part in path_of(f"${inside}"):
        try:
            value = value[part]
        except (LookupError, TypeError):
            return None
    return value


def _unknown_fields(where: str, value: Any, kind: Any, message: str) -> list[tuple[str, str]]:
    """What a part with an unknown field may have."""
    if "unknown field" not in message or not isinstance(value, dict) or not hasattr(kind, "__struct_fields__"):
        return []
    strange = sorted(set(value) - set(kind.__struct_fields__))
    return [(f"{where}.{name}", unknown("field", name, kind.__struct_fields__)) for name in strange]


# --- models --------------------------------------------------------------------------------------------


def _models(path: Path, plain: Any, text: bytes, folders: list[Path]) -> Iterator[Finding]:
    """Faults of the URDF and SRDF of every arm, each file once; then those of the models against the cell."""
    arms = plain.get("arms") if isinstance(plain, dict) else None
    seen: set[Path] = set()
    for n, arm in enumerate(arms if isinstance(arms, list) else []):
        if not isinstance(arm, dict):
            continue
        for place, part in _with_hands(f"arms[{n}]", arm):
            urdf, srdf = (_beside(folders, str(part.get(key, ""))) for key in ("urdf", "srdf"))
            for key, file in (("urdf", urdf), ("srdf", srdf)):
                if key in part and not file.is_file():
                    problem = f"there is no file {file}"
                    yield _at(path, text, f"{place}.{key}", problem, expected="a file beside the cell's")
            if urdf.is_file() and urdf not in seen:
                seen.add(urdf)
                yield from of_urdf(urdf, in_cell=True)
                if srdf.is_file():
                    yield from _srdf(srdf, urdf)
        try:
            spec = msgspec.convert(arm, Arm)
            models = {one.urdf for one in spec.with_each_hand}
            every = {name: _beside(folders, name) for name in models | {one.srdf for one in spec.with_each_hand}}
            texts = {name: file.read_text(encoding="utf-8") for name, file in every.items() if file.is_file()}
        except (msgspec.ValidationError, ValueError, OSError):
            continue  # reported above
        if every.keys() == texts.keys() and not any(_wrong_values(texts[name]) for name in models):
            named = [file for name in sorted(models) for file in model_checks.hulls(texts[name])]
            beside = {file: "" for file in named if _beside(folders, file).is_file()}
            for where, problem in model_checks.problems([spec], texts | beside):
                yield _at(path, text, where.replace("arms[0]", f"arms[{n}]", 1), problem)


def _with_hands(place: str, arm: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """An arm of a plain cell, and each of its hands, with their places."""
    yield place, arm
    hands = arm.get("hands")
    for m, hand in enumerate(hands if isinstance(hands, list) else []):
        if isinstance(hand, dict):
            yield f"{place}.hands[{m}]", hand


def _wrong_values(urdf: str) -> bool:
    """Whether a URDF has faults that `_urdf` states."""
    try:
        return any(urdf_values.faults(ElementTree.fromstring(urdf)))
    except ElementTree.ParseError:
        return True


def _beside(folders: list[Path], file: str) -> Path:
    return next((folder / file for folder in folders if (folder / file).is_file()), folders[0] / file)


def of_urdf(path: Path, in_cell: bool = False, text: str | None = None) -> Iterator[Finding]:
    """The faults of a URDF. `in_cell`: its meshes must be hulls or readable files, which `model_checks` states.
    `text`: instead of that of the file."""

    def found(where: str, problem: str, expected: str = "", severity: Literal["error", "warning"] = "error") -> Finding:
        return Finding(
            severity=severity, file=str(path), where=where, problem=problem, expected=expected, line=_line(path, where)
        )

    try:
        robot = RobotFile(path, text)
    except ProgramError as error:
        yield found("robot", str(error).removeprefix(f"{path}: "), "one tree of links and joints")
        return
    wrong = list(urdf_values.faults(robot.robot))
    yield from (found(*fault) for fault in wrong)
    if (long := urdf_values.too_long(robot.robot)) is not None:
        yield found(*long, "warning")
    faulty, errors = {fault.where for fault in wrong}, bool(wrong)
    for name in robot.joints:
        for problem, expected, severity in [] if f"joint {name}" in faulty else _joint(robot, name):
            errors = errors or severity == "error"
            yield found(f"joint {name}", problem, expected, severity)
        for problem, expected in [] if f"joint {name}" in faulty else plausible.of_joint(robot.joints[name]):
            if robot.type(name) in MOVING:
                yield found(f"joint {name}", problem, expected, "warning")
    if bare := self_collisions.without_shape(robot):
        problem = "nothing notices what it touches: it has no <collision>, nor has what is fixed to it"
        yield from (found(f"link {name}", problem, "a shape, such as a box around it", "warning") for name in bare)
    impossible = in_cell  # to compare; a cell is compared as a whole
    for name, link in robot.links.items():
        for problem, expected, severity in [] if f"link {name}" in faulty else _inertial(robot, name, link):
            impossible = impossible or severity == "error"
            yield found(f"link {name}", problem, expected, severity)
        for problem in [] if in_cell else _mesh_faults(robot, link):
            yield found(f"link {name}", problem, "a readable mesh")
    if not errors:
        try:
            text = ElementTree.tostring(robot.robot, encoding="unicode")
            kinematics(text, path)
            for difference in [] if impossible else two_readers.differences(text, {}, shapes=False):
                yield found(*difference)
        except RtcError as error:
            yield found("robot", str(error).removeprefix(f"{path}: "))


Row = tuple[str, str, Literal["error", "warning"]]


def _joint(robot: RobotFile, name: str) -> Iterator[Row]:
    joint = robot.joints[name]
    if robot.type(name) not in MOVING:
        return
    limit = joint.find("limit")
    if limit is None:
        yield "it has no <limit>", "lower, upper, effort and velocity", "error"
        return
    try:
        lower, upper = robot.limits(name)
        for key in ("effort", "velocity"):
            if not number(limit, key) > 0.0:
                yield f"its {key} is {number(limit, key):g}", "a value above 0, from the data sheet", "error"
    except ProgramError as error:
        yield str(error), "a number", "error"
        return
    if robot.type(name) != "continuous" and lower == upper:
        yield f"its limits are {lower:g} and {upper:g}", "lower below upper, in rad or m", "error"
    soft = joint.find("safety_controller")
    if soft is not None and (narrow := urdf_values.soft_limits(joint, soft)) is not None:
        low, high = narrow
        problem = f"its soft limits {low:g} and {high:g} are not kept; its limits are {lower:g} and {upper:g}"
        yield problem, f'<limit lower="{low:g}" upper="{high:g}" .../>', "warning"
    if robot.type(name) == "revolute" and max(abs(lower), abs(upper)) > urdf_values.MANY_TURNS:
        yield f"its limits are {lower:g} and {upper:g} rad: degrees?", "radians", "warning"


def _inertial(robot: RobotFile, name: str, link: ElementTree.Element) -> Iterator[Row]:
    inertial = link.find("inertial")
    carrier = robot.carrier.get(name)
    if inertial is None:
        if carrier is not None and robot.type(carrier) in MOVING and link.find("collision") is not None:
            yield "it moves and has no <inertial>", "mass, centre of mass and inertia", "error"
        return
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    try:
        kilograms = 0.0 if mass is None else number(mass, "value")
        if inertia is None or name == robot.root:
            return
        matrix = np.diag([number(inertia, key) for key in ("ixx", "iyy", "izz")])
        for (row, column), key in (((0, 1), "ixy"), ((0, 2), "ixz"), ((1, 2), "iyz")):
            matrix[row, column] = matrix[column, row] = number(inertia, key)
    except ProgramError as error:
        yield str(error), "a number", "error"
        return
    a, b, c = sorted(np.linalg.eigvalsh(matrix).tolist())
    if kilograms <= 0.0:
        if carrier is not None and robot.type(carrier) in MOVING:
            yield f"its mass is {kilograms:g} kg", "a mass above 0", "error"
    elif a <= 0.0 or a + b < c - TRIANGLE_SLACK:
        yield (
            f"a rigid body cannot have the inertia {a:.3g}, {b:.3g}, {c:.3g} kg m2; a simulator takes 0 instead",
            "principal moments above 0, none above the sum of the others",
            "error",
        )
    elif (size := _size_m(robot, name)) and math.sqrt(c / kilograms) > GYRATION * size:
        yield (
            f"{kilograms:g} kg with {c:.3g} kg m2 is a ring of {2 * math.sqrt(c / kilograms):.2f} m; "
            f"the link measures {size:.2f} m",
            "the inertia of its data sheet",
            "warning",
        )


def _size_m(robot: RobotFile, name: str) -> float:
    """Diagonal of a box around the meshes of a link; 0: not known."""
    clouds = []
    for mesh in robot.links[name].findall("collision//mesh"):
        try:
            clouds.append(robot.vertices(mesh))
        except ProgramError:
            return 0.0
    if not clouds:
        return 0.0
    cloud = np.vstack(clouds)
    return float(np.linalg.norm(cloud.max(axis=0) - cloud.min(axis=0)))


def _mesh_faults(robot: RobotFile, link: ElementTree.Element) -> Iterator[str]:
    for mesh in link.findall("collision//mesh"):
        try:
            points = robot.vertices(mesh)
        except ProgramError as error:
            yield str(error).removeprefix(f"{robot.path}: ")
            continue
        if wrong := implausible(points, str(mesh.get("filename"))):
            yield wrong


def _srdf(path: Path, urdf: Path) -> Iterator[Finding]:
    def found(line: int, where: str, problem: str, expected: str = "") -> Finding:
        return Finding(file=str(path), where=where, problem=problem, expected=expected, line=line)

    try:
        robot = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        yield found(1, "robot", f"cannot be read: {error}", "an XML file <robot>")
        return
    try:
        links = set(RobotFile(urdf).links) if urdf.is_file() else None
    except ProgramError:
        return  # reported with the URDF
    if links is None:
        yield found(1, "robot", f"there is no {urdf.name} beside it, so its links are not checked")
        return
    for row in robot.iter("disable_collisions"):
        for key in ("link1", "link2"):
            if row.get(key) not in links:
                problem = f"disable_collisions: there is no link {row.get(key)} in {urdf.name}"
                yield found(
                    _line(path, f"link {row.get(key)}"), f"{key} {row.get(key)}", problem, ", ".join(sorted(links))
                )


def _line(path: Path, where: str) -> int:
    """The line of an XML file in which a named element begins; 0: not found."""
    name = where.partition(" ")[2]
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return 0
    return next((n for n, line in enumerate(lines, 1) if name and f'"{name}"' in line), 0)


# --- geometry ------------------------------------------------------------------------------------------

Place = tuple[str, str, str, str]  # where, problem, severity, expected


def _geometry(cell: Cell) -> Iterator[Place]:
    """An arm must be sound with each of its hands; a place or an object needs one with which it is reached."""
    hands = [(arm.name, hand.name) for arm in cell.arms for hand in arm.hands]
    every = [list(_fitted_geometry(cell.with_hands(dict(one)))) for one in ([], *([pair] for pair in hands))]
    arms = dict.fromkeys(row for rows in every for row in rows if row[0].startswith("arms"))
    everywhere = set.intersection(*({row[0] for row in rows} for rows in every))
    yield from arms
    yield from (row for row in every[0] if row[0] in everywhere and row not in arms)


def _fitted_geometry(cell: Cell) -> Iterator[Place]:
    try:
        world = CollisionWorld(cell)
        models = {arm.name: ArmModel.of(cell, arm.name) for arm in cell.arms}
    except (ProgramError, ValueError, RuntimeError) as error:
        yield "arms", str(error), "error", "models that can be built"
        return
    yield from ((where, problem, "error", "") for where, problem in finger_mass.problems(cell))
    yield from _self_pairs(cell)
    home = {arm.name: arm.home_rad for arm in cell.arms}
    for n, arm in enumerate(cell.arms):
        for field, joints in (("home_deg", arm.home_rad), ("stow_deg", arm.stow_rad)):
            where, model = f"arms[{n}].{field}", models[arm.name]
            hit = world.check({**home, arm.name: joints}, Scene(moving=arm.name))
            if hit is not None:
                yield where, f"{hit.body_a} collides with {hit.body_b} there", "error", "a posture without contact"
            still = np.zeros((1, len(joints)))
            torques = np.abs(model.torques(np.array([joints]), still, still)[0])
            worst = int((torques / model.limits.effort).argmax())
            if torques[worst] > WEIGHT_SHARE * model.limits.effort[worst]:
                has = f"{model.limits.effort[worst]:.0f}"
                problem = (
                    f"{arm.joints[worst]} would need {torques[worst]:.0f} N.m to hold the arm; its motor has {has}"
                )
                yield where, problem, "error", "a posture that the motors can hold"
    yield from _places(cell, world, models, home)
    yield from _objects(cell, world, models, home)


def _self_pairs(cell: Cell) -> Iterator[Place]:
    """Pairs of links that collide in every posture but are not in the SRDF: every motion would be refused."""
    for n, arm in enumerate(cell.arms):
        if any(other.urdf == arm.urdf for other in cell.arms[:n]):
            continue
        robot = RobotFile(Path(arm.urdf), cell.urdf(arm.name))
        rows, _ = self_collisions.pairs(robot, cell.urdf(arm.name), cell.texts)
        listed = {
            frozenset((row.get("link1"), row.get("link2")))
            for row in ElementTree.fromstring(cell.srdf(arm.name)).iter("disable_collisions")
        }
        missing = sorted(sorted(pair) for pair, reason in rows.items() if reason != "Never" and pair not in listed)
        for a, b in missing:
            reason = WHY[rows[frozenset((a, b))]]
            expected = f'<disable_collisions link1="{a}" link2="{b}"/>'
            yield f"arms[{n}].srdf", f"{arm.srdf} does not list {a} and {b}, which are {reason}", "warning", expected


def _places(
    cell: Cell, world: CollisionWorld, models: Mapping[str, ArmModel], home: Mapping[str, list[float]]
) -> Iterator[Place]:
    margin = math.radians(cell.numbers.joint_margin_deg)
    for n, place in enumerate(cell.places):
        for arm, frame in place.poses.items():
            where = f"places[{n}].poses.{arm}"
            yield from _reach(models[arm], world, home, frame.pose, margin, where)
        for arm in place.joints_deg:
            joints, where = place.joints_rad(arm) or [], f"places[{n}].joints_deg.{arm}"
            wrong = models[arm].why_not_within(joints, margin)
            if wrong is not None:
                yield where, wrong.message, "error", in_one_line(wrong.clears)
                continue
            hit = world.check({**home, arm: joints}, Scene(moving=arm))
            if hit is not None:
                yield where, f"{hit.body_a} collides with {hit.body_b} there", "error", "a posture without contact"


def _reach(
    model: ArmModel,
    world: CollisionWorld,
    home: Mapping[str, list[float]],
    pose: geometry.Floats,
    margin: float,
    where: str,
    touching: str = "",
) -> Iterator[Place]:
    solutions = model.ik(pose, home[model.name], margin)
    if not solutions:
        why = model.why_no_ik(pose, margin)
        message, clears = (why.message, in_one_line(why.clears)) if why else (f"{model.name} cannot reach it", "")
        yield where, message, "error", clears
        return
    ignore = [(model.name, touching)] if touching else []
    scene = Scene(moving=model.name, ignore=ignore)
    hits = [world.check({**home, model.name: q}, scene) for q in solutions]
    if all(hit is not None for hit in hits):
        hit = hits[0]
        assert hit is not None
        yield where, f"{hit.body_a} collides with {hit.body_b} there", "error", "a pose that is free"


def _objects(
    cell: Cell, world: CollisionWorld, models: Mapping[str, ArmModel], home: Mapping[str, list[float]]
) -> Iterator[Place]:
    margin = math.radians(cell.numbers.joint_margin_deg)
    for n, thing in enumerate(cell.objects):
        if thing.fixed:
            continue
        for m, point in enumerate(thing.grasp_points):
            where = f"objects[{n}].grasp_points[{m}]"
            pose = geometry.compose(cell.object_pose(thing.name), point.frame.pose)
            faults = [list(_reach(models[a.name], world, home, pose, margin, where, thing.name)) for a in cell.arms]
            if all(faults):
                yield (
                    where,
                    f"no arm reaches {point.name} of {thing.name}: {faults[0][0][1]}",
                    "warning",
                    "a reachable pose",
                )
            widest = max(arm.gripper.max_opening_m for arm in cell.arms)
            if point.width_m >= widest:
                words = (
                    f"{point.name} is {1000 * point.width_m:.0f} mm wide; the widest hand opens {1000 * widest:.0f} mm"
                )
                yield where, words, "error", "a width below the opening"
            yield from _between_fingers(where, thing, point)
        if thing.mass_kg > (most := max(arm.payload_kg for arm in cell.arms)):
            yield f"objects[{n}].mass_kg", f"{thing.mass_kg:g} kg; no arm carries more than {most:g} kg", "warning", ""
        hit = world.deepest_contact(thing.name, home)
        if hit is not None and hit.distance_m < -PENETRATION_M:
            other = hit.body_b if hit.body_a.startswith(thing.name) else hit.body_a
            words = f"{thing.name} is {-1000 * hit.distance_m:.0f} mm inside {other} at the beginning"
            yield f"objects[{n}].frame", words, "error", "bodies that at most touch"


def _between_fingers(where: str, thing: Object, point: GraspPoint) -> Iterator[Place]:
    """Whether the fingers, which close along y of the point, close on two sides of the box there, as wide as stated."""
    for box in thing.shapes:
        if not isinstance(box, Box):
            continue
        there = geometry.relative(box.frame.pose, point.frame.pose)
        if any(abs(at) > 0.5 * size for at, size in zip(there[:3], box.size_m, strict=True)):
            continue
        closing = np.abs(geometry.rotate(there, (0.0, 1.0, 0.0)))
        axis = int(np.argmax(closing))
        askew_deg = math.degrees(math.acos(min(1.0, float(closing[axis]))))
        wide_m = box.size_m[axis]
        if askew_deg > ASKEW_DEG:
            words = f"at {point.name} the fingers close at {askew_deg:.0f} deg to the sides of {box.name}"
            yield where, words, "warning", "y of a grasp point square to two sides"
        elif abs(wide_m - point.width_m) > WIDTH_M:
            words = f"{point.name} is {1000 * point.width_m:.0f} mm wide; {box.name} is {1000 * wide_m:.0f} mm there"
            yield where, words, "warning", "the width between the fingers"
