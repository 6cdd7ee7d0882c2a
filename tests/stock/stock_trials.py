"""Stock TWIST2 scripts and servers of ours on one bus: what each reads of the other."""

from __future__ import annotations

import itertools
import json
import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adapters.robots.g1 import twist_keys
from station import registry
from station.bus import keys
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from station.protocols import CommandFormat, Motion
from tests.stock.conftest import OpenBus, Serve, finish
from tests.stock.stock_twist2 import (
    ACTIONS,
    BODY,
    LOOP_S,
    STANDING,
    STATE_BODY,
    STATES,
    LowLevelServer,
    MotionServer,
    Recorder,
)
from tests.waiting import wait_until

MOTION = "motion=builtin:wave"
FASTEST_RAD_S = 3.0
MOST_JOINT_ERROR_RAD = 0.11
SETTLED = 150  # commands: stock steps into the clip at once, our gate blends for 1 s


def gate(bus: Bus) -> str:
    value = bus.get(keys.command_gate(twist_keys.TWIST2_ROBOT))
    return str(json.loads(value)["state"]) if value else ""


def clip(name: str, seconds: float) -> list[list[float]]:
    """The commands of a motion as lists, one period ahead as stock samples it; no blend at either end."""
    command_format: CommandFormat = registry.find("command", "twist2")
    motion: Motion = registry.find("loader", "motion")(name)
    times = 0.02 * (1 + np.arange(int(seconds / 0.02)))
    return [command_format.encode(motion.at(float(time_s)), motion.joint_names).tolist() for time_s in times]


class Follower:
    """Reads the robot's state as a stock script would, after each command."""

    def __init__(self, stock: MotionServer) -> None:
        self._redis = stock.redis
        self.errors: list[float] = []

    def look(self, body: list[float]) -> None:
        state = json.loads(self._redis.get(STATE_BODY) or "[]")
        assert len(state) == 34
        self.errors.append(float(np.abs(np.subtract(state[5:], body[6:])).mean()))


class Walk(NamedTuple):
    """What came of a clip.

    Attributes:
        seen_error_rad: Mean joint error as the stock script saw it after each command, once it had settled [rad].
        steps: Of the robot, as recorded.
    """

    seen_error_rad: float
    steps: int


def walk(
    open_bus: OpenBus, bus: Bus, serve: Serve, stock: MotionServer, motion: str, seconds: float, *robot: str
) -> Walk:
    """Let a stock script play a clip to our robot, and record it."""
    g1, recorder = serve("g1", *robot), serve("recorder")
    started = open_bus.terminal.json("record", "start", "--task", "stock-walk")
    commands, follower = clip(motion, seconds), Follower(stock)
    wait_until(lambda: bus.get(STATE_BODY))
    stock.play(commands, follower.look)
    wait_until(lambda: gate(bus) == "tracking")
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
    (steps,) = check["steps"]
    assert (check["falls"], check["dropped"]) == (0, 0)
    assert steps["mean_joint_error_rad"] <= MOST_JOINT_ERROR_RAD
    assert open_bus.terminal.json("audit", started["path"])["different"] == 0
    return Walk(float(np.mean(follower.errors[SETTLED:])), int(steps["steps"]))


def rows_of_our_servers(bus: Bus, serve: Serve, stock: Recorder) -> list[dict[str, Any]]:
    """Return what a stock recorder reads of our robot and our motion server."""
    serve("g1")
    serve("motion", MOTION)
    wait_until(lambda: bus.get(twist_keys.T_ACTION) and bus.get(twist_keys.T_STATE))
    rows = []
    for _ in range(15):
        rows.append(stock.item())
        time.sleep(1 / 30)
    for row in rows:
        lengths = {name: len(value) for name, value in row.items() if isinstance(value, list)}
        assert lengths == {**STATES, **ACTIONS}
        assert [type(row[name]) for name in ("t_state", "t_action")] == [int, int]
    return rows


def run(stock: LowLevelServer, ticks: int) -> list[list[list[float]]]:
    """Tick as stock does; return the four commands of each tick."""
    read = []
    for _ in range(ticks):
        read.append(stock.tick())
        time.sleep(LOOP_S)
    return read


class Reads(NamedTuple):
    """What a stock robot read in a hundred looks.

    Attributes:
        different: Number of different commands.
        apart_s: From the wall clock of the last command to the last look [s].
    """

    different: int
    apart_s: float


def read_our_commands(bus: Bus, serve: Serve, stock: LowLevelServer) -> Reads:
    """Let a stock robot read what our motion server writes."""
    serve("motion", MOTION)
    wait_until(lambda: bus.get(twist_keys.action_body()))
    stock.say_hello()
    read, now_ms = run(stock, 100), time.time() * 1000
    t_action = stock.redis.get("t_action")
    for commands in read:
        assert [len(command) for command in commands] == list(ACTIONS.values())
        assert all(type(value) is float and math.isfinite(value) for command in commands for value in command)
    assert t_action is not None
    assert t_action.isdigit()
    assert read[-1][1:] == [[0.0] * 7, [0.0] * 7, [0.0] * 2]
    return Reads(len({tuple(commands[0]) for commands in read}), abs(int(t_action) - now_ms) * 1e-3)


class Look(NamedTuple):
    """Joints that a stock robot was asked for [rad], and between which instants it read them [s]."""

    before_s: float
    joints: list[float]
    after_s: float


def look_at_our_commands(bus: Bus, serve: Serve, stock: LowLevelServer) -> float:
    """Return the largest step of a joint between two looks of a stock robot at our commands [rad]."""
    now_s = time.monotonic()
    looks = [Look(now_s, STANDING[6:], now_s)]
    serve("motion", MOTION)
    wait_until(lambda: bus.get(twist_keys.action_body()))
    for _ in range(100):
        before_s = time.monotonic()
        body, *_others = stock.tick()
        looks.append(Look(before_s, body[6:], time.monotonic()))
        time.sleep(LOOP_S)
    steps = []
    for one, two in itertools.pairwise(looks):
        steps.append(max(abs(a - b) for a, b in zip(one.joints, two.joints, strict=True)))
        # A late look sees several periods at once.
        assert steps[-1] < 0.3 + FASTEST_RAD_S * (two.after_s - one.before_s)
    return max(steps)
