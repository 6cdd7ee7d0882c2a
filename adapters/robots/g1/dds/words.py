"""What the motion switcher's requests and answers say, in JSON."""

from __future__ import annotations

from station.bus import codec


def name_of(text: str) -> str | None:
    """Return the controller that a text names: ``ai``, "" for none; None where it names none in words we know."""
    found = codec.parse_facts(text.encode(errors="replace")).get("name")
    return found if isinstance(found, str) else None
