"""What states and commands say: sound episodes are believed, and each kind of corruption is told for what it is."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station.bus import codec, keys
from station.episode.quality import plausibility
from station.episode.quality.alignment import AlignmentMeter
from station.episode.quality.blocks import at_once
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.quality.state_rules import PLAUSIBLE
from station.episode.reading import steps
from station.episode.reading.reader import open_episode
from station.episode.storage.anchor import read_anchor
from station.protocols import Floats
from tests import strider
from tests.episode import lock_step
from tests.episode.arm_run import ArmRun
from tests.episode.filming import HEAD, film, jpeg
from tests.episode.rewritten import as_it_is, rewritten
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, command, tick
from tests.episode.writes import Native

STATE, USED, TIMING = keys.robot_state(ROBOT), keys.command_used(ROBOT), keys.policy_timing(ROBOT)
BODY = twist_keys.action_body()
JOINTS = len(G1_29)
KNEE, OTHER_KNEE = G1_29.index("left_knee"), G1_29.index("right_knee")
LEGS = [*range(6, 12), *range(6), *range(12, JOINTS)]  # left and right exchanged
QUAT = slice(2 * JOINTS, 2 * JOINTS + 4)
NOW_NS = 1 << 62


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of the real policy on the real simulation."""
    return lock_step.record(EpisodeBuilder(tmp_path_factory.mktemp("walk")), seconds=7.0)


def told(quality: Quality) -> dict[str, str]:
    """What the rules of this room say, by their names."""
    return {reason.rule: reason.text for reason in quality.reasons if reason.rule in PLAUSIBLE}


def verdicts(quality: Quality) -> dict[str, str]:
    return {reason.rule: reason.verdict for reason in quality.reasons if reason.rule in PLAUSIBLE}


def spoilt(walked: Path, data: Path, spoil: Callable[[Floats, float], Floats], *, key: str = STATE) -> Quality:
    """The walk, with other numbers in a key; they get them, and the time from the start [s]."""

    def change(topic: str, value: bytes, at_s: float) -> tuple[bytes, float]:
        return (codec.f64(spoil(codec.parse_f64(value).copy(), at_s)) if topic == key else value), at_s

    return check(open_episode(rewritten(walked, data, change)))


def test_a_walk_of_the_real_policy_is_believed(walked: Path, tmp_path: Path) -> None:
    quality = check(open_episode(walked))
    (found,) = quality.plausibility
    assert told(quality) == {}
    assert len(found.orientation_agreement) == 3
    assert min(found.orientation_agreement.values()) > 0.85
    assert found.gyro_factor == pytest.approx(1.0, abs=0.15)
    assert found.velocity_factor == pytest.approx(1.0, abs=0.15)
    assert len(found.velocity_agreement) > 10
    assert min(found.velocity_agreement.values()) > 0.8
    assert told(check(open_episode(rewritten(walked, tmp_path, as_it_is)))) == {}


def test_a_state_that_is_frozen_while_the_robot_walks_is_told_with_when_and_how_long(
    walked: Path, tmp_path: Path
) -> None:
    held: list[Floats] = []

    def freeze(state: Floats, at_s: float) -> Floats:
        if 3.0 <= at_s < 4.0:
            held.append(state)
            return held[0]
        return state

    quality = spoilt(walked, tmp_path, freeze)
    assert verdicts(quality)["frozen-state"] == "reject"
    assert "for 0.98 s from 3.0" in told(quality)["frozen-state"]
    assert "50 equal states" in told(quality)["frozen-state"]


def test_a_state_that_repeats_five_times_is_a_slow_sensor(walked: Path, tmp_path: Path) -> None:
    held: dict[int, Floats] = {}

    def slow(state: Floats, at_s: float) -> Floats:
        return held.setdefault(int(at_s / 0.1 + 1e-6), state)

    assert "frozen-state" not in told(spoilt(walked, tmp_path, slow))


def test_a_joint_that_is_stuck_is_told_by_its_name(walked: Path, tmp_path: Path) -> None:
    def stick(state: Floats, at_s: float) -> Floats:
        if at_s >= 2.0:
            state[KNEE], state[JOINTS + KNEE] = 0.3, 0.0
        return state

    quality = spoilt(walked, tmp_path, stick)
    assert set(told(quality)) >= {"stuck-joint"}
    assert "left_knee stayed at 0.300 rad" in told(quality)["stuck-joint"]
    assert verdicts(quality)["stuck-joint"] == "reject"


def test_a_joint_that_the_policy_is_not_asked_to_move_is_not_stuck(walked: Path, tmp_path: Path) -> None:
    """While a policy of velocities drives, the motion beside it moves no joint."""

    def stick(topic: str, value: bytes, at_s: float) -> tuple[bytes, float]:
        state = codec.parse_f64(value).copy() if topic == STATE else np.empty(0)
        if topic == STATE and at_s >= 2.0:
            state[KNEE], state[JOINTS + KNEE] = 0.3, 0.0
        return (codec.f64(state) if topic == STATE else value), at_s

    reader = open_episode(rewritten(walked, tmp_path, stick))
    contract = reader.contract(USED)
    assert contract is not None
    knee = contract.names.index("left_knee_pos")
    all_but_it = np.arange(len(contract.names)) != knee
    none = np.zeros(len(contract.names), dtype=np.bool_)
    for heard, expected in ((None, ["left_knee"]), (all_but_it, []), (none, [])):
        (meter,) = plausibility.meters(reader, [ROBOT], is_lock_step=True).values()
        lag = AlignmentMeter(ROBOT, STATE, reader.contract)
        for step in steps.iterate(reader, ROBOT):
            meter.feed_step(step, "tracking", heard)
            lag.feed(step, "tracking", heard)
        assert [joint.joint for joint in meter.result().stuck] == expected
        assert (lag.result().lag_s is None) == (heard is none), "what is not followed has no lag"


def test_a_quaternion_of_half_the_length_is_no_rotation(walked: Path, tmp_path: Path) -> None:
    def halve(state: Floats, at_s: float) -> Floats:
        state[QUAT] *= 0.5
        return state

    quality = spoilt(walked, tmp_path, halve)
    assert verdicts(quality) == {"quaternion-norm": "reject"}
    assert "its length 0.5 and not 1, the first at 0.10 s" in told(quality)["quaternion-norm"]


@pytest.mark.parametrize(
    "turned",
    [
        pytest.param(lambda quat: np.roll(quat, -1), id="xyzw"),
        pytest.param(lambda quat: quat * [1, -1, -1, -1], id="inverse"),
        pytest.param(lambda quat: quat[[0, 2, 1, 3]], id="other axes"),
    ],
)
def test_an_orientation_in_another_order_or_frame_disagrees_with_the_gyro(
    walked: Path, tmp_path: Path, turned: Callable[[Floats], Floats]
) -> None:
    def turn(state: Floats, at_s: float) -> Floats:
        state[QUAT] = turned(state[QUAT])
        return state

    quality = spoilt(walked, tmp_path, turn)
    assert verdicts(quality)["orientation-disagrees"] == "reject"


@pytest.mark.parametrize(("factor", "said"), [(0.0, "0 rad/s of the gyro"), (180 / np.pi, "5")])
def test_a_gyro_of_another_scale_is_told(walked: Path, tmp_path: Path, factor: float, said: str) -> None:
    def scale(state: Floats, at_s: float) -> Floats:
        state[QUAT.stop :] *= factor
        return state

    quality = spoilt(walked, tmp_path, scale)
    assert verdicts(quality) == {"gyro-scale": "usable"}
    assert told(quality)["gyro-scale"].startswith(f"{STATE}: {said}")


def test_axes_of_a_gyro_that_are_exchanged_are_told_though_the_third_turns_faster(walked: Path, tmp_path: Path) -> None:
    def exchange(state: Floats, at_s: float) -> Floats:
        gyro = state[QUAT.stop :]
        state[QUAT.stop :] = [gyro[1], -gyro[0], gyro[2]]
        return state

    quality = spoilt(walked, tmp_path, exchange)
    assert quality.plausibility[0].orientation_agreement["gyro_z"] > 0.85
    assert verdicts(quality) == {"orientation-disagrees": "reject"}
    assert f"{STATE}: gyro_" in told(quality)["orientation-disagrees"]


def test_a_robot_that_stands_says_nothing_of_its_gyro(tmp_path: Path) -> None:
    builder, noise = EpisodeBuilder(tmp_path), np.random.default_rng(5)
    for number in range(300):
        turned = np.array([1.0, *(1e-4 * noise.standard_normal(3))])
        tick(builder, number, at_s=0.1 + number / 50, quat=turned / np.linalg.norm(turned))
    (found,) = check(open_episode(builder.finish())).plausibility
    assert (found.orientation_agreement, found.gyro_factor) == ({}, None)


def test_velocities_of_other_joints_are_told_with_whose_they_are(walked: Path, tmp_path: Path) -> None:
    def swap(state: Floats, at_s: float) -> Floats:
        state[JOINTS : 2 * JOINTS] = state[JOINTS : 2 * JOINTS][LEGS]
        return state

    quality = spoilt(walked, tmp_path, swap)
    text = told(quality)["velocity-disagrees"]
    joint = text.split("velocity of ")[1].split(" ")[0]
    other = joint.replace("left", "right") if "left" in joint else joint.replace("right", "left")
    assert f"that of {other} fits" in text


def test_a_joint_that_shakes_faster_than_states_are_written_is_sound(walked: Path, tmp_path: Path) -> None:
    noise = np.random.default_rng(3)

    def shake(state: Floats, at_s: float) -> Floats:
        state[JOINTS + KNEE] = 3.0 * noise.standard_normal()
        return state

    quality = spoilt(walked, tmp_path, shake)
    assert quality.plausibility[0].velocity_agreement["left_knee"] < 0.5
    assert told(quality) == {}


def test_a_joint_that_shakes_beside_another_that_moves_as_it_does_is_sound(walked: Path, tmp_path: Path) -> None:
    """Its positions fit the other one's velocity, which is that one's own: nothing is exchanged."""
    noise, hip = np.random.default_rng(3), G1_29.index("left_hip_pitch")

    def shake(state: Floats, at_s: float) -> Floats:
        state[KNEE] = 0.6 + state[hip]
        state[JOINTS + KNEE] = 3.0 * noise.standard_normal()
        return state

    assert "velocity-disagrees" not in told(spoilt(walked, tmp_path, shake))


def test_velocities_of_the_wrong_sign_are_told(walked: Path, tmp_path: Path) -> None:
    def invert(state: Floats, at_s: float) -> Floats:
        state[JOINTS + KNEE] *= -1.0
        return state

    assert "the velocity of left_knee agrees by -" in told(spoilt(walked, tmp_path, invert))["velocity-disagrees"]


def test_velocities_in_degrees_are_told_where_times_are_those_of_the_control(walked: Path, tmp_path: Path) -> None:
    def degrees(state: Floats, at_s: float) -> Floats:
        state[JOINTS : 2 * JOINTS] *= 180 / np.pi
        return state

    quality = spoilt(walked, tmp_path, degrees)
    factor = quality.plausibility[0].velocity_factor
    assert factor == pytest.approx(180 / np.pi, rel=0.1)
    assert quality.lock_step, "an interval is what the contract says, and not what the machine took"
    assert told(quality)["velocity-scale"].startswith(f"{STATE}: 5")


@pytest.mark.parametrize("factor", [0.0, 3.0])
def test_velocities_that_are_tripled_or_zero_are_told(walked: Path, tmp_path: Path, factor: float) -> None:
    def scale(state: Floats, at_s: float) -> Floats:
        state[JOINTS : 2 * JOINTS] *= factor
        return state

    quality = spoilt(walked, tmp_path, scale)
    assert verdicts(quality) == {"velocity-scale": "usable"}
    assert quality.plausibility[0].velocity_factor == pytest.approx(factor, rel=0.15)


def test_an_encoder_that_slips_is_told_by_joint_and_time(walked: Path, tmp_path: Path) -> None:
    def slip(state: Floats, at_s: float) -> Floats:
        state[KNEE] += 0.3 * (at_s > 4.0)
        return state

    quality = spoilt(walked, tmp_path, slip)
    (jump,) = quality.plausibility[0].jumps
    assert (jump.joint, jump.count, jump.joints) == ("left_knee", 1, 1)
    assert jump.by_rad == pytest.approx(0.3, abs=0.15)
    assert jump.at_s == pytest.approx(4.0, abs=0.05)
    assert told(quality)["position-jump"].startswith(f"{STATE}: left_knee jumps by ")
    assert verdicts(quality)["position-jump"] == "usable"


def test_a_robot_that_is_put_on_its_feet_has_not_slipped(tmp_path: Path) -> None:
    for name, is_told in (("operator-reset", False), ("mark", True)):
        builder = EpisodeBuilder(tmp_path, task=name)
        for number in range(200):
            q = STANDING + 0.1 * np.sin(0.1 * number) + (0.5 if number >= 100 else 0.0)
            if number == 100:
                builder.rates(STATE, np.concatenate([q, [1.0, 0.0, 0.0, 0.0]]), at_s=0.09 + number / 50)
            tick(builder, number, at_s=0.1 + number / 50, q=q)
        builder.event(name, at_s=2.09)
        assert ("position-jump" in told(check(open_episode(builder.finish())))) is is_told


def test_a_sensor_that_is_read_half_as_often_as_it_is_told_repeats_itself(walked: Path, tmp_path: Path) -> None:
    held: list[Floats] = []

    def hold(state: Floats, at_s: float) -> Floats:
        held.append(held[-1] if len(held) % 2 else state)
        return held[-1].copy()

    quality = spoilt(walked, tmp_path, hold)
    assert verdicts(quality) == {"repeated-states": "usable"}
    assert 0.4 < quality.plausibility[0].repeats.count / quality.plausibility[0].moving < 0.6


@pytest.mark.parametrize(
    ("spoil", "rule"), [(lambda q: -q, "joint-reversed"), (lambda q: q + 0.5, "joint-offset")], ids=["sign", "zero"]
)
def test_a_joint_of_the_wrong_sign_or_zero_is_told(
    walked: Path, tmp_path: Path, spoil: Callable[[float], float], rule: str
) -> None:
    def change(state: Floats, at_s: float) -> Floats:
        state[KNEE] = spoil(state[KNEE])
        return state

    assert "left_knee" in told(spoilt(walked, tmp_path, change))[rule]


def test_steps_that_tell_no_instant_are_told_with_the_first(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number in range(200):
        tick(builder, number, at_s=0.1 + number / 50)
        if number >= 100:
            builder.write({TIMING: codec.json_vector([number, number, *[0] * 6])}, at_s=0.105 + number / 50)
    quality = check(open_episode(builder.finish()))
    assert "the first at 2.1" in told(quality)["untimed-steps"]
    assert verdicts(quality)["untimed-steps"] == "usable"


def test_legs_that_are_exchanged_in_state_follow_each_others_commands(walked: Path, tmp_path: Path) -> None:
    def swap(state: Floats, at_s: float) -> Floats:
        state[:JOINTS], state[JOINTS : 2 * JOINTS] = state[:JOINTS][LEGS], state[JOINTS : 2 * JOINTS][LEGS]
        return state

    quality = spoilt(walked, tmp_path, swap)
    assert verdicts(quality)["joint-order"] == "reject"
    found = {each.joint: each.follows for each in quality.plausibility[0].misplaced}
    assert found["left_knee"] == "right_knee"


@pytest.mark.parametrize("key", [STATE, USED])
def test_angles_in_degrees_are_told_of_state_and_command(walked: Path, tmp_path: Path, key: str) -> None:
    def degrees(vector: Floats, at_s: float) -> Floats:
        joints = slice(0, JOINTS) if key == STATE else slice(6, None)
        vector[joints] *= 180 / np.pi
        return vector

    quality = spoilt(walked, tmp_path, degrees, key=key)
    assert verdicts(quality)["not-radians"] == "reject"
    assert told(quality)["not-radians"].startswith(f"{key}: ")


def test_states_that_are_no_numbers_are_told_with_the_first(walked: Path, tmp_path: Path) -> None:
    count = iter(range(NOW_NS))

    def spoil(state: Floats, at_s: float) -> Floats:
        if next(count) % 50 == 10:
            state[KNEE] = np.nan
        return state

    quality = spoilt(walked, tmp_path, spoil)
    assert verdicts(quality) == {"unfit-values": "reject"}
    assert told(quality)["unfit-values"] == (
        f"{STATE}: 7 of 350 writes hold no finite number in left_knee_pos, the first at 0.30 s"
    )


def test_values_that_make_a_list_only_together_are_decoded_one_by_one() -> None:
    decode = msgspec.json.Decoder(list[list[float]]).decode
    assert at_once(decode, [b"[1,2]", b"[3,4]"]) == [[1, 2], [3, 4]]
    assert at_once(decode, [b"[1,2],[3,4]", b"[5", b"6]"]) is None, "as many lists as values, and none of them its own"
    assert at_once(decode, [b"[1,2],[3,4]", b"[5,6]"]) is None


def test_a_single_value_that_is_cut_off_is_told_and_leaves_the_episode_usable(walked: Path, tmp_path: Path) -> None:
    def cut(topic: str, value: bytes, at_s: float) -> tuple[bytes, float]:
        return (value[:-8] if topic == STATE and abs(at_s - 3.1) < 1e-6 else value), at_s

    quality = check(open_episode(rewritten(walked, tmp_path, cut)))
    assert verdicts(quality) == {"unfit-values": "usable"}
    assert (
        "1 of 350 writes hold other than the numbers of the contract, the first at 3.10 s"
        in told(quality)["unfit-values"]
    )


def test_steps_without_a_state_of_their_own_are_told_though_no_number_is_missing(walked: Path, tmp_path: Path) -> None:
    count = iter(range(NOW_NS))

    def leave_out(topic: str, value: bytes, at_s: float) -> tuple[bytes, float] | None:
        return None if topic == STATE and next(count) % 20 == 10 else (value, at_s)

    quality = check(open_episode(rewritten(walked, tmp_path, leave_out)))
    assert verdicts(quality) == {"reused-states": "usable"}
    assert "4.9% of the steps" in told(quality)["reused-states"]


@pytest.mark.parametrize("spoil", ["names", "unit"])
def test_a_contract_that_its_robot_does_not_state_is_told(walked: Path, tmp_path: Path, spoil: str) -> None:
    recorded = open_episode(walked).recorded[STATE]
    assert recorded is not None
    items = list(recorded.elements)
    if spoil == "names":
        items[KNEE], items[OTHER_KNEE] = items[OTHER_KNEE], items[KNEE]
    else:
        items[KNEE] = msgspec.structs.replace(items[KNEE], unit="deg")
    contract = msgspec.structs.replace(recorded, elements=tuple(items))
    quality = check(open_episode(rewritten(walked, tmp_path, contracts={STATE: contract})))
    said = {"names": "right_knee_pos [rad]", "unit": "left_knee_pos [deg]"}[spoil]
    assert verdicts(quality)["contract-differs"] == "reject"
    assert (
        f"{STATE}: recorded with {said} as element {KNEE}, its robot's server states left_knee_pos [rad]"
        in told(quality)["contract-differs"]
    )


@dataclass(frozen=True)
class Waving:
    """Ticks of an arm that waves, each part of them at a time that is chosen here [s]."""

    state_late_s: float = 0.0
    command_late_s: float = 0.0
    command_ahead: int = 0
    written_late_s: float = 0.0

    def recorded(self, data: Path) -> Quality:
        builder = EpisodeBuilder(data / "as made")
        for number in range(300):
            tick(builder, number, at_s=0.1 + number / 50, q=self._q(number), asked=command(q=self._q(number)))
        return check(open_episode(rewritten(builder.finish(), data, self._change)))

    def _q(self, number: float) -> Floats:
        q = STANDING.copy()
        q[G1_29.index("left_elbow")] += 0.5 * np.sin(0.1 * number)
        return q

    def _change(self, topic: str, value: bytes, at_s: float) -> tuple[bytes, float]:
        if topic == STATE:
            at_s += self.state_late_s
        elif topic == BODY:
            at_s += self.command_late_s
        elif topic == USED:
            number = round((at_s - 0.1035) * 50) + self.command_ahead
            value = codec.f64(command(q=self._q(number)))
        elif topic == TIMING and self.written_late_s:
            row = json.loads(value)
            row[2] += round(self.written_late_s * 1e9)
            value = json.dumps(row).encode()
        return value, at_s


def test_times_that_fit_are_believed(tmp_path: Path) -> None:
    quality = Waving().recorded(tmp_path)
    (found,) = quality.plausibility
    assert told(quality) == {}
    assert found.times is not None
    assert found.times.state_off_s == pytest.approx(0.0, abs=1e-3)
    assert found.times.command_off_s == pytest.approx(0.0, abs=1e-3)
    assert (found.times.commands_ahead, found.times.command_difference) == (0, 0.0)


@pytest.mark.parametrize("late_s", [-0.1, 0.1])
def test_states_that_are_stamped_early_or_late_are_told(tmp_path: Path, late_s: float) -> None:
    quality = Waving(state_late_s=late_s).recorded(tmp_path)
    assert verdicts(quality)["step-times"] == "reject"
    how = "later" if late_s > 0 else "earlier"
    assert told(quality)["step-times"].startswith(
        f"states in {STATE} are stamped 100 ms {how} than the steps in {TIMING}"
    )


def test_commands_that_are_stamped_after_their_use_are_told(tmp_path: Path) -> None:
    quality = Waving(command_late_s=0.08).recorded(tmp_path)
    assert f"commands in {BODY} are stamped 80 ms later" in told(quality)["step-times"]


def test_commands_that_were_used_before_they_were_written_are_told(tmp_path: Path) -> None:
    quality = Waving(written_late_s=0.03).recorded(tmp_path)
    assert "100% of the commands were used before they were written" in told(quality)["before-written"]


def test_a_command_that_is_ahead_of_its_time_is_told_by_how_many_writes(tmp_path: Path) -> None:
    quality = Waving(command_ahead=4).recorded(tmp_path)
    assert verdicts(quality)["command-ahead"] == "reject"
    assert "4 writes later" in told(quality)["command-ahead"]


def test_a_command_that_lags_behind_its_number_is_no_command_ahead(tmp_path: Path) -> None:
    assert "command-ahead" not in told(Waving(command_ahead=-4).recorded(tmp_path))


@pytest.mark.parametrize(
    ("age_s", "verdict"),
    [(0.03, None), (-0.2, "reject"), (0.3, "usable"), (1.5, "reject")],
)
def test_pictures_that_were_written_before_they_were_taken_or_long_after_are_told(
    tmp_path: Path, age_s: float, verdict: str | None
) -> None:
    quality = _filmed(tmp_path, [age_s] * 60)
    assert verdicts(quality).get("camera-times") == verdict


def test_an_age_of_pictures_that_jumps_is_told(tmp_path: Path) -> None:
    quality = _filmed(tmp_path, [0.03] * 55 + [0.6] * 5)
    assert "jumps between 30 ms (p50) and 600 ms (p99)" in told(quality)["camera-times"]


def _filmed(data: Path, ages_s: list[float]) -> Quality:
    anchor, camera = read_anchor(), Native("head")
    writes = [
        camera.write(
            HEAD, jpeg(number),
            written_ns=(at_ns := anchor.mono_ns + number * 33_000_000), capture_ns=at_ns - round(age_s * 1e9),
        )
        for number, age_s in enumerate(ages_s)
    ]  # fmt: skip
    film(data / "filmed", [writes], anchor)
    return check(open_episode(data / "filmed"))


def test_an_arm_that_stands_still_repeats_its_state_exactly_and_is_believed(tmp_path: Path) -> None:
    run = ArmRun(EpisodeBuilder(tmp_path))
    run.hold(1.0)
    run.move(2.0)
    run.hold(3.0)
    run.be_silent(1.0)
    quality = check(open_episode(run.finish()))
    assert told(quality) == {}
    assert quality.plausibility[0].frozen is None


def test_a_robot_that_no_description_of_ours_knows_is_believed(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    builder.contracts |= {item.key: item for item in strider.DESCRIPTION.contracts()}
    for number in range(200):
        q, dq = (np.array([0.3, -0.3]) * one for one in (np.sin(0.1 * number), 5.0 * np.cos(0.1 * number)))
        builder.write({keys.robot_state(strider.NAME): strider.state(q, dq=dq)}, at_s=0.02 * number, writer="walker")
        builder.write(strider.step(number, q), at_s=0.02 * number + 0.004, writer="walker")
    quality = check(open_episode(builder.finish({"servers": {"walker": strider.facts()}})))
    assert told(quality) == {}


def test_wheels_may_turn_for_ever_and_what_has_no_end_is_not_in_degrees(tmp_path: Path) -> None:
    wheels = msgspec.structs.replace(
        strider.DESCRIPTION,
        joints=tuple(msgspec.structs.replace(joint, upper=None) for joint in strider.DESCRIPTION.joints),
    )
    builder = EpisodeBuilder(tmp_path)
    builder.contracts |= {item.key: item for item in wheels.contracts()}
    for number in range(100):
        state = strider.state(np.full(2, 0.5 * number), dq=[25.0, 25.0])
        builder.write({keys.robot_state(strider.NAME): state}, at_s=0.02 * number)
    facts = strider.facts(description=msgspec.to_builtins(wheels))
    assert told(check(open_episode(builder.finish({"servers": {"walker": facts}})))) == {}


@pytest.mark.parametrize(("late", "verdict"), [(2, None), (8, "reject")])
def test_a_state_that_repeats_until_a_command_reaches_the_joints_is_believed(
    tmp_path: Path, late: int, verdict: str | None
) -> None:
    steps = [0.0] * 100 + [0.3] * 40
    assert _stepped(tmp_path, steps, [steps[max(0, number - late)] for number in range(len(steps))]) == verdict


@pytest.mark.parametrize(("is_carried", "verdict"), [(True, None), (False, "reject")])
def test_a_hand_that_holds_a_thing_is_not_frozen(tmp_path: Path, is_carried: bool, verdict: str | None) -> None:
    asked = np.linspace(0.0, 1.2, 120).tolist()
    assert _stepped(tmp_path, asked, [min(q, 0.2) for q in asked], is_carried=is_carried) == verdict


def _stepped(folder: Path, asked: list[float], is_at: list[float], **changes: object) -> str | None:
    """Return the verdict on frozen states of a robot whose joints are exactly where they are told to be."""
    described = msgspec.structs.replace(strider.DESCRIPTION, **changes)
    builder = EpisodeBuilder(folder)
    builder.contracts |= {item.key: item for item in described.contracts()}
    for number, (wanted, q) in enumerate(zip(asked, is_at, strict=True)):
        state = strider.state(np.full(2, q), dq=np.zeros(2))
        builder.write({keys.robot_state(strider.NAME): state}, at_s=0.02 * number, writer="walker")
        builder.write(strider.step(number, np.full(2, wanted)), at_s=0.02 * number + 0.004, writer="walker")
    facts = strider.facts(description=msgspec.to_builtins(described))
    return verdicts(check(open_episode(builder.finish({"servers": {"walker": facts}})))).get("frozen-state")


def test_a_robot_that_is_asked_for_nothing_is_not_frozen(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number in range(200):
        asked = STANDING.copy()
        asked[KNEE] += 0.004 * number
        tick(builder, number, at_s=0.1 + number / 50, asked=command(q=asked), gate="waiting")
    assert told(check(open_episode(builder.finish()))) == {}
