"""The whole body: blended in, followed, and to a stand when it is let go; a body that cannot be is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.drivers.body import LEAVE_S, BodyDriver
from adapters.drivers.command_shaper import ENTER_S
from station.blends import VELOCITY_FADE_S
from station.errors import StationError
from station.operator.deadman import Snapshot
from station.operator.sample import Body
from station.protocols import Reference

from .operators import TICK_S, Shadow, body

LEG = slice(6, 12)


class Blind(Shadow):
    """Retargeting that does not like any body."""

    def step(self, body: Body | None, capture_ns: int) -> Reference:
        raise StationError("left_foot is 3.2 m away from the pelvis")


def follow(driver: BodyDriver, seconds: float, *, engaged: bool, begin_s: float = 0.0) -> np.ndarray:
    snapshot = Snapshot(body(0.0).body, driver.target) if engaged else None
    commands = [driver.step(body(begin_s + k * TICK_S), snapshot, TICK_S) for k in range(round(seconds / TICK_S))]
    return np.array(commands)


def test_the_robot_is_where_the_operator_is_once_it_is_blended_in() -> None:
    shadow, driver = Shadow(), BodyDriver(Shadow())
    sent = follow(driver, ENTER_S + 1.0, engaged=True)
    for tick in range(len(sent)):
        sample = body(tick * TICK_S)
        reference = shadow.step(sample.body, 0)
    assert sent[-1] == pytest.approx(FORMAT.encode(reference, shadow.joint_names), abs=1e-9)


def test_let_go_in_a_squat_it_stands_up_and_keeps_its_arms() -> None:
    driver = BodyDriver(Shadow())
    squatting = follow(driver, 3.0, engaged=True)[-1]
    left = follow(driver, LEAVE_S + 0.1, engaged=False, begin_s=3.0)
    assert left[0] == pytest.approx(squatting)
    assert left[-1][LEG] == pytest.approx(FORMAT.default[LEG])
    assert left[-1][:6] == pytest.approx(FORMAT.default[:6])
    assert left[-1][21:] == pytest.approx(squatting[21:])
    assert driver.is_still


def test_let_go_on_a_walk_it_stands_after_200_ms_while_its_legs_are_blended() -> None:
    driver = BodyDriver(Shadow())
    walking = FORMAT.default + 0.1
    walking[list(FORMAT.velocities)] = 0.9, 0.1, 0.4
    follow(driver, ENTER_S, engaged=True)
    driver.resume_from(walking)
    follow(driver, TICK_S, engaged=True)
    left = follow(driver, LEAVE_S + 0.1, engaged=False)
    stands = round(VELOCITY_FADE_S / TICK_S)
    assert left[0] == pytest.approx(walking, abs=0.05)
    assert (np.diff(left[: stands + 1, 0]) < 0.0).all()
    assert not left[stands:, list(FORMAT.velocities)].any()
    assert np.abs(left[stands, LEG] - FORMAT.default[LEG]).max() > 0.09


def test_a_body_that_cannot_be_is_told_in_the_next_tick_and_moves_nothing() -> None:
    driver = BodyDriver(Blind())
    assert driver.inspect(body(0.0)).why_not == ""
    command = driver.step(body(0.0), None, TICK_S)
    assert command == pytest.approx(FORMAT.default, abs=0.0)
    assert driver.inspect(body(0.01)).why_not == "left_foot is 3.2 m away from the pelvis"


def test_a_device_that_does_not_track_or_tell_the_time_is_told() -> None:
    driver = BodyDriver(Shadow())
    assert driver.inspect(replace(body(0.0), body=None)).why_not == "the body is not tracked"
    assert driver.inspect(replace(body(0.0), capture_ns=None)).why_not == "the device does not say when it saw the body"


def test_a_manifest_is_told_what_the_retargeting_is_set_to() -> None:
    facts = BodyDriver(Shadow(), calibration={"operator": "ada"}).facts()
    assert facts["calibration"] == {"operator": "ada"}
    assert facts["retarget"] == Shadow().facts()


def test_a_body_that_is_centred_anew_is_a_jump() -> None:
    before, now = body(0.0).body, body(0.0).body
    assert before is not None
    assert now is not None
    now.positions[:] += (0.5, 0.0, 0.0)
    driver = BodyDriver(Shadow())
    assert driver.jump(before, before) == ""
    assert driver.jump(before, now).startswith("pelvis jumped 0.50 m")
