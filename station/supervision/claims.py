"""Which servers each `station up` of this machine runs: it holds a lock for each until it ends, however it ends."""

from __future__ import annotations

import contextlib
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence

from station import lock_file
from station.bus.address import BusAddress
from station.errors import Refused
from station.supervision.supervisor import log_folder

_SUFFIX = ".lock"


@contextlib.contextmanager
def claimed(address: BusAddress, names: Sequence[str]) -> Iterator[None]:
    """Hold the locks of servers for a block: two stations that start the same ones at once would end each other.

    Args:
        address: The bus that they run on.
        names: Of the servers.

    Raises:
        Refused: another station has one of them.
    """
    folder = log_folder(address)
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as held:
        for name in sorted(set(names)):
            try:
                descriptor, _ = lock_file.take(folder / f"{name}{_SUFFIX}")
            except lock_file.Held as other:
                by = f"by `station up` with pid {other.holder or 'unknown'}"
                raise Refused(
                    f"server {name!r} already runs on {address} ({by}); "
                    "stop that station first (`station down`), or use another bus with --bus"
                ) from None
            held.callback(os.close, descriptor)
        yield


def stations(address: BusAddress) -> dict[int, list[str]]:
    """Return the servers that each station of this machine runs on a bus, by the id of its process."""
    found = defaultdict[int, list[str]](list)
    for file in sorted(log_folder(address).glob(f"*{_SUFFIX}")):
        if holder := lock_file.holder(file):
            found[int(holder)].append(file.name.removesuffix(_SUFFIX))
    return dict(found)
