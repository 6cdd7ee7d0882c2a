"""A real G1 as the station drives it, tried on its twin: what `g1_real` asks for by number (R5 to R8, R12 to R19)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.motions.load import load
from adapters.policies.tracker.policy import TrackerPolicy
from adapters.robots.g1.dds import messages, topics, types
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import NetworkOptions
from adapters.robots.g1.dds.robot import FIRST_STEPS
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.twin.faults import G1Faults
from station import assets
from station.bus import codec
from station.command_formats import command_format
from station.control.command_validator import CommandSample
from station.errors import NotReady
from station.protocols import JointTargets
from tests.adapters.robots.g1.dds.bench import PERIOD_S, Bench, bench


def steps_until_damped(found: Bench) -> int:
    """Move on step by step until the motors hold damping; return how many steps that took."""
    for count in range(1, 100):
        found.run(PERIOD_S)
        if found.is_damped:
            return count
    raise AssertionError("it is not damped after two seconds")


AGAINST_ARMING: dict[str, tuple[dict[str, Any], str]] = {
    "rate": ({"state_drop": 0.1}, "% are lost on the way: is the cable good"),
    "tick": ({"tick_frozen": True}, "its clock stands still"),
    "checksum": ({"state_bad_crc": 0.01}, "wrong checksums"),
    "gyro": ({"gyro_bias_rad_s": 0.5}, "it turns at 0."),
    "tilt": ({"imu_roll_rad": 0.3}, "the pelvis leans 1"),
    "speed": ({"velocity_noise_rad_s": 1.0}, "rad/s"),
    "winding": ({"winding_c": {"left_knee": 65.0}}, "left_knee is at 65 °C; let it cool below 60"),
    "battery": ({"soc": 20.0}, "the battery is at 20 %; expected 30"),
    "motor": ({"motor_error": {"left_elbow": 0x200}}, "motor left_elbow reports the error 0x200"),
    "remote": ({"remote_off": True}, "the remote is off"),
    "silent": ({"state_silent": True}, "no state of the robot for"),
    "select": ({"remote": ("select",)}, "select on the remote"),
}


@pytest.mark.parametrize("name", AGAINST_ARMING)
def test_r5_it_is_not_armed_unless_all_is_well(name):
    faults, words = AGAINST_ARMING[name]
    with bench() as found:
        found.plug_in()
        found.release()
        found.change(**faults)
        found.run(2.1)
        assert words in found.robot.why_not_arm()
        assert words in found.control.arm(found.clock.monotonic_s())
        found.run(0.2)
        assert found.twin.firmware.accepted == 0, "before it was ever armed nothing is sent"


def test_r5_motors_that_say_they_get_no_commands_may_be_armed_and_are_ill_once_they_get_some():
    with bench(G1Faults(without_commands="damp", without_commands_after_s=0.5)) as found:
        found.plug_in()
        found.hang()
        found.run(1.0)
        assert [event for event in found.events if event[0] == "robot-has-to-stand"] == []
        found.change(commands_lost=True)
        found.run(1.0)
        assert found.reason("robot-has-to-stand") == "motor left_hip_pitch reports the error 0x40000000"
        assert found.control.arming.state == "disarmed"


def test_r5_its_own_controller_has_to_let_go_first():
    with bench() as found:
        found.plug_in()
        found.run(3.0)
        assert "own controller 'ai' has the motors; release it first" in found.robot.why_not_arm()
        found.release()


def test_r5_a_switcher_that_does_not_answer_is_no_release():
    with bench() as found:
        found.twin._answer = lambda: None
        found.plug_in()
        found.robot.release()
        found.run(10.5)
        said = "after 10 s the motion switcher did not answer; on the remote: L2+B, then L2+R2"
        assert found.robot.releasing() == (False, said)
        assert "the motion switcher does not answer" in found.robot.why_not_arm()


def test_r5_a_robot_of_another_kind_is_named():
    with bench(twin={"mode_machine": 6}) as found:
        found.plug_in()
        found.robot.release()
        found.run(3.0)
        assert "mode_machine 6 (29 joints, locked waist); expected 5" in found.robot.why_not_arm()


@pytest.mark.parametrize("kind", [types.LowCmd, types.IMUState], ids=["of the type", "of another type"])
def test_r5_another_program_that_writes_commands_is_named(kind):
    with bench() as found:
        found.plug_in()
        found.release()
        with Network(NetworkOptions(domain=found.domain)) as other:
            _its_own = other.writer(topics.LOW_CMD, raw(kind))
            found.run(0.5)
            assert "another program writes rt/lowcmd: python" in found.robot.why_not_arm()
        found.run(0.5)
        assert found.robot.why_not_arm() == ""


def test_a_robot_that_is_not_there_is_told():
    with bench() as found:
        found.change(state_silent=True)
        with pytest.raises(NotReady, match=r"no state of a G1 within 5 s on lo, domain \d+: is it switched on"):
            found.plug_in()


def test_r6_the_first_commands_have_no_stiffness_and_ask_for_where_it_is():
    with bench() as found:
        found.plug_in()
        found.release()
        assert found.control.arm(found.clock.monotonic_s()) == ""
        found.run(FIRST_STEPS * PERIOD_S)
        for record in found.records[-FIRST_STEPS:]:
            assert (record.sent.kp == 0.0).all()
            assert (record.sent.q == record.state.q).all()
            assert np.abs(record.state.q).max() > 0.0
        found.advance(1)
        assert found.twin.firmware.refused == {}
        assert found.twin.firmware.accepted == FIRST_STEPS


def test_r7_it_gets_to_its_pose_gently():
    with bench() as found:
        found.plug_in()
        found.release()
        assert found.control.arm(found.clock.monotonic_s()) == ""
        before = len(found.records)
        found.run(5.0)
        sent = np.array([record.sent.q for record in found.records[before:]])
        stiffness = np.array([record.sent.kp for record in found.records[before:]])
        assert np.abs(np.diff(sent, axis=0)).max() < 0.02
        assert (np.diff(stiffness, axis=0) >= 0.0).all()
        pose = found.policies.spec.default_q
        reached = np.abs(np.array([record.state.q for record in found.records[before:]]) - pose).max(axis=1) < 0.05
        assert reached[round(3.0 / PERIOD_S) :].all()


def test_r7_who_takes_over_after_the_entry_is_not_slowed_down():
    with bench() as found:
        found.plug_in()
        found.hang()
        found.run(0.9)  # three seconds after arming it is in its pose
        sent = found.records[-1].sent
        q = sent.q.copy()
        q[G1_29.index("left_elbow")] += 0.2
        assert found.robot.write(replace(sent, q=q)).q.tolist() == q.tolist()


def test_r8_the_policy_takes_over_without_a_jump():
    with bench() as found:
        found.plug_in()
        found.release()
        found.arm()
        found.change(gantry="down")
        found.run(3.0)
        before, height_m = len(found.records), found.twin.body.height_m
        found.policies.switch("tracker")
        lowest_m = height_m
        for _ in range(50):
            found.run(PERIOD_S)
            lowest_m = min(lowest_m, found.twin.body.height_m)
        sent = np.array([record.sent.q for record in found.records[before - 1 :]])
        assert np.abs(np.diff(sent, axis=0)).max() < 0.05
        assert height_m - lowest_m < 0.03
        assert found.events[-1] == ("policy-switched", "")


@pytest.mark.parametrize(("fault", "words"), [
    ({"state_silent": True}, "no state of the robot"),
    ({"link": "down"}, "no state of the robot"),
    ({"tick_frozen": True}, "its clock stands still"),
])  # fmt: skip
def test_r12_r13_a_robot_that_falls_silent_is_damped(fault, words):
    with bench() as found:
        found.plug_in()
        found.hang()
        found.change(**fault)
        before = len(found.records)
        found.run(0.16)
        when = next(i for i, record in enumerate(found.records[before:], 1) if (record.sent.kp == 0.0).all())
        assert when * PERIOD_S <= 0.15
        assert words in found.reason("robot-fault")
        found.change(**dict.fromkeys(fault, "up" if "link" in fault else False))
        found.run(1.0)
        assert found.is_damped, "what comes back moves nothing"
        assert found.control.arming.state == "disarmed"


@pytest.mark.parametrize("buttons", [("select",), ("L2", "B"), ("select", "A", "up"), ("L2", "B", "R1", "X")])
def test_r14_the_remote_stops_it_whatever_else_is_held(buttons):
    with bench() as found:
        found.plug_in()
        found.hang()
        found.change(remote=buttons, remote_stop_dead=True)
        assert steps_until_damped(found) * PERIOD_S <= 0.06
        assert " on the remote" in found.reason("robot-fault")
        found.change(remote=())
        found.run(0.5)
        assert found.is_damped


def test_r14_one_damaged_message_presses_nothing():
    with bench() as found:
        found.plug_in()
        found.hang()
        found.change(remote=("select",))
        found.twin.tick()
        found.change(remote=())
        found.clock.now_ns += round(found.twin.period_s * 1e9)
        found.run(0.2)
        assert "robot-fault" not in dict(found.events)


def _ask(found: Bench, **changed: Any) -> JointTargets:
    spec = found.policies.spec
    values = {"q": spec.default_q.copy(), "kp": spec.kp.copy(), "kd": spec.kd.copy()} | changed
    return found.robot.write(JointTargets(**values))


@pytest.mark.parametrize(("changed", "words"), [
    ({"kp": np.full(29, 1000.0)}, "asked for a stiffness of 1000 of left_hip_pitch; expected 0 to 200"),
    ({"kp": np.full(29, np.nan)}, "asked for a stiffness of nan"),
    ({"kd": np.full(29, -1.0)}, "asked for a damping of -1"),
    ({"q": np.full(29, np.inf)}, "asked for a position of inf of left_hip_pitch; expected a number"),
])  # fmt: skip
def test_r15_what_no_policy_may_ask_for_reaches_no_motor(changed, words):
    with bench() as found:
        found.plug_in()
        found.hang()
        sent = _ask(found, **changed)
        assert (sent.kp == 0.0).all()
        assert words in found.robot.why_not_drive()
        found.advance(10)
        assert found.is_damped


def test_r15_positions_beyond_a_joints_range_are_clamped():
    with bench() as found:
        found.plug_in()
        found.hang()
        found.run(3.0)
        sent = _ask(found, q=np.full(29, 9.0))
        assert sent.q[G1_29.index("left_knee")] == pytest.approx(2.8798)


def test_r15_the_twin_refuses_what_a_robot_would():
    with bench() as found, Network(NetworkOptions(domain=found.domain)) as network:
        writer = network.writer(topics.LOW_CMD, raw(types.LowCmd))
        found.twin.firmware.controller = ""
        good = messages.new_command()
        good["mode_machine"] = 5
        messages.set_modes(good, np.ones(29, np.uint8))
        good["motors"]["kp"][0, :29] = 40.0
        odd = {"mode_pr": good.copy(), "mode_machine": good.copy(), "not finite": good.copy()}
        odd["mode_pr"]["mode_pr"] = 1
        odd["mode_machine"]["mode_machine"] = 0
        odd["not finite"]["motors"]["q"][0, 3] = np.nan
        for record in odd.values():
            writer.write(messages.signed(record))
            found.advance(1)
        writer.write(messages.signed(good)[:-1] + b"\x55")
        found.advance(1)
        assert dict(found.twin.firmware.refused) == {"mode_pr": 1, "mode_machine": 1, "not finite": 1, "checksum": 1}
        assert (found.twin.body.held.kp == 0.0).all()
        limp = good.copy()
        messages.set_modes(limp, np.zeros(29, np.uint8))
        writer.write(messages.signed(limp))
        found.advance(1)
        assert (found.twin.body.held.kp == 0.0).all(), "motors that are not enabled"
        writer.write(messages.signed(good))
        found.advance(1)
        assert (found.twin.body.held.kp == 40.0).all()


def test_r16_its_own_controller_that_comes_back_in_mid_run_is_named_and_the_robot_damped():
    with bench(G1Faults(controller="fights")) as found:
        found.plug_in()
        found.hang()
        found.twin.firmware.controller = "ai"
        for _ in range(100):
            found.run(PERIOD_S)
            if "robot-fault" in dict(found.events):
                break
        assert "own controller 'ai' has the motors" in found.reason("robot-fault")
        assert (found.records[-1].sent.kp == 0.0).all()


def _walk(found: Bench, seconds: float) -> None:
    """Have the robot follow a motion."""
    motion, followed = load("builtin:walk-forward"), command_format("twist2", "", None, None)
    for count in range(round(seconds / PERIOD_S)):
        vector = followed.encode(motion.at(count * PERIOD_S), motion.joint_names)
        now_s = found.clock.monotonic_s()
        found.command = CommandSample(codec.json_vector(vector), now_s + 0.01, seq=count + 1)
        found.run(PERIOD_S)


@pytest.mark.parametrize(("mode_machine", "absent"), [(6, [13, 14]), (4, [13, 14, 20, 21, 27, 28])])
def test_r17_motors_that_a_robot_does_not_have_are_sent_nothing_and_it_walks_without_them(mode_machine, absent):
    with bench(twin={"mode_machine": mode_machine}, mode_machine=mode_machine) as found:
        found.plug_in()
        found.stand()
        before = len(found.records)
        _walk(found, 3.0)
        assert np.abs([record.state.q[absent] for record in found.records[before:]]).max() < 0.01
        assert not np.any([record.sent.kp[absent] for record in found.records])
        assert np.abs(found.twin.body.qpos[7:][absent]).max() < 0.01, "bolted"
        assert not found.twin.body.held.kd[absent].any()
        assert found.twin.body.falls == 0


@pytest.mark.parametrize(("fault", "words"), [
    ({"winding_c": {"left_knee": 121.0}}, "the winding of left_knee is at 121 °C, the limit is 120"),
    ({"motor_error": {"right_knee": 0x200}}, "motor right_knee reports the error 0x200"),
    ({"soc": 8.0}, "the battery is at 8 %"),
])  # fmt: skip
def test_r18_a_motor_that_is_too_hot_in_mid_walk_ends_it_standing(fault, words):
    with bench() as found:
        found.plug_in()
        found.stand()
        _walk(found, 1.5)
        assert found.records[-1].decision.state == "tracking"
        found.change(**fault)
        _walk(found, 2.6)  # its commands go on
        assert words in found.reason("robot-has-to-stand")
        assert words in found.reason("robot-fault")
        states = [record.decision.state for record in found.records]
        told = [[event.name for event in record.step_events] for record in found.records]
        gave_up = next(number for number, names in enumerate(told) if "robot-fault" in names)
        assert states[gave_up - 1 : gave_up + 1] == ["returning", "waiting"]
        assert found.is_damped


def test_r19_the_yaw_that_the_imu_believes_changes_nothing():
    tracker = TrackerPolicy(assets.resolve("builtin:tracker.onnx"))
    seen = []
    for yaw in (0.0, np.pi, 1.3):
        with bench(G1Faults(imu_yaw_rad=yaw, yaw_drift_rad_s=0.0)) as found:
            found.plug_in()
            found.run(0.1)
            tracker.reset()
            command = command_format("twist2", "", None, None).default
            seen.append(tracker.observe(found.records[-1].state, command))
    assert np.abs(seen[1] - seen[0]).max() < 1e-5
    assert np.abs(seen[2] - seen[0]).max() < 1e-5


def test_every_state_is_among_the_samples_once():
    with bench() as found:
        found.plug_in()
        found.run(0.5)
        rows = []
        found.robot.values()
        for _ in range(50):
            found.run(PERIOD_S)
            rows.append(np.frombuffer(found.robot.values()["samples"]).reshape(-1, 2 + 8 * 29 + 16))
        ticks = np.concatenate(rows)[:, 0]
        assert len(ticks) == 500
        assert (np.diff(ticks) == 2.0).all()
        assert np.allclose(rows[-1][-1, 2 : 2 + 29], found.records[-1].state.q)


def test_closed_it_is_left_damped():
    with bench() as found:
        found.plug_in()
        found.hang()
        found.unplug()
        found.advance(5)
        assert found.is_damped


def test_buttons_of_the_remote_arm_and_choose_the_policy():
    with bench(remote={"start": "arm", "A": "policy", "F1": "disarm"}) as found:
        found.plug_in()
        found.release()
        for button, state in (("start", "armed"), ("A", "armed"), ("F1", "disarmed")):
            found.change(remote=(button,))
            found.run(0.1)
            found.change(remote=())
            found.run(2.2)
            assert found.control.arming.state == state, found.events
        assert found.policies.driving == "tracker"


def test_a_robot_that_reports_no_numbers_is_damped_and_sent_none():
    with bench() as found:
        found.plug_in()
        found.hang()
        measure = found.twin.body.measure
        found.twin.body.measure = lambda: replace(measure(), q=np.full(29, np.nan))
        assert steps_until_damped(found) <= 2
        assert found.reason("robot-fault") == "the robot reports what is no number"
        assert "not finite" not in found.twin.firmware.refused


def test_a_guard_that_does_not_answer_is_named_before_arming_and_in_a_handshake():
    with bench(guard="127.0.0.1", guard_port=9) as found:
        found.plug_in()
        found.robot.release()
        found.run(3.0)
        assert "the guard at 127.0.0.1:9 does not answer" in found.robot.why_not_arm()
        assert found.robot.why_not_drive() == ""
        _ask(found)
        assert "the guard at 127.0.0.1:9 does not answer" in found.robot.why_not_drive()
