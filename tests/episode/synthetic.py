"""Builds episodes of the layout on disk without a bus, a robot or a recorder: every byte and stamp is chosen here."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.writer import CompressionType, Writer

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.bus import codec, contracts, keys
from station.bus.stamp import Stamp, boot_id
from station.contract import Contract
from station.protocols import Floats

WALL_START_NS = 1_795_000_000_000_000_000
MONO_START_NS = 5_000_000_000_000
STANDING = np.array([-0.2, 0, 0, 0.4, -0.2, 0] * 2 + [0, 0, 0] + [0, 0.4, 0, 1.2, 0, 0, 0] + [0, -0.4, 0, 1.2, 0, 0, 0])
ROBOT = twist_keys.TWIST2_ROBOT


class EpisodeBuilder:
    """Writes one episode, message by message; times are seconds since its start."""

    def __init__(self, data: Path, *, task: str = "walk", number: int = 1) -> None:
        self.episode_id = f"2026-11-21-g1-{task}-{number:04d}"
        self.folder = data / task / self.episode_id
        self.folder.mkdir(parents=True)
        self._task = task
        self._stream = (self.folder / "signals.mcap").open("wb")
        self._writer = Writer(self._stream, chunk_size=1 << 18, compression=CompressionType.ZSTD)
        self._writer.start(profile="teleop-station", library="synthetic")
        self._writer.add_metadata(
            "station.anchor",
            {"wall_ns": str(WALL_START_NS), "mono_ns": str(MONO_START_NS), "boot": boot_id()},
        )
        self._writer.add_metadata("station.episode", {"episode_id": self.episode_id, "task": task})
        self._channels: dict[tuple[str, str, str], int] = {}
        self._sequences: dict[tuple[str, str], int] = {}
        self._stamps: list[bytes] = []
        self._places: dict[str, tuple[float, Floats]] = {}  # when and where joints were last, by key
        self.contracts: dict[str, Contract] = {}  # in the place of today's, by key

    def write(self, values: Mapping[str, bytes], *, at_s: float, writer: str = "g1", lag_s: float = 0.0002) -> None:
        """One stamped `MSET`, written at a time and seen by the tap a little later."""
        source = f"{writer}.100.{boot_id()}.beef"
        written = MONO_START_NS + round(at_s * 1e9)
        for key, value in values.items():
            seq = self.skip(key, writer=writer)
            channel = self._channel(key, source, writer, value)
            mark = Stamp(seq, written, WALL_START_NS + round(at_s * 1e9), source)
            self._stamps.append(b"%d %s" % (channel, mark.encode()))
            self._add(channel, value, at_s + lag_s, at_s, seq)

    def rates(self, key: str, q: Floats, *, at_s: float) -> Floats:
        """Return the velocities that a robot measures which is at `q`: since it was where it was last."""
        before_s, before = self._places.get(key, (at_s, q))
        self._places[key] = at_s, np.array(q)
        with np.errstate(all="ignore"):  # some are made that no robot has
            return (q - before) / (at_s - before_s) if at_s > before_s else np.zeros(len(q))

    def repeat(self, key: str, value: bytes, *, at_s: float, seq: int, writer: str = "g1") -> None:
        """A message whose sequence number is chosen: a duplicate, or one out of order."""
        channel = self._channel(key, f"{writer}.100.{boot_id()}.beef", writer, value)
        self._add(channel, value, at_s, at_s, seq)

    def skip(self, key: str, *, writer: str = "g1") -> int:
        """Spend a sequence number; without a message that is a lost write."""
        self._sequences[key, writer] = self._sequences.get((key, writer), 0) + 1
        return self._sequences[key, writer]

    def written(self, key: str, *, writer: str) -> int:
        """Return the number of the newest write."""
        return self._sequences.get((key, writer), 0)

    def foreign(self, key: str, value: bytes, *, at_s: float) -> None:
        """A plain `SET` by a stock script."""
        self._add(self._channel(key, "", "foreign", value), value, at_s, at_s, self.skip(key, writer="foreign"))

    def delete(self, key: str, *, at_s: float) -> None:
        """A key that somebody deleted."""
        channel = self._channels.get((key, "", "deleted"))
        if channel is None:
            metadata = {"source": "", "writer": "foreign", "contract": "none"}
            channel = int(self._writer.register_channel(key, "application/x-deleted", 0, metadata))
            self._channels[key, "", "deleted"] = channel
        self._add(channel, b"", at_s, at_s, self.skip(key, writer="deleted"))

    def event(self, name: str, *, at_s: float, severity: str = "info", source: str = "g1", **numbers: Any) -> None:
        """One event on the bus."""
        wall = WALL_START_NS + round(at_s * 1e9)
        value = {"name": name, "severity": severity, "source": source, "wall_ns": wall, "detail": numbers}
        self.write({keys.EVENT: json.dumps(value).encode()}, at_s=at_s, writer=source)

    def finish(self, manifest: Mapping[str, Any] | None = None, *, torn: bool = False) -> Path:
        """Close the episode and return its folder; torn leaves the file as a killed recorder does."""
        self._flush()
        if not torn:
            self._writer.add_metadata("station.summary", {"messages": str(sum(self._sequences.values()))})
            self._writer.finish()
        self._stream.close()
        if torn:
            signals = self.folder / "signals.mcap"
            signals.rename(self.folder / "signals.mcap.active")
        (self.folder / "manifest.yaml").write_text(yaml.safe_dump(self._manifest(manifest or {})))
        return self.folder

    def _manifest(self, extra: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "episode_id": self.episode_id,
            "state": "finished",
            "task": {"name": self._task, "instruction": "walk"},
            "recorder": {"backend": "replication", "is_lossless": True},
            **extra,
        }

    def _channel(self, key: str, source: str, writer: str, value: bytes) -> int:
        found = self._channels.get((key, source, writer))
        if found is not None:
            return found
        contract = self.contracts.get(key) or contracts.contract(key)
        channel = self._writer.register_channel(
            topic=key,
            message_encoding="json" if _is_json(value) else "application/octet-stream",
            schema_id=0,
            metadata={
                "source": source,
                "writer": writer,
                "contract": "none" if contract is None else codec.json_object(contract).decode(),
            },
        )
        self._channels[key, source, writer] = channel
        return int(channel)

    def _add(self, channel: int, value: bytes, logged_s: float, written_s: float, seq: int) -> None:
        self._writer.add_message(
            channel_id=channel,
            log_time=WALL_START_NS + round(logged_s * 1e9),
            publish_time=WALL_START_NS + round(written_s * 1e9),
            data=value,
            sequence=seq,
        )
        if len(self._stamps) >= 500:
            self._flush()

    def _flush(self) -> None:
        if not self._stamps:
            return
        channel = self._writer.register_channel("station:recorder:stamps", "text", 0, {"writer": "recorder"})
        self._writer.add_message(channel, WALL_START_NS, b"\n".join(self._stamps), WALL_START_NS)
        self._stamps.clear()
        self._writer.flush()


def command(q: Floats = STANDING, *, height: float = 0.79) -> Floats:
    """A TWIST2 command that asks for joints at a root height."""
    return np.concatenate([[0.0, 0.0, height, 0.0, 0.0, 0.0], q])


def tick(
    builder: EpisodeBuilder,
    number: int,
    *,
    at_s: float,
    q: Floats = STANDING,
    asked: Floats | None = None,
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    height: float = 0.79,
    gate: str = "tracking",
    phase: str = "playing",
    age_s: float = 0.004,
    slow_s: float = 0.0,
    is_commanded: bool = True,
    commander: str = "motion",
    command_seq: int | None = None,
) -> None:
    """One step of the motion server and the G1 server: command, state, then what the policy did.

    Args:
        builder: Where it goes.
        number: Number of the tick.
        at_s: When the state is read [s].
        q, quat, height: Measured joints, root orientation and root height.
        asked: Commanded vector; None asks for what is measured.
        gate, phase: State of the gate and of the motion.
        age_s: How long before the state was read the command was written [s].
        slow_s: How much longer than 3 ms the inference takes [s].
        is_commanded: Whether there is a command; without, the policy uses the last one it saw.
        commander: Server that writes the commands.
        command_seq: Number of the command that the policy uses; None for the newest.
    """
    wanted = command(q, height=height) if asked is None else asked
    if is_commanded:
        source = {"file": "walk.pkl", "frame": number, "phase": phase}
        _ask(builder, wanted, source, at_s=at_s - age_s, writer=commander)
    _read(builder, q, quat, [0.02 * number, 0.0, height], at_s=at_s)
    read = MONO_START_NS + round(at_s * 1e9)
    newest = command_seq or builder.written(twist_keys.action_body(), writer=commander)
    stages = [read - round(age_s * 1e9), read - round(age_s * 1e9) + 300_000, read, read + 100_000]
    inferred = read + 3_000_000 + round(slow_s * 1e9)
    builder.write(
        {
            keys.policy_obs(ROBOT): codec.f32(np.arange(8) + number),
            keys.policy_action(ROBOT): codec.f32(np.full(29, 0.1 * number)),
            keys.target(ROBOT): codec.f64(np.concatenate([q, np.full(29, 100.0), np.full(29, 2.0)])),
            keys.command_gate(ROBOT): json.dumps({"state": gate, "reason": "", "age_s": age_s}).encode(),
            keys.command_used(ROBOT): codec.f64(wanted),
            keys.policy_timing(ROBOT): json.dumps([number, newest, *stages, inferred, inferred + 200_000]).encode(),
        },
        at_s=at_s + 0.0035 + slow_s,
    )


def _ask(builder: EpisodeBuilder, wanted: Floats, source: dict[str, Any], *, at_s: float, writer: str) -> None:
    """What a commander writes in a tick."""
    values = {
        twist_keys.action_body(): codec.json_vector(wanted),
        keys.command_source(ROBOT): json.dumps(source).encode(),
    }
    builder.write(values, at_s=at_s, writer=writer)


def _read(builder: EpisodeBuilder, q: Floats, quat: Sequence[float], place: Sequence[float], *, at_s: float) -> None:
    """What the robot writes of its state: joints, orientation, and where its root is."""
    rates = builder.rates(keys.robot_state(ROBOT), np.concatenate([q, quat]), at_s=at_s)
    with np.errstate(all="ignore"):
        turning = rotations.multiply(rotations.inverse(quat), rates[29:])
    builder.write(
        {
            keys.robot_state(ROBOT): codec.f64(np.concatenate([q, rates[:29], quat, 2.0 * turning[1:]])),
            twist_keys.state_body(ROBOT): codec.json_vector(np.concatenate([np.zeros(5), q])),
            keys.sim_qpos(ROBOT): codec.f64(np.concatenate([place, quat, q])),
        },
        at_s=at_s,
    )


def walk(builder: EpisodeBuilder, *, seconds: float = 2.0, rate_hz: float = 50.0, **options: Any) -> None:
    """Ticks of a run without a fault."""
    assert len(G1_29) == len(STANDING)
    for number in range(round(seconds * rate_hz)):
        tick(builder, number, at_s=0.1 + number / rate_hz, **options)


def _is_json(value: bytes) -> bool:
    try:
        json.loads(value)
    except (ValueError, RecursionError):
        return False
    return True
