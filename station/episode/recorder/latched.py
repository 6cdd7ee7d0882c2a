"""States that the bus held when its tap was opened: written shortly before, and perhaps not written again.

A robot that waits for a command says its state once and then waits. A recorder whose tap opens in between would have
the step that answers to this state and not the state itself.

A stamp that stands beside a value need not be the value's: a stock script that writes over a native key leaves it as it
was, and a bus at rest does not tell. A script that goes on writing is heard on the tap, and the state is then left out;
one that wrote within the span and never again is not told from the native writer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from station.bus.contracts import Contracts
from station.bus.tap import Write
from station.contract import Contract
from station.life.server import read_configurations

if TYPE_CHECKING:
    from station.bus.client import Bus

_MOST = 1000  # a station has a dozen; a client may invent names


def latched(bus: Bus, span_s: float) -> list[Write]:
    """Return the states that were written within a span before now and stand on the bus, oldest first.

    Only those of native writers on this machine: others do not say when. Each has the time of its write [ns,
    monotonic] as that of its arrival.

    Args:
        bus: The bus.
        span_s: How far back to look [s].

    Raises:
        BusError: the bus cannot be read.
    """
    known = Contracts(read_configurations(bus))
    held = bus.read(list(islice((key for key in bus.names() if _is_state(known.get(key))), _MOST)))
    now_ns = bus.clock.monotonic_ns()
    oldest_ns = now_ns - int(span_s * 1e9)
    found = [
        Write(key, sample.value, mark.encode(), mark.mono_ns)
        for key, sample in held.items()
        if (mark := sample.stamp) is not None and mark.is_from_this_boot and oldest_ns <= mark.mono_ns <= now_ns
    ]
    return sorted(found, key=lambda write: write.mono_ns)


def not_among(states: Iterable[Write], writes: Iterable[Write]) -> list[Write]:
    """Return the states that are not also among some writes: those came by the tap."""
    known = {(write.key, write.stamp) for write in writes}
    return [state for state in states if (state.key, state.stamp) not in known]


def believed(writes: Sequence[Write], stamps: Mapping[str, bytes | None]) -> Sequence[Write]:
    """Return writes without those latched states whose key was next written by a writer without stamps.

    Args:
        writes: In the order of the bus.
        stamps: Of the latched states among them, by key.
    """
    later: dict[str, Write] = {}
    for write in writes:
        if write.key in stamps and write.value is not None and write.stamp != stamps[write.key]:
            later.setdefault(write.key, write)
    doubted = {(key, stamps[key]) for key, write in later.items() if write.stamp is None}
    return [write for write in writes if (write.key, write.stamp) not in doubted] if doubted else writes


def _is_state(contract: Contract | None) -> bool:
    return contract is not None and contract.role == "state"
