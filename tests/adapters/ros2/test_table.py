"""Tables of the ROS 2 bridge: those that are built in are read, and what is wrong in another is said in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.ros2 import table
from station.errors import StationError

BAD = {
    "no row": ("{}", "it has no row"),
    "a topic twice": (
        "publish: [{topic: /cmd_vel, as: twist, key: action_velocity_go2}]\n"
        "subscribe: [{topic: cmd_vel, as: twist, command: velocity, robot: go2}]",
        "it would hear itself",
    ),
    "a name with a blank": ("publish: [{topic: /cmd vel, as: twist, key: x}]", "no name of a topic"),
    "joints of a twist": ("publish: [{topic: /x, as: twist, key: x, joints: {names: [a]}}]", "is for joint-state"),
    "another kind": ("publish: [{topic: /x, as: odometry, key: x}]", "odometry"),
    "a word too many": ("publish: [{topic: /x, as: imu, key: x, rate: 5}]", "rate"),
    "offsets of fewer": (
        "publish: [{topic: /x, as: joint-state, key: x, joints: {names: [a, b], offset: [1]}}]", "offset has 1 entries"
    ),
    "a scale of nothing": (
        "subscribe: [{topic: /x, as: joint-state, command: go2-joints, joints: {names: [a], scale: 0}}]", "scale is 0"
    ),
    "a stamp's key": ("publish: [{topic: /x, as: imu, key: robot_state_go2@}]", "robot_state_go2@"),
    "a negative age": ("subscribe: [{topic: /x, as: twist, command: velocity, max_age_s: -1}]", "max_age_s is -1"),
    "no depth": ("publish: [{topic: /x, as: imu, key: x, qos: {depth: 0}}]", "depth is 0"),
    "no YAML": ("publish: [", "table.yaml"),
}  # fmt: skip


@pytest.mark.parametrize("name", ["go2", "pilla-policy"])
def test_a_built_in_table_is_read_and_what_moves_somebody_has_an_end(name: str) -> None:
    found = table.read(f"builtin:ros2/{name}.yaml")
    assert found.publish
    assert all(row.max_age_s == table.STALE_S for row in found.subscribe)
    assert table.PublishRow(topic="/cmd_vel", kind="twist", key="action_velocity_go2").ends_after_s == 0.3


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_in_a_table_is_said_in_one_line_with_its_file(what: str, tmp_path: Path) -> None:
    text, said = BAD[what]
    (tmp_path / "table.yaml").write_text(text)
    with pytest.raises(StationError) as caught:
        table.read(str(tmp_path / "table.yaml"))
    assert said in str(caught.value)
    assert "table.yaml" in str(caught.value)
    assert "\n" not in str(caught.value).strip()
