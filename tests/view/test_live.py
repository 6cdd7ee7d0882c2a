"""A live station in Rerun, from a real bus."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from adapters.robots.g1 import twist_keys
from adapters.robots.kassow import kinematics
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import NotReady
from station.life import events
from station.point_cloud import decoded, encoded, voxels, xyz
from station.view.live import LiveView
from tests.episode.filming import cloud
from tests.episode.synthetic import ROBOT, STANDING, command
from tests.view import arms
from tests.view.robots import tiny
from tests.view.rrd import Recorded
from tests.waiting import wait_until


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus:
        yield bus


def publish(bus: Bus, *, height: float, gate: str = "tracking") -> None:
    state = np.concatenate([STANDING, np.zeros(29), [1.0, 0, 0, 0], np.zeros(3)])
    bus.publish(
        {
            keys.robot_state(ROBOT): codec.f64(state),
            keys.sim_qpos(ROBOT): codec.f64(np.concatenate([[0, 0, height, 1, 0, 0, 0], STANDING])),
            keys.command_used(ROBOT): codec.f64(command(height=0.7)),
            keys.command_gate(ROBOT): json.dumps({"state": gate}).encode(),
        }
    )


def test_newest_values_are_drawn_once_each(bus: Bus, tmp_path: Path) -> None:
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "live.rrd")
    publish(bus, height=0.8, gate="entering")
    with LiveView(bus, recording, robot_model=tiny(tmp_path)) as view:
        assert view.robot == ROBOT
        wait_until(lambda: view._watch.is_connected)
        assert view.poll() == 4
        assert view.poll() == 0
        publish(bus, height=0.75)
        bus.publish({keys.EVENT: events.make("g1", "mark", label="here").encode()})
        drawn = 0

        def everything_was_drawn() -> bool:
            nonlocal drawn
            drawn += view.poll()
            return drawn == 5

        wait_until(everything_was_drawn)
    recording.flush()
    recording.disconnect()
    recorded = Recorded(tmp_path / "live.rrd")
    heights = np.array(recorded.column("world/robot/pelvis", ":translation")).reshape(-1, 3)[:, 2]
    assert heights[0] == pytest.approx(0.8)
    assert heights[-1] == pytest.approx(0.75)
    ghost = np.array(recorded.column("world/reference/pelvis", ":translation")).reshape(-1, 3)
    assert ghost[-1] == pytest.approx([0.0, 0.9, 0.7], abs=1e-6)
    assert recorded.column("states/gate", "StateChange:state") == [["entering"], ["tracking"]]
    assert recorded.column("events", "TextLog:text") == [["g1: mark label=here"]]
    assert recorded.rows(f"curves/state/{keys.sim_qpos(ROBOT)}/position") == 2


@pytest.mark.parametrize(("parent", "entity"), [("head", "world/robot/head/top"), ("", "clouds/top")])
def test_the_newest_cloud_of_a_lidar_that_is_stated_is_drawn(
    parent: str, entity: str, bus: Bus, tmp_path: Path
) -> None:
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "live.rrd")
    publish(bus, height=0.8)
    facts = {"lidar": "top", "key": keys.lidar_cloud("top"), **({"mount": {"parent": parent}} if parent else {})}
    bus.publish({keys.server_config("top"): json.dumps(facts).encode()})
    with LiveView(bus, recording, robot_model=tiny(tmp_path)) as view:
        wait_until(lambda: view._watch.is_connected)
        view.poll()
        for number in range(2):
            value = encoded(decoded(cloud(number))._replace(frame=parent or "livox"))
            bus.publish({keys.lidar_cloud("top"): value})
            wait_until(view.poll)
        bus.publish({keys.lidar_cloud("top"): b"no cloud"})
        wait_until(view.poll)
    recording.flush()
    recording.disconnect()
    recorded = Recorded(tmp_path / "live.rrd")
    found = recorded.column(entity, "Points3D:positions")
    assert [len(points) for points in found] == [len(voxels(xyz(decoded(cloud(number))))) for number in range(2)]


def test_value_that_does_not_fit_its_contract_is_passed_over(bus: Bus, tmp_path: Path) -> None:
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "live.rrd")
    publish(bus, height=0.8)
    bus.publish({twist_keys.action_body(): b"[1, 2", twist_keys.state_body(ROBOT): codec.json_vector([0.0] * 127)})
    with LiveView(bus, recording, robot_model=tiny(tmp_path)) as view:
        wait_until(lambda: view._watch.is_connected)
        view.poll()
    recording.flush()
    recording.disconnect()
    recorded = Recorded(tmp_path / "live.rrd")
    assert recorded.rows(f"curves/command/{twist_keys.action_body()}/angle") == 0
    assert recorded.rows("world/robot/pelvis") == 1


def test_bus_without_a_robot_is_one_line(bus: Bus) -> None:
    with pytest.raises(NotReady, match="no robot writes its state"):
        LiveView(bus, rr.RecordingStream("test"))


def test_an_arm_is_found_and_drawn_with_its_target_in_its_place(bus: Bus, tmp_path: Path) -> None:
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "live.rrd")
    source = {"kind": "operator", "driver": "arm-tcp", "mode": "tool", "engaged": True}
    told = {keys.command_source(arms.ROBOT): codec.json_object(source)}
    bus.publish(arms.values(arms.START, asked=arms.START + 0.1) | told)
    with LiveView(bus, recording) as view:
        assert (view.robot, view.warnings) == (arms.ROBOT, [])
        wait_until(view.poll)
    recording.flush()
    recording.disconnect()
    recorded = Recorded(tmp_path / "live.rrd")
    chain = kinematics.MODELS["kr810"]
    for entity, q in (("robot", arms.START), ("reference", arms.START + 0.1)):
        flange = np.array(recorded.column(f"world/{entity}/link7", ":translation")).reshape(-1, 3)[-1]
        assert flange == pytest.approx(chain.posture(q).position, abs=1e-6)
    assert recorded.rows(f"curves/state/{keys.state_joints(arms.ROBOT)}/angle") == 1
    assert recorded.column("states/motion", "StateChange:state") == [["tool"]]


def test_a_second_arm_of_a_model_that_nobody_has_drawn_is_shown_by_its_curves(bus: Bus, tmp_path: Path) -> None:
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "live.rrd")
    key = keys.state_joints("kassow_kr1805_left")
    bus.publish({key: codec.f64(np.zeros(21))})
    with LiveView(bus, recording) as view:
        assert view.robot == "kassow_kr1805_left"
        assert view.warnings[0].startswith("the robot is not drawn: builtin:kassow_kr1805.xml")
        wait_until(view.poll)
    recording.flush()
    recording.disconnect()
    assert Recorded(tmp_path / "live.rrd").rows(f"curves/state/{key}/angle") == 1
