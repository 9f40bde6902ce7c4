"""Leave to write: signed by the broker for one job and its locations, checked by the world database (A25). Pure.

The signature is HMAC-SHA256 over the MessagePack of [job, sorted locations], with the key of the cluster's run
directory, which its owner alone can read. It keeps mistakes out, not an intruder with the same user id.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Iterable

from rtc import wire
from rtc.messages import Lease

KEY_BYTES = 32
KEY_FILE = "lease.key"  # in the run directory
DOUBT = "doubt/"  # begins the job of a lease to doubt everything


def sign(key: bytes, job: str, locations: Iterable[str]) -> Lease:
    """A lease for these locations, in one spelling (sorted, each once)."""
    places = sorted(set(locations))
    return Lease(job=job, locations=places, signature=_signature(key, job, places))


def check(key: bytes, lease: Lease) -> bool:
    """Whether the broker of this cluster gave it."""
    return hmac.compare_digest(lease.signature, _signature(key, lease.job, sorted(set(lease.locations))))


def _signature(key: bytes, job: str, places: list[str]) -> bytes:
    return hmac.digest(key, wire.encode([job, places]), hashlib.sha256)
