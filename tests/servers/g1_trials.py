"""A G1 server that is stopped, armed, and left without a bus: what it does, and when."""

from __future__ import annotations

import json
import time
from typing import NamedTuple

import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.control.arming import RAMP_S
from station.life import arm_request
from tests.faults.bus_station import pause
from tests.servers.g1_station import ROBOT, G1Process, Log, StockCommander, logged, ticks
from tests.waiting import wait_until

PERIOD_S = 0.02


def stop_and_reset(address: BusAddress, stop: bytes, *robot: str) -> float:
    """Stop a robot that follows a commander, and release it.

    Args:
        address: Of the bus.
        stop: Value of the key.
        robot: Settings of the robot's server.

    Returns:
        By how much the last step with stiffness came too late: a step that read its state a period after the stop was
        written has none [s].
    """
    with logged(address) as log, G1Process(address, *robot), Bus(address, name="anna", timeout_s=5.0) as bus:
        with StockCommander(address):
            wait_until(lambda: log.gate()["state"] == "tracking")
            bus.publish({keys.ESTOP: stop})
            wait_until(lambda: log.gate()["state"] == "stopped")
            before = ticks(log)
            wait_until(lambda: ticks(log) > before + 50)
            assert log.gate()["state"] == "stopped"
            bus.publish({keys.ESTOP: b"0"})
            log.wait_for("operator-reset")
        writes, states = list(log.writes), log.states()
    first = states.index("stopped")
    reset_at = first + states.count("stopped")
    assert set(states[first:reset_at]) == {"stopped"}, "latched"
    asked_ns = int(next(write.stamp for write in writes if write.key == keys.ESTOP and write.stamp).split(b" ")[1])
    targets = [codec.parse_f64(write.value) for write in writes if write.key == keys.target(ROBOT) and write.value]
    timings = [json.loads(write.value) for write in writes if write.key == keys.policy_timing(ROBOT) and write.value]
    assert not any(target[29:58].any() for target in targets[first:reset_at]), "damped: no stiffness"
    assert [event.name for event in log.events("estop") + log.events("operator-reset")] == ["estop", "operator-reset"]
    late_s = [
        (timing[4] - asked_ns) * 1e-9 - PERIOD_S
        for target, timing in zip(targets[:reset_at], timings, strict=False)
        if target[29:58].any()
    ]
    return max(0.0, *late_s)


class Ramp(NamedTuple):
    """How the stiffness grew when a robot was armed.

    Attributes:
        rising: Steps in which it was below its full value.
        seconds: From the word that it is arming to the word that it is armed [s].
    """

    rising: int
    seconds: float


def stiffness(log: Log) -> list[float]:
    """Stiffness of the first joint as it was sent, tick by tick [N m/rad]."""
    return [float(codec.parse_f64(value)[29]) for value in log.values(keys.target(ROBOT))]


def arm(address: BusAddress, *robot: str) -> Ramp:
    """Arm a robot that stands disarmed; disarm it again."""
    with logged(address) as log, G1Process(address, *robot), Bus(address, name="ada", timeout_s=5.0) as bus:
        wait_until(lambda: ticks(log) > 5)
        assert arm_request.ask(bus, "arm", reason="a test") == {"g1": ["arming", "armed"]}
        wait_until(lambda: log.events("armed"))
        before = ticks(log)
        wait_until(lambda: ticks(log) > before + 100)
        assert log.gate()["state"] == "waiting", "no command: it is armed while it stands"
        assert not log.events("fall")
        (arming,) = log.events("arming")
        assert arming.detail["who"].endswith(", a test")
        ramp = [value for value in stiffness(log) if value > 0]
        assert ramp[0] <= 0.06 * max(ramp)
        assert np.diff(ramp).max() <= 0.06 * max(ramp), "a tick late at most"
        rising = int(np.count_nonzero(np.array(ramp) < max(ramp)))
        # A tick counts for 0.1 s at most; one that is late by more than a period is followed by the next at once.
        assert 20 <= rising <= round(RAMP_S / PERIOD_S) + 1, rising
        seconds = (log.events("armed")[0].wall_ns - arming.wall_ns) * 1e-9
        assert seconds > 0.9 * RAMP_S
        assert arm_request.ask(bus, "arm") == {"g1": ["armed"]}
        assert arm_request.ask(bus, "disarm") == {"g1": ["disarmed"]}
        wait_until(lambda: log.events("disarmed"))
        assert stiffness(log)[-1] == 0.0
    return Ramp(rising, seconds)


def take_the_bus_away(options: ServerOptions, *robot: str) -> tuple[float, float]:
    """Take the bus from a robot for a second and more; return its steps from then until it said so, and how many
    periods that were."""
    first = RedisServer.start(options)
    try:
        with G1Process(first.address, *robot) as server:
            with logged(first.address) as log:
                with StockCommander(first.address):
                    wait_until(lambda: log.gate()["state"] == "tracking")
                tick, at_s = codec.parse_json_vector(log.last(keys.policy_timing(ROBOT)))[0], time.monotonic()
                first.stop()
            pause(1.0)
            with RedisServer.start(options) as second, logged(second.address) as log:
                wait_until(lambda: log.events("bus-back"))
                later = codec.parse_json_vector(log.last(keys.policy_timing(ROBOT)))[0]
                periods = (time.monotonic() - at_s) / PERIOD_S
                wait_until(lambda: log.gate()["state"] == "waiting")
                assert log.values(keys.server_config("g1")), "a restarted bus is told again what runs"
                code, _, err = server.finish()
                assert code == 0, err
    finally:
        first.stop()
    return float(later - tick), periods
