"""Messages between LCM's own library and ours over real UDP, both ways; prints as JSON what came.

Run in a network namespace whose loopback carries multicast (`tests.adapters.lcm.loopback`).
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time

import lcm

from adapters.lcm import types
from adapters.lcm.multicast import GROUP, Multicast
from tests.adapters.lcm.library import sample

COUNT = 20
LONG = bytes(range(256)) * 500
_WITHIN_S = 10.0


def main(port: int) -> None:
    theirs = lcm.LCM(f"udpm://{GROUP}:{port}?ttl=0")
    message = types.TARGETS.encode(sample(types.TARGETS))
    with contextlib.closing(Multicast(port=port)) as ours:
        to_us = [("targets", message)] * COUNT + [("long", LONG)]

        def publish() -> None:
            for channel, data in to_us:
                theirs.publish(channel, data)
                time.sleep(0.001)

        thread = threading.Thread(target=publish)
        thread.start()
        came: list[tuple[str, bytes]] = []
        end_s = time.monotonic() + _WITHIN_S
        while len(came) < len(to_us) and time.monotonic() < end_s:
            came += [(each.channel, each.message) for each in ours.receive(0.1)]
        thread.join()
        heard: list[tuple[str, bytes]] = []
        for channel in ("targets", "long"):
            theirs.subscribe(channel, lambda channel, data: heard.append((channel, data)))
        while len(heard) < len(to_us) and time.monotonic() < end_s:
            channel, data = to_us[len(heard)]
            ours.send(channel, data)
            theirs.handle_timeout(1000)
    json.dump({"to us": came == to_us, "to them": heard == to_us, "count": [len(came), len(heard)]}, sys.stdout)


if __name__ == "__main__":
    main(int(sys.argv[1]))
