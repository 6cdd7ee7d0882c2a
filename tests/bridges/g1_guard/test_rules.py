"""Each rule of the guard, to the millisecond: what is sent to the motors, and when it comes to damping."""

from __future__ import annotations

import random
import zlib

import numpy as np
import pytest

from adapters.robots.g1.dds import messages
from adapters.robots.g1.dds.guard_client import MOTORS, Answer, Kind, Reason, Refusal, State
from adapters.robots.g1.dds.guard_limits import most_gains
from adapters.robots.g1.joints import G1_29, JOINTS, lower, upper, velocity
from tests.bridges.g1_guard.virtual import KD, KP, STRANGER, Q, Rules

CASING, WINDING = 0, 1
SELECT, L2, B, A = 0x0008, 0x0020, 0x0200, 0x0100


@pytest.fixture
def rules(library) -> Rules:
    return Rules(library)


def assert_ramp_to_damping(sent, began_ms: int, kp=40.0) -> None:
    """From an instant on the damping is 8, and the stiffness falls within 300 ms without a step."""
    before = [each for each in sent if each.at_ms < began_ms]
    after = [each for each in sent if each.at_ms >= began_ms]
    assert all((each.command["kd"] != 8).all() for each in before)
    assert all((each.command["kd"] == 8).all() for each in after)
    stiffness = np.array([each.command["kp"] for each in after])
    steps = -np.diff(stiffness, axis=0)
    assert after[0].at_ms == began_ms
    assert (stiffness[0] == kp).all()
    assert (steps >= 0).all()
    assert steps.max() <= kp * 2 / 300 * 1.001
    at_zero = next(each.at_ms for each in after if not each.command["kp"].any())
    assert at_zero == began_ms + 300
    assert not after[-1].command["kp"].any()
    assert all((each.command["q"] == after[0].command["q"]).all() for each in after), "no motion in the ramp"


# ---- before it is armed ----


def test_nothing_is_sent_before_it_is_armed(rules):
    assert rules.run(500, rules.command) == []
    assert rules.status.state is State.WAITING
    assert rules.status.refused[Refusal.NOT_ARMED] == 25


def test_a_guard_that_follows_one_that_ended_while_armed_begins_with_damping(library):
    rules = Rules(library, was_armed=True)
    rules.is_heard = False
    assert rules.run(20) == [], "mode_machine is not known yet"
    rules.is_heard = True
    sent = rules.run(100)
    assert len(sent) == 50
    assert not any(each.command["kp"].any() for each in sent)
    assert all((each.command["kd"] == 8).all() and each.command["mode"].all() for each in sent)
    assert (rules.status.state, rules.status.reason) == (State.DAMPING, Reason.RESTARTED)


# ---- arming ----


def test_arming_sends_the_measured_pose_without_stiffness_until_a_command_comes(rules):
    rules.robot["q"][0] = np.linspace(-0.05, 0.05, MOTORS)
    rules.run(20)
    said = rules.arm()
    assert (said.kind, said.state) == (Answer.ARMED, State.ARMED)
    sent = rules.run(10)
    assert len(sent) == 5
    for each in sent:
        assert (each.command["q"] == rules.robot["q"][0]).all()
        assert not each.command["kp"].any()
        assert (each.command["mode_machine"], each.command["mode"].all()) == (5, True)


def test_a_challenge_is_the_guards_and_is_good_once(rules):
    rules.driven()
    token = rules.token
    rules.run(500)
    assert rules.status.state is State.DAMPING
    for used in (token, 0):
        said = rules.ask(Kind.CONFIRM, used)
        assert (said.kind, said.reason) == (Answer.ARM_REFUSED, Reason.CHALLENGE)
    rules.run(100, rules.command)
    assert rules.status.state is State.DAMPING
    assert rules.arm().kind is Answer.ARMED
    assert rules.token != token


def test_a_confirmation_whose_answer_was_lost_is_answered_again(rules):
    rules.driven()
    accepted = rules.status.accepted
    said = rules.ask(Kind.CONFIRM, rules.token)
    assert (said.kind, said.challenge, rules.status.accepted) == (Answer.ARMED, rules.token, accepted)


def test_asking_again_brings_the_same_challenge_for_a_second(rules):
    rules.run(20)
    first = rules.ask(Kind.ARM, 77).challenge
    assert rules.ask(Kind.ARM, 77).challenge == first
    assert rules.ask(Kind.ARM, 78).challenge != first
    rules.run(1002)
    assert rules.ask(Kind.ARM, 78).challenge > first + 1


@pytest.mark.parametrize("token", [0, 5])
def test_a_wrong_number_does_not_arm(rules, token):
    rules.run(20)
    rules.ask(Kind.ARM, 77)
    said = rules.ask(Kind.CONFIRM, token)
    assert (said.kind, said.reason, rules.status.state) == (Answer.ARM_REFUSED, Reason.CHALLENGE, State.WAITING)


def test_another_address_does_not_confirm(rules):
    rules.run(20)
    challenge = rules.ask(Kind.ARM, 77).challenge
    assert rules.ask(Kind.CONFIRM, challenge, STRANGER).reason is Reason.CHALLENGE


def test_a_confirmation_after_a_second_does_not_arm(rules):
    rules.run(20)
    challenge = rules.ask(Kind.ARM, 77).challenge
    rules.run(1002)
    assert rules.ask(Kind.CONFIRM, challenge).reason is Reason.CHALLENGE


def _tilt(rules: Rules, degrees: float) -> None:
    half = np.radians(degrees) / 2
    rules.robot["quat_wxyz"][0] = np.cos(half), np.sin(half), 0, 0


def _heat(rules: Rules, motor: int, which: int, degrees: int) -> None:
    rules.robot["temperature"][0, motor, which] = degrees


def _buttons(rules: Rules, buttons: int, head: bytes = b"\x55\x51") -> None:
    rules.robot["remote"][0] = list(head + buttons.to_bytes(2, "little") + bytes(36))


FAULTS = {
    "tilt": (lambda rules: _tilt(rules, 61), Reason.TILT),
    "winding": (lambda rules: _heat(rules, 28, WINDING, 120), Reason.WINDING),
    "casing": (lambda rules: _heat(rules, 14, CASING, 85), Reason.CASING),
    "motor error": (lambda rules: rules.robot["error"][0].__setitem__(11, 0x200), Reason.MOTOR_ERROR),
    "select": (lambda rules: _buttons(rules, SELECT), Reason.REMOTE),
    "select with others": (lambda rules: _buttons(rules, SELECT | A | L2), Reason.REMOTE),
    "L2+B": (lambda rules: _buttons(rules, L2 | B), Reason.REMOTE),
    "all buttons": (lambda rules: _buttons(rules, 0xFFFF), Reason.REMOTE),
    "a remote without head": (lambda rules: _buttons(rules, SELECT, bytes(2)), Reason.REMOTE),
    "foreign writer": (lambda rules: rules.foreign(b"pc2", 4711, b"sport"), Reason.FOREIGN_WRITER),
}
NO_FAULTS = {
    "tilt": lambda rules: _tilt(rules, 59),
    "winding": lambda rules: _heat(rules, 28, WINDING, 119),
    "casing": lambda rules: _heat(rules, 14, CASING, 84),
    "error of an arm": lambda rules: rules.robot["error"][0].__setitem__(20, 1),
    "L2": lambda rules: _buttons(rules, L2),
    "B": lambda rules: _buttons(rules, B | A),
    "a damaged remote": lambda rules: _buttons(rules, 0xFFFF, b"\x55\x50"),
    "measured past a limit": lambda rules: rules.robot["q"][0].__setitem__(5, 0.3),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_comes_to_damping_and_is_refused_at_arming(rules, what):
    act, reason = FAULTS[what]
    rules.driven()
    act(rules)
    began_ms = rules.now_ms + (4 if reason is Reason.REMOTE else 2)  # the remote is believed at the second message
    sent = rules.run(400, rules.command)
    assert (rules.status.state, rules.status.reason) == (State.DAMPING, reason)
    assert_ramp_to_damping(sent, began_ms)
    said = rules.arm()
    assert (said.kind, said.reason, rules.status.why_not) == (Answer.ARM_REFUSED, reason, reason)


@pytest.mark.parametrize("what", NO_FAULTS)
def test_what_is_no_fault_disturbs_nothing(rules, what):
    rules.driven()
    NO_FAULTS[what](rules)
    rules.run(200, rules.command)
    assert rules.status.state is State.ARMED


def test_motors_that_say_they_get_no_commands_are_armed_and_are_a_fault_after_a_second_of_commands(rules):
    rules.robot["error"][0, :] = messages.TIMED_OUT
    rules.driven()
    assert rules.status.state is State.ARMED
    rules.run(780, rules.command)
    assert rules.status.state is State.ARMED
    rules.run(100, rules.command)
    assert (rules.status.state, rules.status.reason) == (State.RAMPING, Reason.MOTOR_ERROR)
    rules.run(400)
    assert rules.arm().kind is Answer.ARMED


def test_one_message_of_the_remote_is_not_believed(rules):
    rules.driven()
    for _ in range(20):
        _buttons(rules, SELECT)
        rules.run(2, rules.command)
        _buttons(rules, 0)
        rules.run(2, rules.command)
    assert rules.status.state is State.ARMED


def test_another_writer_is_named(rules):
    rules.foreign(b"pc2", 4711, b"sport")
    assert rules.status.foreign == "sport (pid 4711) on pc2"
    rules.foreign(b"", 0)
    assert rules.status.foreign == ""


@pytest.mark.parametrize(("mode_machine", "is_armed"), [(0, False), (1, True), (2, True), (3, True), (4, True),
                                                        (5, True), (6, True), (7, False), (9, False)])  # fmt: skip
def test_only_a_g1_is_armed(rules, mode_machine, is_armed):
    rules.robot["mode_machine"] = mode_machine
    rules.run(20)
    said = rules.arm()
    assert said.kind is (Answer.ARMED if is_armed else Answer.ARM_REFUSED)
    assert said.reason is (Reason.NONE if is_armed else Reason.MACHINE)


def test_it_does_not_arm_in_its_first_second_when_it_may_not_have_found_another_writer_yet(library):
    rules = Rules(library, begun_ms=0)
    rules.run(998)
    assert rules.arm().reason is Reason.STARTING
    rules.run(2)
    assert rules.arm().kind is Answer.ARMED


def test_without_a_robot_it_does_not_arm(rules):
    rules.is_heard = False
    rules.run(20)
    assert rules.arm().reason is Reason.NO_STATE


def test_who_is_armed_keeps_it(rules):
    rules.driven()
    said = rules.ask(Kind.ARM, 99, STRANGER)
    assert (said.kind, said.reason) == (Answer.ARM_REFUSED, Reason.BUSY)
    rules.ask(Kind.DISARM, rules.token, STRANGER)
    rules.datagram(rules.command(), STRANGER)
    assert rules.status.refused[Refusal.SENDER] == 2
    rules.run(100, rules.command)
    assert rules.status.state is State.ARMED


@pytest.mark.parametrize(("mode_machine", "absent"), [(3, [13, 14]), (6, [13, 14]), (1, [13, 14, 20, 21, 27, 28]),
                                                      (4, [13, 14, 20, 21, 27, 28])])  # fmt: skip
def test_motors_that_a_robot_does_not_have_stay_disabled_and_their_numbers_say_nothing(rules, mode_machine, absent):
    rules.robot["mode_machine"] = mode_machine
    rules.robot["temperature"][0, absent] = 200
    rules.driven()
    command = rules.sent[-1].command
    assert [i for i in range(MOTORS) if not command["mode"][i]] == absent
    assert not command["kp"][absent].any()
    assert (command["kp"][12], command["mode_machine"]) == (40, mode_machine)
    rules.robot["temperature"][0, 12] = 200
    rules.run(10, rules.command)
    assert rules.status.reason is Reason.WINDING


# ---- commands ----


def test_a_command_is_sent_as_it_is_every_2_ms(rules):
    rules.driven()
    sent = rules.run(100, rules.command)
    assert np.diff([each.at_ms for each in sent]).tolist() == [2] * 49
    for each in sent:
        assert np.allclose(each.command["q"], Q)
        assert (each.command["kp"] == 40).all()
        assert (each.command["kd"] == 2).all()


def test_a_step_that_a_command_brings_early_moves_a_target_by_no_more_than_its_time_allows(rules):
    rules.driven()
    far = rules.sent[-1].command["q"].astype(float) + 0.5
    rules.datagram(rules.command(q=far))
    rules.step()
    rules.now_ms += 1
    rules.step()
    rules.now_ms += 2
    rules.step()
    before, at_once, early, whole = (each.command["q"][15].astype(float) for each in rules.sent[-4:])
    assert at_once == before, "no time went by"
    assert (whole - early) == pytest.approx(2.0 * (early - at_once), rel=1e-3)
    assert early > at_once


def test_positions_are_clamped_to_the_range_and_the_speed_of_their_joints(rules):
    rules.driven()
    for sign, end in ((1, upper(G1_29)), (-1, lower(G1_29))):
        wanted = end + sign * 0.5
        sent = rules.run(400, lambda wanted=wanted: rules.command(q=wanted))
        q = np.array([each.command["q"] for each in sent])
        assert (np.abs(np.diff(q, axis=0)) <= velocity(G1_29) * 0.002 * 1.0001).all()
        assert (q <= upper(G1_29) + 1e-6).all()
        assert (q >= lower(G1_29) - 1e-6).all()
        assert np.allclose(q[-1], end)
    assert rules.status.clamped == 40
    assert rules.status.state is State.ARMED


def _changed(values, index: int, value: float):
    made = np.array(values)
    made[index] = value
    return made


BAD_NUMBERS = {
    "q NaN": (lambda: {"q": _changed(Q, 3, np.nan)}, Refusal.NUMBER),
    "kp NaN": (lambda: {"kp": _changed(KP, 28, np.nan)}, Refusal.NUMBER),
    "kd infinite": (lambda: {"kd": _changed(KD, 0, np.inf)}, Refusal.NUMBER),
    "q infinite": (lambda: {"q": _changed(Q, 0, -np.inf)}, Refusal.NUMBER),
    "q in degrees": (lambda: {"q": _changed(Q, 7, 45.0)}, Refusal.LIMIT),
    "kp ten times": (lambda: {"kp": KP * 10}, Refusal.LIMIT),
    "kp of one": (lambda: {"kp": _changed(KP, 20, 61.0)}, Refusal.LIMIT),
    "kp below zero": (lambda: {"kp": _changed(KP, 20, -1.0)}, Refusal.LIMIT),
    "kd ten times": (lambda: {"kd": KD * 10}, Refusal.LIMIT),
    "kd below zero": (lambda: {"kd": _changed(KD, 0, -0.1)}, Refusal.LIMIT),
}


@pytest.mark.parametrize("what", BAD_NUMBERS)
def test_a_command_of_bad_numbers_reaches_no_motor_and_the_third_in_a_row_ends_it(rules, what):
    make, refusal = BAD_NUMBERS[what]
    rules.driven()
    for refused in (1, 2):
        rules.run(20, lambda: rules.command(**make()))
        assert (rules.status.refused[refusal], rules.status.state) == (refused, State.ARMED)
        assert np.allclose(rules.sent[-1].command["q"], Q)
        assert (rules.sent[-1].command["kp"] == 40).all()
    rules.run(20, rules.command)
    for _ in range(2):
        rules.run(20, lambda: rules.command(**make()))
    assert rules.status.state is State.ARMED, "a good one between them begins anew"
    began_ms = rules.now_ms + 2
    sent = rules.run(400, lambda: rules.command(**make()))
    assert rules.status.reason is Reason.REFUSALS
    assert_ramp_to_damping(sent, began_ms)


def _sealed(data: bytes) -> bytes:
    return data[:-4] + zlib.crc32(data[:-4]).to_bytes(4, "little")


DAMAGED = {
    "truncated": (lambda data: data[:-1], Refusal.SIZE),
    "longer": (lambda data: data + b"\0", Refusal.SIZE),
    "empty": (lambda data: b"", Refusal.SIZE),
    "magic": (lambda data: _sealed(b"X" + data[1:]), Refusal.MAGIC),
    "version": (lambda data: _sealed(data[:4] + b"\2" + data[5:]), Refusal.VERSION),
    "checksum": (lambda data: data[:40] + bytes([data[40] ^ 1]) + data[41:], Refusal.CRC),
    "kind": (lambda data: _sealed(data[:5] + b"\x09" + data[6:]), Refusal.KIND),
    "size": (lambda data: _sealed(data[:6] + b"\0\0" + data[8:]), Refusal.SIZE),
    "a long hello": (lambda data: _sealed(data[:5] + b"\1" + data[6:]), Refusal.SIZE),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_what_is_damaged_reaches_no_motor_and_the_third_in_a_row_ends_it(rules, what):
    damage, refusal = DAMAGED[what]
    rules.driven()
    for _ in range(3):
        assert rules.status.state is State.ARMED
        rules.run(20, lambda: damage(rules.command(q=-Q)))
    assert rules.status.refused[refusal] == 3
    assert (rules.status.state, rules.status.reason) == (State.RAMPING, Reason.REFUSALS)
    assert np.allclose([each.command["q"] for each in rules.sent[-60:]], Q)


@pytest.mark.parametrize("what", DAMAGED)
def test_damage_of_a_stranger_ends_nothing(rules, what):
    damage, refusal = DAMAGED[what]
    rules.driven()
    for _ in range(9):
        rules.datagram(damage(rules.command()), STRANGER)
    rules.run(20, rules.command)
    assert (rules.status.refused[refusal], rules.status.state) == (9, State.ARMED)


def test_an_old_command_reaches_no_motor(rules):
    rules.driven()
    seq = rules.seq
    for old in (seq, seq - 1, seq - 2**30):
        rules.datagram(rules.command(q=-Q, seq=old))
    assert rules.status.refused[Refusal.SEQ] == 3
    rules.run(20)
    assert np.allclose(rules.sent[-1].command["q"], Q)
    assert rules.status.state is State.ARMED


def test_the_number_of_a_command_may_wrap(rules):
    rules.run(20)
    rules.arm()
    for seq in (2**32 - 2, 2**32 - 1, 0, 1):
        rules.run(20, lambda seq=seq: rules.command(seq=seq))
    assert (rules.status.accepted, rules.status.command_seq) == (4, 1)


@pytest.mark.parametrize(("age_ms", "is_stale"), [(100, False), (101, True), (-50, False), (-51, True)])
def test_a_command_that_answers_no_recent_state_reaches_no_motor(rules, age_ms, is_stale):
    rules.driven()
    rules.datagram(rules.command(q=-Q, state_tick=int(rules.robot["tick"][0]) - age_ms))
    assert rules.status.refused[Refusal.STALE] == is_stale


def test_a_session_counts_its_commands_anew(rules):
    rules.driven()
    rules.run(500)
    rules.arm()
    rules.datagram(rules.command(seq=1))
    assert (rules.status.command_seq, rules.status.refused[Refusal.SEQ]) == (1, 0)


def test_a_command_of_an_earlier_session_reaches_no_motor(rules):
    rules.driven()
    old = rules.token
    rules.run(500)
    rules.arm()
    rules.datagram(rules.command(token=old))
    assert rules.status.refused[Refusal.TOKEN] == 1
    assert not rules.run(2)[-1].command["kp"].any()


# ---- silence ----


def test_a_silent_station_is_held_for_60_ms_frozen_until_100_and_damped_for_ever(rules):
    rules.driven()
    rules.run(2, lambda: rules.command(q=Q + 0.05))
    last_ms = rules.now_ms
    rules.run(58)
    assert (rules.now_ms - last_ms, rules.status.state) == (58, State.ARMED)
    rules.run(2)
    assert (rules.status.state, rules.status.freezes) == (State.FROZEN, 1)
    held = rules.run(38)
    assert all((each.command["kp"] == 40).all() and np.allclose(each.command["q"], Q + 0.05) for each in held)
    sent = rules.run(10_000)
    assert_ramp_to_damping(sent, last_ms + 100)
    assert (rules.status.state, rules.status.reason) == (State.DAMPING, Reason.SILENCE)
    assert len(sent) == 5000


def test_a_motion_under_way_stops_where_it_is_when_it_freezes(rules):
    rules.driven()
    far = upper(G1_29)
    rules.run(2, lambda: rules.command(q=far))
    frozen = [each.command["q"] for each in rules.run(96)]
    moving = int(np.argmax(far - Q))
    q = np.array(frozen)[:, moving]
    assert q[0] < q[28] < far[moving], "on its way at 58 ms"
    assert (q[29:] == q[29]).all()


def test_a_command_while_frozen_goes_on(rules):
    rules.driven()
    rules.run(80)
    assert rules.status.state is State.FROZEN
    rules.run(100, rules.command)
    assert (rules.status.state, rules.status.damped) == (State.ARMED, 0)


@pytest.mark.parametrize("silence_ms", [120, 350, 1000])
def test_commands_that_return_after_100_ms_move_nothing(rules, silence_ms):
    rules.driven()
    rules.run(silence_ms)
    before = rules.sent[-1].command
    sent = rules.run(1000, lambda: rules.command(q=-Q))
    assert all((each.command["q"] == before["q"]).all() and (each.command["kd"] == 8).all() for each in sent)
    assert not sent[-1].command["kp"].any()
    assert rules.status.state is State.DAMPING
    assert rules.status.refused[Refusal.NOT_ARMED] == 50


def test_the_ramp_is_not_cut_short_by_arming(rules):
    rules.driven()
    rules.run(150)
    assert rules.arm().reason is Reason.BUSY
    rules.run(400)
    assert rules.arm().kind is Answer.ARMED


def test_disarming_comes_to_damping_at_once(rules):
    rules.driven()
    began_ms = rules.now_ms
    rules.ask(Kind.DISARM, rules.token)
    rules.step()
    rules.run(400)
    assert_ramp_to_damping(rules.sent[100:], began_ms)
    assert rules.status.reason is Reason.DISARMED
    rules.ask(Kind.DISARM, rules.token)
    assert rules.status.refused[Refusal.NOT_ARMED] == 1


def test_disarming_with_another_sessions_number_does_nothing(rules):
    rules.driven()
    rules.ask(Kind.DISARM, 1)
    assert (rules.status.state, rules.status.refused[Refusal.TOKEN]) == (State.ARMED, 1)


# ---- the robot's messages ----


def test_a_robot_that_is_not_heard_for_50_ms_is_damped(rules):
    rules.driven()
    last_ms = rules.now_ms
    rules.is_heard = False
    sent = rules.run(500, rules.command)
    assert_ramp_to_damping(sent, last_ms + 52)
    assert rules.status.reason is Reason.NO_STATE
    assert len(sent) == 250, "it goes on when it hears nothing"
    rules.is_heard = True
    rules.run(100, rules.command)
    assert rules.status.state is State.DAMPING


def test_a_tick_that_stands_still_is_a_robot_that_is_not_heard(rules):
    rules.driven()
    last_ms = rules.now_ms
    rules.is_ticking = False
    assert_ramp_to_damping(rules.run(500, rules.command), last_ms + 52)
    assert rules.status.reason is Reason.TICK


def test_a_tick_that_goes_to_and_fro_does_not_count(rules):
    rules.driven()
    rules.is_ticking = False
    for step in range(40):
        rules.robot["tick"][0] = 60_000 + step % 2
        rules.run(2, rules.command if step % 10 == 0 else None)
    assert rules.status.reason is Reason.TICK


def test_a_robot_that_began_anew_can_be_armed(rules):
    rules.run(20)
    rules.robot["tick"] = 10
    rules.run(20)
    assert rules.arm().kind is Answer.ARMED


@pytest.mark.parametrize("quat", [(0, 0, 0, 0), (np.nan, 0, 0, 0), (9, 0, 0, 0)])
def test_a_state_without_an_attitude_is_none(rules, quat):
    rules.driven()
    rules.robot["quat_wxyz"][0] = quat
    rules.run(100, rules.command)
    assert rules.status.reason is Reason.NO_STATE
    assert rules.status.bad_states == 50


# ---- the guard itself ----


@pytest.mark.parametrize(("still_ms", "state"), [(90, State.ARMED), (110, State.RAMPING)])
def test_a_guard_that_stood_still_for_100_ms_comes_to_damping(library, still_ms, state):
    rules = Rules(library, begun_ms=0)
    rules.run(1000)
    rules.driven()
    rules.skip(still_ms)
    rules.run(10, rules.command)
    assert rules.status.state is state
    assert rules.status.reason is (Reason.LATE if state is State.RAMPING else Reason.NONE)
    assert rules.status.max_late_s == still_ms / 1000


def test_a_guard_that_is_to_end_ramps_and_damps_for_300_ms(rules):
    rules.driven()
    began_ms = rules.now_ms
    rules.end()
    rules.step()
    while not rules.is_done():
        rules.run(2, rules.command)
        rules.end()
    assert_ramp_to_damping(rules.sent[100:], began_ms)
    assert rules.now_ms - began_ms == 600
    assert rules.arm().reason is Reason.ENDING


def test_a_guard_in_damping_sends_damping_for_300_ms_before_it_ends(rules):
    rules.driven()
    rules.run(1000)
    rules.end()
    count = 0
    while not rules.is_done():
        count += len(rules.run(2))
    assert count == 150


def test_a_guard_that_never_was_armed_ends_at_once(rules):
    rules.run(20)
    rules.end()
    assert rules.is_done()


def test_who_is_silent_for_a_second_is_told_nothing_more(rules):
    assert rules.listener() == 0
    rules.ask(Kind.HELLO, sender=3)
    assert rules.listener() == 3
    rules.run(998)
    assert rules.listener() == 3
    rules.run(2)
    assert rules.listener() == 0


def test_while_armed_only_the_station_is_told(rules):
    rules.driven()
    rules.ask(Kind.HELLO, sender=STRANGER)
    assert rules.listener() != STRANGER


# ---- numbers ----


def test_both_checksums_are_those_of_the_station(library):
    chance = random.Random(3)
    for _ in range(200):
        data = chance.randbytes(4 * chance.randint(1, 300))
        assert library.crc32_unitree(data, len(data)) == messages.crc32_of_words(data)
        assert library.crc32_zlib(data, len(data)) == zlib.crc32(data)


def test_gains_of_the_policies_pass_and_ten_times_them_do_not(rules):
    from adapters.policies.rl_gym import RlGymG1Policy
    from adapters.policies.twist2 import gains

    kp, kd = gains(20.0, 1.0)
    rules.driven()
    rules.run(100, lambda: rules.command(kp=kp, kd=kd))
    assert np.allclose(rules.sent[-1].command["kp"], kp)
    assert (RlGymG1Policy.GAINS[0] <= [most_gains(joint)[0] for joint in G1_29[:12]]).all()
    for joint, stiffness in zip(JOINTS, kp, strict=True):
        assert stiffness < most_gains(joint.name)[0] < 10 * stiffness


# ---- a station that sends garbage ----


def _mutant(chance: random.Random, good: bytes) -> bytes:
    data = bytearray(good)
    for _ in range(chance.randint(1, 4)):
        match chance.randrange(4):
            case 0 if data:
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            case 1:
                data = data[: chance.randrange(len(data) + 1)]
            case 2:
                data += chance.randbytes(chance.randrange(8))
            case _:
                data = bytearray(chance.randbytes(len(data)))
    return bytes(data)


def rearm(rules: Rules) -> None:
    rules.run(2)  # it sees that it is to ramp
    rules.skip(300)
    rules.run(4)
    assert rules.arm().kind is Answer.ARMED


def test_of_30_000_mutants_none_reaches_a_motor(library):
    chance = random.Random(5)
    rules = Rules(library).driven()
    for count in range(30_000):
        mutant = _mutant(chance, rules.command(q=-Q))
        if mutant[-4:] == zlib.crc32(mutant[:-4]).to_bytes(4, "little"):
            continue  # two changes undid each other
        rules.datagram(mutant, STRANGER if count % 3 else 7)
        if count % 50 == 0:
            rules.run(2, rules.command)
            assert np.allclose(rules.sent[-1].command["q"], Q)
        if count % 10 == 0 and rules.status.state is not State.ARMED:
            rearm(rules)
            rules.run(12, rules.command)
    assert rules.status.damped > 500
    assert sum(rules.status.refused.values()) > 29_000


def test_whatever_numbers_a_station_sends_what_is_sent_is_within_limits(library):
    chance = np.random.default_rng(6)
    rules = Rules(library).driven()
    most = np.array([most_gains(joint) for joint in G1_29])
    for _ in range(5_000):
        scale = 10.0 ** chance.uniform(-2, 3)
        q, kp, kd = chance.normal(size=(3, MOTORS)) * scale
        sent = rules.run(2, lambda q=q, kp=kp, kd=kd: rules.command(q=q, kp=np.abs(kp) * 10, kd=np.abs(kd)))
        command = sent[-1].command
        assert (lower(G1_29) - 1e-6 <= command["q"]).all()
        assert (command["q"] <= upper(G1_29) + 1e-6).all()
        assert (command["kp"] <= most[:, 0]).all()
        assert (command["kd"] <= most[:, 1]).all()
        if rules.status.state is not State.ARMED:
            rearm(rules)
    assert rules.status.accepted > 50
