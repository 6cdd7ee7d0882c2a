"""A G1's messages: types that the robot knows (R1), checksums (R2), and another program on the same wire (R3)."""

from __future__ import annotations

import random
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.dds import messages, rows, types, words
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import NetworkOptions
from adapters.robots.g1.joints import G1_29
from station.contract import names_of
from station.description import JOINT
from station.errors import ConfigError
from tests.adapters.robots.g1.dds import far
from tests.dds_domains import domain
from tests.waiting import wait_until

# Minimal and complete XTypes hashes in Unitree's own library, as its stock programs announce them.
HASHES = {
    types.LowCmd: ("6569fc15f0d47aa8600b9e91fbbc", "42b0283aa7e1bb592ec898a0dbed"),
    types.LowState: ("2f38296b52aa0230b92d378b1e39", "2be9706c9587e8d8afd8bfc6de7b"),
    types.IMUState: ("fc687176651206558473df442280", "7d4166754177d86fa27cd25b0403"),
    types.WirelessController: ("d8dc69fff5d75961cd0e3fc049cb", "e9686fe76f7b08f92cb24943ac72"),
    types.Request: ("cba4dc965d393ada76b4de081925", "c47a4429fcbf539486498753c48f"),
    types.Response: ("48c997d379c3e18c530b5f8fe946", "d1c32cc02214901a464a6c51325d"),
}


def _hashes(kind: Any) -> tuple[str, str]:
    info = kind.__idl__.get_type_info()
    return tuple(each.typeid_with_size.type_id.value.hex() for each in (info.minimal, info.complete))


@pytest.mark.parametrize("kind", HASHES, ids=lambda kind: kind.__name__)
def test_r1_a_type_has_the_hash_that_the_robot_knows(kind):
    assert _hashes(kind) == HASHES[kind]
    assert _hashes(raw(kind)) == HASHES[kind]


def test_r1_the_hashes_are_those_of_unitrees_own_library():
    theirs = pytest.importorskip("unitree_interface", reason=far.NEEDED)
    library = b"".join(path.read_bytes() for path in Path(theirs.__file__).parent.glob("unitree_interface.*.so"))
    for pair in HASHES.values():
        assert all(bytes.fromhex(each) in library for each in pair)
    for kind in (types.LowCmd, types.LowState):
        kind.__idl__.fill_type_data()
        assert kind.__idl__._xt_bytedata[0] in library, "what is announced, to the last byte"


# C's structs, as the SDK makes its checksum over them.
_CMD_STRUCT = np.dtype({
    "names": ["pr", "machine", "motors", "reserve", "crc"],
    "formats": ["u1", "u1", (np.dtype([("mode", "u1"), ("pad", "u1", 3), ("rest", "<u4", 6)]), 35), ("<u4", 4), "<u4"],
    "offsets": [0, 1, 4, 984, 1000],
    "itemsize": 1004,
})  # fmt: skip


def _bit_by_bit(words: np.ndarray) -> np.ndarray:
    """The SDK's checksum of many messages at once, as its source says it: bit after bit; words shape (k, n)."""
    register = np.full(len(words), 0xFFFFFFFF, np.uint64)
    for column in words.astype(np.uint64).T:
        for bit in range(31, -1, -1):
            out = register >> np.uint64(31)
            register = (register << np.uint64(1)) & np.uint64(0xFFFFFFFF)
            register ^= np.where(out == 1, np.uint64(0x04C11DB7), np.uint64(0))
            register ^= np.where((column >> np.uint64(bit)) & np.uint64(1) == 1, np.uint64(0x04C11DB7), np.uint64(0))
    return register


def test_r2_a_hundred_thousand_checksums_are_those_of_the_sdks_algorithm():
    words = np.frombuffer(random.Random(17).randbytes(100_000 * 4 * 6), "<u4").reshape(-1, 6)
    assert [messages.crc32_of_words(row.tobytes()) for row in words] == _bit_by_bit(words).tolist()


def test_r2_the_checksum_is_over_the_padded_struct():
    chance = np.random.default_rng(18)
    record = messages.new_command()
    struct_ = np.zeros(1, _CMD_STRUCT)
    record["mode_machine"], struct_["machine"] = 5, 5
    numbers = chance.normal(size=(35, 5)).astype(np.float32)
    modes = chance.integers(0, 2, 35).astype(np.uint8)
    for name, column in zip(("q", "dq", "tau", "kp", "kd"), numbers.T, strict=True):
        record["motors"][name][0] = column
    struct_["motors"]["rest"][0, :, :5] = numbers.view("<u4")
    messages.set_modes(record, modes)
    struct_["motors"]["mode"][0] = modes
    assert (messages.modes(record, 35) == modes).all()
    expected = int(_bit_by_bit(np.frombuffer(struct_.tobytes()[:-4], "<u4")[None])[0])
    assert messages.checksum(messages.signed(record)) == expected


def _random_object(kind: Any, chance: random.Random):
    """An object of a type, all of whose numbers are random."""
    if kind is types.LowCmd:
        motors = [types.MotorCmd(chance.randint(0, 1), *chance.choices(range(-9, 9), k=5), 7) for _ in range(35)]
        return types.LowCmd(0, 5, motors, [1, 2, 3, 4], chance.getrandbits(32))
    motors = [
        types.MotorState(chance.randint(0, 1), *(chance.randint(-9, 9) for _ in range(4)), [30, 31], 48.5, [1, 2], 512,
                         [1, 2, 3, 4])
        for _ in range(35)
    ]  # fmt: skip
    imu = types.IMUState([1.0, 0.5, 0.25, 0.125], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0], -3)
    return types.LowState([1, 2], 0, 5, 12345, imu, motors, list(range(40)), [1, 2, 3, 4], chance.getrandbits(32))


def test_a_record_is_the_message_that_cyclone_would_write():
    chance = random.Random(19)
    state, command = _random_object(types.LowState, chance), _random_object(types.LowCmd, chance)
    record = messages.states([state.serialize()])[0]
    assert (record["tick"], record["mode_machine"], record["crc"]) == (12345, 5, state.crc)
    assert record["quat_wxyz"].tolist() == state.imu_state.quaternion
    assert record["accelerometer"].tolist() == state.imu_state.accelerometer
    assert bytes(record["remote"]) == bytes(range(40))
    motors = record["motors"]
    for name, field in (("q", "q"), ("dq", "dq"), ("ddq", "ddq"), ("tau", "tau_est"), ("voltage", "vol"),
                        ("error", "motorstate")):  # fmt: skip
        assert motors[name].tolist() == [getattr(motor, field) for motor in state.motor_state]
    assert motors["temperature"].tolist() == [motor.temperature for motor in state.motor_state]
    assert messages.modes(messages.states([state.serialize()]), 35).tolist() == [m.mode for m in state.motor_state]
    sent = messages.command(command.serialize())
    assert sent["motors"]["kd"][0].tolist() == [motor.kd for motor in command.motor_cmd]
    assert messages.modes(sent, 35).tolist() == [motor.mode for motor in command.motor_cmd]


def test_a_row_has_what_the_message_says_under_its_name():
    state = _random_object(types.LowState, random.Random(20))
    (row,) = rows.of(messages.states([state.serialize()])).tolist()
    names = [name.replace(JOINT, joint) for name in names_of(rows.SAMPLES)
             for joint in (G1_29 if JOINT in name else ("",))]  # fmt: skip
    told = dict(zip(names, row, strict=True))
    for joint, motor in zip(G1_29, state.motor_state, strict=False):
        assert (told[f"{joint}_pos"], told[f"{joint}_torque"]) == (motor.q, motor.tau_est)
        assert (told[f"{joint}_vel"], told[f"{joint}_acc"]) == (motor.dq, motor.ddq)
        assert [told[f"{joint}_casing"], told[f"{joint}_winding"]] == motor.temperature
        assert (told[f"{joint}_voltage"], told[f"{joint}_error"]) == (motor.vol, motor.motorstate)
    imu = state.imu_state
    assert row[rows.INERTIAL] == [*imu.quaternion, *imu.gyroscope, *imu.accelerometer]
    assert (told["tick"], told["mode_machine"], told["imu_temperature"]) == (12345, 5, imu.temperature)
    assert told["remote_buttons"] == 2 + 3 * 256


def test_what_a_battery_says_is_what_cyclone_would_write():
    state = types.BmsState(
        1, 2, 3, list(range(40)), [54321, 2, 3], -1500, 88, 99, list(range(-2, 10)), 5, 6, [7] * 5, [8] * 3
    )
    assert messages.battery(state.serialize()) == (88, 99, 54.321, -1.5, 9)
    assert messages.battery(state.serialize()[:-1]) is messages.battery(b"\0\0" + state.serialize()[2:]) is None


def test_the_switchers_requests_and_answers_are_what_cyclone_would_write():
    identity = types.RequestIdentity(1 << 40, 1001)
    header = types.RequestHeader(identity, types.RequestLease(0), types.RequestPolicy(0, False))
    assert words.request(1 << 40, 1001) == types.Request(header, "{}", []).serialize()
    for text in ('{"name": "ai"}', "", "\u00fc"):
        answer = types.Response(types.ResponseHeader(identity, types.ResponseStatus(-3)), text, [1, 2]).serialize()
        assert words.answer_of(answer) == (1 << 40, -3, text)
        assert words.answer_of(b"\0\0" + answer[2:]) is None, "another byte order"
        assert words.answer_of(answer[:30] if text else answer[:27]) is None


@pytest.mark.parametrize("damage", [lambda m: m[:-1], lambda m: m + b"\0", lambda m: b"\0\0" + m[2:], lambda m: b""])
def test_what_is_no_message_is_none(damage):
    assert messages.command(damage(messages.signed(messages.new_command()))) is None
    assert len(messages.states([damage(messages.signed(messages.new_state()))])) == 0


def test_one_bit_that_is_wrong_is_seen():
    # Bytes by which CDR pads alone: the struct, over which the checksum is, has none of them.
    of_cdr = {messages.CMD.itemsize: {7}, messages.STATE.itemsize: {14, 15, 75}}
    for good in (messages.signed(messages.new_command()), messages.signed(messages.new_state())):
        assert messages.is_intact(good)
        for byte in range(4, len(good)):
            damaged = bytearray(good)
            damaged[byte] ^= 1 << (byte % 8)
            assert messages.is_intact(bytes(damaged)) == (byte in of_cdr[len(good)]), byte


@pytest.mark.parametrize(("options", "words"), [
    ({"interface": "eth0\"/><x"}, "expected the name of a network interface"),
    ({"domain": 231}, "expected 0 to 230"),
])  # fmt: skip
def test_a_wrong_setting_is_named(options, words):
    with pytest.raises(ValueError, match=words):
        NetworkOptions(**options)


def test_an_interface_that_is_not_there_is_named(processes):
    with pytest.raises(ConfigError, match=r"interface 'nosuch0': DDS cannot use it .* `ip -br address`"):
        Network(NetworkOptions(interface="nosuch0", domain=229))


def test_r3_another_programs_robot_hears_our_commands_and_lives(processes):
    said, came, damaged = far.command_its_robot(3.0)
    assert damaged == 0
    assert came > 1000, "of 1,500 states; the first tenths of a second are for finding each other"
    assert said["commands"] > 80
    assert (said["kp0"], said["q0"] > 80) == (40.0, True)


def test_r3_another_program_hears_our_states_and_lives(processes):
    said, came, damaged = far.be_its_robot(3.0)
    assert damaged == 0
    assert came > 1000, "it repeats its command at 500 Hz"
    assert said["states"] > 80
    assert said["mode_machine"] == 5
    assert said["q0"] > 1.0


def test_who_writes_a_topic_is_known_by_host_and_process(processes):
    with domain() as number, Network(NetworkOptions(domain=number)) as network:
        assert network.writers_of("rt/lowcmd") == []
        own = network.writer("rt/lowcmd", raw(types.LowCmd))
        own.write(messages.signed(messages.new_command()))
        script = (
            "from adapters.robots.g1.dds import network, options, types; "
            f"n = network.Network(options.NetworkOptions(domain={number})); "
            "w = n.writer('rt/lowcmd', network.raw(types.LowCmd)); input(); n.close()"
        )
        with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE) as child:
            try:
                wait_until(lambda: network.writers_of("rt/lowcmd"))
                (other,) = network.writers_of("rt/lowcmd")
                assert (other.pid, other.host) == (str(child.pid), socket.gethostname())
                assert f"(pid {child.pid}) on {socket.gethostname()}" in str(other)
            finally:
                child.communicate(b"\n")  # it ends as it should: one that was killed is missed after ten seconds
        wait_until(lambda: not network.writers_of("rt/lowcmd"))
