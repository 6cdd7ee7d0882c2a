"""A stock TWIST2 motion server in place of ours: our G1 follows it, our recorder keeps it as foreign."""

from __future__ import annotations

from collections.abc import Callable
from itertools import takewhile

import pytest

from station.bus.client import Bus
from tests.servers.g1_station import LEAVING, PATIENT
from tests.stock.conftest import OpenBus, Serve, health
from tests.stock.stock_trials import gate, walk
from tests.stock.stock_twist2 import ACTIONS, BODY, LOOP_S, STANDING, MotionServer, waving
from tests.waiting import DEADLINE_S, wait_until

AS_STOCK = ("policy=twist2", "robot_model=twist2:g1/g1_sim2sim_29dof.xml")


@pytest.fixture
def stock(open_bus: OpenBus) -> MotionServer:
    return MotionServer(open_bus.port)


def play_until_followed(bus: Bus, stock: MotionServer, each: Callable[[list[float]], object] | None = None) -> None:
    """Play until the robot follows."""
    stock.play(takewhile(lambda _: gate(bus) != "tracking", waving(DEADLINE_S)), each)
    assert gate(bus) == "tracking"


def refused(bus: Bus, kind: str) -> int:
    """Return how many commands of a kind the robot has refused."""
    return int(health(bus, "g1").detail.get("refused", {}).get(kind, 0))


def play_until_refused(bus: Bus, stock: MotionServer, kind: str, body: list[float]) -> None:
    """Play one body until the robot has refused it; the one before was of another kind, and is counted by then."""
    known, bodies = refused(bus, kind), [list(map(float, body))] * round(DEADLINE_S / LOOP_S)
    stock.play(takewhile(lambda _: refused(bus, kind) == known, bodies))
    assert refused(bus, kind) > known


@pytest.mark.parametrize(
    ("motion", "settings"),
    [
        ("builtin:walk-forward", ()),
        pytest.param("twist2:motions/0807_yanjie_walk_001.pkl", AS_STOCK, marks=pytest.mark.assets),
    ],
    ids=["built in", "as stock"],
)
def test_robot_walks_to_stock_commands_and_all_of_it_is_recorded(
    open_bus: OpenBus, bus: Bus, serve: Serve, stock: MotionServer, motion: str, settings: tuple[str, ...]
) -> None:
    walk(open_bus, bus, serve, stock, motion, 4.0, *settings, *PATIENT)


@pytest.mark.parametrize("is_first", [True, False], ids=["stock starts first", "our robot starts first"])
def test_order_of_starting_does_not_matter(bus: Bus, serve: Serve, stock: MotionServer, is_first: bool) -> None:
    if is_first:
        stock.play(waving(0.1))
    g1 = serve("g1", *LEAVING)
    wait_until(lambda: gate(bus))
    assert gate(bus) == "waiting"  # an empty bus, or the last words of somebody who has gone, move nothing
    play_until_followed(bus, stock)
    stock.close()
    wait_until(lambda: gate(bus) == "waiting")  # stock would repeat the last command for ever
    assert g1.poll() is None


def test_what_stock_may_write_wrongly_is_refused_and_the_robot_stands(
    bus: Bus, serve: Serve, stock: MotionServer
) -> None:
    g1 = serve("g1", *PATIENT)
    nan = [float("nan"), *STANDING[1:]]
    play_until_refused(bus, stock, "wrong-length", [*STANDING, 1.0, 0.0])
    play_until_refused(bus, stock, "not-finite", nan)
    play_until_refused(bus, stock, "wrong-length", [*STANDING, 0.0, 0.0, 0.0])
    stock.redis.set(BODY, "not a list")
    wait_until(lambda: refused(bus, "not-json") > 0)
    play_until_refused(bus, stock, "wrong-length", STANDING[:33])
    assert (g1.poll(), gate(bus)) == (None, "waiting")
    play_until_followed(bus, stock)
    stock.close()


def test_robot_needs_none_of_the_companion_keys(bus: Bus, serve: Serve, stock: MotionServer) -> None:
    g1 = serve("g1", *PATIENT)
    others = [key for key in ACTIONS if key != BODY]
    play_until_followed(bus, stock, each=lambda _: stock.redis.delete(*others))
    assert g1.poll() is None
    stock.close()
