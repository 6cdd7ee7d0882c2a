"""The low-level server of a Kassow arm: commands through the gate to the controller's session, its state to the bus.

The session (`station_kord`) is native code with a thread of its own that keeps the controller's 250 Hz; this process
only hands it targets that moved. Killed in motion, it leaves an arm that finishes what it has, which is no more than
`lead_s`, and stays there.
"""

from __future__ import annotations

import dataclasses
import logging
import queue
import threading
from pathlib import Path
from typing import Any, Literal

import msgspec

from adapters.commands.arm import arm_command
from adapters.robots import arm_limits
from adapters.robots.arm_limits import ArmLimits
from adapters.robots.kassow import session as sessions
from adapters.robots.kassow import wire
from adapters.robots.kassow.description import of_joints
from adapters.robots.kassow.names import MAKER, suffix
from adapters.robots.kassow.native import kord
from adapters.robots.kassow.session import KordSession
from station.arms import ArmState, JointCommand
from station.bus import codec, keys
from station.config import to_plain
from station.control.arm_control import ArmControl, result_values
from station.control.arm_kind import ArmServerKind
from station.control.gate import GateConfig
from station.control.low_level import LowLevelLoop
from station.errors import Refused
from station.life.controller_request import ControllerAnswer, ControllerRequest
from station.life.loop import Rate, real_time
from station.life.request import OVERTAKEN, Asked, DoneRequests, parse
from station.life.server import Life
from station.printable import printable
from station.software import software

RATE_HZ = 250.0
"""Ticks of the gate: as many as the controller's, so that no turn of the throttle passes without a target."""
_STATE_EVERY, _CONTROLLER_EVERY = 2, 25  # ticks: 125 Hz and 10 Hz

log = logging.getLogger(__name__)


class SimulatedController(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the simulated controller in this process behaves.

    Attributes:
        q_start: Joints at the start, 7 numbers [rad]; None for a model's own place to begin work, or its zeros.
        preset: What planning a target by speed costs: ``final``, or ``narrative``, with which 125 Hz overflows in 25 s.
    """

    q_start: tuple[float, float, float, float, float, float, float] | None = None
    preset: Literal["final", "narrative"] = "final"


class KassowConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of a Kassow arm's server.

    Attributes:
        model: Which arm it is, for example ``kr810``; part of the suffix of its keys.
        limits: File with the limits of its joints; needed for a model of which none ship.
        name: Further part of the suffix, for a second arm of the model; "" for none.
        host: Address of the controller; ``sim`` for a simulated one in this process, ``unix:PATH`` for one that
            `station kassow controller` runs.
        port, session_id: Of the controller's KORD.
        profile: How targets are tracked; docs/kassow.md tells them apart.
        speed_rad_s: Greatest speed of a target; a command that jumps is caught up with [rad/s].
        lead_s: How far ahead of the arm a target may be, in time at the profile's speed [s].
        gate: Times of the gate, and which writer to obey when two write the command.
        start_armed: Whether targets go to the arm from the start; None: only in simulation. Otherwise `station arm`.
        connect_within_s: Longest wait for the controller [s].
        real_time_priority: SCHED_FIFO priority that the session's thread asks for, the server for less; 0 for none.
        lock_memory: Whether to ask for the memory to be locked, so that no page has to be fetched in motion.
        sim: The simulated controller, with ``host: sim``.
    """

    model: str = "kr810"
    limits: Path | None = None
    name: str = ""
    host: str = "sim"
    port: int = 7582
    session_id: int = 1
    profile: str = "speed125"
    speed_rad_s: float = 1.0
    lead_s: float = 0.05
    gate: GateConfig = GateConfig()
    start_armed: bool | None = None
    connect_within_s: float = 5.0
    real_time_priority: int = 70
    lock_memory: bool = False
    sim: SimulatedController = SimulatedController()

    def __post_init__(self) -> None:
        if not (self.model.isidentifier() and (self.name == "" or self.name.isidentifier())):
            raise ValueError(f"model {self.model!r} and name {self.name!r}: expected letters, digits and _")
        for field, value, most in (("speed_rad_s", self.speed_rad_s, 4.0), ("lead_s", self.lead_s, 0.1)):
            if not 0.0 < value <= most:
                raise ValueError(f"{field} is {value:g}; expected more than 0 and {most:g} at most")
        if not 0.0 < self.connect_within_s <= 60.0:
            raise ValueError(f"connect_within_s is {self.connect_within_s:g}; expected up to 60 s")

    @property
    def is_simulated(self) -> bool:
        """Whether the controller is a simulated one."""
        return self.host == "sim" or self.host.startswith("unix:")

    @property
    def is_armed(self) -> bool:
        """Whether targets go to the arm from the start."""
        return self.is_simulated if self.start_armed is None else self.start_armed

    @property
    def robot(self) -> str:
        """Suffix of the arm's keys."""
        return suffix(self.model, self.name)


def main(config: KassowConfig, life: Life) -> int:
    """Run until asked to stop."""
    limits = arm_limits.load(MAKER, config.model, config.limits)
    command_format = arm_command(MAKER, limits, speed_rad_s=config.speed_rad_s, robot=config.robot)
    # Before the session's own thread is there, which asks for more than what every thread gets here.
    scheduling = real_time() if config.real_time_priority else "as it was"
    session = _open(config, limits)
    try:
        control = ArmControl(session, command_format, gate=config.gate, is_armed=config.is_armed, clock=life.clock)
        publisher = StatePublisher(life, config, session)
        requests = RequestHandler(control, session, config.robot)
        with LowLevelLoop(
            life,
            control,
            state_values=publisher.state_values,
            result_values=lambda record, arm: result_values(
                config.robot, record, control.commanded, arm, requests.poll()
            ),
            period_s=1.0 / RATE_HZ,
            requests={keys.CONTROLLER: requests.on_request},
        ) as loop:
            life.configured(_facts(config, life.name, command_format, limits, session))
            if not life.ready():
                return 0
            life.report(scheduling=scheduling, session_scheduling=session.real_time)
            loop.run_at(Rate(RATE_HZ, life.clock))
    finally:
        session.close()
    return 0


KIND = ArmServerKind(
    name="kassow",
    role="low-level",
    summary="Kassow arm, real or simulated: commands through the gate to the controller's 250 Hz session",
    config=KassowConfig,
    main=main,
    bridge=kord,
    expect=lambda _: kord(),
)


class StatePublisher:
    """Puts the session's state on the bus: joints at 125 Hz, the controller's words at 10 Hz, its events as they come.

    Args:
        life: The server's.
        config: The server's.
        session: Tells the state.
    """

    def __init__(self, life: Life, config: KassowConfig, session: KordSession) -> None:
        self._life, self._robot, self._session = life, config.robot, session
        self._tool = wire.tool_of(config.model) if session.is_simulated else None
        self._tick, self._told = 0, 0

    def state_values(self, state: ArmState) -> dict[str, bytes]:
        """Return what is published at the start of a tick."""
        kord, self._tick = state.told, self._tick + 1
        values = wire.state_values(self._robot, kord, self._tool) if self._tick % _STATE_EVERY == 1 else {}
        if self._tick % _CONTROLLER_EVERY == 1:
            values[keys.state_controller(self._robot)] = codec.json_object(
                wire.controller(kord, self._session.lead_rad)
            )
        for event in kord.events:
            if event.number > self._told:
                self._told = event.number
                self._life.event("controller-event", severity="error", id=event.id, group=event.group,
                                 text=event.text, tick=event.tick)  # fmt: skip
        return values


class RequestHandler:
    """Does what is asked of the controller: in the loop, or in a thread where it takes time.

    Args:
        control: Is told when the faults are cleared.
        session: Is asked.
        robot: Suffix of the arm's keys; requests to other arms are none of ours.
    """

    def __init__(self, control: ArmControl, session: KordSession, robot: str) -> None:
        self._control, self._session, self._robot = control, session, robot
        self._cleared: queue.SimpleQueue[tuple[ControllerRequest, str]] = queue.SimpleQueue()
        self._clearing: ControllerRequest | None = None
        self._answer: ControllerAnswer | None = None
        self._done = DoneRequests[ControllerAnswer]()

    def on_request(self, asked: Asked) -> None:
        """Do what came on the key of requests."""
        try:
            request = parse(asked.data, ControllerRequest, "a request to a controller")
        except Refused as error:
            self._control.commanded.add_event("request-refused", "warning", reason=str(error))
            return
        if request.robot != self._robot or (self._clearing is not None and request.id == self._clearing.id != ""):
            return
        if (known := self._done.get(request.id)) is not None:  # its asker has not seen the answer yet
            self._answer = known
        elif self._done.begin(asked.first_ns(request.late_s)):
            self._reply(request, OVERTAKEN)
        elif request.action == "profile":
            self._reply(request, self._session.choose(request.profile))
        elif request.action == "throttle":
            self._reply(request, self._session.throttle(request.throttle))
        elif self._clearing is not None:
            self._reply(request, "its faults are being cleared already")
        else:
            self._clearing = request
            self._control.clearing()
            self._begin_clearing(request)

    def poll(self) -> ControllerAnswer | None:
        """Answer what is done by now; return the newest answer."""
        if self._clearing is not None and not self._cleared.empty():
            request, refusal = self._cleared.get()
            self._clearing = None
            self._reply(request, refusal)
            if refusal:
                self._control.commanded.add_event("clear-refused", "warning", who=request.who, reason=refusal)
            else:
                self._control.cleared(request.who)
        return self._answer

    def _begin_clearing(self, request: ControllerRequest) -> None:
        try:
            threading.Thread(target=self._clear, args=(request,), name="clear", daemon=True).start()
        except RuntimeError as error:  # the system gives no more threads
            self._cleared.put((request, f"it cannot be tried now ({error})"))

    def _clear(self, request: ControllerRequest) -> None:
        """Clear, and hand over how it ended in every case: the asker waits for it, and may ask again after it."""
        refusal = "it ended without a result; see the server's log"
        try:
            refusal = self._session.clear()
        except Exception as error:  # whatever it is, the operator hears of it, and the arm stays faulted
            log.exception("clearing the controller's faults failed")
            refusal = f"clearing failed: {type(error).__name__}: {printable(str(error))}"
        finally:
            self._cleared.put((request, refusal))

    def _reply(self, request: ControllerRequest, refusal: str) -> None:
        self._answer = ControllerAnswer(id=request.id, action=request.action, refused=refusal)
        self._done.put(request.id, self._answer)


def _open(config: KassowConfig, limits: ArmLimits) -> KordSession:
    preset, q_start = config.sim.preset, config.sim.q_start
    sim = sessions.simulated(limits, preset=preset, q_start=q_start) if config.host == "sim" else None
    return sessions.open_session(
        host=config.host, port=config.port, session_id=config.session_id, limits=limits, profile=config.profile,
        sim=sim, real_time_priority=config.real_time_priority, lock_memory=config.lock_memory,
        connect_within_s=config.connect_within_s, speed_rad_s=config.speed_rad_s, lead_s=config.lead_s,
    )  # fmt: skip


def _facts(
    config: KassowConfig, name: str, command_format: JointCommand, limits: ArmLimits, session: KordSession
) -> dict[str, Any]:
    """What a recording must know of this server."""
    code = software()
    return {
        "server": name,
        "role": KIND.role,
        "robot": config.robot,
        "description": to_plain(of_joints(config.robot, limits.joints())),
        "command": command_format.facts(),
        "robot_facts": {
            "maker": MAKER,
            "backend": session.backend,
            "limits": limits.facts(),
            "profile": dataclasses.asdict(session.profile),
        },
        "rates": {"control_hz": RATE_HZ, "pace": "wall"},
        "gate": to_plain(config.gate),
        "software": {"version": code.version, "revision": code.revision, "dirty": code.dirty},
        "config": to_plain(config),
    }
