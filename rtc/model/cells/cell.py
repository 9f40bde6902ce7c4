"""A work-cell as data: arms, seats, objects, places, regions, cameras, tags and numbers.

A cell is a YAML file and the robot models that it names. `Cell.load` reads them and embeds the texts of the models, so
that one `encode()`d document is all that a process needs (no shared files, R51). A cell is checked when it is
constructed: all its references and lengths are valid.

The types of its parts are in `rtc.model.cells.parts`. This module knows no kinematics and does not check reachability.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec

from rtc.model.cells import extension, model_checks
from rtc.model.cells.parts import (
    FAR,
    Arm,
    Camera,
    Frame,
    GraspPoint,
    Hinge,
    Maintained,
    Numbers,
    Object,
    Place,
    Region,
    Seat,
    Tag,
    Vec3,
    named,
)
from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.protocol.digest import digest
from rtc.protocol.outcomes import ProgramError
from rtc.protocol.primitive.limits import HEAVIEST_KG, MAX_INERTIA_KG_M2
from rtc.protocol.spelling import unknown
from rtc.protocol.subsystems import ARMS, Subsystem, owner, resolved
from rtc.spatial import geometry, hinges

MOST_ADDED = 100  # grasp points of an object that one package adds
CELLS = Path(__file__).parent  # the cells of the project: cells/NAME/cell.yaml


class Cell(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    name: Annotated[str, msgspec.Meta(min_length=1, max_length=100)]
    gravity_m_s2: Vec3 = (0.0, 0.0, 0.0)
    arms: list[Arm]
    seats: list[Seat] = []
    objects: list[Object] = []
    places: list[Place] = []
    regions: list[Region] = []
    cameras: list[Camera] = []
    tags: list[Tag] = []
    attitudes: dict[str, Frame] = {}  # of the tcp, world frame; for POSE-DURING-MOTION
    maintain: Maintained = Maintained()
    numbers: Numbers = Numbers()
    subsystems: list[Subsystem] = []  # beside those of every cell; see `all_subsystems`
    mechanisms: dict[str, Any] = {}  # mechanism of an installed package -> its piece, in the form that it states
    texts: dict[str, str] = {}  # URDF, SRDF and hulls by file name; filled by `load`

    def __post_init__(self) -> None:
        for place, problem in problems(self):
            raise ValueError(f"$.{place}: {problem}")

    @property
    def all_subsystems(self) -> list[Subsystem]:
        """Every subsystem of the cell with its arms and cameras."""
        return resolved(self.subsystems, [arm.name for arm in self.arms], [one.name for one in self.cameras])

    def subsystem_of(self, performer: str) -> str:
        """The name of the subsystem of an arm or a camera. Raises KeyError."""
        return owner(self.all_subsystems, performer)

    def of_subsystem(self, name: str) -> Cell:
        """The cell as a subsystem of arms simulates it: with its own arms, and without the cameras of others."""
        own = {performer for one in self.all_subsystems if one.name == name for performer in one.performers}
        arms = [arm for arm in self.arms if arm.name in own]
        if len(arms) == len(self.arms):
            return self
        gone = {arm.name for arm in self.arms} - own
        cameras = [camera for camera in self.cameras if camera.arm not in gone]
        places = [place.without(gone) for place in self.places]
        return msgspec.structs.replace(self, arms=arms, cameras=cameras, places=places, subsystems=[])

    def with_hands(self, hands: Mapping[str, str]) -> Cell:
        """The cell with these hands in the couplers of its arms (by arm; empty: none). Raises KeyError."""
        arms = [arm.with_hand(hands.get(arm.name, "")) for arm in self.arms]
        return msgspec.structs.replace(self, arms=arms)

    def without_objects(self, names: Collection[str]) -> Cell:
        """The cell without these objects, their tags, and what else names them."""
        arms = [msgspec.structs.replace(a, hands=[h for h in a.hands if h.name not in names]) for a in self.arms]
        objects = [thing for thing in self.objects if thing.name not in names]
        tags = [tag for tag in self.tags if tag.body not in names]
        return msgspec.structs.replace(self, arms=arms, objects=objects, tags=tags)

    # --- reading and sending ---------------------------------------------------------------------------

    @classmethod
    def load(cls, name_or_path: str | Path) -> Cell:
        """The cell of a name (cells/NAME/cell.yaml) or file, models embedded. Raises ProgramError with the place."""
        path = file_of(name_or_path)
        bare, folders = _read(path)
        texts = dict(bare.texts)
        for n, arm in _models(bare.arms):
            for field, file in (("urdf", arm.urdf), ("srdf", arm.srdf)):
                if file not in texts:
                    folder = next((one for one in folders if (one / file).is_file()), path.parent)
                    try:
                        texts[file] = (folder / file).read_text(encoding="utf-8")
                    except (OSError, UnicodeDecodeError) as error:
                        raise ProgramError(f"{path}: $.arms[{n}].{field}: cannot read {file}: {error}") from error
            for file in model_checks.hulls(texts[arm.urdf]):
                own = next((one for one in folders if (one / file).is_file()), None)
                if file not in texts and own is not None:
                    texts[file] = (own / file).read_text(encoding="utf-8", errors="replace")
        cell = msgspec.structs.replace(bare, texts=texts)
        cell = msgspec.structs.replace(cell, objects=[_with_added_grasps(thing, cell) for thing in cell.objects])
        for place, problem in (*model_checks.problems(cell.arms, cell.texts), *_wrong_pieces(cell)):
            raise ProgramError(f"{path}: $.{place}: {problem}")
        return cell

    @classmethod
    def from_bytes(cls, document: bytes) -> Cell:
        """The cell of an `encode()`d document, or of any self-contained YAML document. Raises ProgramError."""
        cell = _decode(document, "cell document")
        for n, arm in _models(cell.arms):
            for field, file in (("urdf", arm.urdf), ("srdf", arm.srdf)):
                if file not in cell.texts:
                    raise ProgramError(f"cell document: $.arms[{n}].{field}: the text of {file} is not embedded")
        return cell

    def encode(self) -> bytes:
        """One self-contained document (JSON, which is YAML); equal cells give equal bytes."""
        return msgspec.json.encode(self, order="deterministic")

    def digest(self) -> str:
        return digest(self.encode())

    # --- look-ups (KeyError for an unknown name) ----------------------------------------------------------------------

    def arm(self, name: str) -> Arm:
        return named(self.arms, name, "arm")

    def seat(self, name: str) -> Seat:
        return named(self.seats, name, "seat")

    def object(self, name: str) -> Object:
        return named(self.objects, name, "object")

    def place(self, name: str) -> Place:
        return named(self.places, name, "place")

    def region(self, name: str) -> Region:
        return named(self.regions, name, "region")

    def camera(self, name: str) -> Camera:
        return named(self.cameras, name, "camera")

    def urdf(self, arm: str) -> str:
        """The URDF text of an arm."""
        return self.texts[self.arm(arm).urdf]

    def srdf(self, arm: str) -> str:
        return self.texts[self.arm(arm).srdf]

    def seated_pose(self, seat: str) -> geometry.Array:
        """World pose of a module in `seat`."""
        found = self.seat(seat)
        return geometry.compose(found.frame.pose, found.module_frame.pose)

    def object_pose(self, name: str) -> geometry.Array:
        """Initial world pose of an object."""
        found = self.object(name)
        if found.hinge is not None:
            return hinges.turned(found.frame.pose, found.hinge.axis, math.radians(found.hinge.at_deg))
        if found.seat is None:
            return found.frame.pose
        return geometry.compose(self.seated_pose(found.seat), found.frame.pose)

    def mounted(self, body: str) -> list[Seat | Object]:
        """The seats and objects that are mounted on an object."""
        every: list[Seat | Object] = [*self.seats, *self.objects]
        return [part for part in every if part.mounted_on == body]

    def names(self) -> Iterator[str]:
        """All names in this cell that a sentence may use."""
        for arm in self.arms:
            yield from (arm.name, arm.end_effector)
        for group in (self.seats, self.objects, self.places, self.regions, self.cameras):
            yield from (part.name for part in group)


def _models(arms: Sequence[Arm]) -> Iterator[tuple[int, Arm]]:
    """Each arm with its number, and again with each of its hands."""
    return ((n, fitted) for n, arm in enumerate(arms) for fitted in arm.with_each_hand)


def file_of(name_or_path: str | Path, folder: Path = Path()) -> Path:
    """The file of a cell: its name, its folder or the file itself, relative to `folder`. Raises ProgramError."""
    path = folder / name_or_path
    if path.suffix not in (".yaml", ".yml"):
        path = (path if (path / "cell.yaml").is_file() else CELLS / name_or_path) / "cell.yaml"
    if not path.is_file():
        raise ProgramError(
            unknown("cell", str(name_or_path), (p.parent.name for p in CELLS.glob("*/cell.yaml")))
            + f"; there is no file {path}"
        )
    return path


def _read(path: Path) -> tuple[Cell, list[Path]]:
    """The cell of a file, without the texts of its models, and the folders where they may be."""
    plain, folders = extension.read(path, file_of)
    return _typed(plain, str(path), " (of the cell as extended)" if folders[1:] else ""), folders


def _decode(document: bytes, source: str) -> Cell:
    if document.startswith(b"{"):
        with contextlib.suppress(msgspec.DecodeError):  # which the reader states with its place
            return msgspec.json.decode(document, type=Cell)
    return _typed(extension.document_of(document, source), source)


def _typed(plain: Any, source: str, note: str = "") -> Cell:
    try:
        return msgspec.convert(plain, Cell)
    except msgspec.ValidationError as error:
        if str(error).startswith("Object contains unknown field") and "$" not in str(error):
            known = ", ".join(sorted(set(Cell.__struct_fields__) - {"texts"}))
            beside = "; what the mechanism of an installed package reads stands in `mechanisms`, under its name"
            raise ProgramError(f"{source} is not a cell: {error}; a cell has {known}{beside}") from error
        raise ProgramError(f"{source}: {error}{note}") from error


def _with_added_grasps(thing: Object, cell: Cell) -> Object:
    """The object with the grasp points of installed packages (`rtc.grasp_planners`). Raises ProgramError."""
    points = list(thing.grasp_points)
    for name, plan in registry.installed(registry.GRASP_PLANNERS).items():
        try:
            with registry.guarded(registry.GRASP_PLANNERS, name):
                added = _grasp_points(plan(copy.deepcopy(thing), copy.deepcopy(cell)))
            points += [msgspec.structs.replace(point, planner=name) for point in added]
        except PluginError as error:
            raise ProgramError(f"{error}, for {thing.name}") from None
    return msgspec.structs.replace(thing, grasp_points=points)


def _grasp_points(found: Any) -> list[GraspPoint]:
    """What a grasp planner has returned. Raises ValueError and others; JSON has neither NaN nor infinities."""
    text = msgspec.json.encode(found, enc_hook=_of_numpy)
    points = msgspec.json.decode(text, type=list[GraspPoint])
    if len(points) > MOST_ADDED:
        raise ValueError(f"{len(points)} grasp points of one object; {MOST_ADDED} are allowed")
    return points


def _of_numpy(part: Any) -> Any:
    if hasattr(part, "tolist"):
        return part.tolist()
    raise TypeError(f"a grasp point cannot contain a {type(part).__name__}")


def _wrong_pieces(cell: Cell) -> Iterator[tuple[str, str]]:
    """Pieces of packages that are not here, or that have another form. Other processes pass them on unread."""
    for name, piece in cell.mechanisms.items():
        place = f"mechanisms.{name}"
        if why := registry.why_missing(registry.MECHANISMS, name):
            yield place, f"{why}; install the package of the mechanism {name}, or leave its piece out"
            continue
        try:
            with registry.guarded(registry.MECHANISMS, name):
                form = registry.installed(registry.MECHANISMS)[name].piece
                problem = "" if form is None else _misfit(piece, form)
        except PluginError as error:
            form, problem = None, error.problem
        if form is None:
            yield place, problem or f"the mechanism {name} reads nothing of the cell; leave its piece out"
        elif problem:
            yield place, f"{problem}; it has {', '.join(form.__struct_fields__) or 'nothing'}"


def _misfit(piece: Any, form: Any) -> str:
    try:
        msgspec.convert(piece, form)
    except msgspec.ValidationError as error:
        return str(error)
    return ""


def _wrong_subsystems(cell: Cell) -> Iterator[tuple[str, str]]:
    performers = dict.fromkeys((arm.name for arm in cell.arms), "arm") | {one.name: "camera" for one in cell.cameras}
    given: dict[str, str] = {}
    for n, one in enumerate(cell.subsystems):
        for name in one.performers:
            if name not in performers:
                yield f"subsystems[{n}].performers", unknown("arm or camera", name, performers)
            elif given.setdefault(name, one.name) != one.name:
                yield f"subsystems[{n}].performers", f"{name} belongs to {given[name]} already"
        kinds = {performers[name] for name in one.performers if name in performers}
        if len(kinds) != 1:
            yield f"subsystems[{n}].performers", f"{one.name} needs arms or cameras, and not both"
        elif one.estop and kinds == {"camera"}:
            yield f"subsystems[{n}].estop", f"{one.name} has cameras: only a subsystem of arms has a socket for halts"
        elif one.module and not one.estop and kinds == {"arm"}:
            yield f"subsystems[{n}].estop", f"{one.name} moves arms, so it needs a socket for halts: estop: true"
    if len(names := [one.name for one in cell.subsystems]) != len(set(names)):
        yield "subsystems", "a name stands there twice"
    every = resolved(cell.subsystems, [arm.name for arm in cell.arms], [one.name for one in cell.cameras])
    simulated = [one.name for one in every if one.module == ARMS.module]
    if cell.cameras and len(simulated) > 1:
        yield "subsystems", f"cameras are drawn from one simulation, and {' and '.join(simulated)} each have their own"


def problems(cell: Cell) -> Iterator[tuple[str, str]]:
    """(place, problem) for faults that the types do not exclude."""
    if not all(abs(part) <= FAR for part in cell.gravity_m_s2):  # false for nan too
        yield "gravity_m_s2", f"at most {FAR:g} m/s2 along an axis"
    if not cell.arms:
        yield "arms", "a cell needs an arm"
    yield from _repeated_names(cell)
    seats = {seat.name for seat in cell.seats}
    arms = {arm.name: arm for arm in cell.arms}
    bolts = [thing.name for thing in cell.objects if thing.thread is not None]
    taken: dict[str, str] = {}
    for n, arm in enumerate(cell.arms):
        for field in ("home_deg", "stow_deg", "acceleration_deg_s2"):
            if len(getattr(arm, field)) != len(arm.joints):
                yield f"arms[{n}].{field}", f"{len(arm.joints)} joints need as many values"
    for n, seat in enumerate(cell.seats):
        if abs(math.hypot(*seat.way_out) - 1.0) > 1e-6:
            yield f"seats[{n}].way_out", "must be of unit length"
        if seat.detent_nm is not None and seat.detent_nm > seat.detent_n:
            yield f"seats[{n}].detent_nm", "must be at most detent_n: a catch bears at most as many N.m as N"
        for m, bolt in enumerate(seat.bolts):
            if bolt not in bolts:
                yield f"seats[{n}].bolts[{m}]", unknown("object with a thread", bolt, bolts)
    for n, thing in enumerate(cell.objects):
        if thing.seat is not None and thing.seat not in seats:
            yield f"objects[{n}].seat", unknown("seat", thing.seat, seats)
        if thing.seat is not None and taken.setdefault(thing.seat, thing.name) != thing.name:
            yield f"objects[{n}].seat", f"{thing.seat} already holds {taken[thing.seat]}"
        if not thing.shapes:
            yield f"objects[{n}].shapes", "an object needs at least one shape"
        if not thing.fixed and thing.hinge is None:
            yield from ((f"objects[{n}].{field}", problem) for field, problem in _wrong_load(thing))
        if thing.thread is not None and not thing.fixed:
            yield f"objects[{n}].thread", "an object with a thread must be fixed: it only turns"
        if thing.hinge is not None:
            yield from ((f"objects[{n}].{field}", problem) for field, problem in _wrong_hinge(thing, thing.hinge))
    for n, place in enumerate(cell.places):
        for field in ("poses", "joints_deg"):
            for name in getattr(place, field):
                if name not in arms:
                    yield f"places[{n}].{field}.{name}", unknown("arm", name, arms)
        for name, joints in place.joints_deg.items():
            if len(joints) != len(arms[name].joints):
                yield f"places[{n}].joints_deg.{name}", f"{len(arms[name].joints)} joints need as many values"
            elif [isinstance(value, str) for value in joints] != [isinstance(v, str) for v in arms[name].home_deg]:
                yield (
                    f"places[{n}].joints_deg.{name}",
                    "a joint that slides needs metres, one that turns degrees, as home",
                )
    yield from _wrong_hands(cell)
    yield from _wrong_mounts(cell)
    yield from _wrong_subsystems(cell)
    regions = [region.name for region in cell.regions]
    for field in ("safe_work_range", "avoid_task_region"):
        if (name := getattr(cell.maintain, field)) is not None and name not in regions:
            yield f"maintain.{field}", unknown("region", name, regions)
    if (name := cell.maintain.pose_during_motion) is not None and name not in cell.attitudes:
        yield "maintain.pose_during_motion", unknown("attitude", name, cell.attitudes)
    yield from _blind_cameras(cell, arms)
    yield from _loose_tags(cell)


def _wrong_hands(cell: Cell) -> Iterator[tuple[str, str]]:
    things, taken = {thing.name: thing for thing in cell.objects}, dict[str, str]()
    for n, arm in enumerate(cell.arms):
        for m, hand in enumerate(arm.hands):
            place, thing = f"arms[{n}].hands[{m}]", things.get(hand.name)
            if thing is None:
                yield f"{place}.name", unknown("object", hand.name, things)
            elif thing.fixed or thing.hinge is not None:
                yield f"{place}.name", f"{hand.name} is fixed or has a hinge: no arm can take it"
            elif hand.coupling not in (points := [point.name for point in thing.grasp_points]):
                yield f"{place}.coupling", unknown(f"grasp point of {hand.name}", hand.coupling, points)
            if taken.setdefault(hand.name, arm.name) != arm.name:
                yield f"{place}.name", f"{hand.name} fits {taken[hand.name]}: state a hand of its own for {arm.name}"


def _wrong_load(thing: Object) -> Iterator[tuple[str, str]]:
    if thing.mass_kg > HEAVIEST_KG:
        yield "mass_kg", f"a load has at most {HEAVIEST_KG:g} kg"
    if max(thing.inertia_kg_m2 or [0.0]) > MAX_INERTIA_KG_M2:
        yield "inertia_kg_m2", f"a load has at most {MAX_INERTIA_KG_M2:g} kg m2 about each axis"


def _wrong_hinge(thing: Object, hinge: Hinge) -> Iterator[tuple[str, str]]:
    least, most = hinge.range_deg
    if abs(math.hypot(*hinge.axis) - 1.0) > 1e-6:
        yield "hinge.axis", "must be of unit length"
    if not -180.0 < least < most < 180.0:
        yield "hinge.range_deg", "two angles between -180 and 180, the least first"
    elif not least <= hinge.at_deg <= most:
        yield "hinge.at_deg", f"{hinge.at_deg:g} is not within {least:g} to {most:g}"
    if thing.fixed or thing.seat is not None:
        yield "hinge", "an object with a hinge is neither fixed nor in a seat"


def _wrong_mounts(cell: Cell) -> Iterator[tuple[str, str]]:
    bodies = [t.name for t in cell.objects if t.fixed and t.thread is None and t.mounted_on is None]
    for group in ("seats", "objects"):
        for n, part in enumerate(getattr(cell, group)):
            if part.mounted_on is None:
                continue
            place = f"{group}[{n}].mounted_on"
            if part.mounted_on not in bodies:
                yield place, unknown("fixed object that is mounted on nothing", part.mounted_on, bodies)
            elif isinstance(part, Object) and (part.seat is not None or not (part.fixed or part.hinge)):
                yield place, "an object that is mounted is fixed or has a hinge, and is in no seat"


def _blind_cameras(cell: Cell, arms: Mapping[str, Arm]) -> Iterator[tuple[str, str]]:
    for n, camera in enumerate(cell.cameras):
        if camera.arm is not None and camera.arm not in arms:
            yield f"cameras[{n}].arm", unknown("arm", camera.arm, arms)
        elif camera.arm is not None and arms[camera.arm].hands:
            yield f"cameras[{n}].arm", f"{camera.arm} changes its hand: its camera would move with the tcp"
        try:
            _ = camera.pose
        except ValueError as error:
            yield f"cameras[{n}].looks_at", str(error)


def _loose_tags(cell: Cell) -> Iterator[tuple[str, str]]:
    bodies = {seat.name for seat in cell.seats} | {thing.name for thing in cell.objects}
    places: dict[int, int] = {}
    for n, tag in enumerate(cell.tags):
        if tag.body not in bodies:
            yield f"tags[{n}].body", unknown("seat or object", tag.body, bodies)
        if (other := places.setdefault(tag.id, n)) != n:
            yield f"tags[{n}].id", f"{tag.id} is already the id of $.tags[{other}]"


def _repeated_names(cell: Cell) -> Iterator[tuple[str, str]]:
    seen: dict[str, str] = {}
    for group in ("arms", "seats", "objects", "places", "regions", "cameras"):
        for n, part in enumerate(getattr(cell, group)):
            where = f"{group}[{n}]"
            names = [part.name, part.end_effector] if isinstance(part, Arm) else [part.name]
            for name in names:
                if seen.setdefault(name, where) != where:
                    yield f"{where}.name", f"{name} is already the name of $.{seen[name]}"
    for group in ("seats", "objects"):
        for n, body in enumerate(getattr(cell, group)):
            for field in ("shapes", "grasp_points"):
                pieces = [piece.name for piece in getattr(body, field, [])]
                for m, name in enumerate(pieces):
                    if name in pieces[:m]:
                        yield f"{group}[{n}].{field}[{m}].name", f"{name} is used twice"
