"""An operator drives an arm through real processes: a fake spacemouse under the real library, our own bus."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from adapters.robots.kassow.kinematics import KR810
from station.bus import codec, keys
from tests.lateness import STALE_S, TooLate, Waits, in_time
from tests.servers.operated_arm import ROBOT, OperatedArm
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(240)

SPEED_RAD_S, RATE_HZ = 0.3, 250.0
ROUNDS = 3
_REST = [0, 0, 0, 0, 0, 0]


def press(at_s: float, for_s: float = 0.4) -> list[dict[str, Any]]:
    return [{"at_s": at_s, "buttons": [0]}, {"at_s": at_s + for_s, "buttons": []}]


def push(at_s: float, twist: list[float], for_s: float) -> list[dict[str, Any]]:
    return [{"at_s": at_s, "twist": twist}, {"at_s": at_s + for_s, "twist": _REST}]


def test_the_tool_is_moved_and_then_a_joint_and_let_go_the_arm_stays_where_it_is(tmp_path: Path) -> None:
    in_time(lambda: move_and_let_go(Path(mkdtemp(dir=tmp_path))), ROUNDS)


def move_and_let_go(folder: Path) -> None:
    steps = [
        *press(0.5), *push(1.0, [1, 0, 0, 0, 0, 0], 1.0), *press(2.1, 1.4), *push(3.7, [0, 0, 0, 0, 0, 1], 1.0),
        *press(5.0), *push(5.5, [1, 1, 1, 1, 1, 1], 1.0),
    ]  # fmt: skip
    with Waits.watched() as waits, OperatedArm(folder, steps) as station:
        arm = station.start_arm()
        station.start_script()
        started = arm.session.q.copy()
        released = station.wait_for("operator-disengaged")
        expect_released(str(released.detail["reason"]), waits)
        wait_until(lambda: bool((np.abs(station.commands()[-1] - arm.session.q) < 1e-9).all()))
        commands = station.commands()
        assert station.told("operator-mode")[0].detail["mode"] == "joints 1-4"
        assert commands[0] == pytest.approx(started, abs=1e-6)
        assert np.abs(np.diff(commands, axis=0)).max() <= SPEED_RAD_S / RATE_HZ + 1e-9
        moved = np.array([KR810.posture(q).position for q in commands[::25]])
        assert moved[:, 0].max() - moved[0, 0] > 0.08  # the tool went forwards
        assert commands[:, 0].max() - started[0] > 0.2  # and then the base turned
        rest = arm.session.q.copy()
        count = len(commands)
        wait_until(lambda: len(station.commands()) > count + 250)  # another second, the cap is pushed in it
        assert station.commands()[-1] == pytest.approx(commands[-1], abs=0.0)
        assert arm.session.q == pytest.approx(rest, abs=0.0)
        source = codec.parse_json(station.log.last(keys.command_source(ROBOT)))
        assert (source["driver"], source["engaged"]) == ("arm-tcp", False)
        assert not station.log.values(keys.T_ACTION)  # of stock readers, which there are none for an arm


def expect_released(reason: str, waits: Waits) -> None:
    """The operator let go; or samples came late, as on a busy machine, and the script's next press began anew."""
    if reason != "released":
        waits.seconds()
        raise TooLate(reason, STALE_S / 2, waits.longest_s)


def test_nobody_drives_an_arm_that_has_not_said_where_it_is(tmp_path: Path) -> None:
    again = [step for number in range(1, 15) for step in press(4.0 * number)]  # until there is an arm
    with OperatedArm(tmp_path, [*press(0.5), *again]) as station:
        station.start_script()
        refused = station.wait_for("operator-refused")
        assert refused.detail["reason"] == "the robot has not said where it is; is its server started?"
        assert not len(station.commands())
        arm = station.start_arm()
        station.wait_for("operator-engaged")
        wait_until(lambda: len(station.commands()))
        assert station.commands()[0] == pytest.approx(arm.session.q, abs=1e-6)


def test_after_a_fault_the_arm_is_driven_from_where_it_stands_and_only_after_a_new_press(tmp_path: Path) -> None:
    steps = [*press(0.5), *push(1.0, [0, 0, 1, 0, 0, 0], 3.0), *press(5.0), *press(9.0), *press(13.0)]
    with OperatedArm(tmp_path, steps, driver="arm-joints") as station:
        arm = station.start_arm()
        station.start_script()
        wait_until(lambda: len(arm.session.sent) > 50)
        arm.session.fault = "HALT: event 1010"
        ended = station.wait_for("teleop-commands-end")
        assert "HALT: event 1010" in ended.detail["reason"]
        assert ended.detail["then"] == "the robot stays where it is; engage anew"
        arm.session.q = arm.session.q + 0.05  # pushed aside meanwhile
        arm.session.goal = arm.session.q.copy()
        stands = arm.session.q.copy()
        count = len(station.commands())
        arm.session.clear()
        arm.control.cleared("tests")
        station.wait_for("operator-engaged", 2)
        wait_until(lambda: len(station.commands()) > count)
        assert station.commands()[count] == pytest.approx(stands, abs=1e-6)


def test_asked_to_stop_it_leaves_the_arm_where_it_is_at_once(tmp_path: Path) -> None:
    with OperatedArm(tmp_path, [*press(0.5), *push(1.0, [1, 0, 0, 0, 0, 0], 60.0)], leave_s=30.0) as station:
        arm = station.start_arm()
        station.start_script()
        wait_until(lambda: len(arm.session.sent) > 50)
        station.supervisor.stop("teleop")
        last = station.commands()[-1]
        wait_until(lambda: not arm.session.is_engaged)
        assert arm.session.q == pytest.approx(last, abs=arm.session.lead_rad)
