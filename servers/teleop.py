"""The teleoperation server: an operator's device drives the robot, whatever the device.

It knows no device: it follows the operator's keys of one (`station.operator.device_subscriber`), has one dead-man and
one map of buttons for all (`station.operator.driving`), and a driver that makes commands (`adapters.drivers`).

Commands are sent from the first engaging on; before, no command is sent and the robot stands. The first one is the
command that the robot already follows. When the operator lets go, the pose is held and a walk comes to a stand.
Commands end, and the robot returns to standing, when the device has been away for `patience_s`, when the robot was
stopped, or when it ceased to follow; only a new engaging begins them again. Asked to leave, or on an error, it blends
to the default. A robot that stays where it is without a command, an arm, is left there instead.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from station import config as configs
from station import registry, user_config
from station.bus import keys
from station.bus.watch import Watch
from station.config import to_plain
from station.life.events import Severity
from station.life.loop import real_time
from station.life.pace import WallPace
from station.life.server import Life, ServerKind
from station.life.writer_conflict import OwnKey
from station.operator.buttons import DRIVING, ButtonMap, Buttons, Pressed
from station.operator.device_subscriber import DeviceSubscriber
from station.operator.driver import Driver, DriverKind
from station.operator.driving import CommandWriter, Driving, DrivingStep, ExitBlend, buttons_to_drive
from station.operator.requests import ArmButtons, PolicyButton, RecordButtons, Requests, StopPresser
from station.operator.robot_side import RobotSide
from station.protocols import Floats

_ENDING = "teleoperation is ending"


class TeleopConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the teleoperation server.

    Attributes:
        device: Name of the device server that is followed.
        driver: Registered name of what makes commands of it.
        options: The driver's.
        operator: Who drives, for the recording; the driver `body` takes this name's calibration.
        controls_from: Name of another device server whose controls count, for a device without buttons.
        kind: What kind of device has the controls (pico, gamepad, …), for the names of its buttons; "" where the device
            server is called so.
        only_drives: Whether its buttons only drive and stop: of several that share a pad one has the episodes and arms.
        buttons: File that changes what the buttons mean; `station devices buttons` shows it.
        rate_hz: Commands per second [Hz]; 0 for as many as the driver's robot expects.
        patience_s: How long the device may be away before commands end and the robot returns to standing [s].
        leave_s: Blend to the default pose at the end [s].
        task, instruction: Of episodes that are begun with a button; "" for the task of the episode before.
    """

    device: str = "pico"
    driver: Annotated[str, registry.named("driver")] = "hands"
    options: dict[str, Any] = {}
    operator: str = ""
    controls_from: str = ""
    kind: str = ""
    only_drives: bool = False
    buttons: Path | None = None
    rate_hz: float = 0.0
    patience_s: float = 5.0
    leave_s: float = 2.0
    task: str = ""
    instruction: str = ""

    def __post_init__(self) -> None:
        registry.expect("driver", self.driver)
        if self.rate_hz and not 20.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 20 to 500 Hz, or 0 for the driver's own")
        if not 1.0 <= self.patience_s <= 600.0:
            raise ValueError(f"patience_s is {self.patience_s:g}; expected 1 to 600 s")
        if not 0.5 <= self.leave_s <= 60.0:
            raise ValueError(f"leave_s is {self.leave_s:g}; expected 0.5 to 60 s: a shorter blend is a kick")
        self.typed_options()
        if self.button_kind not in registry.names("device"):
            listed = ", ".join(registry.names("device"))
            raise ValueError(f"kind: nothing is known of the buttons of {self.button_kind!r}; expected one of {listed}")

    def typed_options(self) -> Any:
        """Return the options as the driver's type has them.

        Raises:
            ValueError: they are none of its options; the message names the field.
        """
        where = f"options of the driver {self.driver}"
        return configs.build_options(self.option_types["options"], self.options, where=where)

    @property
    def option_types(self) -> dict[str, type[msgspec.Struct]]:
        """Types of the settings that are mappings, by name."""
        kind: DriverKind = registry.find("driver", self.driver)
        return {"options": kind.options}

    @property
    def button_kind(self) -> str:
        """Kind of the device that has the controls."""
        return self.kind or self.controls_from or self.device


def main(config: TeleopConfig, life: Life) -> int:
    """Drive until the operator leaves or we are asked to stop; return the exit code."""
    kind: DriverKind = registry.find("driver", config.driver)
    bound = buttons_to_drive(config.button_kind, config.buttons)
    bound = bound.only(DRIVING) if config.only_drives else bound
    driver = kind.make(config.typed_options(), config.operator)
    config = msgspec.structs.replace(config, rate_hz=config.rate_hz or kind.rate_hz)
    life.configured(_facts(life, config, driver, bound))
    watched = [
        *DeviceSubscriber.watched(config.device, config.controls_from),
        *RobotSide.watched(driver.command_format.robot),
        driver.command_format.key,
        keys.RECORDER,
    ]
    with life.bus.watch(watched) as watch:
        if not life.ready():
            return 0
        help_line = "; ".join(filter(None, (kind.moves.get(config.button_kind), bound.beside_driving)))
        life.report(scheduling=real_time(), help=help_line)
        teleop = Teleop(config, life, driver, bound, watch)
        try:
            teleop.run()
        finally:
            teleop.close()
    return 0


KIND = ServerKind(
    name="teleop",
    role="command",
    summary="an operator's device drives the robot: dead-man, buttons, and a driver that makes commands",
    config=TeleopConfig,
    main=main,
)


def _facts(life: Life, config: TeleopConfig, driver: Driver, bound: ButtonMap) -> dict[str, Any]:
    command_format = driver.command_format
    return {
        "server": life.name,
        "role": KIND.role,
        "robot": command_format.robot,
        "command": {
            "format": command_format.name,
            "key": command_format.key,
            "rate_hz": config.rate_hz,
            "pace": "wall",
        },
        "driver": driver.facts(),
        "buttons": {action: gestures for action, gestures, _ in bound.table()},
        "config": to_plain(config),
    }


class Teleop:
    """The loop: hear, drive, tell, obey, publish, wait.

    Args:
        config: The server's.
        life: The server's.
        driver: Makes commands.
        bound: What the buttons mean.
        watch: Watches device, robot, recorder and the command's own key.
    """

    def __init__(self, config: TeleopConfig, life: Life, driver: Driver, bound: ButtonMap, watch: Watch) -> None:
        self._config, self._life, self._driver, self._watch = config, life, driver, watch
        self._command_format = driver.command_format
        self._driving = Driving(driver, Buttons(bound))
        self._subscriber = DeviceSubscriber(watch, config.device, config.controls_from)
        self._robot = RobotSide(
            watch,
            self._command_format.robot,
            len(self._command_format.default),
            holds_position=self._command_format.holds_position,
        )
        self._own_key = OwnKey(life, self._command_format.key)
        self._writer = CommandWriter(life, driver.command_format, device=config.device, driver=driver.name)
        person = {"interface": config.device, "id": user_config.operator(config.operator)}
        self._to_drive, self._to_arm = bound.how_to_drive, bound.how_to_arm
        record = RecordButtons(life, watch, task=config.task, instruction=config.instruction, operator=person)
        robot = self._command_format.robot
        arm, policy = ArmButtons(life, robot, config.device), PolicyButton(life, robot)
        self._requests = Requests(record, StopPresser(life), arm, policy, device=config.device)
        self._speaks = False
        self._clock = life.clock
        self._heard_s = self._clock.monotonic_s()
        self._taken_up: Floats | None = None
        self._leaving: ExitBlend | None = None

    def run(self) -> None:
        """Drive to the end; on an error blend to the default first, then raise it."""
        pace = WallPace(self._config.rate_hz, self._clock)
        try:
            dt_s = 1.0 / self._config.rate_hz
            while not self._is_over:
                self._tick(dt_s)
                self._life.report(**pace.health())
                dt_s = pace.wait(is_leaving=self._leaving is not None)
            self._publish_farewell()
        except Exception as error:
            self._life.event("teleop-error", severity="error", reason=f"{type(error).__name__}: {error}")
            self._leave_blindly(pace)
            raise

    def close(self) -> None:
        """Let what was asked of the recorder be done; hang up."""
        self._requests.close()

    @property
    def _is_over(self) -> bool:
        return self._leaving is not None and (self._leaving.is_done or not self._speaks)

    def _tick(self, dt_s: float) -> None:
        now_ns = self._clock.monotonic_ns()
        if self._leaving is None and self._life.stopping:
            self._leaving = ExitBlend(self._command_format, self._config.leave_s)
        heard = self._subscriber.poll()
        if not heard.why_not:
            self._heard_s = now_ns * 1e-9
        self._robot.poll(now_ns)
        self._resume_from_robot()
        why_blocked = (
            _ENDING if self._leaving is not None else self._robot.why_blocked or self._writer.why_not or heard.why_not
        )
        driven = self._driving.step(heard.sample, dt_s, why_blocked=why_blocked)
        self._publish_events(driven)
        self._obey(driven.pressed)
        self._own_key.check(self._watch.latest(self._command_format.key))
        self._decide_to_speak(driven, now_ns)
        command, auxiliary = driven.command, driven.auxiliary
        if self._leaving is not None:
            command = self._leaving.step(command, dt_s, is_still=self._driver.is_still)
            auxiliary = self._leaving.auxiliary(auxiliary)
        if self._speaks:
            deadman = self._driving.deadman
            self._writer.write(command, auxiliary, heard,
                               engaged=deadman.is_engaged, mode=self._driver.mode, reason=deadman.reason)  # fmt: skip
        self._report(why_blocked)

    def _resume_from_robot(self) -> None:
        """Before commands begin: take up the command that the robot follows, so that engaging starts from it."""
        used, known = self._robot.used, self._taken_up
        if not self._speaks and used is not None and not (known is not None and np.array_equal(used, known)):
            self._driver.resume_from(used)
            self._taken_up = used

    def _decide_to_speak(self, driven: DrivingStep, now_ns: int) -> None:
        if driven.change is not None and driven.change.name == "operator-engaged":
            if not self._speaks:
                self._robot.begin(now_ns)
            self._speaks = True
        if not self._speaks or self._driving.deadman.is_engaged:
            return
        away_s = now_ns * 1e-9 - self._heard_s
        if self._robot.left:
            self._be_silent(self._robot.left)
        elif away_s > self._config.patience_s and self._driver.is_still and self._leaving is None:
            self._be_silent(f"{self._config.device} has been away for {away_s:.0f} s")

    def _be_silent(self, reason: str) -> None:
        """Command nothing more; the gate takes the robot to standing, or leaves it where it is."""
        self._speaks, self._taken_up, self._writer.why_not = False, None, ""
        self._robot.end()
        then = f"{self._then}; engage anew"
        self._life.event("teleop-commands-end", severity="warning", reason=reason, then=then)

    @property
    def _then(self) -> str:
        return "the robot stays where it is" if self._command_format.holds_position else "the robot returns to standing"

    def _publish_farewell(self) -> None:
        if self._speaks:
            reason = "the server was asked to stop" if self._life.stopping else "the operator left"
            self._life.event("teleop-commands-end", reason=reason, then=self._then)

    def _publish_events(self, driven: DrivingStep) -> None:
        mode = {"mode": self._driver.mode} if self._driver.mode else {}
        told: dict[str, Any] = {"device": self._config.device, "driver": self._driver.name} | mode
        if driven.mode:
            self._life.event("operator-mode", **told)
        if (change := driven.change) is not None:
            severity: Severity = "info" if change.reason in ("", "released", _ENDING) else "warning"
            why = {"reason": change.reason} if change.reason else {}
            self._life.event(change.name, severity=severity, **told | why)

    def _obey(self, pressed: Pressed) -> None:
        self._requests.obey(pressed)
        if "exit" in pressed.started and self._leaving is None:
            self._life.event("operator-exit", device=self._config.device)
            self._leaving = ExitBlend(self._command_format, self._config.leave_s)

    def _leave_blindly(self, pace: WallPace) -> None:
        """Blend from the last command to the default, without anything that may have broken."""
        if not self._speaks or self._writer.newest is None:
            return
        leaving = ExitBlend(self._command_format, self._config.leave_s)
        while not leaving.is_done:
            self._writer.write_alone(leaving.step(self._writer.newest, pace.wait(is_leaving=True), is_still=True))

    def _report(self, why_blocked: str) -> None:
        deadman = self._driving.deadman
        reasons = [why_blocked] if why_blocked else [deadman.reason, self._to_drive]
        if self._robot.arming == "disarmed":
            reasons += [self._requests.refusal or self._to_arm]
        reason = "" if deadman.is_engaged else "; ".join(filter(None, reasons))
        self._life.report(engaged=deadman.is_engaged, why_not=reason, mode=self._driver.mode, commands=self._speaks)
