"""A stock TWIST2 robot in place of ours: it reads our commands, our recorder keeps its state as foreign."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from tests.stock.conftest import OpenBus, Serve, finish
from tests.stock.stock_trials import MOTION, look_at_our_commands, read_our_commands, run
from tests.stock.stock_twist2 import ACTIONS, STANDING, STATE_BODY, LowLevelServer
from tests.waiting import wait_until


@pytest.fixture
def stock(open_bus: OpenBus) -> Iterator[LowLevelServer]:
    server = LowLevelServer(open_bus.port)
    yield server
    server.close()


def test_our_commands_are_what_a_stock_robot_reads(bus: Bus, serve: Serve, stock: LowLevelServer) -> None:
    assert read_our_commands(bus, serve, stock).different > 1, "it moves"


def test_first_command_is_near_the_default_pose_and_no_step_is_a_jump(
    bus: Bus, serve: Serve, stock: LowLevelServer
) -> None:
    look_at_our_commands(bus, serve, stock)


def test_all_four_keys_outlive_our_motion_server(bus: Bus, serve: Serve, stock: LowLevelServer) -> None:
    with pytest.raises(TypeError):  # a stock robot dies on an empty bus: ours must have run first
        stock.tick()
    finish(serve("motion", MOTION))
    body, *_ = stock.tick()
    assert body == pytest.approx([float(value) for value in STANDING])  # it left the robot standing


@pytest.mark.parametrize("is_robot_first", [True, False], ids=["robot starts first", "motion starts first"])
def test_order_of_starting_does_not_matter(bus: Bus, serve: Serve, stock: LowLevelServer, is_robot_first: bool) -> None:
    finish(serve("motion", MOTION))  # what upstream calls warming up: the keys are there
    if is_robot_first:
        stock.say_hello()
        run(stock, 10)
    motion = serve("motion", MOTION)
    (first, *_), *_ = run(stock, 1)
    wait_until(lambda: run(stock, 1)[0][0] != first)  # it moves
    assert motion.poll() is None


def test_recorder_keeps_the_states_of_a_stock_robot_as_foreign(
    open_bus: OpenBus, bus: Bus, serve: Serve, stock: LowLevelServer
) -> None:
    recorder = serve("recorder", "preroll_s=0")
    started = open_bus.terminal.json("record", "start", "--task", "stock-robot")
    motion = serve("motion", MOTION)
    wait_until(lambda: bus.get(twist_keys.action_body()))
    stock.say_hello()
    run(stock, 50)
    finish(motion)
    open_bus.terminal.json("record", "stop")
    finish(recorder)

    reader = open_episode(Path(started["path"]))
    written = {stream.channel.topic: (stream.channel.writer, stream.count) for stream in reader.streams()}
    assert written[STATE_BODY] == ("foreign", 51)
    hands = {written[twist_keys.state_hand(side)] for side in ("left", "right")}
    assert hands == {("foreign", 51)}
    assert written[twist_keys.state_neck()] == written["t_state"] == ("foreign", 50)
    assert {written[key][0] for key in ACTIONS} == {"motion"}
    first = next(reader.messages([STATE_BODY]))
    assert len(json.loads(first.data)) == 127
    states = reader.vectors(STATE_BODY)  # the contract says 34: the odd one is left out and counted
    assert (len(states.log_ns), reader.skipped[STATE_BODY]) == (50, 1)
    check = open_bus.terminal.json("check", started["path"])
    assert (check["dropped"], check["steps"]) == (0, [])
    audit = open_bus.terminal.run("audit", started["path"])
    assert audit.returncode == 1
    assert "no policy steps" in audit.stderr
    assert len(audit.stderr.strip().splitlines()) == 1


def test_a_start_signal_of_the_robot_starts_our_motion(bus: Bus, serve: Serve, stock: LowLevelServer) -> None:
    stock.redis.set("motion_start_signal", "1")  # left behind by an earlier session
    motion = serve("motion", MOTION, "wait_for_start=true")
    wait_until(lambda: stock.redis.get("motion_start_signal") == b"0")
    waiting = run(stock, 20)
    assert {tuple(commands[0]) for commands in waiting} == {tuple(float(value) for value in STANDING)}
    stock.redis.set("motion_start_signal", "1")
    wait_until(lambda: run(stock, 1)[0][0] != waiting[-1][0])  # it moves
    stock.redis.set("motion_exit_signal", "1")
    motion.communicate(timeout=30)
    assert motion.returncode == 0
