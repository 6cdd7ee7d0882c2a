"""A live station in Rerun: the newest of every key, some twenty-five times a second. Looks on; never writes the bus."""

from __future__ import annotations

import threading
from pathlib import Path

import rerun as rr

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.errors import NotReady
from station.life.loop import Rate
from station.life.server import read_configurations
from station.view import clouds, curves, layout, poses, scene
from station.view.episode_story import StateOf, gate_state, level, line
from station.view.find_model import find_model
from station.view.phases import driven_by
from station.view.poses import Numbers, Posture

RATE_HZ = 25.0


class LiveView:
    """Draws what a bus says now; call `poll` at any rate.

    Args:
        bus: The station's.
        recording: Where to draw: a viewer, a file, memory.
        robot: Suffix of the robot; "" takes the one that writes a state.
        robot_model: MJCF of the robot, path or ``collection:path``; None for the one that its server names.

    Attributes:
        robot: Suffix of the robot that is drawn.
        clock: Time where the bus is.

    Raises:
        NotReady: no robot writes a state on this bus.
        AssetMissing, BadFile: `robot_model` is not there, or is none.
    """

    def __init__(
        self, bus: Bus, recording: rr.RecordingStream, *, robot: str = "", robot_model: str | Path | None = None
    ) -> None:
        servers = read_configurations(bus)
        known = Contracts(servers)
        self.robot = robot or _present_robot(bus, known)
        self._recording = recording
        self._description = known.robot(self.robot)
        self._contracts = {
            item.key: item for item in curves.drawable(one for one in known.of(self.robot) if one.vector_codec)
        }
        self._lidars = clouds.stated(servers)
        others = [keys.command_gate(self.robot), keys.command_source(self.robot), keys.EVENT, *self._lidars]
        self._watch = bus.watch([*self._contracts, *others])
        self._model, self.warnings = find_model(servers, self.robot, robot_model)
        self._seen: dict[str, Sample] = {}
        self._states: dict[str, str] = {}
        self.clock = bus.clock
        self._began_s = self.clock.monotonic_s()
        self._prepare()

    def poll(self) -> int:
        """Draw what is new since the last look; return how many keys that were."""
        self._recording.set_time(layout.TIMELINE, duration=self.clock.monotonic_s() - self._began_s)
        wanted = (*self._contracts, *self._shown, keys.EVENT, *self._lidars)
        fresh = {key: sample for key in wanted if (sample := self._fresh(key)) is not None}
        numbers = {key: found for key in self._contracts if key in fresh and (found := self._find(key))}
        for found in numbers.values():
            curves.log_values(self._recording, found.contract, found.values[0])
        if numbers:
            self._pose()
        for key in self._lidars.keys() & fresh.keys():
            clouds.log_cloud(self._recording, key, fresh[key].value, self._bodies)
        self._draw_changes(fresh)
        return len(fresh)

    def close(self) -> None:
        """Stop watching the bus."""
        self._watch.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _shown(self) -> dict[str, tuple[str, StateOf]]:
        """Keys whose changes are shown as states: entity, and what makes the state of a value."""
        return {
            keys.command_gate(self.robot): (f"{layout.STATES}/gate", gate_state),
            keys.command_source(self.robot): (f"{layout.STATES}/motion", driven_by),
        }

    @property
    def _bodies(self) -> frozenset[str]:
        return frozenset() if self._model is None else self._model.visible

    def _prepare(self) -> None:
        for contract in self._contracts.values():
            curves.log_names(self._recording, contract)
        layout.log_state_colours(self._recording)
        if self._model is not None:
            scene.log_shapes(self._recording, scene.ROBOT, self._model)
            scene.log_shapes(self._recording, scene.GHOST, self._model, is_ghost=True)
        is_apart = clouds.apart(self._lidars.values(), self._bodies)
        arranged = layout.layout(
            self._contracts.values(), has_robot=self._model is not None, groups={},
            clouds=[clouds.CLOUDS] if is_apart else [],
        )  # fmt: skip
        self._recording.send_blueprint(arranged)

    def _fresh(self, key: str) -> Sample | None:
        sample = self._watch.latest(key)
        if sample is None or sample is self._seen.get(key):
            return None
        self._seen[key] = sample
        return sample

    def _find(self, key: str) -> Numbers | None:
        return poses.newest(self._seen.get(key), self._contracts[key]) if key in self._contracts else None

    def _pose(self) -> None:
        states = poses.state_keys(self.robot, self._contracts.values(), self._description)
        where = poses.measured(self._find, states, self._description)
        if self._model is None or where is None:
            return
        self._place(scene.ROBOT, where)
        ghost = poses.asked(
            self._find, poses.command_keys(self.robot, self._contracts.values(), self._description), where
        )
        if ghost is not None:
            self._place(scene.GHOST, ghost._replace(root=scene.beside(self._model, ghost.root)))

    def _place(self, root: str, posture: Posture) -> None:
        assert self._model is not None
        positions, quats = self._model.poses(posture.root, posture.joints, posture.q)
        scene.log_pose(self._recording, root, self._model, positions[0], quats[0])

    def _draw_changes(self, fresh: dict[str, Sample]) -> None:
        if keys.EVENT in fresh and (event := codec.parse_facts(fresh[keys.EVENT].value)):
            self._recording.log(layout.EVENTS, rr.TextLog(line(event), level=level(event)))
        for key, (entity, state_of) in self._shown.items():
            state = state_of(codec.parse_facts(fresh[key].value)) if key in fresh else ""
            if state and state != self._states.get(entity):
                self._states[entity] = state
                self._recording.log(entity, rr.StateChange(state=state))


def run(view: LiveView, stop: threading.Event, *, rate_hz: float = RATE_HZ) -> None:
    """Poll at a fixed rate until asked to stop."""
    rate = Rate(rate_hz, view.clock)
    while not stop.is_set():
        rate.wait()
        view.poll()


def _present_robot(bus: Bus, known: Contracts) -> str:
    """Return the first robot whose state stands on the bus, of those that are known, listed or not."""
    families = (keys.robot_state, keys.state_joints)
    others = (key.removeprefix(family("")) for family in families for key in bus.names(family("*")))
    for robot in (*known.robots(), *others):
        states = [item.key for item in known.of(robot) if item.role == "state" and item.key.endswith(f"_{robot}")]
        if bus.read(states):
            return robot
    raise NotReady(f"bus {bus.address}: no robot writes its state; start a low-level server first")
