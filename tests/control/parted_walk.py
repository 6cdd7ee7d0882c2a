"""A G1 whose legs follow a policy and whose arms, and hands, are commanded apart, by commanders with bad days.

Pedals, arms and hands are fresh, silent, late, wrong, or of another writer, at random and each by itself. Beside the
robot each part's own command path, alone, is given the same: what it lets through is what the robot's part did, bit for
bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

import numpy as np

from adapters.commands.hand import HandCommand
from station.bus import codec
from station.control.arming import Arming
from station.control.command_path import CommandPath
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.control.rig import RigConfig, build
from station.parts import parts_of, rests_on_joints
from station.protocols import CommandFormat, Floats

DT = 0.02
FALCON, ASAP = "zoo:policies/falcon_g1_29dof.onnx", "zoo:policies/asap_dec_loco_g1.onnx"
RLGYM, HOLOSOMA = "zoo:policies/rlgym_g1_motion.pt", "zoo:policies/holosoma_fastsac_g1_29dof.onnx"
ARM = np.array([0.0, 0.2, 0.0, 1.0, 0.0, 0.0, 0.0])
SWING = np.array([0.6, 0.2, 0.3, 0.4, 0.4, 0.4, 0.4])
"""How far an arm is sent from `ARM` [rad]."""
_SILENT_S = 0.3  # from the last good command to a velocity of zero


class Commander:
    """Who writes one part's command, on good days and bad ones."""

    def __init__(self, part: CommandFormat, swing: float, seed: int) -> None:
        self.part, self._swing, self._random = part, swing, Random(seed)
        self._held: CommandSample | None = None
        self._kind, self._until, self._goal = "fresh", 100, part.default.copy()
        self.good_s: float | None = None

    def sample(self, tick: int) -> CommandSample | None:
        """Return what the key holds in a tick."""
        random, now_s = self._random, tick * DT
        if tick >= self._until:
            kinds = ["fresh"] * 4 + ["silent", "silent", "bad", "late", "other"]
            self._kind, self._until = random.choice(kinds), tick + random.randrange(5, 200)
            self._goal = self._wish()
        if self._kind == "silent":
            return self._held
        delay_s = 0.6 if self._kind == "late" else 0.001
        data = b"odd" if self._kind == "bad" else codec.json_vector(self._goal)
        source = "b.1.x.n" if self._kind == "other" else "a.1.x.n"
        self._held = CommandSample(data, now_s, delay_s, source=source)
        if self._kind in ("fresh", "other"):
            self.good_s = now_s
        return self._held

    def _wish(self) -> Floats:
        random = self._random
        if self.part.velocities:
            wish, walks = self.part.default.copy(), random.random() < 0.7
            velocity = random.uniform(-0.4, 0.7), random.uniform(-0.3, 0.3), random.uniform(-0.5, 0.5)
            wish[:3] = walks * np.array(velocity)
            if self.part.holds_position:  # a height, and a torso
                wish[3:] = random.uniform(0.5, 0.75), *(random.uniform(-0.4, 0.4) for _ in wish[4:])
            return wish
        if isinstance(self.part, HandCommand):
            bent = np.array([random.random() for _ in self.part.fingers])
            return self.part.opened + bent * (self.part.closed - self.part.opened)
        side = -1.0 if "right" in self.part.robot else 1.0
        offset = self._swing * SWING * np.array([random.uniform(-1, 1) for _ in SWING])
        return ARM * [1, side, 1, 1, 1, 1, 1] + offset


def walked(
    legs: str, checkpoint: str, swing: float, seconds: float, seed: int = 1, *, hands: bool = False
) -> Iterator[tuple[list[str], Floats | None]]:
    """Run a robot and yield, of each step, the states of the parts, and the place of the base [m].

    Args:
        legs, checkpoint: The policy of the legs, or of all of it, and its file.
        swing: How far arms are moved, in `SWING`.
        seconds: Simulated time [s].
        seed: Of what becomes of the commands.
        hands: Whether it has hands that are commanded as well.

    Raises:
        AssertionError: it fell, or a part did something else than its own command path alone.
    """
    around = {"policy": "g1-arms", "policy_options": {"legs": legs, "hands": hands}}
    policy = {"policy": legs} if legs in ("falcon", "asap") and not hands else around
    robot = "g1-dex3-mujoco" if hands else "g1-mujoco"
    rig = build(RigConfig(robot=robot, robot_options={"physics_dt_s": 0.002}, checkpoint=checkpoint, **policy))
    control = rig.control()
    parts = parts_of(rig.command_format)
    alone = [CommandPath(part, GateConfig(), Arming(is_armed=True)) for part in parts]
    commanders = [Commander(part, swing, seed * 10 + index) for index, part in enumerate(parts)]
    names, before = list(rig.robot.joint_names), None
    for tick in range(round(seconds / DT)):
        now_s, state = tick * DT, control.sense()
        samples = tuple(each.sample(tick) for each in commanders)
        record = control.step(state, samples, now_s)
        for part, path, sample, decision in zip(parts, alone, samples, record.decision.parts, strict=True):
            if rests_on_joints(part):
                joints = [names.index(element.name.removesuffix("_pos")) for element in part.elements]
                path.gate.rest(state.q[joints] if before is None else before[part.name])
            own = path.decide(sample, now_s)
            assert (own.state, own.vector.tobytes()) == (decision.state, decision.vector.tobytes()), (part.name, now_s)
        before = {part.name: decision.vector for part, decision in zip(parts, record.decision.parts, strict=True)}
        assert record.fall is None, f"fell at {now_s:.2f} s: {record.fall}"
        good_s = commanders[0].good_s
        if good_s is None or now_s - good_s > _SILENT_S + DT / 2:
            assert not record.decision.parts[0].vector[:3].any(), f"walks on without a command at {now_s:.2f} s"
        yield [part.state for part in record.decision.parts], state.root_pos
    rig.robot.close()
