"""The G1 server as others meet it: a process, its keys, what it does with good, bad, late and rival commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import ServerOptions
from tests.servers.g1_station import (
    FORMAT,
    LEAVING,
    LIGHT,
    PATIENT,
    ROBOT,
    G1Process,
    Log,
    StockCommander,
    leaning,
    logged,
    publish,
    ticks,
)
from tests.servers.g1_trials import stop_and_reset, take_the_bus_away
from tests.waiting import wait_until


def test_a_stock_commander_is_followed_and_when_it_falls_silent_the_robot_stands_again(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *LEAVING):
        wait_until(lambda: ticks(log) > 5)
        assert log.gate()["state"] == "waiting"
        with StockCommander(bus_server):
            wait_until(lambda: log.gate()["state"] == "tracking")
            wait_until(lambda: b'"command_age_by":"arrival alone"' in log.last(keys.server("g1")))
        # The event of a change is written after the tick that shows it.
        wait_until(lambda: [event.detail["to"] for event in log.events("gate")][-1:] == ["waiting"])
    changes = [(event.detail["from"], event.detail["to"]) for event in log.events("gate")]
    assert changes[:2] == [("waiting", "entering"), ("entering", "tracking")]
    assert changes[-3:] == [("tracking", "holding"), ("holding", "returning"), ("returning", "waiting")]
    used = codec.parse_f64(log.last(keys.command_used(ROBOT)))
    np.testing.assert_array_equal(used, FORMAT.default)
    timing = codec.parse_json_vector(log.last(keys.policy_timing(ROBOT)))
    assert timing[1] == timing[2] == 0, "a foreign writer has no sequence and no time of writing"
    assert timing[3] > 0
    assert (np.diff(timing[4:]) >= 0).all()
    assert not log.events("fall")


def test_malformed_commands_of_every_kind_are_refused_told_once_per_kind_and_survived(bus_server: BusAddress) -> None:
    bad = [b"", b"hello", b"[1, 2]", json.dumps([float("nan")] * 35).encode(), b"[" * 100_000, b"\xff" * 10,
           json.dumps([9.0] * 35).encode(), b'{"a": 1}', b"null"]  # fmt: skip
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *PATIENT) as server,  # none of them is too old, however long it was on its way
        Bus(bus_server, name="bad", timeout_s=5.0) as bus,
    ):
        wait_until(lambda: ticks(log) > 5)
        for value in bad:
            before = log.gate()["refused"]
            bus.publish(
                {
                    twist_keys.action_body(): value,
                    twist_keys.action_neck(): value,
                    twist_keys.action_hand("left"): value,
                }
            )
            wait_until(lambda before=before: log.gate()["refused"] > before)  # type: ignore[misc]
        bus.call("DEL", twist_keys.action_body())
        bus.call("RPUSH", twist_keys.action_body(), "a list of another type")
        before = ticks(log)
        wait_until(lambda: ticks(log) > before + 10)
        bus.call("DEL", twist_keys.action_body())
        wait_until(lambda: ticks(log) > before + 20)

        def is_good_again() -> bool:
            publish(bus, FORMAT.default)  # again and again: a write within the same look as a stranger's is nobody's
            return bool(log.events("command-good-again"))

        wait_until(is_good_again)
        assert server.process.poll() is None
    assert log.gate()["refused"] == len(bad)
    kinds = [event.detail["reason"].split(":")[0] for event in log.events("refused-command")]
    assert set(kinds) == {"not-json", "wrong-length", "not-finite", "out-of-range"}
    assert len(kinds) <= len(bad)


@pytest.mark.parametrize("stop", [b"1", b'{"stop": true, "who": "anna", "reason": "smoke"}'])
def test_the_emergency_stop_damps_and_is_left_only_by_a_reset(bus_server: BusAddress, stop: bytes) -> None:
    stop_and_reset(bus_server, stop, *PATIENT)


def test_two_writers_of_the_command_are_an_event_that_names_both(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *LIGHT), Bus(bus_server, name="native", timeout_s=5.0) as bus:
        wait_until(lambda: ticks(log) > 5)
        with StockCommander(bus_server):

            def alternates() -> bool:
                publish(bus, FORMAT.default)
                return bool(log.events("second-writer"))

            wait_until(alternates)
    detail = log.events("second-writer")[0].detail
    assert detail["key"] == twist_keys.action_body()
    assert any(writer.startswith("native.") for writer in detail["writers"])
    assert "foreign" in detail["writers"]


def test_a_fall_is_one_event_and_the_robot_is_put_back_on_its_feet_when_asked(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *LIGHT, "on_fall=reset", "envelope=none"):
        wait_until(lambda: ticks(log) > 5)
        with StockCommander(bus_server, leaning):
            wait_until(lambda: log.events("robot-reset"))
        wait_until(lambda: height_m(log) > 0.7)
    fall, reset = log.events("fall", "robot-reset")[:2]
    assert (fall.name, reset.name) == ("fall", "robot-reset"), "one event, whatever comes after the reset"
    assert fall.severity == "error"
    assert fall.detail["contacts"] or fall.detail["tilt_rad"] > 1.0
    assert min(codec.parse_f64(value)[2] for value in log.values(keys.sim_qpos(ROBOT))) < 0.6


def height_m(log: Log) -> float:
    return float(codec.parse_f64(log.last(keys.sim_qpos(ROBOT)))[2])


def test_without_a_bus_the_loop_goes_on_and_says_so_when_the_bus_is_back(processes: None, tmp_path: Path) -> None:
    made, _ = take_the_bus_away(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock"), *LIGHT)
    assert made > 5


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["polciy=twist2"], "unknown key 'polciy' (did you mean 'policy'?)"),
        (["backend=real"], "unknown robot 'g1-real'"),
        (["gate.hold_after_s=-1"], "hold_after_s must be a positive time"),
        (["pace=fast"], "pace"),
        (["policy=twist2", "checkpoint=builtin:tracker.onnx"], "expected one float input [batch, 1432]"),
    ],
)
def test_a_wrong_setting_ends_it_with_one_line_and_exit_code_two(
    bus_server: BusAddress, settings: list[str], expected: str
) -> None:
    with G1Process(bus_server, *LIGHT, *settings) as server:
        code, out, err = server.result()
    assert code == 2, err
    assert out == ""
    assert expected in err.strip().splitlines()[-1]
