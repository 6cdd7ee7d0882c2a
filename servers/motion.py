"""The motion server: plays a recorded motion of a person as whole-body commands.

Each tick writes the command vector, the keys that stock readers expect beside it, the time and the source of the
command in one atomic write. Ticks come from the wall clock, or one per robot state (``pace: state``: lock-step with a
simulated robot, deterministic). Asked to stop, or on an error, it blends back to the default pose before it leaves.
An emergency stop ends its commands at once, and itself: after a release somebody starts a motion anew.

Control: JSON on ``station:motion``, ``{"action": "start|pause|resume|seek|loop|leave", "time_s": …, "on": …}``; and
stock TWIST2's ``motion_start_signal`` and ``motion_exit_signal`` (``1``).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from station import assets, registry
from station.bus import codec, contracts, keys
from station.bus.watch import Watch
from station.command_formats import command_format, expect_robot
from station.errors import ConfigError, Refused
from station.life.estop import StopWatch
from station.life.loop import real_time
from station.life.pace import Pace, StatePace, WallPace
from station.life.server import Life, ServerKind
from station.life.stop_file import StopFile
from station.life.writer_conflict import OwnKey
from station.motion.playback import AtEnd, Frame, Playback
from station.motion.playback_requests import Requests
from station.parts import by_key, parts_of, rests_on_joints
from station.protocols import CommandFormat, Motion

if TYPE_CHECKING:
    from station.view.preview import Preview

_GATE_WITHIN_S = 1.0  # a living robot says the state of its gate fifty times a second
_LOOK_S = 0.01
_SHORTEST_BLEND_S = 0.1


class MotionConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the motion server.

    Attributes:
        motion: The motion file, a path or ``collection:path``.
        format: Registered name of the command format.
        robot: Which robot it commands, by the end of its keys; only for a format that is for any (``velocity``).
        fps: Frames per second, in place of what the file says.
        holes: What is done with bad frames between good ones.
        rate_hz: Commands per second [Hz]; with ``pace: state`` the time that one robot state stands for.
        pace: ``wall`` sends by the clock, ``state`` one command per robot state.
        loop: Whether the motion starts again when it ends.
        at_end: What follows the last frame: ``exit`` leaves, ``hold`` stands in it until told otherwise.
        wait_for_start: Whether the default pose is sent until a start signal comes.
        enter_s, leave_s: Blend from and to the default pose [s].
        seek_s, ease_s: Blend into another place of the motion; into and out of a pause [s].
        lead_s: How far ahead the motion is sampled [s]; stock TWIST2 samples one period ahead.
        patience_s: With ``pace: state``: how long the robot may be silent before that is an event and the command is
            sent again [s].
        preview: Whether the reference is shown: in a window, or where there is no display in a file for Rerun.
        preview_file: That file.
        preview_model: The robot that is shown, a path or ``collection:path``; "" for the one that the command is for.
    """

    motion: str
    format: Annotated[str, registry.named("command")] = "twist2"
    robot: str = ""
    fps: float | None = None
    holes: Literal["refuse", "bridge"] = "refuse"
    rate_hz: float = 50.0
    pace: Literal["wall", "state"] = "wall"
    loop: bool = False
    at_end: AtEnd = "exit"
    wait_for_start: bool = False
    enter_s: float = 1.0
    leave_s: float = 2.0
    seek_s: float = 1.0
    ease_s: float = 0.5
    lead_s: float = 0.02
    patience_s: float = 1.0
    preview: bool = False
    preview_file: str = "preview.rrd"
    preview_model: str = ""

    def __post_init__(self) -> None:
        registry.expect("command", self.format)
        expect_robot(self.format, self.robot)
        if not 10.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 500 Hz (TWIST and TWIST2 expect 50)")
        for name in ("enter_s", "leave_s", "seek_s", "ease_s"):
            if not _SHORTEST_BLEND_S <= getattr(self, name) <= 60.0:
                raise ValueError(
                    f"{name} is {getattr(self, name):g}; expected {_SHORTEST_BLEND_S:g} to 60 s: "
                    "a shorter blend is a kick to the robot"
                )
        if not 0.0 <= self.lead_s <= 1.0:
            raise ValueError(f"lead_s is {self.lead_s:g}; expected 0 to 1 s")
        if not 0.1 <= self.patience_s <= 60.0:
            raise ValueError(f"patience_s is {self.patience_s:g}; expected 0.1 to 60 s")


def _expect_motion(config: MotionConfig) -> None:
    from adapters.motions.load import expect

    expect(config.motion)


def main(config: MotionConfig, life: Life) -> int:
    """Load the motion, play it, leave in the default pose; return the exit code."""
    command = command_format(config.format, config.robot)
    if staying := [part.name for part in parts_of(command) if rests_on_joints(part)]:
        raise ConfigError(
            f"format {config.format!r}: {', '.join(staying)} rests where it is, and has no pose to begin a motion from"
        )
    motion: Motion = registry.find("loader", "motion")(config.motion, holes=config.holes, fps=config.fps)
    life.configured(_facts(life, config, motion, command))
    with life.bus.watch(_watched_keys(command)) as watch:
        if not life.ready():
            return 0
        if (latched := StopFile(life.bus.address).read()) is not None:
            raise Refused(str(latched))
        if config.pace == "wall":
            life.report(scheduling=real_time())
        player = Player(config, life, motion, command, watch)
        try:
            player.run()
        finally:
            player.close()
    return 0


KIND = ServerKind(
    name="motion",
    role="command",
    summary="plays a recorded human motion as TWIST2 or TWIST commands",
    config=MotionConfig,
    main=main,
    expect=_expect_motion,
)


def _facts(life: Life, config: MotionConfig, motion: Motion, command: CommandFormat) -> dict[str, Any]:
    return {
        "server": life.name,
        "role": KIND.role,
        "robot": command.robot,
        "command": {"format": command.name, "key": command.key, "rate_hz": config.rate_hz, "pace": config.pace},
        "motion": motion.facts(),
        "config": msgspec.to_builtins(config),
    }


def _watched_keys(command: CommandFormat) -> list[str]:
    return [
        *(part.key for part in parts_of(command)),
        keys.robot_state(command.robot),
        keys.MOTION_CONTROL,
        *command.stock.signals,
        *StopWatch.watched(command.robot),
    ]


class _Stopped(Refused):
    """The emergency stop is latched: nothing is commanded any more, and no blend."""


class Player:
    """The loop: obey, step, publish, wait.

    Args:
        config: The server's.
        life: The server's.
        motion: What is played.
        command: As what.
        watch: Watches the command's key, the robot's state and the keys of requests.
    """

    def __init__(self, config: MotionConfig, life: Life, motion: Motion, command: CommandFormat, watch: Watch) -> None:
        self._config, self._life, self._motion, self._command, self._watch = config, life, motion, command, watch
        self._playback = Playback(
            motion, command, enter_s=config.enter_s, leave_s=config.leave_s, seek_s=config.seek_s,
            ease_s=config.ease_s, lead_s=config.lead_s, loop=config.loop, wait_for_start=config.wait_for_start,
            at_end=config.at_end,
        )  # fmt: skip
        self._writer = _Writer(life, motion, command)
        self._requests = Requests(life, watch, self._playback, command.stock.signals)
        self._story = _Story(life, self._playback)
        self._own_keys = [(part.key, OwnKey(life, part.key)) for part in parts_of(command)]
        self._stop = StopWatch(watch, command.robot)
        self._preview = _open_preview(config, life, motion, command)
        if config.wait_for_start:
            # As stock does: a "1" that an earlier session left behind must not start this one.
            life.bus.publish(dict.fromkeys(command.stock.signals, b"0"))

    def run(self) -> None:
        """Play to the end; on an error blend back to the default first, then raise it."""
        try:
            if self._config.pace == "wall":  # in lock-step no time passes for a robot that is not commanded
                self._wait_for_silence()
            self._play(self._new_pace())
        except _Stopped:
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            self._life.event("motion-error", severity="error", reason=reason, time_s=self._playback.time_s)
            self._playback.leave()
            pace = WallPace(self._config.rate_hz, self._life.clock)
            while not (
                self._playback.is_done or self._stop.why_stopped()
            ):  # a blend needs nothing of what may be broken
                self._writer.write(self._playback.step(pace.wait(is_leaving=True)), None)
            raise

    def _wait_for_silence(self) -> None:
        """Wait while a robot that was stopped wants commands to cease: one that began now would never be followed."""
        clock = self._life.clock
        until_s = clock.monotonic_s() + _GATE_WITHIN_S
        while self._stop.is_gate_old and clock.monotonic_s() < until_s:
            clock.sleep(_LOOK_S)
        if reason := self._stop.needs_silence:
            self._life.event("motion-waits", reason=reason)
        while self._stop.needs_silence and not self._life.stopping:
            self._expect_no_stop()
            clock.sleep(1.0 / self._config.rate_hz)

    def _expect_no_stop(self) -> None:
        if reason := self._stop.why_stopped():
            raise _Stopped(
                f"the emergency stop ({reason}) ended the motion at {self._playback.time_s:.1f} s; "
                "release it (`station estop --reset`), then start the motion again"
            )

    def _new_pace(self) -> Pace:
        config = self._config
        if config.pace == "wall":
            return WallPace(config.rate_hz, self._life.clock)
        robot_state = keys.robot_state(self._command.robot)
        return StatePace(self._life, self._watch, robot_state, config.rate_hz, patience_s=config.patience_s)

    def close(self) -> None:
        """Close the preview."""
        if self._preview is not None:
            self._preview.close()

    def _play(self, pace: Pace) -> None:
        dt_s = 0.0
        while not self._playback.is_done:
            self._expect_no_stop()
            if self._life.stopping:
                self._playback.leave()
            self._requests.obey()
            frame = self._playback.step(dt_s)
            for key, own in self._own_keys:
                own.check(self._watch.latest(key))
            self._writer.write(frame, pace.state_seq)
            self._story.publish(frame)
            if self._preview is not None:
                self._preview.show(frame.time_s)
            self._life.report(**pace.health(), phase=frame.phase, motion_time_s=round(frame.time_s, 3))
            if not self._playback.is_done:
                dt_s = pace.wait(is_leaving=frame.phase == "leaving")


class _Writer:
    """One atomic write per tick."""

    def __init__(self, life: Life, motion: Motion, command: CommandFormat) -> None:
        self._life, self._command = life, command
        self._auxiliary = {key: codec.json_vector(value) for key, value in command.auxiliary.items()}
        facts = motion.facts()
        self._file, self._sha256 = facts.get("file", motion.name), facts.get("sha256", "")
        self._first_frame = int(facts.get("first_frame", 0))

    def write(self, frame: Frame, state_seq: int | None) -> None:
        source = {
            "kind": "motion",
            "file": self._file,
            "sha256": self._sha256,
            "frame": self._first_frame + frame.frame_index,
            "time_s": frame.time_s,
            "phase": frame.phase,
            "state_seq": state_seq,
        }
        self._life.bus.publish(
            {
                **{key: codec.json_vector(each) for key, each in by_key(self._command, frame.command).items()},
                **self._auxiliary,
                **dict.fromkeys(self._command.stock.clocks, b"%d" % (self._life.clock.wall_ns() // 1_000_000)),
                keys.command_source(self._command.robot): codec.json_object(source),
            }
        )


class _Story:
    """Events at the changes of phase."""

    def __init__(self, life: Life, playback: Playback) -> None:
        self._life, self._playback = life, playback
        self._has_begun, self._phase, self._loops = False, "", 0

    def publish(self, frame: Frame) -> None:
        if frame.phase == self._phase:
            return
        self._phase = frame.phase
        if frame.phase == "playing" and not self._has_begun:
            self._has_begun = True
            self._life.event("motion-start", time_s=frame.time_s)
        if self._playback.loops > self._loops:
            self._loops = self._playback.loops
            self._life.event("motion-loop", loops=self._loops)
        if frame.phase == "leaving":
            self._life.event("motion-end", time_s=frame.time_s, is_complete=self._playback.is_complete,
                             loops=self._playback.loops, blends=self._playback.blends)  # fmt: skip


def _open_preview(config: MotionConfig, life: Life, motion: Motion, command: CommandFormat) -> Preview | None:
    if not config.preview:
        return None
    from station.view.preview import Preview

    described = contracts.description(command.robot)
    model = config.preview_model or (described.drawn_as if described is not None else "")
    if not model:
        raise ConfigError(f"preview_model: nothing says how {command.robot} looks; name its model, or leave preview")
    preview = Preview(
        motion,
        assets.resolve(model),
        Path(config.preview_file),
        on_end=lambda reason: life.event("preview-ended", severity="warning", reason=reason),
    )
    life.event("preview", where=preview.where)
    return preview
