"""A line that was frozen delivers the commands of seconds ago at once; the robot does not follow them."""

from __future__ import annotations

from pathlib import Path

from adapters.robots.g1.joints import G1_29
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.protocols import Floats
from tests.faults.cuttable_line import CuttableLine
from tests.servers.g1_station import FORMAT, LIGHT, ROBOT, G1Process, Log, logged, publish
from tests.waiting import wait_until

WAIST_YAW = 6 + G1_29.index("waist_yaw")


def turned(yaw_rad: float) -> Floats:
    vector = FORMAT.default.copy()
    vector[WAIST_YAW] = yaw_rad
    return vector


def used_yaw_rad(log: Log) -> list[float]:
    return [float(codec.parse_f64(value)[WAIST_YAW]) for value in log.values(keys.command_used(ROBOT))]


def test_commands_that_a_frozen_line_kept_move_nothing_when_it_goes_on(bus_server: BusAddress, tmp_path: Path) -> None:
    with (
        CuttableLine(tmp_path / "line.sock", bus_server) as line,
        Bus(line.address, name="teleop") as operator,
        logged(bus_server) as log,
        G1Process(bus_server, *LIGHT),
    ):

        def follows() -> bool:
            publish(operator, turned(0.0))
            return bool(log.of(keys.command_gate(ROBOT))) and log.gate()["state"] == "tracking"

        wait_until(follows)
        wait_until(lambda: follows() and b'"command_age_by":"stamp and arrival"' in log.last(keys.server("g1")))
        line.freeze()
        for number in range(30):
            publish(operator, turned(0.5 + number / 1000))
        wait_until(lambda: log.gate()["state"] == "waiting")  # more than two seconds later
        before, already_told = len(log.states()), len(log.events("refused-command"))
        line.thaw()
        kept = codec.json_vector(turned(0.529))
        wait_until(lambda: kept in log.values(FORMAT.key))
        wait_until(lambda: len(log.events("refused-command")) > already_told or "entering" in log.states()[before:])
        assert set(log.states()[before:]) == {"waiting"}
        assert max(used_yaw_rad(log)) == 0.0
        refused = log.events("refused-command")[already_told]
        assert str(refused.detail["reason"]).startswith("stale: written ")
        wait_until(follows)
        assert log.wait_for("command-good-again").detail["count"] >= 1
        assert max(used_yaw_rad(log)) == 0.0
