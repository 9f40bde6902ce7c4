"""What both clients are made of: addresses, sockets, halt line and heartbeat of one cluster. Only the first Welcome
and halts are waited for here."""

from __future__ import annotations

import itertools
import os
import re
import time
import uuid
from pathlib import Path
from typing import Literal, get_args

from rtc.client.connection import LAST_WORDS_MS, BrokerConnection
from rtc.client.context import ClientContext
from rtc.client.core import SubmittedCommand
from rtc.client.halt import HaltLine, HaltResult, OnRest
from rtc.client.heartbeat import HeartbeatSender
from rtc.client.liveness import BrokerLiveness, Report
from rtc.client.rehearsing import NO_TEST, AboutTest
from rtc.language.refuse import MAX_CHARACTERS
from rtc.protocol import messages as m
from rtc.protocol.outcomes import KeyTrouble, NoCluster, Refusal, RefusalReason, RequestDeclined
from rtc.protocol.traceparent import with_traceparent
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.run_dir import running_settings, supervised
from rtc.runtime.settings import Settings, default_run_dir

NAME_BYTES = 128  # maximum length of a client's name; it becomes part of other names
REST_S = 2.0  # wait for the rest of what was halted
NO_TEXT = re.compile("[\ud800-\udfff]")  # lone surrogates, made by Python of undecodable bytes; not valid in UTF-8

Source = Literal["operator", "aip"]
SOURCES = get_args(Source)


def as_text(sentence: str) -> str:
    """The sentence as valid UTF-8; undecodable characters become U+FFFD, which the parser refuses at its place."""
    return NO_TEXT.sub("\ufffd", sentence)


class ClientSession:
    """The parts of one client. Arguments and errors are those of `rtc.Client`."""

    def __init__(
        self,
        run_dir: str | Path | None = None,
        *,
        name: str | None = None,
        source: Source = "operator",
        need_broker: bool = True,
        halt_if_lost: bool = False,
        key: str | Path | None = None,
        on_silence: Report | None = None,
    ) -> None:
        if source not in SOURCES:
            raise ValueError(f"invalid source {source!r}: it must be {' or '.join(SOURCES)}")
        self.run_dir = Path(run_dir) if run_dir is not None else default_run_dir()
        self.endpoints: Endpoints = running_settings(self.run_dir) if key is None else KeyFile.load(key)
        self.endpoints.endpoint("front")  # raises if the key's role is not that of a client
        self.source: Source = source
        self._life = uuid.uuid4().hex[:8]  # keeps our requests apart from those of another client with this name
        self.name = name or f"client-{os.getpid()}"
        if (length := len(self.name.encode())) > NAME_BYTES or self.name[0] == "\0":
            raise ValueError(f"invalid client name: {length} bytes; the limit is {NAME_BYTES}, the first must not be 0")
        me = f"{self.name}~{self._life}"  # unique, although two clients may have one name
        self._ask_number = itertools.count(1)
        self.context = ClientContext()  # of all its sockets, but those of halts
        self._halt_line = HaltLine(self.context, self.endpoints)
        run = self.endpoints.run if isinstance(self.endpoints, Settings) else ""
        lives = (lambda by_hand: supervised(self.run_dir, by_hand)) if key is None else None
        liveness = BrokerLiveness(str(self.run_dir), lives, on_silence, halt_if_lost)
        self.connection = BrokerConnection(self.context, self.endpoints, me, run, liveness)
        self.core = self.connection.core
        self._heartbeat = HeartbeatSender(self.context, self.endpoints, me) if halt_if_lost else None
        if need_broker:
            try:
                while self.core.welcome is None:
                    self.connection.step(self.core.hello_wait_s(time.monotonic()))
            except (NoCluster, RequestDeclined):
                self.close()
                raise

    def close(self) -> None:
        """Close all sockets. Commands in progress continue."""
        if self._heartbeat is not None:
            self._heartbeat.close()
        self._halt_line.close()
        self.connection.close()
        self.context.destroy(linger=LAST_WORDS_MS)  # also closes the sockets of `events` and `telemetry`

    @property
    def where(self) -> str:
        """The cluster, for people: its run directory, or the address of its gateway."""
        return self.endpoints.address if isinstance(self.endpoints, KeyFile) else str(self.run_dir)

    @property
    def settings(self) -> Settings:
        """Settings of a cluster on this machine. Raises KeyTrouble for a cluster that is reached by a key."""
        if not isinstance(self.endpoints, Settings):
            raise KeyTrouble("the settings of a cluster on another machine are not available over tcp")
        return self.endpoints

    @property
    def far(self) -> bool:
        """Whether the cluster is reached over tcp, by a key."""
        return bool(self.endpoints.far)

    @property
    def round_trip_s(self) -> float:
        """To the broker and back, over tcp (s); 0 on the cluster's machine. Waits for answers are longer by it."""
        return self.core.round_trip_s

    def next_request(self) -> str:
        """A name for a request that no other request has."""
        return f"{self.name}/{self._life}-{next(self._ask_number)}"

    def send(
        self,
        command: SubmittedCommand,
        *,
        progress: bool = True,
        traceparent: str = "",
        about: AboutTest = NO_TEST,
        saved: m.SavedWorld | None = None,
    ) -> None:
        """Send the sentence of a command, with the next exchange of frames. Raises ValueError for an invalid trace
        context."""
        request = self.next_request()
        sentence = m.CommandText(
            request=with_traceparent(request, traceparent) if traceparent else request,
            text=as_text(command.text)[: 2 * MAX_CHARACTERS],  # cut for the wire; still refused by the parser
            source=self.source,
            progress=progress,
            halt_if_lost=self._heartbeat is not None,
            saved=saved,
            sent_at_s=time.monotonic(),  # a repeat after a halt keeps this time, so that the halt covers it
            if_tested=about.if_tested,
            after_test=about.after_test,
            label=about.label,
        )
        self.core.submit(command, sentence, time.monotonic())

    def program_text(self, kind: str, name: str, text: bytes) -> m.ProgramText:
        """A request to load a program. Raises RequestDeclined for one that is too long."""
        if len(text) > m.PROGRAM_BYTES:
            words = f"{name} has {len(text):,} bytes; the limit is {m.PROGRAM_BYTES:,}"
            raise RequestDeclined(Refusal(reason=RefusalReason.PROGRAM, message=words))
        return m.ProgramText(request=self.next_request(), kind=m.WorkerKind(kind.lower()), name=name, body=text)

    def halt(self, scope: str = "ALL", timeout_s: float | None = None, on_rest: OnRest | None = None) -> HaltResult:
        """Stop motion now: ALL, an arm, or a command C-n. The order goes to broker and MCM at once, past all queues.

        Returns when rest is confirmed (`confirmed`) or `timeout_s` has passed: None is 2 s, and over tcp the round trip
        in addition. `on_rest` is called at once with a subsystem that has come to rest while others have not, and the
        names of these. Any thread may call it. Raises ClusterError if neither broker nor MCM could be reached.
        """
        round_trip_s = self.round_trip_s
        limit_s = REST_S + round_trip_s if timeout_s is None else timeout_s
        return self._halt_line.halt(scope, limit_s, round_trip_s, on_rest)

    def halt_ready(self) -> bool:
        """True once the halt sockets of broker and MCM are both connected."""
        return self._halt_line.ready()
