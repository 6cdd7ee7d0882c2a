"""The ROS 2 bridge: what it passes on and refuses, what is told when a side is gone, and what its services do."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.ros2.table import STALE_S, PublishRow, SubscribeRow
from servers.ros2 import HEAD, KIND, NODE, SILENT_S, Frame, Intake, Outlet, Ros2Config
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.config import build
from station.errors import ConfigError, StationError
from tests.adapters.ros2.test_messages import joint_state, made, vector
from tests.ros import ros_python
from tests.servers.device_station import RUN
from tests.servers.ros2_station import Ros2Station, ros2_station
from tests.waiting import is_running, wait_until

TWIST, JOINTS, IMU = "geometry_msgs/msg/Twist", "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
VELOCITY = keys.action("velocity_go2")
CMD_VEL = SubscribeRow(topic="/cmd_vel", kind="twist", command="velocity", robot="go2")
WALK = {
    "publish": [
        {"topic": "/joint_states", "as": "joint-state", "key": "robot_state_go2"},
        {"topic": "/imu", "as": "imu", "key": "robot_state_go2"},
        {"topic": "/walked", "as": "twist", "key": "action_velocity_go1"},
        {"topic": "/diagnostics", "as": "diagnostics", "key": "station:event"},
    ],
    "subscribe": [{"topic": "/cmd_vel", "as": "twist", "command": "velocity", "robot": "go2"}],
    "services": {"arm": "/arm", "engage": "/engage", "zero": "/zero"},
}
SOURCE = stamp.new_source("gamepad")
NOW = 1_700_000_000_000_000_000


@pytest.fixture
def bridge(bus_server: BusAddress, tmp_path: Path) -> Iterator[Ros2Station]:
    with ros2_station(bus_server, tmp_path) as station:
        yield station


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="writer", timeout_s=5.0) as client:
        yield client


# -- What a topic takes, without a process ---------------------------------------------------------------------------
def twist(vx: float = 0.5, age_s: float = 0.0, sender: int = 0) -> Frame:
    data = made("twist", vector(vx, 0, 0), vector(0, 0, 0))
    return Frame(b"m", 0, NOW - round(age_s * 1e9), NOW, sender, data)


def names(of: Intake, now_s: float) -> list[str]:
    return [name for name, _, _ in of.on_tick(now_s)]


BAD = {
    "not-a-message": twist()._replace(data=b"\0\1\0\0short"),
    "not-finite": twist(float("nan")),
    "not-planar": twist()._replace(data=made("twist", vector(0, 0, 1), vector(0, 0, 0))),
    "out-of-range": twist(1e6),
    "stale": twist(age_s=STALE_S + 0.01),
    "wrong-clock": twist(age_s=-STALE_S - 0.01),
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_command_is_refused_counted_and_told_when_it_begins_and_ends(kind: str) -> None:
    of = Intake(CMD_VEL)
    for number in range(3):
        assert of.take(BAD[kind], NOW, number * 0.02) is None
    assert of.dropped == {kind: 3}
    assert names(of, 0.1) == ["ros2-refused"]
    assert of.take(twist(), NOW, 0.1) is not None
    assert names(of, 0.2) == []
    ((name, _, detail),) = of.on_tick(0.05 + SILENT_S)
    assert (name, detail) == ("ros2-refused", {"topic": "/cmd_vel", "ended": True, "dropped": {kind: 3}})


def test_a_message_is_as_old_as_its_header_says_unless_the_row_says_otherwise() -> None:
    robot = [f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")]
    rest = [0.0, 0.8, -1.5] * 4
    frame = Frame(b"m", 0, NOW, NOW, 0, joint_state(robot, rest, NOW - 10**9))
    taken = {
        stamp: Intake(SubscribeRow(topic="/x", kind="joint-state", command="go2-joints", stamp=stamp)).take(
            frame, NOW, 0.0
        )
        for stamp in ("header", "publisher", "none")
    }
    assert [name for name, value in taken.items() if value is None] == ["header"]
    bare = frame._replace(data=joint_state(robot, rest), at_ns=NOW - 10**9)
    of = Intake(SubscribeRow(topic="/x", kind="joint-state", command="go2-joints"))
    assert of.take(bare, NOW, 0.0) is None, "without a stamp in its header it is as old as its publisher says"


def test_a_second_publisher_is_heard_only_once_the_first_has_fallen_silent() -> None:
    of = Intake(CMD_VEL)
    for number in range(20):
        assert of.take(twist(sender=1), NOW, number * 0.02) is not None
        assert of.take(twist(sender=2), NOW, number * 0.02 + 0.01) is None
        list(of.on_tick(number * 0.02 + 0.01))
    assert of.dropped == {"second-publisher": 20}
    assert of.take(twist(sender=2), NOW, 0.38 + SILENT_S - 0.01) is None
    list(of.on_tick(0.38 + SILENT_S + 0.01))
    assert of.take(twist(sender=2), NOW, 0.38 + SILENT_S + 0.02) is not None


def test_live_silent_and_back_are_told() -> None:
    of = Intake(CMD_VEL)
    of.record(0.001, 0.001)
    assert names(of, 0.1) == ["ros2-live"]
    assert names(of, 0.1 + SILENT_S) == ["ros2-silent"]
    of.record(0.001, 2.001)
    ((name, _, detail),) = of.on_tick(2.1)
    assert (name, detail["silent_s"]) == ("ros2-back", 2.0)
    assert of.status()["passed"] == 2


def sample(seq: int, arrived_s: float, *, written_s: float | None = None, vx: float = 0.5) -> Sample:
    at_ns = round((arrived_s if written_s is None else written_s) * 1e9)
    mark = stamp.Stamp(seq, at_ns, at_ns, SOURCE, None)
    return Sample(VELOCITY, codec.json_vector([vx, 0.0, 0.0]), mark, round(arrived_s * 1e9))


def outlet() -> Outlet:
    found = Outlet(PublishRow(topic="/cmd_vel", kind="twist", key=VELOCITY))
    found.describe(Contracts())
    return found


def offered(of: Outlet, found: Sample, now_s: float, *, is_stopped: bool = False) -> bool:
    return of.message(found, round(now_s * 1e9), NOW, is_stopped=is_stopped) is not None


def test_what_was_overwritten_before_it_was_seen_is_counted_and_what_lay_too_long_is_not_passed() -> None:
    of = outlet()
    assert offered(of, sample(1, 1.0), 1.0)
    assert offered(of, sample(5, 1.02), 1.02)
    assert of.dropped["skipped"] == 3
    assert not offered(of, sample(6, 2.0, written_s=1.0), 2.0)
    assert of.dropped["stale"] == 1
    assert not offered(of, Sample(VELOCITY, b"[0, 0, 0]", None, None), 2.0), "it was there before"


def test_after_a_stop_a_commander_has_to_cease_before_it_drives_anybody_in_ros() -> None:
    of = outlet()
    for number in range(50):
        assert not offered(of, sample(number + 1, number * 0.02), number * 0.02, is_stopped=number < 10)
    assert of.dropped["stopped"] == 50
    assert offered(of, sample(51, 0.98 + 0.31), 1.29)
    assert offered(of, sample(52, 1.31), 1.31)


# -- The node's file -------------------------------------------------------------------------------------------------
def test_the_node_needs_the_standard_library_and_rclpy_alone_and_python_3_10() -> None:
    tree = ast.parse(NODE.read_text(), feature_version=(3, 10))
    roots = {
        name.split(".")[0]
        for node in ast.walk(tree)
        for name in (
            [each.name for each in node.names] if isinstance(node, ast.Import)
            else [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        )
    }  # fmt: skip
    assert roots - set(sys.stdlib_module_names) == {"rclpy"}


def test_server_and_node_mean_the_same_by_a_frame() -> None:
    spec = importlib.util.spec_from_file_location("station_node", NODE)
    assert spec is not None
    assert spec.loader is not None
    node = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(node)
    assert node.HEAD.format == HEAD.format
    assert node.BEAT_S * 5 < 2.0, "a node that speaks so often is not taken for one that stands still"


def test_the_node_by_itself_says_what_starts_it(processes: None) -> None:
    done = subprocess.run([sys.executable, str(NODE)], input=b"", capture_output=True, check=False)
    assert (done.returncode, b"station serve ros2" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"node": "a node"}, "node is 'a node'"), ({"domain_id": 300}, "domain_id is 300"),
        ({"python": ""}, "python is empty"), ({"python": "'"}, "No closing quotation"),
    ],
    ids=["node", "domain", "python", "quotes"],
)  # fmt: skip
def test_wrong_settings_are_said_in_a_line(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build(Ros2Config, {"table": "x", **settings}, where="test")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"python": "python-of-nowhere"}, "python-of-nowhere is no program"),
        ({"setup": "/opt/ros/nowhere/setup.bash"}, "/opt/ros/nowhere/setup.bash is no file"),
        ({"table": "tables/of/nobody.yaml"}, "nobody.yaml"),
    ],
    ids=["python", "setup", "table"],
)  # fmt: skip
def test_what_is_not_on_this_computer_is_said_before_anything_starts(settings: dict[str, Any], said: str) -> None:
    config = build(Ros2Config, {"table": "builtin:ros2/go2.yaml", **settings}, where="test")
    assert KIND.expect is not None
    with pytest.raises(StationError, match=said):
        KIND.expect(config)


# -- Real processes, a real ROS --------------------------------------------------------------------------------------
def a_state() -> bytes:
    state = np.zeros(31)
    state[:12], state[24] = np.arange(12) / 10, 1.0
    return state.tobytes()


def test_topics_become_commands_and_states_topics_until_ctrl_c(bridge: Ros2Station, bus: Bus, tmp_path: Path) -> None:
    setup = tmp_path / "setup.bash"
    setup.write_text(f'echo "ROS is set up"\nexport PATH={Path(ros_python()).parent}:$PATH\n')
    bridge.start(table=WALK, engaged=True, setup=str(setup), python="python")
    bridge.peer.listen("/joint_states", JOINTS)
    bridge.peer.listen("/imu", IMU)
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": 0.5, "y": -0.25}, angular={"z": 0.125})
    bridge.until(lambda: len(bridge.written[VELOCITY]) > 10)
    assert {tuple(each) for each in bridge.vectors(VELOCITY)} == {(0.5, -0.25, 0.125)}

    def heard() -> bool:
        bus.publish({"robot_state_go2": a_state()})
        time.sleep(0.02)
        return len(bridge.peer.heard("/joint_states")) > 3 and len(bridge.peer.heard("/imu")) > 3

    wait_until(heard)
    joints = bridge.peer.heard("/joint_states")[-1]
    np.testing.assert_allclose(joints["position"], np.arange(12) / 10)
    assert (joints["name"][0], joints["name"][-1]) == ("FL_hip", "RR_calf")
    assert bridge.peer.heard("/imu")[-1]["orientation"]["w"] == 1.0
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": float("nan")})
    bridge.until(lambda: bridge.told("ros2-refused"))
    bridge.peer.cease("/cmd_vel")
    bridge.until(lambda: bridge.told("ros2-silent"))
    bridge.until(lambda: bridge.detail["subscribe"]["/cmd_vel"]["dropped"].get("not-finite"))
    bridge.until(lambda: bridge.detail["publish"]["/joint_states"]["passed"] >= len(bridge.peer.heard("/joint_states")))
    node = bridge.node()
    opened = [each.readlink() for each in Path(f"/proc/{node}/fd").iterdir()]
    shared = [each for each in opened if re.fullmatch(r"fastdds_[0-9a-f]+_el", each.name)]
    assert bridge.interrupt() == 0
    wait_until(lambda: not is_running(node))
    assert shared
    assert not any(each.exists() for each in shared), "memory that is shared is nobody's to free later"


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_a_node_that_dies_or_stands_still_is_told_of_and_started_again(
    bridge: Ros2Station, bus: Bus, how: signal.Signals
) -> None:
    bridge.start(table=WALK, engaged=True)
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": 0.5})
    bridge.until(lambda: bridge.told("ros2-live"))
    node = bridge.node()
    os.kill(node, how)
    bridge.until(lambda: bridge.told("ros2-again"))
    assert not is_running(node), "one that stands still is killed: it must not go on with what is old"
    (lost,), (again,) = bridge.told("ros2-lost"), bridge.told("ros2-again")
    assert ("signal 9" if how == signal.SIGKILL else "said nothing") in lost.detail["reason"]
    assert again.detail["silent_s"] > 0
    written = len(bridge.written[VELOCITY])
    bridge.until(lambda: len(bridge.written[VELOCITY]) > written + 10)


def test_a_peer_that_is_killed_is_silent_and_one_that_comes_is_heard(bridge: Ros2Station) -> None:
    bridge.start(table=WALK, engaged=True)
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": 0.5})
    bridge.until(lambda: bridge.told("ros2-live"))
    bridge.peer.kill()
    bridge.until(lambda: bridge.told("ros2-silent"))
    bridge.peer.__init__(bridge.domain)  # type: ignore[misc]
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": 0.25})
    bridge.until(lambda: bridge.told("ros2-back"))
    assert bridge.told("ros2-back")[0].detail["silent_s"] >= SILENT_S
    assert bridge.vectors(VELOCITY)[-1] == [0.25, 0.0, 0.0]


@pytest.mark.parametrize("how", ["server killed", "server frozen", "stopped", "silent"])
def test_who_is_driven_in_ros_is_told_to_stand_when_the_station_falls_silent(
    bridge: Ros2Station, bus: Bus, how: str
) -> None:
    bridge.start(table=WALK)
    bridge.peer.listen("/walked", TWIST)
    command = {"action_velocity_go1": codec.json_vector([0.5, 0.0, 0.0])}

    def walks() -> bool:
        bus.publish(command)
        time.sleep(0.02)
        heard = bridge.peer.heard("/walked")
        return len(heard) > 5 and heard[-1]["linear"]["x"] == 0.5

    wait_until(walks)
    if how == "server killed":
        bridge.node()
        bridge.process.kill()
    elif how == "server frozen":
        bridge.node()
        bridge.process.send_signal(signal.SIGSTOP)
    elif how == "stopped":
        bus.publish({keys.ESTOP: codec.json_object({"stop": True, "reason": "test"})})
        for _ in range(20):
            bus.publish(command)
            time.sleep(0.02)
    wait_until(lambda: bridge.peer.heard("/walked")[-1]["linear"]["x"] == 0.0)
    said = [each["linear"]["x"] for each in bridge.peer.heard("/walked")]
    assert len(said) - max(place for place, vx in enumerate(said) if vx) <= 11, "it says so ten times"


def test_services_arm_engage_and_send_to_rest(bridge: Ros2Station) -> None:
    bridge.start(table=WALK)
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": 0.5})
    bridge.until(lambda: bridge.detail["subscribe"]["/cmd_vel"]["dropped"].get("not-engaged"))
    assert not bridge.written[VELOCITY], "a table with a service to engage begins without"
    done = bridge.peer.call("/engage", "std_srvs/srv/SetBool", data=True)
    assert done["success"], done
    bridge.until(lambda: len(bridge.written[VELOCITY]) > 5)
    assert bridge.peer.call("/zero", "std_srvs/srv/Trigger")["success"]
    bridge.until(lambda: not bridge.detail["engaged"])
    refused = bridge.peer.call("/arm", "std_srvs/srv/SetBool", data=True)
    assert not refused["success"]
    assert "no low-level server" in refused["message"]
    bridge.until(lambda: len(bridge.told("ros2-called")) == 3)
    assert [event.detail["service"] for event in bridge.told("ros2-called")] == ["/engage", "/zero", "/arm"]


def test_events_are_diagnostics_and_a_command_through_a_stop_is_dropped(bridge: Ros2Station, bus: Bus) -> None:
    bridge.start(table=WALK, engaged=True)
    bridge.peer.listen("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    bridge.until(lambda: bridge.detail["publish"]["/diagnostics"]["peers"])
    bridge.peer.publish("/cmd_vel", TWIST, linear={"x": 0.5})
    wait_until(lambda: any(each["status"][0]["message"] == "ros2-live" for each in bridge.peer.heard("/diagnostics")))
    bus.publish({keys.ESTOP: codec.json_object({"stop": True, "reason": "test"})})
    bridge.until(lambda: bridge.detail["subscribe"]["/cmd_vel"]["dropped"].get("stopped"))
    assert bridge.detail["stopped"]


def test_a_python_without_ros_ends_the_bridge_with_one_line(bus_server: BusAddress) -> None:
    config = json.dumps({"table": "builtin:ros2/go2.yaml", "python": sys.executable})
    command = [sys.executable, "-c", RUN, "ros2", bus_server.url, config]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    assert (done.returncode, "Traceback" in done.stderr) == (1, False), done.stderr
    assert "has no rclpy" in done.stderr.splitlines()[-1]
