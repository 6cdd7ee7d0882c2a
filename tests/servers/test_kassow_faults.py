"""What halts an arm's controller, and how an operator takes it back: real processes, a simulated controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from station.errors import Refused
from station.life import controller_request
from tests.servers.kassow_station import ROBOT, ArmStation, Commander
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


def test_what_only_a_person_can_confirm_is_not_cleared(kord: Any, tmp_path: Path) -> None:
    socket = tmp_path / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(tmp_path, host=f"unix:{socket}") as arm:
        controller.simulator.emergency_stop(True)
        arm.wait_for_gate("faulted")
        wait_until(lambda: arm.controller()["needs_confirmation"])
        with pytest.raises(Refused):
            controller_request.ask(arm.bus, ROBOT, "clear")
        controller.simulator.emergency_stop(False)
        controller.simulator.confirm()
        wait_until(lambda: not arm.controller()["needs_confirmation"])  # a heartbeat has told the server of it
        controller_request.ask(arm.bus, ROBOT, "clear")
        arm.wait_for_gate("waiting")


def test_a_controller_that_is_paused_while_it_is_driven_ends_driving_and_is_not_cleared_before_it_goes_on(
    kord: Any, tmp_path: Path
) -> None:
    socket = tmp_path / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(tmp_path, host=f"unix:{socket}") as arm:
        with Commander(arm):
            arm.wait_for_gate("tracking")
            controller.simulator.pause(True)
            arm.wait_for_gate("faulted")
            assert "not ready: paused" in arm.gate()["reason"]
            with pytest.raises(Refused, match="not ready: paused"):
                controller_request.ask(arm.bus, ROBOT, "clear")
            wait_until(lambda: arm.controller()["not_ready"] == "paused")
            controller.simulator.pause(False)
            wait_until(lambda: arm.controller()["not_ready"] == "")
            controller_request.ask(arm.bus, ROBOT, "clear")
            arm.wait_for_gate("waiting")
        arm.settle()
        with Commander(arm):
            arm.wait_for_gate("tracking")
        assert [event.detail["who"] for event in arm.log.events("clear-refused")]


def test_a_lost_session_is_a_fault_and_clearing_opens_it_anew(kord: Any, tmp_path: Path) -> None:
    socket = tmp_path / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(tmp_path, host=f"unix:{socket}") as arm:
        ticks = arm.counter("tick")
        controller.simulator.silence(True)
        arm.wait_for_gate("faulted")
        controller.simulator.silence(False)
        controller_request.ask(arm.bus, ROBOT, "clear")
        arm.wait_for_gate("waiting")
        wait_until(lambda: arm.counter("tick") > ticks + 100)
