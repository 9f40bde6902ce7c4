"""Leases: write permissions, signed by the broker for one job and its locations (A25). Pure.

The world database checks them. The signature is HMAC-SHA256 over the MessagePack of [job, sorted locations], with the
key in the run directory, which only its owner can read. It prevents mistakes, not an intruder with the same user id.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable

from rtc.protocol import wire
from rtc.protocol.messages import Lease

KEY_BYTES = 32
KEY_FILE = "lease.key"  # in the run directory
DOUBT = "doubt/"  # prefix of the job of a lease that makes all facts suspect


def sign(key: bytes, job: str, locations: Iterable[str]) -> Lease:
    """A lease for these locations, sorted and without duplicates."""
    places = sorted(set(locations))
    return Lease(job=job, locations=places, signature=_signature(key, job, places))


def check(key: bytes, lease: Lease) -> bool:
    """True if the broker of this cluster signed the lease."""
    return hmac.compare_digest(lease.signature, _signature(key, lease.job, sorted(set(lease.locations))))


def _signature(key: bytes, job: str, places: list[str]) -> bytes:
    return hmac.digest(key, wire.encode([job, places]), hashlib.sha256)
