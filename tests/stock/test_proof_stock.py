"""Stock scripts and our servers keep pace with each other."""

from __future__ import annotations

from contextlib import closing

import pytest

from station.bus.client import Bus
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.servers.g1_station import LIGHT
from tests.stock.conftest import OpenBus, Serve
from tests.stock.stock_trials import (
    MOST_JOINT_ERROR_RAD,
    look_at_our_commands,
    read_our_commands,
    rows_of_our_servers,
    walk,
)
from tests.stock.stock_twist2 import LOOP_S, LowLevelServer, MotionServer, Recorder

WALK_S = 8.0
STEPS, DIFFERENT = 350, 50
TOGETHER_S = 1.0


@pytest.mark.timeout(300)
def test_our_robot_keeps_pace_with_stock_commands(open_bus: OpenBus, bus: Bus, serve: Serve, proof: Figures) -> None:
    with Waits.watched() as waits:
        stock = MotionServer(open_bus.port)
        done = walk(open_bus, bus, serve, stock, "builtin:walk-forward", WALK_S, *LIGHT, "gate.hold_after_s=1.0",
                    "gate.return_after_s=2.0")  # fmt: skip
    if done.steps <= STEPS:
        raise TooLate(f"{done.steps} steps in {WALK_S:g} s", (STEPS + 1 - done.steps) * LOOP_S, waits.seconds())
    assert done.seen_error_rad <= MOST_JOINT_ERROR_RAD
    limit = f"{MOST_JOINT_ERROR_RAD} rad"
    proof.figure("stock motion server to our robot: mean joint error as it sees it", done.seen_error_rad, "rad", limit)


def test_state_and_command_of_a_row_of_a_stock_recorder_are_of_one_time(
    open_bus: OpenBus, bus: Bus, serve: Serve, proof: Figures
) -> None:
    with Waits.watched() as waits, closing(Recorder(open_bus.port, patience_s=5.0)) as stock:
        rows = rows_of_our_servers(bus, serve, stock)
    apart_s = max(abs(row["t_state"] - row["t_action"]) * 1e-3 for row in rows)
    if apart_s >= TOGETHER_S:
        raise TooLate("state and command of a row", apart_s - TOGETHER_S, waits.longest_s)
    proof.figure("row of a stock recorder: state to command", apart_s * 1e3, "ms", limit="1000 ms")


def test_a_stock_robot_reads_new_commands_at_its_pace(
    open_bus: OpenBus, bus: Bus, serve: Serve, proof: Figures
) -> None:
    with closing(LowLevelServer(open_bus.port)) as stock:

        def once() -> int:
            with Waits.watched() as waits:
                reads = read_our_commands(bus, serve, stock)
            if reads.apart_s >= TOGETHER_S:
                raise TooLate("the last command", reads.apart_s - TOGETHER_S, waits.longest_s)
            if reads.different <= DIFFERENT:
                late_s = (DIFFERENT + 1 - reads.different) * LOOP_S
                raise TooLate(f"{reads.different} different commands of 100", late_s, waits.seconds())
            return reads.different

        different = in_time(once, rounds=1)
    proof.figure("stock robot: different commands in 100 looks", different, limit=f"more than {DIFFERENT}")


def test_no_step_of_our_commands_is_a_jump_to_a_stock_robot(
    open_bus: OpenBus, bus: Bus, serve: Serve, proof: Figures
) -> None:
    with Waits.watched() as waits, closing(LowLevelServer(open_bus.port)) as stock:
        step_rad = look_at_our_commands(bus, serve, stock)
    if step_rad >= 0.3:
        raise TooLate(f"a look that saw {step_rad:.2f} rad", LOOP_S, waits.longest_s)
    proof.figure("stock robot: largest step of a joint between two looks", step_rad, "rad", limit="0.3 rad")
