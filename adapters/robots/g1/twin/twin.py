"""A G1 on its DDS network that is no robot: body, firmware, and what passes between them and the cable."""

from __future__ import annotations

import random
import struct
from collections import Counter, deque
from pathlib import Path
from typing import Any

import numpy as np

from adapters.robots.g1.dds import messages, topics, types
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import ABSENT, NetworkOptions
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.twin import hands
from adapters.robots.g1.twin.body import JOINTS, STEP_S, TwinBody
from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.firmware import Firmware
from adapters.robots.g1.twin.neck import TwinNeck
from adapters.robots.g1.twin.options import G1TwinOptions
from station import assets

STEPS_PER_STATE = 2
"""Physics steps between two states: 500 of them in a second."""

_LOW_RATE = 25  # states for each of the slow topics: 20 Hz
_RECENT = 4096
_JUNK = 200  # of motors that are not there: what a robot sends for them nobody knows, so nothing may lean on it


class G1Twin:
    """Implements `station.robot_twin.Twin`.

    Args:
        options: Its settings.
        faults: What is wrong with it at the start.
    """

    period_s = STEP_S * STEPS_PER_STATE

    def __init__(self, options: G1TwinOptions, faults: G1Faults) -> None:
        self._absent = list(ABSENT.get(options.mode_machine, ()))
        self.body = TwinBody(assets.resolve(options.model), absent=self._absent, seed=options.seed)
        self.firmware = Firmware(options.mode_machine)
        if options.is_released:
            self.firmware.controller = ""
        self._chance = random.Random(options.seed)
        self._network = Network(NetworkOptions(interface=options.interface, domain=options.domain))
        network = self._network
        self._states = network.writer(topics.LOW_STATE, raw(types.LowState))
        self._slow_states = network.writer(topics.LOW_STATE_SLOW, raw(types.LowState))
        self._torso_imu = network.writer(topics.TORSO_IMU, types.IMUState)
        self._battery = network.writer(topics.BATTERY, types.BmsState)
        self._commands = network.reader(topics.LOW_CMD, types.LowCmd, depth=64)
        self._requests = network.reader(topics.SWITCHER_REQUEST, types.Request, depth=16)
        self._answers = network.writer(topics.SWITCHER_RESPONSE, types.Response)
        self.hands = hands.hands(network, options.hands, options.hand_motors)
        self.neck = TwinNeck(Path(options.neck)) if options.neck else None
        self._record = messages.new_state()
        self._record["mode_machine"] = options.mode_machine
        self._record["version"] = (1, 0)
        modes = np.zeros(messages.SLOTS, np.uint8)
        modes[:JOINTS] = 1
        modes[self._absent] = 0
        messages.set_modes(self._record, modes)
        self._ticks = self._tick_ms = 0
        self._on_the_way: deque[tuple[float, bytes]] = deque(maxlen=_RECENT)
        self._waiting: deque[bytes] = deque(maxlen=_RECENT)  # commands of a line that is frozen
        self._sent: Counter[str] = Counter()
        self._faults = faults
        self.change(faults)

    @property
    def now_s(self) -> float:
        """Simulated time since its start [s]."""
        return self._ticks * self.period_s

    def change(self, faults: G1Faults) -> None:
        """Have other faults from now on."""
        self._faults = faults
        self.body.change(faults)
        self.firmware.change(faults)

    def tick(self) -> None:
        """Advance by `period_s`: hear what came, move, and say what is measured."""
        self._hear()
        for own in (True, False):
            self.body.held = self.firmware.held(self.now_s, is_own_turn=own)
            self.body.step(STEPS_PER_STATE // 2)
        self._ticks += 1
        if not self._faults.tick_frozen:
            self._tick_ms = round(self.now_s * 1000.0)
        self._say()
        for hand in self.hands.values():
            hand.tick(
                self.now_s, self.period_s, self._faults,
                is_heard=self._faults.link == "up",
                says=self._faults.link == "up" and self._ticks % hands.TICKS_PER_STATE == 0,
            )  # fmt: skip
        if self._ticks % _LOW_RATE == 0:
            self._answer()
            self._say_slowly()

    def health(self) -> dict[str, Any]:
        """Return what the heartbeat tells of it."""
        firmware, held = self.firmware, self.body.held
        return {
            "is_stiff": bool(held.kp.any()), "is_damped": bool(held.kd.any() and not held.kp.any()),
            "accepted": firmware.accepted, "refused": dict(firmware.refused), "states": dict(self._sent),
            "controller": firmware.controller, "damped_by_remote": firmware.is_damped, "falls": self.body.falls,
            "pelvis_m": round(self.body.height_m, 4), "tilt_rad": round(self.body.tilt_rad, 4),
            **{name: hand.health() for name, hand in self.hands.items()},
            **({"neck": self.neck.health()} if self.neck is not None else {}),
        }  # fmt: skip

    def close(self) -> None:
        """Leave the network, and take the neck's port away."""
        if self.neck is not None:
            self.neck.close()
        self._network.close()

    def _hear(self) -> None:
        came = self._commands.take()
        if self._faults.link == "down" or self._faults.commands_lost:
            return
        if self._faults.link == "frozen":
            self._waiting.extend(came)
            return
        while self._waiting:
            self.firmware.on_command(self._waiting.popleft(), self.now_s)
        for message in came:
            self.firmware.on_command(message, self.now_s)

    def _say(self) -> None:
        """Send the state of this instant once it is as old as states are."""
        faults = self._faults
        self._on_the_way.append((self.now_s, self._state()))
        while (
            self._on_the_way
            and faults.link != "frozen"
            and self.now_s - self._on_the_way[0][0] >= faults.state_delay_ms / 1000.0 - 1e-9
        ):
            self._send(self._on_the_way.popleft()[1])

    def _send(self, message: bytes) -> None:
        faults = self._faults
        if faults.link == "down" or faults.state_silent:
            return
        if faults.state_drop and self._chance.random() < faults.state_drop:
            self._sent["dropped"] += 1
            return
        if faults.state_bad_crc and self._chance.random() < faults.state_bad_crc:
            self._sent["damaged"] += 1
            message = message[:-4] + struct.pack("<I", int.from_bytes(message[-4:], "little") ^ 1)
        is_twice = faults.state_twice and self._chance.random() < faults.state_twice
        for _ in range(2 if is_twice else 1):
            self._states.write(message)
        self._sent["sent"] += 2 if is_twice else 1
        if self._ticks % _LOW_RATE == 0:
            self._slow_states.write(message)

    def _state(self) -> bytes:
        measured, record = self.body.measure(), self._record
        record["tick"] = self._tick_ms
        record["quat_wxyz"], record["gyro"] = measured.quat_wxyz, measured.gyro
        record["accelerometer"], record["rpy"] = measured.accelerometer, measured.rpy
        record["imu_temperature"] = 40
        motors = record["motors"][0, :JOINTS]
        motors["q"], motors["dq"], motors["ddq"], motors["tau"] = measured.q, measured.dq, measured.ddq, measured.tau
        motors["temperature"][:, 0], motors["temperature"][:, 1] = measured.casing_c, measured.winding_c
        motors["voltage"] = self._faults.voltage
        motors["error"] = messages.TIMED_OUT if self.firmware.is_without_commands(self.now_s) else 0
        for name, bits in self._faults.motor_error.items():
            motors["error"][G1_29.index(name)] |= bits
        for name in ("q", "dq", "temperature", "error"):
            motors[name][self._absent] = _JUNK
        record["remote"] = np.frombuffer(self.firmware.remote(), np.uint8)
        return messages.signed(record)

    def _say_slowly(self) -> None:
        if self._faults.link != "up":
            return
        measured = self.body.measure()
        imu = (measured.quat_wxyz, measured.gyro, measured.accelerometer, measured.rpy)
        self._torso_imu.write_object(types.IMUState(*(each.tolist() for each in imu), 40))
        self._battery.write_object(
            types.BmsState(
                1,
                0,
                0,
                [round(self._faults.voltage * 1000 / 13)] * 13 + [0] * 27,
                [round(self._faults.voltage * 1000)] * 3,
                -2000,
                round(self._faults.soc),
                100,
                [30] * 12,
                10,
                0,
                [0] * 5,
                [0] * 3,
            )
        )

    def _answer(self) -> None:
        for request in self._requests.take_objects():
            if self._faults.link != "up":
                continue
            identity = request.header.identity
            code, data = self.firmware.request(identity.api_id, request.parameter)
            header = types.ResponseHeader(identity, types.ResponseStatus(code))
            self._answers.write_object(types.Response(header, data, []))
