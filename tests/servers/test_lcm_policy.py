"""The LCM bridge in the place of HOMIE's `g1_control`: what it tells HOMIE's policy, and what it obeys."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.lcm.homie import low_level_of, low_level_routes, robot_messages
from servers.lcm import LcmConfig, TargetsIntake
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.config import build
from station.control.foreign_stream import SILENT_S, Arrived
from station.errors import ConfigError
from tests.servers.bridge_station import InThread
from tests.servers.lcm_station import SOME_ARMS, LcmStation, lcm_station

LEGS = keys.action("targets_g1_29_legs")
LEFT, RIGHT = (keys.action_joints(f"g1_29_{side}_arm") for side in ("left", "right"))
CHANNEL = "pd_plustau_targets"
STANDING = [-0.1, 0.0, 0.0, 0.3, -0.2, 0.0] * 2
STATE = np.array([*np.linspace(-0.3, 0.3, 29), *np.linspace(-1.0, 1.0, 29), 1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3])
PRESSED, RELEASED = (robot_messages(STATE, is_pressed=down)["rc_command"] for down in (True, False))


def targets(legs: list[float], *, others: float = 0.0, kind: int = 0x86DB34943194C221) -> bytes:
    """Return a message as HOMIE's policy sends it: its layout stands here once more."""
    return struct.pack(">Q29d29dq", kind, *legs, *[others] * 17, *[0.0] * 29, 1_700_000_000_000_000)


GOOD = targets(STANDING)
BAD = {
    "wrong-length": (GOOD[:-8], "472 bytes, expected the 480 of pd_tau_targets_lcmt"),
    "wrong-type": (targets(STANDING, kind=0xDB10251DE2523982), "expected 86db34943194c221 of pd_tau_targets_lcmt"),
    "not-finite": (targets([math.nan, *STANDING[1:]]), "a number of q_des is not finite"),
    "out-of-range": (targets([*STANDING[:3], 5.0, *STANDING[4:]]), "left_knee_pos is 5, allowed -2.087 to 4.88"),
}


def intake() -> TargetsIntake:
    return TargetsIntake(low_level_routes(low_level_of("g1_29"))[0])


def take(legs: TargetsIntake, message: bytes, at_s: float) -> bool:
    found = legs.take(Arrived(message, "127.0.0.1:1001", at_s), at_s)
    if found is not None:
        legs.record(found, at_s)
    return found is not None


def steady(legs: TargetsIntake, *, from_s: float = 0.0) -> float:
    """Send as a policy that runs does, until it is followed; return the instant of the last one [s]."""
    at_s = from_s
    while not take(legs, GOOD, at_s):
        at_s += 0.02
        assert at_s < from_s + 1.0
    return at_s


@pytest.mark.parametrize("kind", BAD)
def test_what_are_no_targets_is_refused_and_told_what_came_and_what_was_expected(kind: str) -> None:
    legs, (message, told) = intake(), BAD[kind]
    assert not take(legs, message, 0.0)
    ((name, _, detail),) = legs.on_tick(0.0)
    assert (name, detail["reason"].partition(":")[0]) == ("lcm-refused", kind)
    assert told in detail["reason"]
    last_s = steady(legs, from_s=0.02)
    assert not take(legs, message, last_s + 0.02), "also of a policy that is followed"
    assert legs.dropped[kind] == 2
    assert take(legs, GOOD, last_s + 0.04)


def test_a_number_that_is_not_finite_is_refused_also_of_a_joint_that_is_not_obeyed() -> None:
    assert not take(intake(), targets(STANDING, others=math.inf), 0.0)


def test_targets_are_followed_once_they_come_as_often_as_from_a_policy_that_runs() -> None:
    legs = intake()
    assert steady(legs) == pytest.approx(0.18)
    assert legs.dropped == {"not-steady": 9}
    assert take(legs, GOOD, 0.4), "one that is late is followed again at once"


def test_a_calibration_is_not_followed_however_long_it_takes() -> None:
    legs = intake()
    assert not any(take(legs, GOOD, number * 0.07) for number in range(200))
    ((_, _, detail), *_) = legs.on_tick(14.0)
    assert "not-steady: the first message, expected 30 or more a second for 0.3 s" in detail["reason"]


def test_after_a_silence_it_has_to_be_steady_again() -> None:
    legs = intake()
    last_s = steady(legs)
    assert not take(legs, GOOD, last_s + 0.31)
    assert steady(legs, from_s=last_s + 0.33) > last_s + 0.33
    assert "lcm-silent" in {name for name, _, _ in legs.on_tick(last_s + 1.0 + SILENT_S)}


# -- With real processes ---------------------------------------------------------------------------------------------
@pytest.fixture
def bridge(bus_server: BusAddress, tmp_path: Path) -> Iterator[LcmStation]:
    with lcm_station(bus_server, tmp_path) as made:
        made.start(mode="their-policy")
        yield made


class Robot(InThread):
    """Says fifty times a second where it is and whether it is armed, as a robot's server does."""

    def __init__(self, bus: Bus) -> None:
        self.state, self.arming = STATE, "armed"
        self.is_silent, self._bus = False, bus
        super().__init__()

    def _run(self) -> None:
        while not self._ends.wait(0.02):
            if not self.is_silent:
                gate = codec.json_object({"state": "waiting", "arming": self.arming})
                state = codec.f64(self.state)
                self._bus.publish({keys.robot_state("g1_29"): state, keys.command_gate("g1_29"): gate})


@pytest.fixture
def robot(bus_server: BusAddress) -> Iterator[Robot]:
    with Bus(bus_server, name="robot", timeout_s=5.0) as client:
        made = Robot(client)
        yield made
        made.close()


def heard(bridge: LcmStation) -> dict[str, list[bytes]]:
    """Return what has come by now, by channel."""
    found: dict[str, list[bytes]] = {}
    for each in bridge.peer.receive(0.0):
        found.setdefault(each.channel, []).append(each.message)
    return found


def test_a_policy_is_told_where_the_robot_is_200_times_a_second_and_nothing_once_that_is_silent(
    bridge: LcmStation, robot: Robot
) -> None:
    came: dict[str, list[bytes]] = {}

    def has_come() -> bool:
        for channel, messages in heard(bridge).items():
            came.setdefault(channel, []).extend(messages)
        return len(came.get("rc_command", ())) > 400

    bridge.until(has_come)
    assert set(came) == {"state_estimator_data", "body_control_data", "rc_command"}
    expected = robot_messages(STATE, is_pressed=False)
    assert set(came["state_estimator_data"]) == {expected["state_estimator_data"]}
    assert set(came["body_control_data"]) == {expected["body_control_data"]}
    sent = bridge.detail["sent"]
    assert sent["body_control_data"] == sent["rc_command"]
    robot.is_silent = True
    bridge.until(lambda: bridge.told("lcm-robot-silent"))
    heard(bridge)
    bridge.until(lambda: bridge.detail["robot_heard"] is False)
    assert heard(bridge) == {}
    robot.is_silent = False
    bridge.until(lambda: len(bridge.told("lcm-robot-told")) == 2)


@pytest.mark.parametrize("state", [STATE[:-1], np.append(STATE[:-1], np.nan)], ids=["short", "no number"])
def test_a_state_that_is_none_is_not_passed_on(bridge: LcmStation, robot: Robot, state: np.ndarray) -> None:
    bridge.until(lambda: bridge.told("lcm-robot-told"))
    robot.state = state
    bridge.until(lambda: bridge.told("lcm-robot-silent"))


def test_r2_is_pressed_again_and_again_while_the_robot_is_armed_and_no_targets_come(
    bridge: LcmStation, robot: Robot
) -> None:
    robot.arming = "disarmed"
    remote: list[bytes] = []

    def presses() -> int:
        remote.extend(heard(bridge).get("rc_command", ()))
        return sum(before == RELEASED and after == PRESSED for before, after in itertools.pairwise(remote))

    bridge.until(lambda: presses() == 0 and len(remote) > 600)
    robot.arming = "armed"
    bridge.until(lambda: presses() == 2)
    assert len(bridge.told("lcm-pressed")) == 1

    def comes() -> bool:
        bridge.peer.send(CHANNEL, GOOD)
        presses()
        return len(bridge.written[LEGS]) > 30

    remote.clear()
    bridge.until(comes)
    assert remote[-10:] == [RELEASED] * 10
    bridge.until(lambda: bridge.detail["presses"] >= 2)


def test_targets_and_arms_are_commands_on_the_bus_and_nothing_is_written_once_they_are_silent(
    bridge: LcmStation, robot: Robot
) -> None:
    def passed() -> bool:
        bridge.peer.send(CHANNEL, GOOD)
        bridge.send("arm_action", SOME_ARMS)
        bridge.send("pedal_command", [0.5, 0.0, 0.0, 0.74])
        return len(bridge.written[LEGS]) > 20 and len(bridge.written[LEFT]) > 20

    bridge.until(passed)
    assert bridge.vectors(LEGS)[-1] == [*STANDING, 1.0]
    assert bridge.vectors(LEFT)[-1] + bridge.vectors(RIGHT)[-1] == SOME_ARMS
    bridge.until(lambda: CHANNEL in {event.detail["channel"] for event in bridge.told("lcm-silent")})
    count = len(bridge.written[LEGS])
    bridge.until(lambda: bridge.detail["channels"][CHANNEL]["live"] is False)
    assert len(bridge.written[LEGS]) == count
    commands = {key for key in bridge.written if key.startswith("action_")}
    assert commands == {LEGS, LEFT, RIGHT}, "pedals are the policy's affair"
    assert bridge.interrupt() == 0


def test_another_robot_on_the_bus_is_told(bridge: LcmStation, robot: Robot) -> None:
    state = robot_messages(STATE, is_pressed=False)["body_control_data"]
    bridge.until(lambda: bridge.told("lcm-robot-told"))
    bridge.until(lambda: [bridge.peer.send("body_control_data", state)] and bridge.told("lcm-second-sender"))
    bridge.until(lambda: any(event.detail.get("ended") for event in bridge.told("lcm-second-sender")))


def test_hands_are_none_of_the_policys() -> None:
    with pytest.raises(ConfigError, match="hands is true; expected false with mode their-policy"):
        build(LcmConfig, {"mode": "their-policy", "hands": True}, where="server lcm")
