"""Records a lock-step run of the real policy on the real simulation, without processes: same steps, same bytes."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from servers.g1 import G1Config
from station import registry
from station.bus import codec, keys
from station.control.command_validator import CommandSample
from station.control.control import ControlStep
from station.control.low_level import result_values
from station.control.rig import Rig, build
from station.control.robot_server import facts
from station.motion.playback import Playback
from station.protocols import Floats
from tests.episode.synthetic import EpisodeBuilder

MOTION = "builtin:walk-forward"


def record(
    builder: EpisodeBuilder,
    *,
    seconds: float,
    skip: int = 0,
    config: G1Config | None = None,
    switches: Mapping[int, str] | None = None,
    with_first_state: bool = True,
    commands: Floats | None = None,
) -> Path:
    """Run a motion for some seconds, write what the servers would write, and return the episode's folder.

    Args:
        builder: Where it goes.
        seconds: Simulated time [s].
        skip: First steps that are run but not recorded, as when the recording starts late.
        config: Of the G1 server.
        switches: Names of policies that are asked for, by the tick at which.
        commands: What is commanded in place of the motion, shape (ticks, m); its last row on and on.
        with_first_state: Whether the first state that the robot said is in the file; it waited long for a command else.
    """
    config = config or G1Config(pace="command", physics_dt_s=0.002)
    rig = build(config.rig)
    control = rig.control(gate=config.gate)
    motion = registry.find("loader", "motion")(MOTION)
    playback = Playback(motion, rig.command_format, enter_s=0.2)
    command_key = rig.command_format.key
    for tick in range(round(seconds / rig.period_s)):
        if switches and tick in switches and control.policies is not None:
            control.policies.switch(switches[tick])
        frame = playback.step(rig.period_s)
        command = frame.command if commands is None else commands[min(tick, len(commands) - 1)]
        values = _tick(control, rig, codec.json_vector(command), tick)
        source = json.dumps({"file": "walk.pkl", "frame": frame.frame_index, "phase": frame.phase}).encode()
        at_s = 0.1 + tick * rig.period_s
        if tick < skip:
            for writer, keys_of_writer in values:
                for key in keys_of_writer:
                    builder.skip(key, writer=writer)
            continue
        if tick or with_first_state:
            builder.write(values[0][1], at_s=at_s)
        sent = {command_key: values[1][1][command_key], keys.command_source(rig.command_format.robot): source}
        builder.write(sent, at_s=at_s + 0.001, writer="motion")
        builder.write(values[2][1], at_s=at_s + 0.004)
    rig.robot.close()
    return builder.finish(manifest(config, rig))


def manifest(config: G1Config, rig: Rig) -> dict[str, Any]:
    """What the G1 server states of itself."""
    return {"servers": {"g1": facts(config, "g1", rig)}}


def _tick(control: ControlStep, rig: Rig, command: bytes, tick: int) -> list[tuple[str, dict[str, bytes]]]:
    now_s = tick * rig.period_s
    state = control.sense()
    suffix = rig.command_format.robot
    before = rig.state_values(state)
    arrived_ns = time.monotonic_ns()
    sample = CommandSample(command, now_s, written_ns=arrived_ns - 1000, arrived_ns=arrived_ns, seq=tick + 1)
    done = result_values(suffix, control.step(state, sample, now_s), control.commanded)
    return [("g1", before), ("motion", {rig.command_format.key: command}), ("g1", done)]
