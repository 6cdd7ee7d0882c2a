"""A stock TWIST2 motion server in place of ours: our G1 follows it, our recorder keeps it as foreign."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from station import registry
from station.bus import keys
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from station.protocols import CommandFormat, Motion
from tests.lateness import TooLate, Waits, excuse
from tests.stock.conftest import OpenBus, Serve, finish, health
from tests.stock.stock_twist2 import ACTIONS, BODY, STANDING, STATE_BODY, MotionServer, waving
from tests.waiting import wait_until

AS_STOCK = ("policy=twist2", "robot_model=twist2:g1/g1_sim2sim_29dof.xml")
PATIENCE_S = 1.0
PATIENT = (f"gate.hold_after_s={PATIENCE_S}", "gate.return_after_s=2.0")
"""A robot that still follows when a busy machine looks at it a moment after the last command."""
PERIOD_S = 0.02
MOST_JOINT_ERROR_RAD = 0.11
SETTLED = 150  # commands: stock steps into the clip at once, our gate blends for 1 s


def gate(bus: Bus) -> str:
    value = bus.get(keys.command_gate(keys.TWIST2_ROBOT))
    return str(json.loads(value)["state"]) if value else ""


def expect_tracked(bus: Bus, waits: Waits) -> None:
    """The robot follows; or it is still on its way there, because somebody had to wait."""
    if (state := gate(bus)) in ("entering", "holding"):
        excuse(TooLate(f"the robot, which is {state},", PATIENCE_S, waits.seconds()))
    else:
        assert state == "tracking"


def clip(name: str, seconds: float) -> list[list[float]]:
    """The commands of a motion as lists, one period ahead as stock samples it; no blend at either end."""
    form: CommandFormat = registry.find("command", "twist2")
    motion: Motion = registry.find("loader", "motion")(name)
    times = 0.02 * (1 + np.arange(int(seconds / 0.02)))
    return [form.encode(motion.at(float(time_s)), motion.joint_names).tolist() for time_s in times]


@pytest.fixture
def stock(open_bus: OpenBus) -> MotionServer:
    return MotionServer(open_bus.port)


class Follower:
    """Reads the robot's state as a stock script would, after each command."""

    def __init__(self, stock: MotionServer) -> None:
        self._redis = stock.redis
        self.errors: list[float] = []

    def look(self, body: list[float]) -> None:
        state = json.loads(self._redis.get(STATE_BODY) or "[]")
        assert len(state) == 34
        self.errors.append(float(np.abs(np.subtract(state[5:], body[6:])).mean()))


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
    g1, recorder = serve("g1", *settings, *PATIENT), serve("recorder")
    started = open_bus.terminal.json("record", "start", "--task", "stock-walk")
    commands, follower = clip(motion, 8.0), Follower(stock)
    with Waits.watched() as waits:
        stock.play(commands, follower.look)
        waited_s = waits.seconds()
    expect_tracked(bus, waits)
    assert np.mean(follower.errors[SETTLED:]) <= MOST_JOINT_ERROR_RAD
    stock.close()
    open_bus.terminal.json("record", "stop")
    finish(recorder)
    finish(g1)

    reader = open_episode(Path(started["path"]))
    body = list(reader.messages([BODY]))
    assert [message.data for message in body] == [json.dumps(command).encode() for command in commands]
    writers = {stream.channel.topic: stream.channel.writer for stream in reader.streams()}
    assert {writers[key] for key in ACTIONS} == {"foreign"}
    assert writers[STATE_BODY] == "g1"
    check = open_bus.terminal.json("check", started["path"])
    (robot,) = check["steps"]
    assert (check["falls"], check["dropped"]) == (0, 0)
    assert robot["gate_shares"]["tracking"] > 0.3
    if (steps := robot["steps"]) <= 350:
        excuse(TooLate(f"{steps} steps in 8 s", (351 - steps) * PERIOD_S, waited_s))
    assert open_bus.terminal.json("audit", started["path"])["different"] == 0


@pytest.mark.parametrize("is_first", [True, False], ids=["stock starts first", "our robot starts first"])
def test_order_of_starting_does_not_matter(bus: Bus, serve: Serve, stock: MotionServer, is_first: bool) -> None:
    if is_first:
        stock.play(waving(0.1))
    g1 = serve("g1", *PATIENT)
    wait_until(lambda: gate(bus))
    assert gate(bus) == "waiting"  # an empty bus, or the last words of somebody who has gone, move nothing
    waits = Waits()
    stock.play(waving(2.0))  # twice as long as it takes to enter
    expect_tracked(bus, waits)
    stock.close()
    wait_until(lambda: gate(bus) == "waiting")  # stock would repeat the last command for ever
    assert g1.poll() is None


def test_what_stock_may_write_wrongly_is_refused_and_the_robot_stands(
    bus: Bus, serve: Serve, stock: MotionServer
) -> None:
    g1 = serve("g1", *PATIENT)
    nan = [float("nan"), *STANDING[1:]]
    for body in ([*STANDING, 1.0, 0.0], [*STANDING, 0.0, 0.0, 0.0], nan, STANDING[:33]):
        stock.play([list(map(float, body))] * 5)
    stock.redis.set(BODY, "not a list")
    wait_until(lambda: sum(health(bus, "g1").detail.get("refused", {}).values()) >= 4)
    assert (g1.poll(), gate(bus)) == (None, "waiting")
    waits = Waits()
    stock.play(waving(2.0))  # twice as long as it takes to enter
    expect_tracked(bus, waits)
    stock.close()


def test_robot_needs_none_of_the_companion_keys(bus: Bus, serve: Serve, stock: MotionServer) -> None:
    g1 = serve("g1", *PATIENT)
    others = [key for key in ACTIONS if key != BODY]
    waits = Waits()
    stock.play(waving(2.0), each=lambda _: stock.redis.delete(*others))
    expect_tracked(bus, waits)
    assert g1.poll() is None
    stock.close()
