"""``station serve robot``: any robot that is registered, with settings of its own, by one server."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest

from servers.g1 import G1Config
from station import config, registry
from station.bus import keys
from station.bus.client import Bus
from station.control import rig
from station.control.rig import RigConfig, checkpoint_of, robot_kind
from station.control.robot_server import PolicyServerConfig, RobotConfig
from station.errors import ConfigError, UnknownName
from tests.cli.running import new_home, one_line
from tests.servers.g1_station import ROBOT
from tests.waiting import wait_until

OPTIONS = {"physics_dt_s": 0.002, "model": "builtin:g1_dex3.xml"}


@pytest.mark.usefixtures("processes")
def test_a_robot_is_served_by_its_registered_name_and_states_what_it_is() -> None:
    with new_home() as home, home.running("bus", "start"):
        wait_until(home.bus_is_there)
        options = (f"--set=robot_options.{name}={value}" for name, value in OPTIONS.items())
        settings = ["--set", "robot=g1-mujoco", *options]
        with home.running("serve", "robot", *settings) as server:
            wait_until(lambda: (it := home.health().get("robot")) is not None and it.state == "active")
            stated = home.json("describe", ROBOT)
            assert (stated["model"], len(stated["joints"])) == ("unitree_g1", 29)
            with Bus(home.bus, name="test", timeout_s=5.0) as line:
                wait_until(lambda: line.get(keys.command_gate(ROBOT)) is not None)
            gate = home.json("describe", keys.command_gate(ROBOT))["value"]
            assert (gate["state"], gate["arming"]) == ("waiting", "armed")
            server.interrupt()
            assert server.finish()[0] == 0


def test_the_server_of_a_g1_is_that_of_any_robot_with_short_names() -> None:
    simulated = {"robot_model": "x.xml", "physics_dt_s": 0.002, "viewer": True}
    given = G1Config(**simulated, policy="twist2", rate_hz=25.0, pace="command")
    general = RobotConfig(
        robot="g1-mujoco", robot_options={"model": "x.xml", "physics_dt_s": 0.002, "viewer": True}, policy="twist2",
        rate_hz=25.0, pace="command",
    )  # fmt: skip
    assert given.rig == general.rig
    assert {name: getattr(given, name) for name in PolicyServerConfig.__struct_fields__} == {
        name: getattr(general, name) for name in PolicyServerConfig.__struct_fields__
    }
    assert given.is_armed
    assert not G1Config(start_armed=False).is_armed


def test_without_a_window_the_rest_of_a_rig_stays() -> None:
    shown = RigConfig(robot="g1-mujoco", robot_options={"viewer": True, "physics_dt_s": 0.002})
    assert shown.headless().robot_options == {"viewer": False, "physics_dt_s": 0.002}


def test_one_robot_is_the_default_and_its_policy_has_a_checkpoint() -> None:
    kind = robot_kind("")
    assert kind.name in registry.names("robot")
    assert checkpoint_of(kind.policy).startswith("builtin:")
    assert checkpoint_of(kind.policy, "mine.onnx") == "mine.onnx"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"robot": "g1-mojoco"}, "unknown robot 'g1-mojoco' (did you mean 'g1-mujoco'?)"),
        ({"robot": "g1-mujoco", "robot_options": {"modl": "x"}}, "unknown key 'modl' (did you mean 'model'?)"),
        ({"robot": "g1-mujoco", "policy": "trackr"}, "unknown policy 'trackr' (did you mean 'tracker'?)"),
    ],
)
def test_a_wrong_name_is_refused_before_anything_is_loaded(values: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        config.build(RobotConfig, values, where="robot")


def test_a_wrong_setting_of_a_robot_names_it_and_those_it_has() -> None:
    with pytest.raises(ConfigError, match=re.escape("robot g1-mujoco: unknown key 'modl' (did you mean 'model'?)")):
        robot_kind("g1-mujoco").typed({"modl": "x"})
    with pytest.raises(UnknownName):
        robot_kind("h1-mojoco")


@pytest.mark.usefixtures("processes")
def test_a_wrong_setting_ends_the_server_in_a_line_before_it_looks_for_a_bus() -> None:
    with new_home() as home:
        said = one_line(home.run("serve", "robot", "--set", "robot=g1-mujoco", "--set", "robot_options.modl=x"))
    assert "robot g1-mujoco: unknown key 'modl' (did you mean 'model'?)" in said


def test_offline_no_real_robot_is_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []
    kind = msgspec.structs.replace(robot_kind("g1-mujoco"), name="g1-real", is_simulated=False,
                                   make=lambda *given: made.append(given))  # fmt: skip
    monkeypatch.setattr(rig, "robot_kind", lambda _name: kind)
    with pytest.raises(ConfigError, match="robot 'g1-real' is a real one; only its server drives it"):
        rig.build(RigConfig(robot="g1-real"))
    assert made == []
    assert not RobotConfig(robot="g1-mujoco").is_armed, "nor is it armed from the start"
    rig.build(RigConfig(robot="g1-real"), may_be_real=True)
    assert len(made) == 1
