"""Messages of hands: what we make is what Cyclone's own codec makes, and what is no message is none."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.dds import types
from adapters.robots.g1.dds.network import raw
from adapters.robots.g1.joints import hand, select
from adapters.robots.hands import inspire, wire
from adapters.robots.hands.kinds import motors_of

IDL = Path(__file__).with_name("hands.idl")
KINDS = {
    "unitree_hg_msg_dds__HandCmd_": types.HandCmd,
    "unitree_hg_msg_dds__HandState_": types.HandState,
    "unitree_go_msg_dds__MotorCmds_": types.MotorCmds,
    "unitree_go_msg_dds__MotorStates_": types.MotorStates,
    "inspire_inspire_hand_ctrl": types.InspireCtrl,
    "inspire_inspire_hand_state": types.InspireState,
}

LEFT = wire.Dex3Wire("left", select(hand("left")), hand("left"))
DFX = wire.DfxWire(inspire.JOINTS["left"], inspire.JOINTS["right"])
DFTP = wire.DftpWire("right", inspire.JOINTS["right"])
CHANCE = np.random.default_rng(17)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory, processes: None) -> str:
    """What Cyclone 0.10's compiler makes of the types."""
    if shutil.which("idlc") is None and not os.environ.get("CI"):
        pytest.skip("needs idlc of Cyclone DDS 0.10 (apt install cyclonedds-tools)")
    folder = tmp_path_factory.mktemp("idl")
    subprocess.run(["idlc", "-l", "c", str(IDL)], cwd=folder, check=True, capture_output=True)
    return (folder / "hands.c").read_text()


@pytest.mark.parametrize("name", KINDS)
def test_a_type_has_the_hashes_that_cyclones_own_compiler_gives_it(name: str, compiled: str) -> None:
    found = re.search(rf"TYPE_INFO_CDR_{name} \(unsigned char \[\]\)\{{(.*?)\n\}}", compiled, re.DOTALL)
    assert found is not None
    announced = bytes(int(each, 16) for each in re.findall(r"0x([0-9a-f]{2})", found[1]))
    for kind in (KINDS[name], raw(KINDS[name])):
        info: Any = kind.__idl__.get_type_info()  # type: ignore[attr-defined]
        for each in (info.minimal, info.complete):
            assert bytes(each.typeid_with_size.type_id.value) in announced


def test_a_dex3_is_told_what_cyclones_codec_would_tell_it_and_always_to_stop_by_itself() -> None:
    q, kp, kd = CHANCE.uniform(-1.0, 1.0, (3, 7)).astype("f4").astype(float)
    told = types.HandCmd.deserialize(LEFT.command(q, kp, kd))
    assert [motor.mode for motor in told.motor_cmd] == [0x90 | index for index in range(7)]
    for name, values in (("q", q), ("kp", kp), ("kd", kd)):
        assert [getattr(motor, name) for motor in told.motor_cmd] == values.tolist()
    assert told.serialize() == LEFT.command(q, kp, kd)
    limp = types.HandCmd.deserialize(LEFT.limp(q))
    assert all(
        motor.kp == motor.kd == motor.tau == 0.0 and motor.mode & wire.STOPS_BY_ITSELF for motor in limp.motor_cmd
    )


@pytest.mark.parametrize("sensors", [0, 9, 12])
def test_a_dex3s_state_is_read_as_cyclones_codec_reads_it(sensors: int) -> None:
    motors = [
        types.MotorState(1, 0.1 * number, 0.2, 0.3, 0.4, [30, 40], 24.0, [0, 0], 0, [0] * 4) for number in range(7)
    ]
    cells = [types.PressSensorState([30000.0] * 11 + [float(number)], [25.0] * 12, 0, 0) for number in range(sensors)]
    imu = types.IMUState([1.0, 0.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3, [0.0] * 3, 40)
    state = types.HandState(motors, cells, imu, 24.0, 0.5, 12.0, 5.0, [0, 0], [0, 0])
    measured = LEFT.measured([state.serialize(), state.serialize()])
    assert measured is not None
    assert measured.rows.shape == (2, 7 * len(LEFT.columns))
    assert measured.q == pytest.approx([0.1 * number for number in range(7)])
    assert measured.rows[1].reshape(len(LEFT.columns), 7)[:, 3] == pytest.approx([0.3, 0.2, 0.4, 30, 40, 24.0, 0.0])
    assert measured.pressure.shape == (12 * sensors,)
    assert measured.pressure[11::12].tolist() == [float(number) for number in range(sensors)]
    assert measured.error == ""
    state.motor_state[5].motorstate = 0x200
    assert (LEFT.measured([state.serialize()]) or measured).error == "motor left_hand_index_0 reports the error 0x200"
    state.motor_state[5].motorstate, state.error = 0, [0, 7]
    assert (LEFT.measured([state.serialize()]) or measured).error == "the hand reports the error [0, 7]"


@pytest.mark.parametrize(("order", "third"), [("as-twist2", "index_0"), ("middle-index", "middle_0")])
def test_the_order_of_the_motors_is_a_setting(order: str, third: str) -> None:
    spoken = wire.Dex3Wire("right", select(hand("right")), motors_of("right", order))
    q = np.arange(7.0)
    told = types.HandCmd.deserialize(spoken.command(q, q, q))
    names = [joint.name for joint in spoken.joints]
    assert told.motor_cmd[3].q == names.index(f"right_hand_{third}")


def test_inspires_hands_are_told_a_part_of_the_way_the_right_one_first() -> None:
    lower, upper = (np.array([getattr(joint, end) for joint in DFX.joints]) for end in ("lower", "upper"))
    q = np.concatenate([lower[:6], upper[6:]])  # the left one open, the right one closed
    told = types.MotorCmds.deserialize(DFX.command(q, q, q))
    assert [motor.q for motor in told.cmds] == [0.0] * 6 + [1.0] * 6
    assert told.serialize() == DFX.command(q, q, q)
    ctrl = types.InspireCtrl.deserialize(DFTP.command((0.25 * lower + 0.75 * upper)[6:], q, q))
    assert list(ctrl.angle_set) == [250] * 6
    assert ctrl.mode == "\x01", "by angle"


def test_what_inspires_hands_measure_is_read_as_cyclones_codec_reads_it() -> None:
    go = [types.GoMotorState(1, 0.1 * n % 1.0, 0, 0, 0, 0, 0, 0, 33, n, [0, 0]) for n in range(12)]
    both = DFX.measured([types.MotorStates(go).serialize()])
    assert both is not None
    assert both.q[6] == pytest.approx(1.7), "the right hand's first motor, which is closed"
    assert both.rows.reshape(3, 12)[2].tolist() == [*range(6, 12), *range(6)], "lost messages, of the left hand first"
    state = types.InspireState([0] * 6, [500] * 6, [7] * 6, [8] * 6, [0, 0, 4, 0, 0, 0], [2] * 6, [40] * 6)
    one = DFTP.measured([state.serialize()])
    assert one is not None
    assert one.q == pytest.approx([0.85] * 4 + [0.25, 0.6])
    assert one.rows.reshape(6, 6)[1:, 0].tolist() == [7, 8, 0, 2, 40]
    assert one.error == "motor right_hand_middle reports the error 0x4"


@pytest.mark.parametrize("spoken", [LEFT, DFX, DFTP], ids=["dex3", "dfx", "dftp"])
def test_bytes_that_are_no_state_say_nothing_and_break_nothing(spoken: wire.HandWire) -> None:
    whole = _state_of(spoken)
    assert spoken.measured([whole]) is not None
    for _ in range(3000):
        damaged = bytearray(whole)
        for place in CHANCE.integers(0, len(damaged), CHANCE.integers(1, 6)):
            damaged[place] = CHANCE.integers(256)
        cut = bytes(damaged[: CHANCE.integers(0, len(damaged) + 1)])
        for message in (bytes(damaged), cut, cut * 2):
            measured = spoken.measured([message])
            assert measured is None or measured.rows.shape == (1, len(spoken.joints) * len(spoken.columns))
    assert spoken.measured([]) is None
    assert spoken.measured([b"", whole[:-1]]) is None


def _state_of(spoken: wire.HandWire) -> bytes:
    if isinstance(spoken, wire.Dex3Wire):
        record = wire.new_message(wire.dex3_state(9))
        record["count"], record["sensors"] = 7, 9
        return record.tobytes()
    assert isinstance(spoken, wire.DfxWire | wire.DftpWire)
    return spoken.state(np.array([joint.lower for joint in spoken.joints]), [0] * len(spoken.joints))
