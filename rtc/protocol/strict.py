"""The base of what may restrict a motion: a reader that does not know one of its keys must not read the rest."""

from __future__ import annotations

import msgspec


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A struct whose unknown keys make the whole message invalid.

    Other parts of messages ignore unknown keys. Here such a key may delay, limit or stop a motion, so an older process
    that left it out would move otherwise than ordered. It refuses the primitive or the job instead.
    """
