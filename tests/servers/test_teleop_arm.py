"""An operator drives an arm through real processes: a fake spacemouse under the real library, our own bus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.life.events import Event
from tests.servers.arm_trials import move_and_let_go, press, press_and_push
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
    with OperatedArm(tmp_path, press_and_push([0, 0, 1, 0, 0, 0]), driver="arm-joints") as station:
        arm = station.start_arm()
        station.start_script()
        wait_until(lambda: len(arm.session.sent) > 50)
        arm.session.fault = "HALT: event 1010"
        wait_until(lambda: ended_by(station, "HALT: event 1010"))
        (ended,) = ended_by(station, "HALT: event 1010")
        assert ended.detail["then"] == "the robot stays where it is; engage anew"
        stands = arm.session.q + 0.05
        arm.session.goal = stands  # pushed aside meanwhile
        wait_until(lambda: np.allclose(arm.session.q, stands, rtol=0.0, atol=1e-9))
        count, engaged = len(station.commands()), len(station.told("operator-engaged"))
        arm.session.clear()
        arm.control.cleared("tests")
        station.wait_for("operator-engaged", engaged + 1)
        wait_until(lambda: len(station.commands()) > count)
        assert station.commands()[count] == pytest.approx(stands, abs=1e-6)


def ended_by(station: OperatedArm, reason: str) -> list[Event]:
    """Return the events of commands that ended for a reason."""
    return [event for event in station.told("teleop-commands-end") if reason in event.detail["reason"]]


def test_asked_to_stop_it_leaves_the_arm_where_it_is_at_once(tmp_path: Path) -> None:
    with OperatedArm(tmp_path, press_and_push([1, 0, 0, 0, 0, 0]), leave_s=30.0) as station:
        arm = station.start_arm()
        station.start_script()
        wait_until(lambda: len(arm.session.sent) > 50)
        ended = len(station.told("teleop-commands-end"))
        station.supervisor.stop("teleop")
        wait_until(lambda: not arm.session.is_engaged)
        # On its way, at what it was sent last: on a busy machine that is behind the commands and beside their path.
        assert np.abs(arm.session.q - arm.session.sent[-1]).max() <= arm.session.lead_rad
        assert np.abs(arm.session.q - station.commands()[0]).max() > arm.session.lead_rad, "it has left its place"
        sent = len(arm.session.sent)
        station.wait_for("teleop-commands-end", ended + 1)
        assert len(arm.session.sent) == sent
