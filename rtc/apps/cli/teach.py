"""rtc teach: a place where an arm stands now gets a name, which sentences may use; kept for the next runs."""

from __future__ import annotations

from typing import Annotated

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.cluster_cell import cell_of
from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, emit_json, exit_code, table
from rtc.apps.cli.progress import print_result
from rtc.client.client import Client
from rtc.model.cells import taught, taught_file
from rtc.model.cells.cell import Cell
from rtc.model.cells.taught import Postures
from rtc.protocol.outcomes import NoCluster, OutcomeKind


def teach(
    place: Annotated[str, typer.Argument(help="A name for the place, such as P1.", show_default="list them")] = "",
    arm: Annotated[str, typer.Argument(help="The arm that stands there, by its name.", show_default="")] = "",
    forget: Annotated[bool, typer.Option("--forget", help="Forget the place, for this arm or for all.")] = False,
    json: AsJson = False,
    run_dir: RunDir = None,
) -> None:
    """Give the place where an arm stands a name. Sentences use it like a place of the cell: MOVE RIGHT-ARM TO P1.

    It is kept for all later runs of this cell. Without arguments the taught places are listed. Refused for a name that
    is taken, for an arm whose joints are not sure, and near a joint limit.

    Example:  rtc teach P1 RIGHT-ARM
    Example:  rtc teach P1 --forget
    """
    cell = Cell.load(cell_of(run_dir))
    place, arm = (word.upper().replace("_", "-") for word in (place, arm))
    if not place:
        _list(cell, _known(cell, run_dir), json)
        return
    if not (arm or forget):
        raise cli_error(f"which arm stands at {place}? For example: rtc teach {place} {cell.arms[0].name}", 2)
    try:
        with Client(run_dir) as client:
            arms = [arm] if arm else list(_of_world(client).get(place, {}))
            if not arms:
                raise cli_error(f"there is no taught place {place}; `rtc teach` lists them", 2)
            for one in arms:
                _set(client, place, one, "NONE" if forget else "HERE")
            known = _of_world(client)
    except NoCluster:
        if not forget:
            raise
        known = taught_file.load(cell)
        if known.get(place) is None or (arm and arm not in known[place]):
            raise cli_error(f"there is no taught place {f'{place} of {arm}' if arm else place}", 2) from None
        known = _without(known, place, arm)
    _save(cell, known)
    if json:
        emit_json({"place": place, "arms": known.get(place, {})})
    else:
        console.print(Text(f"{place} is forgotten" if forget else f"{place}: use it like MOVE {arm} TO {place}"))


def with_taught(cell: Cell, run_dir: RunDir) -> Cell:
    """The cell, with the taught places among its places."""
    places = [*cell.places, *taught.as_places(cell, _known(cell, run_dir))]
    return msgspec.structs.replace(cell, places=places)


def _set(client: Client, place: str, arm: str, value: str) -> None:
    """Raises typer.Exit, with the reason printed, if it is refused."""
    ended = client.run(f"SET {place} POSTURE-OF-{arm} {value}")
    if ended.outcome.kind is not OutcomeKind.SUCCEEDED:
        print_result(ended, ended.text, console)
        raise typer.Exit(exit_code([ended.outcome.kind]))


def _of_world(client: Client) -> Postures:
    return taught.postures((fact.key, fact.value) for fact in client.world.view().facts)


def _known(cell: Cell, run_dir: RunDir) -> Postures:
    """Those of the running cluster; without one, those in the file."""
    try:
        with Client(run_dir, need_broker=False) as client:
            return _of_world(client)
    except NoCluster:
        try:
            return taught_file.load(cell)
        except (OSError, msgspec.MsgspecError) as error:
            raise cli_error(f"{taught_file.file_of(cell)} cannot be read: {error}") from None


def _without(known: Postures, place: str, arm: str) -> Postures:
    rest = {one: joints for one, joints in known[place].items() if arm and one != arm}
    others = {name: by_arm for name, by_arm in known.items() if name != place}
    return others | ({place: rest} if rest else {})


def _save(cell: Cell, known: Postures) -> None:
    try:
        taught_file.save(cell, known)
    except OSError as error:
        raise cli_error(f"it is known until `rtc down`, but cannot be kept: {error}") from None


def _list(cell: Cell, known: Postures, json: bool) -> None:
    if json:
        emit_json({"cell": cell.name, "places": known})
        return
    if not known:
        console.print(f"no place was taught in the cell {cell.name}; for example: rtc teach P1 {cell.arms[0].name}")
        return
    out = table("place", "arm", "joints")
    places = taught.as_places(cell, known)
    for place in places:
        for arm, joints in place.joints_deg.items():
            values = " ".join(value if isinstance(value, str) else f"{value:.2f}" for value in joints)
            out.add_row(place.name, arm, f"{values} deg")
    console.print(out)
