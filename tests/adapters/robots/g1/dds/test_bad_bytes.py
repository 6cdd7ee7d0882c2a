"""Bytes that are no message, or lie: a hundred thousand each way, and none moves a motor or ends a process."""

from __future__ import annotations

import random

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.dds import messages, rows
from adapters.robots.g1.dds.health_monitor import HealthMonitor
from adapters.robots.g1.dds.remote import Remote
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.firmware import Firmware

CASES = 100_000
AT_ONCE = 10


def _command() -> bytes:
    record = messages.new_command()
    record["mode_machine"] = 5
    messages.set_modes(record, np.ones(29, np.uint8))
    record["motors"]["kp"][0, :29] = 40.0
    return messages.signed(record)


def _state() -> bytes:
    record = messages.new_state()
    record["mode_machine"], record["quat_wxyz"] = 5, (1.0, 0.0, 0.0, 0.0)
    return messages.signed(record)


def _mutant(good: bytes, chance: random.Random) -> bytes:
    """A message that is damaged, cut, longer, or nothing but chance."""
    kind = chance.randrange(4)
    if kind == 0:
        return chance.randbytes(chance.randrange(0, 2 * len(good)))
    if kind == 1:
        return good[: chance.randrange(len(good))]
    if kind == 2:
        return good + chance.randbytes(chance.randrange(1, 64))
    data = bytearray(good)
    for _ in range(chance.randrange(1, 9)):
        data[chance.randrange(4, len(data))] ^= 1 << chance.randrange(8)
    return bytes(data)


def test_no_damaged_command_reaches_a_motor():
    chance, firmware, good = random.Random(5), Firmware(5), _command()
    firmware.controller = ""
    firmware.change(G1Faults())
    is_padding = messages.checksum(good)
    for _ in range(CASES):
        mutant = _mutant(good, chance)
        firmware.on_command(mutant, 0.0)
        if firmware.accepted:  # what differs in padding alone is the same command
            assert messages.checksum(mutant) == is_padding
            firmware.accepted = 0
    held = firmware.held(0.0, is_own_turn=False)
    assert set(np.unique(held.kp)) <= {0.0, 40.0}
    assert not held.q.any()
    assert firmware.refused.total() > 0.99 * CASES


def test_numbers_of_chance_with_a_right_checksum_reach_a_motor_only_where_they_are_numbers():
    chance, firmware = np.random.default_rng(6), Firmware(5)
    firmware.controller = ""
    good = messages.command(_command())
    assert good is not None
    record = good.copy()
    for _ in range(CASES // 10):
        words = chance.integers(0, 2**32, (29, 5), dtype=np.uint64).astype(np.uint32).view("<f4")
        for name, column in zip(("q", "dq", "tau", "kp", "kd"), words.T, strict=True):
            record["motors"][name][0, :29] = column
        firmware.on_command(messages.signed(record), 0.0)
        held = firmware.held(0.0, is_own_turn=False)
        assert all(np.isfinite(values).all() for values in (held.q, held.dq, held.tau, held.kp, held.kd))


def test_no_state_of_chance_ends_what_reads_it():
    chance, good = random.Random(7), _state()
    monitor, remote, count = HealthMonitor("lo"), Remote(), 0
    for number in range(CASES // AT_ONCE):
        came = [_mutant(good, chance) for _ in range(AT_ONCE)]
        if number % 3 == 0:  # a lie with a right checksum
            body = good[:4] + chance.randbytes(len(good) - 8) + b"0000"
            came.append(body[:-4] + messages.checksum(body).to_bytes(4, "little"))
        records = messages.intact_states(came)
        with np.errstate(all="ignore"):
            monitor.on_states(records, len(came) - len(records), number * 0.02)
            if len(records):
                count += len(records)
                rows.of(records)
                remote.update(np.ascontiguousarray(records["remote"]))
                said = (
                    monitor.why_not_drive(number * 0.02),
                    monitor.why_stand(is_commanded=True),
                    monitor.why_not_arm(number * 0.02),
                )
                assert all(isinstance(each, str) for each in said)
    assert count > CASES // AT_ONCE // 4
    assert monitor.damaged > 0.9 * CASES
