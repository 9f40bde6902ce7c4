"""Does any value in the code, a file or a message of a user end the arms' process or the broker, or keep HALT waiting?

    python -m tests.campaigns.odd_values [--seconds 3600] [--seed 1] [--door packages] [--mcm kinematic]

A package is installed whose every function does what a file says: odd values, exceptions, exits, forks, endless loops,
memory without end. Other doors: facts of `rtc world restore` and SET, a file of taught places, programs to load,
messages without a hello, breakpoints, the twists of an operator, requests and sockets of the page. One attack follows
another; during each one a second client halts, and all that was sent must be answered.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import json
import math
import os
import random
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

import msgspec
import zmq

from benchmarks.report import finish, percentile, question
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import RtcError
from rtc.protocol.versions import VERSION
from rtc.runtime.process_table import processes
from rtc.runtime.settings import Settings
from tests.apps.console.flood import Pages, frame
from tests.campaigns import RESULTS, hostile

ARMS = ("broker", "MCM")  # what must never die
HALT_LIMIT_S = 0.05  # of the MCM, from its receipt of an order until the arm brakes
WHOLE_LIMIT_S = 1.0  # of the same from the call on: on a busy machine the caller waits for a processor
AGAIN_S = 1.0  # after which a client that has asked too often may ask again
ANSWER_S = 90.0  # for any sentence: two workers may die of it first
SENTENCE = "MOVE RIGHT-ARM BY {} CM ALONG Z"
ODD = [math.nan, math.inf, -1e308, 1e308, "x", "", None, [], {}, [[]], [math.nan] * 6, "\ud800", -1, 2**70, True]

CODE = """
import json, os, time
def act(where, value=None):
    try:
        wanted, what = json.load(open({mode!r}))
    except (OSError, ValueError):
        return value
    if wanted != where:
        return value
    kind = what[0]
    if kind == "value": return what[1]
    if kind == "raise": raise [RuntimeError, SystemExit, KeyboardInterrupt, MemoryError, RecursionError][what[1]]("odd")
    if kind == "loop":
        while True: pass
    if kind == "library": return sum(range(10**12))
    if kind == "sleep": time.sleep(1000.0)
    if kind == "memory": return len(bytearray(12_000_000_000))
    if kind == "list":
        kept = []
        while True: kept.append([0.0] * 100_000)
    if kind == "exit": os._exit(0)
    if kind == "kill": os.kill(os.getpid(), 9)
    if kind == "fork":
        if os.fork() == 0: time.sleep(1000.0)
    if kind == "object": return object()
    if kind == "large": return "x" * 20_000_000
    if kind == "close": os.closerange(3, 200)
    return value
def item(arm): return act("item", 1.0)
def score(option): return act("score", 0.0)
def plan(request, goal): return act("plan")
def phase(data, product): return act("phase", product)
def choose(data, entries): return act("trim")
def solve(arm, target, near): return act("ik", [])
def times(arm, path, pace, load): return act("time")
class Law:
    def __init__(self, model, gains):
        from sim_mcm.arms.control_laws import ComputedTorque
        self.own = ComputedTorque(model, gains)
        act("factory")
    def torque(self, wanted, q, v): return act("law", self.own.torque(wanted, q, v))
"""
ENTRIES = {
    **{"rtc.report_items": ("ODD", "item"), "rtc.evaluators": ("ODD", "score"), "rtc.planners": ("ODD", "plan")},
    **{"rtc.phases": ("ODD", "phase"), "rtc.trimmers": ("ODD", "choose"), "rtc.ik": ("ODD", "solve")},
    **{"rtc.timing": ("ODD", "times"), "rtc.control_laws": ("odd", "Law")},
}
_PLANNED = "planners: [ODD, own]\nik: [ODD, own]\ntiming: [ODD, own]"
#: kind of worker -> what its program names besides a phase
NAMED = {"elaborator": f"{_PLANNED}\nevaluators: [ODD]", "binder": _PLANNED, "analyzer": "trimmers: [ODD, stack]"}
SLOW = ("loop", "sleep", "library")
PLACES = ("item", "score", "plan", "phase", "trim", "ik", "time")
DEEDS: list[list[Any]] = [
    *([["value", value] for value in ODD if value != "\ud800"]),
    *([["raise", number] for number in range(5)]),
    *([[deed] for deed in ("object", "large", "fork", "memory", "list", "exit", "kill", "loop", "sleep", "close")]),
    ["library"],
]


@contextmanager
def odd_package(folder: Path) -> Iterator[Path]:
    """A package for the processes that begin meanwhile. Its mode is written to the file that is given."""
    mode, info = folder / "mode", folder / "odd_rtc-1.dist-info"
    info.mkdir(parents=True)
    (folder / "odd_rtc.py").write_text(CODE.replace("{mode!r}", repr(str(mode))))
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: odd-rtc\nVersion: 1\n")
    entries = (f"[{group}]\n{name} = odd_rtc:{target}\n" for group, (name, target) in ENTRIES.items())
    (info / "entry_points.txt").write_text("".join(entries))
    before = {name: os.environ.get(name) for name in ("PYTHONPATH", "XDG_DATA_HOME")}
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(folder), before["PYTHONPATH"])))
    os.environ["XDG_DATA_HOME"] = str(folder / "data")
    taught = folder / "data" / "rtc" / "places" / "swapout.json"
    taught.parent.mkdir(parents=True)
    taught.write_text(json.dumps({"FAR": {"RIGHT-ARM": [9.0] * 6}, "OUT": {"RIGHT-ARM": [1e308] * 6}}))
    try:
        yield mode
    finally:
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.__setitem__(name, value)


def _is_for(request: str, message: dict[str, Any]) -> bool:
    return bool(message.get("request") == request)


class Peer:
    """A client of plain messages at one socket of a cluster."""

    def __init__(self, context: zmq.Context[Any], settings: Settings, name: str, hello: bool = False) -> None:
        self._socket = context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.IDENTITY, uuid.uuid4().hex.encode())
        self._socket.connect(settings.endpoint(name))
        self.ended: dict[str, str] = {}  # request of a sentence that has ended -> kind of its end
        if hello:
            self.say(type="ClientHello", protocol=VERSION, client="odd_values", at_s=time.monotonic(), abilities=[])
            assert self.receive(10.0, lambda message: message["type"] == "Welcome")

    def say(self, **message: Any) -> None:
        self._socket.send_multipart([b"RTC1", msgspec.msgpack.encode(message)])

    def receive(self, for_s: float, wanted: Callable[[Any], bool] = lambda _: True) -> Any:
        end_s = time.monotonic() + for_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            if self._socket.poll(int(1000 * left_s) + 1):
                message = msgspec.msgpack.decode(self._socket.recv_multipart()[-1])
                if message.get("type") == "CommandEnded":
                    self.ended[message["request"]] = message["outcome"]["kind"]
                if wanted(message):
                    return message
        return None

    def answer(self, for_s: float = 60.0, **question: Any) -> Any:
        """The answer to a question, which is asked again while the broker says that there are too many. None: there is
        no answer in time."""
        end_s = time.monotonic() + for_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            request = uuid.uuid4().hex
            self.say(request=request, **question)
            found = self.receive(left_s, partial(_is_for, request))
            if found is None or found["type"] != "Declined" or found["refusal"]["reason"] != "overload":
                return found
            self.receive(AGAIN_S, lambda _: False)
        return None

    def outcome(self, text: str, for_s: float = ANSWER_S, **more: Any) -> str:
        """Kind and message of the end of a sentence. "" without one in time."""
        request = uuid.uuid4().hex
        self.say(type="CommandText", request=request, text=text, sent_at_s=time.monotonic(), **more)
        ends = ("CommandEnded", "Declined")
        found = self.receive(for_s, lambda message: message["type"] in ends and message["request"] == request)
        if found is None:
            return ""
        if found["type"] == "Declined":
            return f"declined {found['refusal']['message']}"
        return f"{found['outcome']['kind']} {found['outcome'].get('message', '')}"

    def close(self) -> None:
        self._socket.close(linger=0)


@dataclass
class Noticed:
    attacks: Counter[str] = field(default_factory=Counter)
    deaths: Counter[str] = field(default_factory=Counter)  # of processes by name
    halts_s: list[float] = field(default_factory=list)  # from the call until the arm has begun to brake
    own_s: list[float] = field(default_factory=list)  # of that in the MCM
    wrong: list[str] = field(default_factory=list)


class Doors:
    """Attacks on one cluster. Each returns a complaint, or ''."""

    def __init__(self, run_dir: Path, mode: Path, seed: int, page: Pages | None = None, slow: bool = True) -> None:
        """`slow`: with what takes its worker many seconds."""
        self._deeds = DEEDS if slow else [one for one in DEEDS if one[0] not in SLOW]
        self.run_dir, self.mode, self.page = run_dir, mode, page
        self.rng, self.settings = random.Random(seed), Settings.load(run_dir)
        self.context: zmq.Context[Any] = zmq.Context()
        self.peer = Peer(self.context, self.settings, "front", hello=True)
        self.noticed = Noticed()
        self._pids = self.pids()
        self._ways = 0
        self._name_all()

    def _name_all(self) -> None:
        """Load programs that name the package wherever it can act."""
        for kind, more in NAMED.items():
            self._load(kind, f"phases: [ODD]\n{more}")

    def _load(self, kind: str, body: str, name: str = "odd.yaml") -> Any:
        return self.peer.answer(type="ProgramText", kind=kind, name=name, body=body.encode())

    # --- the doors --------------------------------------------------------------------------------------

    def packages(self) -> str:
        place, deed = self.rng.choice(PLACES), self.rng.choice(self._deeds)
        answer = self._beside(place, deed)
        if answer and not _names_it(answer):  # other attacks may have left the arm where it has no room
            home = self.peer.outcome("STOW RIGHT-ARM")
            answer = self._beside(place, deed) if home.startswith("succeeded") else f"STOW RIGHT-ARM: {home}"
        if not answer:
            return f"{place} {deed}: no answer in {ANSWER_S:g} s; live: {self._live()}"
        return "" if _names_it(answer) else f"{place} {deed}: {answer[:200]}"

    def _beside(self, place: str, deed: list[Any]) -> str:
        """The outcome of a short motion while the function of the package at this place does what it should not."""
        self.mode.write_text(json.dumps([place, deed]))
        self._ways += 1
        distance = 1 if self._ways % 2 else -1
        report = " REPORT ODD" if place == "item" else ""
        answer = self.peer.outcome(SENTENCE.format(distance) + report)
        self.mode.write_text("")
        self._name_all()  # a failed first job has rolled them back
        return answer

    def _live(self) -> str:
        """The commands that have not ended, and what each waits for."""
        found = self.peer.answer(type="StatusQuery")
        rows = found["status"]["commands"] if found else []
        return "; ".join(f"{row['command']} {row['text'][:40]!r}: {row['phase']} {row['step']}" for row in rows)

    def facts(self) -> str:
        view = Peer(self.context, self.settings, "world")
        view.say(type="ReadView", request="r", keys=None, since=0)
        found = view.receive(10.0)
        view.close()
        kept = ("value", "validity", "spread")
        facts = {one["key"]: {name: one[name] for name in kept if name in one} for one in found["facts"]}
        hurt = copy.deepcopy(facts)
        for key in self.rng.sample(sorted(facts), self.rng.choice((1, 2, 5))):
            self._hurt(hurt, key, hurt[key])
        status = self.peer.answer(type="StatusQuery")["status"]
        saved = {"cell": status["programs"]["cell"], "facts": hurt}
        answers = [self.peer.outcome("SET WORLD FACTS SAVED", saved=saved), self.peer.outcome(SENTENCE.format(0.2))]
        answers.append(self.peer.outcome("TEST GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM"))
        saved["facts"] = facts
        answers.append(self.peer.outcome("SET WORLD FACTS SAVED", saved=saved))
        return next((f"facts: {one or 'no answer'}" for one in answers if not one or "killed its worker" in one), "")

    def _hurt(self, facts: dict[str, Any], key: str, fact: dict[str, Any]) -> None:
        rng = self.rng
        value = fact["value"]
        part = rng.choice(("value", "value", "number", "spread", "validity", "key"))
        if part == "number" and isinstance(value, list) and value:
            value[rng.randrange(len(value))] = rng.choice(hostile.FLOATS)
        elif part == "spread":
            fact["spread"] = [rng.choice(hostile.FLOATS)] * rng.choice((6, 6, 1))
        elif part == "validity":
            fact["validity"] = rng.choice(("valid", "suspect", "changing", "certain"))
        elif part == "key":
            facts[rng.choice(hostile.NAMES[:24])] = fact
        else:
            fact["value"] = rng.choice([*ODD[:10], *hostile.NAMES[:24], 1e308, [0.0] * 7])

    def sentences(self) -> str:
        number = self.rng.choice(("1e308", "-1e308", "1e-308", "0", "99999999999999999999", "-0"))
        text = self.rng.choice(
            (
                f"SET MACS-NEW mass {number} KG",
                f"SET MACS-NEW frame {number} {number} 0 MM 0 0 0 DEG",
                f"MOVE RIGHT-ARM BY {number} CM ALONG Z",
                f"MOVE RIGHT-ARM TO JOINTS {number} 0 0 0 0 0 DEG",
                f"TURN RIGHT-ARM BY {number} DEG ABOUT TOOL-Z",
                f"TEST MOVE RIGHT-ARM BY {number} MM ALONG X MAINTAIN SPEED {number} CM/S",
                f"HOLD RIGHT-ARM FOR {number} SEC",
                *("MOVE RIGHT-ARM TO FAR", "MOVE RIGHT-ARM TO OUT", 'CANNOT ""', "\0", "STOW " * 500),
            )
        )
        later = threading.Timer(2.0, self.halt)  # a hold of 1e308 s ends by it
        later.start()
        answer = self.peer.outcome(text)
        later.cancel()
        later.join()
        return "" if answer and "killed its worker" not in answer else f"{text[:60]}: {answer or 'no answer'}"

    def programs(self) -> str:
        kind = self.rng.choice(("elaborator", "binder", "analyzer", "parser"))
        body = self.rng.choice(
            (
                *(
                    "phases: [NOPE]",
                    "phases: 7",
                    "[" * 5000,
                    "a: &a [*a]",
                    "x: 1",
                    "\ud800".encode("utf-8", "replace").decode(),
                ),
                *(
                    "decision_tree: [{verb: FLY, script: stow}]",
                    "steps: []",
                    "{}",
                    "trimmers: [NOPE]",
                    "phases: [ODD, ODD]",
                ),
                "script: stow\ncase: 1\nuses: [hand]\nsteps: [{do: hold, stop: hold, label: w, args: {n: .inf}}]",
            )
        )
        answer = self._load(kind, body)
        self._load(kind, "phases: []") if kind != "parser" else None
        return "" if answer else f"program {body[:40]!r}: no answer"

    def messages(self) -> str:
        """Without a hello, and with odd values."""
        stranger = Peer(self.context, self.settings, "front")
        stranger.say(type="CommandText", request="q", text="STOW LEFT-ARM", sent_at_s=time.monotonic())
        answer = stranger.receive(10.0)
        verb, step = self.rng.choice(hostile.NAMES), self.rng.choice(hostile.INTEGERS)
        stranger.say(type="SetBreakpoints", request="b", breakpoints=[{"verb": verb, "step": step}])
        points = stranger.receive(10.0)
        stranger.close()
        attacker = hostile.Attacker(self.context, self.settings, self.rng.choice([*hostile.ACCEPTED]), self.rng)
        attacker.send(100)
        attacker.close()
        declined = [one is not None and one["type"] == "Declined" for one in (answer, points)]
        return "" if all(declined) else f"without a hello: {answer} {points}"

    def twists(self) -> str:
        request = uuid.uuid4().hex
        self.peer.say(
            type="CommandText", request=request, text="GIVE RIGHT-ARM TO OPERATOR", sent_at_s=time.monotonic()
        )
        telemetry = self.context.socket(zmq.SUB)
        telemetry.setsockopt(zmq.SUBSCRIBE, b"")
        telemetry.connect(self.settings.endpoint("telemetry"))
        end_s, primitive = time.monotonic() + 10.0, ""
        while not primitive and time.monotonic() < end_s:
            if telemetry.poll(100):
                arm = msgspec.msgpack.decode(telemetry.recv_multipart()[-1])["arms"]["RIGHT-ARM"]
                primitive = arm["primitive"] if arm.get("operation") else ""
        telemetry.close(linger=0)
        hand, unanswered = Peer(self.context, self.settings, "operate"), 0
        for _ in range(40):
            twist = [self.rng.choice([*hostile.FLOATS, 0.01, 0.1]) for _ in range(self.rng.choice((6, 6, 6, 5, 0)))]
            odd = self.rng.random() < 0.2
            hand.say(
                type=self.rng.choice(("Operate", "Odd")) if odd else "Operate",
                **{"primitive": primitive, "operator": "X", "seen_at_s": time.monotonic(), "hold": True},
                **{
                    "frame": self.rng.choice(("tool", "world")),
                    "twist": twist,
                    "turn": self.rng.choice(hostile.FLOATS),
                },
            )
            unanswered += hand.receive(5.0) is None
        hand.close()
        taken, end_s = "", time.monotonic() + ANSWER_S
        # It may not have begun, or still move. A twist may also have ended it, at a joint limit, say.
        while not self._is_over(request, taken) and time.monotonic() < end_s:
            taken = self.peer.outcome("TAKE RIGHT-ARM FROM OPERATOR")
        if unanswered or not self._is_over(request, taken):
            return f"twists: {unanswered} without an answer, TAKE {taken or 'no answer'}; live: {self._live()}"
        return ""

    def _is_over(self, request: str, taken: str) -> bool:
        """Whether the operator has no arm: TAKE has succeeded, or the GIVE of this request has ended."""
        return taken.startswith("succeeded") or request in self.peer.ended

    def pages(self) -> str:
        if self.page is None:
            return ""
        odd = self.rng.choice([*ODD[2:11], *hostile.INTEGERS, {"a": [1]}, 1.5])
        path = self.rng.choice(
            ("/check", "/check", "/sentence", "/why/C-1", f"/why/{self.rng.randrange(9)}%00", "/nope")
        )
        given = self.rng.choice(({"text": "MOVE RIGHT-ARM ", "at": odd}, {"text": odd, "at": 3}, odd, {"scope": odd}))
        body = json.dumps(given).encode() if path in ("/check", "/sentence") else None
        headers = {"Origin": self.page.base, "Cookie": self.page.cookie, "Content-Type": "application/json"}
        try:
            with urlopen(Request(self.page.base + path, body, headers), timeout=30.0) as answer:
                status = answer.status
        except HTTPError as error:
            status = error.code
        except (URLError, TimeoutError, OSError) as error:
            return f"page {path} {given!r:.60}: {error}"
        with contextlib.suppress(OSError, AssertionError):
            line = self.page.socket(self.rng.choice(("/poses", "/story", "/operate", "/halt")))
            line.sendall(frame(json.dumps(given)[:125], self.rng.choice((1, 2, 9, 5))))
            line.close()
        return f"page {path} {given!r:.60}: {status}" if status >= 500 else ""

    # --- what others notice --------------------------------------------------------------------------------

    def attack(self, name: str) -> None:
        """One attack, with halts of another client meanwhile."""
        over = threading.Event()
        halting = threading.Thread(target=self._halt_until, args=(over,))
        halting.start()
        try:
            complaint = getattr(self, name)()
        finally:
            over.set()
            halting.join()
        self.noticed.attacks[name] += 1
        if complaint:
            self.noticed.wrong.append(complaint)
        now = self.pids()
        for process, pid in self._pids.items():
            self.noticed.deaths[process] += now.get(process, pid) != pid
        self._pids = now

    def _halt_until(self, over: threading.Event) -> None:
        """Halts of an arm that no attack moves."""
        with Client(self.run_dir) as rtc:
            while True:
                self.halt(rtc)
                if over.wait(0.25):
                    return

    def halt(self, rtc: Client | None = None) -> None:
        with contextlib.nullcontext(rtc) if rtc is not None else Client(self.run_dir) as client:
            try:
                halted = client.halt("LEFT-ARM" if rtc is not None else "ALL")
            except RtcError as error:
                self.noticed.wrong.append(f"a halt: {error}")
                return
        if not halted.confirmed or halted.latency_s is None:
            self.noticed.wrong.append(f"a halt: {halted.message}")
        else:
            self.noticed.halts_s.append(halted.latency_s)
            found = (sub for sub in halted.subsystems if sub.latency_s is not None and sub.receipt_s is not None)
            self.noticed.own_s.append(max(sub.latency_s - sub.receipt_s for sub in found))

    def pids(self) -> dict[str, int]:
        return {name: row.pid for name, row in processes(self.run_dir).items() if "template" not in name and row.pid}

    def late_halts(self) -> int:
        noticed = self.noticed
        late = zip(noticed.own_s, noticed.halts_s, strict=True)
        return sum(own_s > HALT_LIMIT_S or whole_s > WHOLE_LIMIT_S for own_s, whole_s in late)

    def close(self) -> None:
        self.peer.close()
        self.context.destroy(linger=0)


def _names_it(answer: str) -> bool:
    """Whether the outcome of a motion is that of a healthy cluster, or names the package."""
    return answer.startswith(("succeeded", "halted")) or "ODD" in answer


DOORS = ("packages", "facts", "sentences", "programs", "messages", "twists", "pages")


def main() -> int:
    from tests.apps.console.test_in_browser import Gateway

    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.odd_values", description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--door", action="append", choices=DOORS, help="only this one (may be repeated)")
    parser.add_argument("--mcm", default="kinematic", choices=("kinematic", "bullet"))
    given = parser.parse_args()
    question("odd_values", "Does a value of a user end the arms' process, or keep HALT waiting?", seed=given.seed)
    with (
        tempfile.TemporaryDirectory() as folder,
        odd_package(Path(folder) / "package") as mode,
        own_cluster(mcm=given.mcm) as run_dir,
    ):
        gateway = Gateway(run_dir)
        doors = Doors(run_dir, mode, given.seed, Pages.admitted(gateway.link))
        end_s = time.monotonic() + given.seconds
        while time.monotonic() < end_s:
            name = doors.rng.choice(given.door or DOORS)
            before = len(doors.noticed.wrong)
            doors.attack(name)
            for complaint in doors.noticed.wrong[before:]:
                print(f"  {name}: {complaint}", flush=True)
        gateway.end()
        doors.close()
    noticed = doors.noticed
    metrics: dict[str, float | None] = {
        "attacks": float(noticed.attacks.total()),
        "deaths": float(sum(noticed.deaths[name] for name in ARMS)),
        "deaths_of_workers": float(sum(n for name, n in noticed.deaths.items() if "@" in name)),
        "wrong": float(len(noticed.wrong)),
        "halts": float(len(noticed.halts_s)),
        "late_halts": float(doors.late_halts()),
        "halt_p50_ms": 1e3 * percentile(noticed.halts_s, 50),
        "halt_p99_ms": 1e3 * percentile(noticed.halts_s, 99),
        "halt_worst_ms": 1e3 * max(noticed.halts_s, default=0.0),
        "halt_own_worst_ms": 1e3 * max(noticed.own_s, default=0.0),
    }
    rows = [(name, str(n)) for name, n in noticed.attacks.items()]
    rows += [(f"deaths of {name}", str(n)) for name, n in noticed.deaths.items() if n]
    finish("odd_values", metrics, rows, RESULTS)
    return int(bool(metrics["deaths"] or metrics["late_halts"] or metrics["wrong"]))


if __name__ == "__main__":
    sys.exit(main())
