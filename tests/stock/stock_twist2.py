"""What stock TWIST2 scripts do on Redis, in our own words and with nothing of this station.

Only redis-py, plain ``SET`` and ``GET``, JSON text: keys and lengths are spelled out here a second time, from the
scripts of amazon-far/TWIST2 (`server_motion_lib.py`, `server_low_level_g1_sim.py`, `server_data_record.py`), so that
a slip in `station.bus.keys` cannot hide. Where a stock script would die, this one does too.

    python -m tests.stock.stock_twist2 motion --port 6379 --seconds 20
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import redis

ROBOT = "unitree_g1_with_hands"
ACTIONS = {
    f"action_body_{ROBOT}": 35,
    f"action_hand_left_{ROBOT}": 7,
    f"action_hand_right_{ROBOT}": 7,
    f"action_neck_{ROBOT}": 2,
}
STATES = {
    f"state_body_{ROBOT}": 34,
    f"state_hand_left_{ROBOT}": 7,
    f"state_hand_right_{ROBOT}": 7,
    f"state_neck_{ROBOT}": 2,
}
BODY, STATE_BODY = f"action_body_{ROBOT}", f"state_body_{ROBOT}"
FIRST_STATE_BODY = 127
CONTROLLER_DATA = "controller_data"

_LEG = [-0.2, 0.0, 0.0, 0.4, -0.2, 0.0]
STANDING = (
    [0.0, 0.0, 0.8, 0.0, 0.0, 0.0] + 2 * _LEG + [0.0] * 3 + [0, 0.4, 0, 1.2, 0, 0, 0] + [0, -0.4, 0, 1.2, 0, 0, 0]
)
"""The body command that asks to stand: root velocity, height, roll and pitch, yaw rate, 29 joints."""

LOOP_S = 0.02


class MotionServer:
    """Publishes body commands at 50 Hz with four SETs each; no ramp into the first, no time stamp."""

    def __init__(self, port: int) -> None:
        self.redis = redis.Redis(host="localhost", port=port, db=0)
        self.redis.ping()

    def publish(self, body: list[float]) -> None:
        """Write one command: body, open hands, neck straight."""
        self.redis.set(BODY, json.dumps(body))
        self.redis.set(f"action_hand_left_{ROBOT}", json.dumps([0.0] * 7))
        self.redis.set(f"action_hand_right_{ROBOT}", json.dumps([0.0] * 7))
        self.redis.set(f"action_neck_{ROBOT}", json.dumps([0.0, 0.0]))

    def play(self, bodies: Iterable[list[float]], each: Callable[[list[float]], object] | None = None) -> None:
        """Play commands, sleeping what is left of each period; `each` is called after each write."""
        for body in bodies:
            began = time.time()
            self.publish(body)
            if each is not None:
                each(body)
            time.sleep(max(0.0, LOOP_S - (time.time() - began)))

    def close(self) -> None:
        """Hang up; the keys stay as they are for ever."""
        self.redis.close()


class LowLevelServer:
    """Publishes the state, reads the four commands, in a pipeline each; a robot that is where it was told to be."""

    def __init__(self, port: int) -> None:
        self.redis = redis.Redis(host="localhost", port=port, db=0)
        self.pipeline = self.redis.pipeline()
        self.joints = [float(value) for value in STANDING[6:]]

    def say_hello(self) -> None:
        """Write what stock writes before its loop: a body state of another length than all that follow."""
        self.pipeline.set(STATE_BODY, json.dumps([0.0] * FIRST_STATE_BODY))
        self.pipeline.set(f"state_hand_left_{ROBOT}", json.dumps([0.0] * 7))
        self.pipeline.set(f"state_hand_right_{ROBOT}", json.dumps([0.0] * 7))
        self.pipeline.execute()

    def tick(self) -> list[list[float]]:
        """Write the state, read body, hands and neck.

        Raises:
            TypeError: a command key is not there; a stock loop ends with it.
        """
        self.pipeline.set(STATE_BODY, json.dumps([0.0] * 5 + self.joints))
        self.pipeline.set(f"state_hand_left_{ROBOT}", json.dumps([0.0] * 7))
        self.pipeline.set(f"state_hand_right_{ROBOT}", json.dumps([0.0] * 7))
        self.pipeline.set(f"state_neck_{ROBOT}", json.dumps([0.0] * 2))
        self.pipeline.set("t_state", int(time.time() * 1000))
        self.pipeline.execute()
        for key in ACTIONS:
            self.pipeline.get(key)
        commands = [json.loads(value) for value in self.pipeline.execute()]
        self.joints = commands[0][6:]
        return commands

    def close(self) -> None:
        """Hang up."""
        self.redis.close()


class Recorder:
    """Reads ten keys in a pipeline, thirty times a second; its buttons are in ``controller_data``.

    Args:
        port: Of the bus.
        patience_s: Longest wait for an answer [s]; stock ends after that.
    """

    def __init__(self, port: int, patience_s: float = 0.1) -> None:
        self.redis = redis.Redis(
            host="localhost", port=port, db=0, socket_timeout=patience_s, socket_connect_timeout=patience_s
        )
        self.pipeline = self.redis.pipeline()

    def is_button_pressed(self) -> bool:
        """Return whether the operator holds the button that starts and stops an episode.

        Raises:
            TypeError: nobody has ever written ``controller_data``; a stock recorder ends with it.
        """
        pressed: bool = json.loads(self.redis.get(CONTROLLER_DATA))["LeftController"]["key_two"]
        return pressed

    def item(self) -> dict[str, Any]:
        """Return one row of ``data.json``; what is not there, or not JSON, is None."""
        names = [*STATES, "t_state", *ACTIONS, "t_action"]
        for name in names:
            self.pipeline.get(name)
        return {name: _loads(value) for name, value in zip(names, self.pipeline.execute(), strict=True)}

    def close(self) -> None:
        """Hang up."""
        self.redis.close()


def press(client: redis.Redis, *, button: bool) -> None:
    """Write ``controller_data`` as a headset that lies on the table does; `button` is left Y."""
    hand = {"index_trig": 0.0, "grip": 0.0, "key_one": False, "key_two": False, "axis": [0.0, 0.0], "axis_click": False}
    both = {"LeftController": {**hand, "key_two": button}, "RightController": hand, "timestamp": time.time_ns()}
    client.set(CONTROLLER_DATA, json.dumps(both))


def waving(seconds: float) -> Iterator[list[float]]:
    """Commands of a robot that stands and waves both arms."""
    for step in range(int(seconds / LOOP_S)):
        swing = math.sin(2 * math.pi * 0.5 * step * LOOP_S)
        body = [float(value) for value in STANDING]
        body[6 + 18] += 0.4 * swing  # left elbow
        body[6 + 22] -= 0.4 * swing  # right shoulder pitch
        yield body


def _loads(value: bytes | None) -> Any:
    try:
        return None if value is None else json.loads(value)
    except json.JSONDecodeError:
        return None


def _run(role: str, port: int, seconds: float) -> str:
    if role == "motion":
        server = MotionServer(port)
        server.play(waving(seconds))
        return f"published for {seconds:g} s"
    if role == "robot":
        robot, ticks = LowLevelServer(port), int(seconds / LOOP_S)
        robot.say_hello()
        for _ in range(ticks):
            commands = robot.tick()
            time.sleep(LOOP_S)
        return f"{ticks} ticks; last commands of lengths {[len(command) for command in commands]}"
    recorder = Recorder(port)
    rows: list[dict[str, Any]] = []
    while not recorder.is_button_pressed() and len(rows) < seconds * 30:
        rows.append(recorder.item())
        time.sleep(1 / 30)
    empty = sorted({name for row in rows for name, value in row.items() if value is None})
    return f"{len(rows)} rows; never or not always there: {', '.join(empty) or 'nothing'}"


def main() -> None:
    """Run one of the three against a server on this machine."""
    parser = argparse.ArgumentParser(description="A stand-in for a stock TWIST2 script.")
    parser.add_argument("role", choices=["motion", "robot", "recorder"])
    parser.add_argument("--port", type=int, default=6379)
    parser.add_argument("--seconds", type=float, default=20.0, help="How long.  [default: 20]")
    options = parser.parse_args()
    sys.stdout.write(_run(options.role, options.port, options.seconds) + "\n")


if __name__ == "__main__":
    main()
