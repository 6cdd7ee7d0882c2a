"""An arm, whatever an operator does: within limits, no faster than told, no jump at engaging, at rest when let go."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.drivers.arm import ArmDriver
from adapters.drivers.arm_options import ArmOptions
from adapters.robots.kassow.kinematics import REACHING_DOWN
from station import rotations
from station.operator.buttons import Buttons, button_map
from station.operator.driving import Driving
from station.operator.sample import OperatorSample, Pose
from station.protocols import Floats
from tests.examples import examples

TICK_S = 0.004
SPEED = 0.3
FORMAT = ArmDriver("arm-joints", ArmOptions(), "joints").command_format

Wish = Callable[[np.random.Generator, Floats], OperatorSample]
"""From chance, and where the arm is asked to be, to a sample."""


def by_twist(random: np.random.Generator, q: Floats) -> OperatorSample:
    return OperatorSample(twist=random.uniform(-3.0, 3.0, 6))


def by_sticks(random: np.random.Generator, q: Floats) -> OperatorSample:
    names = (
        "left_stick_x",
        "left_stick_y",
        "right_stick_x",
        "right_stick_y",
        "dpad_up",
        "dpad_left",
        "key_up",
        "key_5",
    )
    return OperatorSample(controls=dict(zip(names, random.uniform(-1.0, 1.0, len(names)).tolist(), strict=True)))


def by_hand(random: np.random.Generator, q: Floats) -> OperatorSample:
    turn = rotations.from_rotation_vector(random.uniform(-0.3, 0.3, 3))
    return OperatorSample(right=Pose(random.uniform(-0.12, 0.12, 3), turn))


def by_leader(random: np.random.Generator, q: Floats) -> OperatorSample:
    return OperatorSample(joints=q + random.uniform(-0.35, 0.35, 7))


def by_nothing(random: np.random.Generator, q: Floats) -> OperatorSample:
    return OperatorSample()


WISHES: tuple[Wish, ...] = (by_twist, by_sticks, by_hand, by_leader, by_nothing)
ACTS = ("engage", "engage", "engage", "go on", "mode", "silence", "let go")

segment = st.tuples(
    st.sampled_from(WISHES), st.integers(0, 2**16), st.integers(1, 60), st.sampled_from(ACTS), st.booleans()
)
poses = st.one_of(
    st.just(np.array(REACHING_DOWN)),
    st.just(np.array(FORMAT.default)),
    st.integers(0, 2**16).map(lambda seed: np.random.default_rng(seed).uniform(FORMAT.lower, FORMAT.upper)),
    st.just(np.array(FORMAT.upper)),
    st.just(np.array(FORMAT.lower)),
)


class Pilot:
    """Somebody at the controls, and what must hold in every tick."""

    def __init__(self, driver: ArmDriver, q: Floats) -> None:
        driver.resume_from(q)
        self.driving = Driving(driver, Buttons(button_map("pico", {"engage": "left_grip"})))
        self.command = q
        self.tick(OperatorSample())

    def tick(self, reading: OperatorSample | None, *down: str) -> None:
        if reading is not None:
            reading = OperatorSample(
                controls={"left_grip": 0.0} | dict(reading.controls) | dict.fromkeys(down, 1.0),
                twist=reading.twist, right=reading.right, joints=reading.joints,
            )  # fmt: skip
        before, was_engaged = self.command, self.driving.deadman.is_engaged
        driven = self.driving.step(reading, TICK_S)
        command = driven.command
        assert np.isfinite(command).all()
        assert (command >= FORMAT.lower).all()
        assert (command <= FORMAT.upper).all()
        assert np.abs(command - before).max() <= SPEED * TICK_S + 1e-12
        if not (was_engaged and self.driving.deadman.is_engaged) or driven.mode:
            assert (command == before).all()  # engaging, letting go, the tick of another mode, and while nobody drives
        self.command = command


@settings(max_examples=examples(60), deadline=None)
@given(q=poses, begins=st.sampled_from(["joints", "tool"]), segments=st.lists(segment, min_size=1, max_size=8))
def test_no_limit_is_passed_no_joint_too_fast_no_jump_at_engaging_and_rest_in_the_tick_of_letting_go(
    q: Floats, begins: str, segments: list[tuple[Wish, int, int, str, bool]]
) -> None:
    pilot = Pilot(ArmDriver("arm", ArmOptions(speed_rad_s=SPEED, tool_mps=0.5, tool_rad_s=2.0), begins), q)
    held: tuple[str, ...] = ()
    for wish, seed, ticks, act, is_steady in segments:
        random = np.random.default_rng(seed)
        steady = wish(random, pilot.command)
        if act == "engage":  # from wherever the hands are
            for _ in range(4):
                pilot.tick(steady)
            held = ("left_grip",)
        elif act == "let go":
            held = ()
        for tick in range(ticks):
            pressed = ("right_stick_click",) if act == "mode" and tick < 5 else ()
            reading = steady if is_steady else wish(random, pilot.command)
            pilot.tick(None if act == "silence" else reading, *held, *pressed)


@settings(max_examples=20, deadline=None)
@given(q=poses, seed=st.integers(0, 2**16), begins=st.sampled_from(["joints", "tool"]))
def test_the_first_command_after_engaging_is_where_the_arm_stands_also_where_it_was_moved_meanwhile(
    q: Floats, seed: int, begins: str
) -> None:
    driver = ArmDriver("arm", ArmOptions(), begins)
    pilot = Pilot(driver, q)
    pilot.tick(OperatorSample(twist=np.ones(6)), "left_grip")
    pilot.tick(OperatorSample(twist=np.ones(6)), "left_grip")
    for _ in range(5):
        pilot.tick(OperatorSample(twist=np.ones(6)))
    elsewhere = np.random.default_rng(seed).uniform(FORMAT.lower, FORMAT.upper)
    driver.resume_from(elsewhere)  # by hand, or by another server
    pilot.command = elsewhere
    pilot.tick(OperatorSample(twist=np.ones(6)), "left_grip")
    assert pilot.driving.deadman.is_engaged
    assert np.abs(pilot.command - elsewhere).max() <= 1e-6
