"""The stream of events: refused sentences, floods, and noise of subscribers."""

from __future__ import annotations

from typing import Any

from broker.router.egress import NOTES_PER_S, REFUSALS_PER_S
from broker.router.event_stream import PERIOD_S
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.versions import VERSION
from tests.broker.router.bench import Bench


def test_noise_at_the_event_stream_does_not_cut_listeners_off(bench: Bench) -> None:
    events = bench.sockets["events"]
    for frame in (b"\1", b"junk", b"", b"\0other", b"\0other", b"\xff"):
        events.put([frame])
    bench.turn()
    bench.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert events.sent
    events.put([b"\0"])
    bench.turn()
    events.sent.clear()
    bench.send("front", b"ann", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert not events.sent


def subscribe(bench: Bench) -> None:
    bench.sockets["events"].put([b"\1"])
    bench.turn()


def published(bench: Bench, kind: type) -> list[Any]:
    """The events of this kind that were published until PERIOD_S from now."""
    bench.now += PERIOD_S
    bench.turn()
    read = wire.reader(m.Event)
    return [event for parts in bench.sockets["events"].sent if isinstance(event := read(parts), kind)]


def test_an_event_after_a_silence_is_published_at_once_and_those_that_follow_it_together(working: Bench) -> None:
    subscribe(working)
    sent = working.sockets["events"].sent
    working.send("front", b"ann", m.CommandText(request="2", text="STOW LEFT-ARM"))
    first = len(sent)
    assert first
    working.send("front", b"ann", m.CommandText(request="3", text="STOW RIGHT-ARM"))
    assert len(sent) == first
    assert working.router.wait_s() <= PERIOD_S
    working.now += PERIOD_S
    working.turn()
    assert len(sent) > first


def test_a_halt_is_published_at_once_after_the_events_before_it(working: Bench) -> None:
    subscribe(working)
    for number, arm in enumerate(("LEFT-ARM", "RIGHT-ARM")):
        working.send("front", b"ann", m.CommandText(request=f"stow {number}", text=f"STOW {arm}"))
    working.send("halt", b"bob", m.HaltOrder(halt="H-bob", scope="ALL"))
    read = wire.reader(m.Event)
    sent = [read(parts) for parts in working.sockets["events"].sent]
    (halt,) = (n for n, event in enumerate(sent) if isinstance(event, m.HaltRequested))
    assert {event.command for event in sent[:halt]} == {"C-2", "C-3"}


def test_a_refused_request_is_published_with_its_sentence(working: Bench) -> None:
    subscribe(working)
    working.send("front", b"ann", m.CommandText(request="1", text="another sentence"))
    (refused,) = published(working, m.RequestRefused)
    assert (refused.request, refused.text, refused.refusal.reason) == ("1", "another sentence", RefusalReason.STATE)


def test_a_flood_of_refused_requests_does_not_drown_the_event_stream(working: Bench) -> None:
    """Given refused sentences above the published rate, the rest is counted, and a command's events are published."""
    subscribe(working)
    again = m.CommandText(request="1", text="another sentence")
    answers = working.send("front", b"ann", *[again] * (REFUSALS_PER_S + 50))
    assert len(answers) == REFUSALS_PER_S + 50  # each sender gets its answer
    assert len(published(working, m.RequestRefused)) == REFUSALS_PER_S
    assert working.router.core.dropped["refusals"] == 50
    working.send("front", b"bob", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert published(working, m.ProgressNote)
    working.now += 1.0
    working.send("front", b"ann", again)
    assert len(published(working, m.RequestRefused)) == REFUSALS_PER_S + 1


def test_a_flood_of_commands_publishes_a_limited_number_of_notes(working: Bench) -> None:
    subscribe(working)

    def flood(how_many: int) -> None:
        for first in range(0, how_many, 100):
            numbers = range(first, first + 100)
            texts = (m.CommandText(request=str(n), text="STOW LEFT-ARM", progress=False) for n in numbers)
            hello = m.ClientHello(protocol=VERSION, client="ann", at_s=working.now)
            working.send("front", f"ann-{first // 1000}".encode(), hello, *texts)

    flood(NOTES_PER_S + 1000)
    notes = len(published(working, m.ProgressNote))
    assert NOTES_PER_S < notes < NOTES_PER_S + 500
    working.now += 1.0
    working.send("front", b"bob", m.CommandText(request="1", text="STOW LEFT-ARM"))
    working.send("front", b"bob", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert len(published(working, m.ProgressNote)) > notes
