"""An operator drives an arm through real processes: a fake spacemouse under the real library, our own bus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.servers.arm_trials import move_and_let_go, press, push
from tests.servers.operated_arm import OperatedArm
from tests.waiting import wait_until

pytestmark = [pytest.mark.timeout(240), pytest.mark.usefixtures("processes")]


def test_the_tool_is_moved_and_then_a_joint_and_let_go_the_arm_stays_where_it_is(tmp_path: Path) -> None:
    assert "released" in move_and_let_go(tmp_path)


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
        wait_until(lambda: not arm.session.is_engaged)
        # On its way: at a command that it was given, not at its default; a busy machine's arm is behind the last one.
        away = np.abs(station.commands() - arm.session.q).max(axis=1)
        assert away.min() <= arm.session.lead_rad
        sent = len(arm.session.sent)
        station.wait_for("teleop-commands-end")
        assert len(arm.session.sent) == sent
