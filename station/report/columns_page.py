"""The last part of a report: what each key holds, number by number, so that every column of an export is told of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from station.bus import contracts
from station.contract import Contract
from station.report.html import Html, details, table, tag

_MOST_KEYS = 200


def columns(keys: Iterable[str], recorded: Mapping[str, Contract]) -> Html | None:
    """Return every key with what its contract says: as it was recorded where that was read, else as it is today."""
    found = {key: contract for key in keys if (contract := recorded.get(key) or contracts.contract(key)) is not None}
    rows = [_row(found[key]) for key in sorted(found, key=lambda key: (not found[key].elements, key))][:_MOST_KEYS]
    if not rows:
        return None
    text = (
        "The names and units of these numbers are the columns of an export, which takes them from the same contracts; "
        "they are recorded beside the values. In a LeRobot data set, unless other keys were named, observation.state "
        "is robot_state_… (of an arm state_joints_…), action is command_used_…, observation.images.NAME is "
        "camera_image_NAME; the columns age_s.* say how old each was at time_ns, the instant of the row. README.md in "
        "the data set has all of its own."
    )
    head = ("key", "role", "rate", "numbers", "what it holds")
    return tag(
        "div",
        tag("h3", "What each column is", id="columns"),
        tag("p", text, class_="soft"),
        table(head, rows),
        class_="card",
    )


def _row(contract: Contract) -> tuple[Html | str, ...]:
    rate = "on events" if contract.rate_hz is None else f"{contract.rate_hz:g} Hz"
    names = [(str(n), tag("code", element.name), element.unit) for n, element in enumerate(contract.elements)]
    note = tag("span", contract.note)
    unfolded = details(f"{len(names)} columns", table(("", "name", "unit"), names)) if names else None
    count = str(len(names)) if names else contract.codec
    return tag("code", contract.key), contract.role, rate, count, tag("div", note, unfolded)
