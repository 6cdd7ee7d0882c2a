"""The progress of a run as a few tidy lines, for a terminal that shows them in place and for one that does not."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from station.control.gate import LATCHED
from station.episode.quality.falls import UPRIGHT_RAD
from station.life.server import Health
from station.printable import printable
from station.protocols import FALL_TILT_RAD
from station.view.progress import ArmProgress, MotionProgress, PolicyProgress, Progress, RobotProgress

_TURNING, _TURNS_PER_S = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏", 8.0
_NAMES, _BAR = 8, 30  # characters
_WORDS = {"unconfigured": "loading", "inactive": "ready", "active": "running", "finalized": "ended"}
_COLOURS = {"loading": "yellow", "ready": "cyan", "running": "green", "ended": "dim", "starting": "dim", "died": "red"}


def panel(
    progress: Progress, names: Sequence[str], step: str = "", died: Mapping[str, str] | None = None
) -> RenderableType:
    """Return the progress as lines.

    Args:
        progress: What was seen.
        names: Servers of the run, in the order of their start.
        step: What is being done meanwhile, "" for nothing.
        died: How those ended that were not started again, by name.
    """
    died = died or {}
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", no_wrap=True, min_width=_NAMES)
    table.add_column(overflow="fold")
    states = {health.name: health for health in progress.servers}
    words = {name: "died" if name in died else _word(states.get(name)) for name in names}
    if step or any(word != "running" for word in words.values()):
        table.add_row("servers", _servers(words))
    for name, how in died.items():
        table.add_row(escape(name), Text(f"died: {printable(how)}", style="red"))
    if progress.motion is not None:
        table.add_row("motion", _motion(progress.motion))
    for health in progress.servers:
        if health.state == "active" and "engaged" in health.detail:
            table.add_row("operator", _operator(health))
            if said := health.detail.get("help"):
                table.add_row("controls", Text(printable(str(said)), style="dim"))
    if progress.robot is not None:
        table.add_row("robot", Text.from_markup(_robot(progress.robot)))
    if progress.arm is not None:
        table.add_row("arm", _arm(progress.arm))
    if progress.policy is not None:
        table.add_row("policy", Text.from_markup(_policy(progress.policy)))
    if progress.recorder is not None and progress.recorder.state == "recording":
        recorder = progress.recorder
        lost = f"   [red]{recorder.dropped} dropped[/]" if recorder.dropped else ""
        said = f"{_thousands(recorder.messages)} messages   {recorder.bytes / 1e6:.1f} MB{lost}"
        table.add_row("recorder", Text.from_markup(f"[red]●[/] {said}"))
    turning = _TURNING[int(time.monotonic() * _TURNS_PER_S) % len(_TURNING)]
    return Group(*([f"[cyan]{turning}[/] [dim]{escape(step)}[/]"] if step else []), table)


def line(progress: Progress) -> str:
    """Return the progress as one plain line; "" where nothing moves yet."""
    motion, robot = progress.motion, progress.robot
    if motion is None:
        return ""
    parts = [f"{doing(motion)}, {motion.time_s:.1f} of {motion.duration_s:.1f} s"]
    if robot is not None:
        height = "" if robot.height_m is None else f", base at {robot.height_m:.2f} m"
        parts.append(f"{_posture(robot.tilt_rad)}, leans {math.degrees(robot.tilt_rad):.0f}°{height}")
    if progress.recorder is not None and progress.recorder.state == "recording":
        parts.append(f"{_thousands(progress.recorder.messages)} messages")
    return "; ".join(parts)


def doing(motion: MotionProgress) -> str:
    """Return what is being played: the clip, or the phase while none is."""
    if motion.phase != "playing":
        return f"{motion.name}: {motion.phase}" if motion.phase else motion.name
    return f"{motion.name}: {motion.clip}" if motion.clip else motion.name


def _operator(health: Health) -> Text:
    """Return whether an operator drives and, if not, why."""
    said = health.detail
    mode = f" ({printable(str(said['mode']))})" if said.get("mode") else ""
    if said["engaged"]:
        return Text(f"engaged{mode}", style="green")
    return Text(f"not engaged{mode}: {printable(str(said.get('why_not', '')))}", style="yellow")


def _servers(words: Mapping[str, str]) -> Text:
    return Text.from_markup("   ".join(f"{escape(name)} [{_COLOURS[word]}]{word}[/]" for name, word in words.items()))


def _word(health: Health | None) -> str:
    return "starting" if health is None else _WORDS.get(health.state, health.state)


def _motion(motion: MotionProgress) -> RenderableType:
    row = Table.grid(padding=(0, 2))
    share = min(max(motion.time_s / (motion.duration_s or 1.0), 0.0), 1.0)
    bar = ProgressBar(total=1.0, completed=share, width=_BAR, complete_style="cyan",
                      finished_style="green")  # fmt: skip
    said = escape(printable(doing(motion)))
    row.add_row(bar, f"{motion.time_s:4.1f} / {motion.duration_s:.1f} s", f"[bold cyan]{said}[/]")
    return row


def _robot(robot: RobotProgress) -> str:
    posture = _posture(robot.tilt_rad)
    colour = {"upright": "green", "leaning": "yellow", "fallen": "red"}[posture]
    height = "" if robot.height_m is None else f"   base {robot.height_m:.2f} m"
    falls = f"   [red]{robot.falls} {'fall' if robot.falls == 1 else 'falls'}[/]" if robot.falls else ""
    gate = f"   gate {escape(printable(robot.gate))}" if robot.gate else ""
    return f"[{colour}]● {posture:<8}[/] lean {math.degrees(robot.tilt_rad):4.1f}°{height}{gate}{falls}"


def _arm(arm: ArmProgress) -> Text:
    """Gate and rates; why nothing is followed, where something is wrong."""
    rates = "" if arm.sync_hz is None else f"   {arm.sync_hz:.0f} heartbeats/s   {arm.send_hz or 0.0:.0f} targets/s"
    why = f": {printable(arm.reason)}" if arm.gate in LATCHED else ""
    colour = "red" if arm.gate in LATCHED else "green" if arm.gate == "tracking" else "yellow"
    text = Text(f"● {printable(arm.gate)}{why}", style=colour)
    return text.append(f"   {printable(arm.backend)}, {printable(arm.profile)}{rates}", style="default")


def _posture(tilt_rad: float) -> str:
    return "fallen" if tilt_rad > FALL_TILT_RAD else "leaning" if tilt_rad > UPRIGHT_RAD else "upright"


def _policy(policy: PolicyProgress) -> str:
    parts = [escape(printable(policy.name))]
    if policy.rate_hz is not None:
        parts.append(f"{policy.rate_hz:.1f} Hz")
    if policy.inference_s is not None:
        parts.append(f"inference {policy.inference_s * 1e3:.2f} ms")
    if policy.latency_s is not None:
        parts.append(f"command to joints {policy.latency_s * 1e3:.1f} ms")
    return "   ".join(parts)


def _thousands(number: int) -> str:
    return f"{number:,}".replace(",", " ")
