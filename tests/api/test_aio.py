"""A script on asyncio asks as one that waits does, and nothing that it waits for holds up the rest of it."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import threading

import pytest

from station import AsyncStation
from station.bus.address import BusAddress
from station.errors import BusError, NotReady, UsageError
from tests.waiting import DEADLINE_S, wait_until

KEY = "state_force_gripper"


def test_what_is_published_is_read_followed_and_refused_as_by_one_that_waits(bus_server: BusAddress) -> None:
    async def main() -> tuple[list[object], list[str]]:
        async with AsyncStation(bus_server.url, name="gripper") as lab:
            values = await lab.follow(KEY, silent_s=DEADLINE_S)
            await lab.publish({KEY: {"newton": 3.5}})
            first = await anext(values)
            await lab.publish({KEY: {"newton": 4.0}})
            second = await anext(values)
            with pytest.raises(UsageError, match="holds no vector that is known"):
                await lab.publish({KEY: [1.0]})
            with pytest.raises(NotReady, match="record mark: no recorder answered"):
                await lab.record.mark("here")
            assert await lab.runbook() is None
            with pytest.raises(NotReady, match="no runbook is run on"):
                await lab.answer("a", "yes", who="anna")
            found = await lab.read(KEY)
            assert found is not None
            return [first.json(), second.json(), found.json()], [first.writer, *await lab.keys("state_*")]

    held, told = asyncio.run(main())
    assert held == [{"newton": 3.5}, {"newton": 4.0}, {"newton": 4.0}]
    assert told == ["gripper", KEY]


def test_what_is_waited_for_holds_up_nothing_and_can_be_given_up(bus_server: BusAddress) -> None:
    async def main() -> None:
        async with AsyncStation(bus_server.url) as lab:
            robot = asyncio.create_task(lab.wait_for_robot(within_s=DEADLINE_S))
            event = asyncio.create_task(anext(await lab.events()))
            await lab.publish({KEY: {"newton": 1.0}})
            assert await lab.keys("state_*") == [KEY]
            assert not robot.done()
            assert not event.done()
            for waiting in (robot, event):
                waiting.cancel()
            found = await asyncio.gather(robot, event, return_exceptions=True)
            assert [type(each) for each in found] == [asyncio.CancelledError] * 2

    asyncio.run(main())
    wait_until(lambda: not [each for each in threading.enumerate() if each.name.startswith(("station", "event-feed"))])


def test_a_follower_that_was_never_asked_listens_no_longer_than_it_is_held(bus_server: BusAddress) -> None:
    async def main() -> None:
        async with AsyncStation(bus_server.url) as lab:
            values, events = await lab.follow(KEY), await lab.events()
            assert _listeners() != []
            del values, events
            await asyncio.to_thread(wait_until, lambda: not _listeners())

    asyncio.run(main())


def _listeners() -> list[str]:
    return [
        each.name for each in threading.enumerate() if each.name.startswith(("station-items", "event-feed", "watch"))
    ]


def test_ctrl_c_ends_a_script_that_follows_with_no_other_error(bus_server: BusAddress) -> None:
    script = f"""
import asyncio, station
async def main():
    async with station.AsyncStation({bus_server.url!r}) as lab:
        values = await lab.follow({KEY!r})
        print("following", flush=True)
        async for _ in values:
            pass
asyncio.run(main())
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"following\n"
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=DEADLINE_S)
    assert said.endswith(b"\nKeyboardInterrupt\n"), said.decode()


def test_followers_end_with_the_station_or_after_a_silence(bus_server: BusAddress) -> None:
    async def main() -> tuple[list[object], list[object]]:
        async with AsyncStation(bus_server.url) as lab:
            silent = [value async for value in await lab.follow(KEY, silent_s=0.1)]
            values = await lab.follow(KEY)
        return silent, [value async for value in values]

    assert asyncio.run(main()) == ([], [])


def test_where_no_bus_is_entering_says_so(tmp_path: object) -> None:
    async def main() -> None:
        async with AsyncStation(f"unix://{tmp_path}/none.sock"):
            pass

    with pytest.raises(BusError, match=r"none\.sock"):
        asyncio.run(main())
