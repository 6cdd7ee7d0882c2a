"""The stock pattern, written anew from what is known of it: what every figure of ours stands beside.

redis-py over TCP loopback; vectors as JSON text by Python's own encoder; the command read by a pipeline in every
cycle whether or not it is new; a sleep of what is left of the period; a recorder that polls 30 times a second; and,
in simulation, PD control in numpy before each physics step.
"""

from __future__ import annotations

import itertools
import json
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import redis
from numpy.typing import NDArray

from adapters.robots.g1 import twist_keys

COMMAND_KEYS = (
    twist_keys.action_body(),
    twist_keys.action_hand("left"),
    twist_keys.action_hand("right"),
    twist_keys.action_neck(),
)
COMMAND_SIZES = (35, 7, 7, 2)
STATE_KEY = twist_keys.state_body(twist_keys.TWIST2_ROBOT)
POLICY_HZ, RECORDER_HZ = 50.0, 30.0

Floats = NDArray[np.float64]


class Client:
    """A stock script's end of the bus."""

    def __init__(self, port: int) -> None:
        self._redis = redis.Redis(host="localhost", port=port, db=0)
        self._pipeline = self._redis.pipeline()

    def send_command(self, vectors: Sequence[Floats], time_ns: int) -> None:
        """Write body, hands, neck and the time in one pipeline, as the stock teleoperation does."""
        for key, vector in zip(COMMAND_KEYS, vectors, strict=True):
            self._pipeline.set(key, json.dumps(vector.tolist()))
        self._pipeline.set(twist_keys.T_ACTION, time_ns)
        self._pipeline.execute()

    def send_state(self, state: Floats, time_ns: int) -> None:
        """Write the state of the body and the time in one pipeline, as the stock low-level loop does."""
        self._pipeline.set(STATE_KEY, json.dumps(state.tolist()))
        self._pipeline.set(twist_keys.T_STATE, time_ns)
        self._pipeline.execute()

    def read_command(self) -> list[Floats]:
        """Read body, hands and neck in one pipeline, as the stock low-level loop does."""
        for key in COMMAND_KEYS:
            self._pipeline.get(key)
        return [np.array(json.loads(value)) for value in self._pipeline.execute()]

    def read_command_and_time(self) -> tuple[list[Floats], int]:
        """Read them and the time of the command."""
        for key in (*COMMAND_KEYS, twist_keys.T_ACTION):
            self._pipeline.get(key)
        *values, time_ns = self._pipeline.execute()
        return [np.array(json.loads(value)) for value in values], int(time_ns)

    def read(self, names: Sequence[str]) -> list[bytes | None]:
        """Read keys in one pipeline, as the stock recorder does."""
        for name in names:
            self._pipeline.get(name)
        found: list[bytes | None] = self._pipeline.execute()
        return found

    def close(self) -> None:
        """Hang up."""
        self._redis.close()


def loop(hz: float, ticks: int, tick: Callable[[], None]) -> None:
    """Tick that often, sleeping what is left of each period."""
    period_s = 1.0 / hz
    for _ in range(ticks):
        began_s = time.time()
        tick()
        left_s = period_s - (time.time() - began_s)
        if left_s > 0:
            time.sleep(left_s)


def record(stop: Callable[[], bool], port: int, names: Sequence[str]) -> int:
    """Look at keys 30 times a second until told to stop; return how many distinct values were seen of them."""
    client = Client(port)
    seen: dict[str, set[bytes]] = {name: set() for name in names}
    while not stop():
        loop(RECORDER_HZ, 1, lambda: _poll(client, names, seen))
    client.close()
    return sum(map(len, seen.values()))


def command(stop: Callable[[], bool], port: int, commands: Sequence[Floats]) -> None:
    """Write commands of the body, shape (35,), 50 times a second, from the first again after the last, until told to
    stop."""
    client, others = Client(port), [np.zeros(size) for size in COMMAND_SIZES[1:]]
    following = itertools.cycle(commands)
    while not stop():
        loop(POLICY_HZ, 1, lambda: client.send_command([next(following), *others], time.time_ns()))
    client.close()


def simulate(stop: Callable[[], bool], port: int, constants: Sequence[Any]) -> None:
    """Follow the commands on the bus with a `Simulation` made of `constants`, 50 times a second, until told to stop."""
    client, simulation = Client(port), Simulation(*constants)
    while not stop() and None in client.read(COMMAND_KEYS):
        time.sleep(0.01)

    def tick() -> None:
        simulation.run(client.read_command()[:1])
        client.send_state(simulation.state(), time.time_ns())

    while not stop():
        loop(POLICY_HZ, 1, tick)
    client.close()


def _poll(client: Client, names: Sequence[str], seen: dict[str, set[bytes]]) -> None:
    for name, value in zip(names, client.read(names), strict=True):
        if value is not None:
            seen[name].add(value)


class Simulation:
    """A free-running stock simulation loop: one physics step, one PD in numpy; every 20th the network.

    Left out, to its advantage: the sleep before each physics step, the viewer, and the bus.

    Args:
        model: MJCF file of the G1 with 29 torque motors.
        checkpoint: ONNX file of TWIST2.
        default_q, kp, kd, torque_limit: Constants of the policy, shape (29,).
    """

    PHYSICS_DT_S, DECIMATION, PAST = 0.001, 20, 10

    def __init__(
        self, model: Path, checkpoint: Path, default_q: Floats, kp: Floats, kd: Floats, torque_limit: Floats
    ) -> None:
        import mujoco
        import onnxruntime

        self._step: Callable[[Any, Any], None] = mujoco.mj_step
        self._model = mujoco.MjModel.from_xml_path(str(model))
        self._model.opt.timestep = self.PHYSICS_DT_S
        self._data = mujoco.MjData(self._model)
        self._data.qpos[2], self._data.qpos[7:] = 0.793, default_q
        self._session = onnxruntime.InferenceSession(str(checkpoint), providers=["CPUExecutionProvider"])
        self._input = self._session.get_inputs()[0].name
        self._default_q, self._kp, self._kd, self._limit = default_q, kp, kd, torque_limit
        self._past: deque[NDArray[np.float32]] = deque([np.zeros(127, np.float32)] * self.PAST, maxlen=self.PAST)
        self._action = np.zeros(29, np.float32)

    def run(self, commands: Sequence[Floats]) -> float:
        """Follow one command per policy period; return simulated time over wall time."""
        began_s = time.perf_counter()
        for command in commands:
            target = self._policy(command)
            for _ in range(self.DECIMATION):
                torque = (target - self._data.qpos[7:]) * self._kp - self._data.qvel[6:] * self._kd
                self._data.ctrl[:] = np.clip(torque, -self._limit, self._limit)
                self._step(self._model, self._data)
        simulated_s = len(commands) * self.DECIMATION * self.PHYSICS_DT_S
        return simulated_s / (time.perf_counter() - began_s)

    def state(self) -> Floats:
        """Return gyro, roll and pitch, and joints, as stock publishes them, shape (34,)."""
        qpos = self._data.qpos
        return np.concatenate([self._data.qvel[3:6], _roll_pitch(qpos[3:7]), qpos[7:]])

    def _policy(self, command: Floats) -> Floats:
        qpos, qvel = self._data.qpos, self._data.qvel
        velocity = qvel[6:] * 0.05
        velocity[[4, 5, 10, 11]] = 0.0
        own = [qvel[3:6] * 0.25, _roll_pitch(qpos[3:7]), qpos[7:] - self._default_q, velocity, self._action]
        frame = np.concatenate([command, *own]).astype(np.float32)
        row = np.concatenate([frame, np.array(self._past).flatten(), command]).astype(np.float32)
        self._past.append(frame)
        self._action = self._session.run(None, {self._input: row[None, :]})[0].flatten()
        target: Floats = np.clip(self._action, -10.0, 10.0) * 0.5 + self._default_q
        return target


def _roll_pitch(quat_wxyz: Floats) -> Floats:
    w, x, y, z = quat_wxyz
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return np.array([roll, np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))])
