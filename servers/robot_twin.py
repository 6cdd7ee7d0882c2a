"""The server of a robot twin: it ticks, tells how it is, and has its faults switched.

It stands for a robot, so it goes on whatever becomes of the bus: only switching needs that.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec

from station import libraries, registry, safe_yaml
from station.bus import keys
from station.config import to_plain
from station.errors import BadFile, ConfigError, Refused
from station.life.loop import Rate, real_time
from station.life.request import NewRequests, parse
from station.life.server import Life, ServerKind
from station.life.twin_request import STATED_AS, TwinAnswer, TwinRequest
from station.robot_twin import Twin, TwinKind

_REPORT_S = 0.25


class TwinConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of a robot twin.

    Attributes:
        twin: Registered name of the twin.
        options: Its settings.
        faults: What is wrong with it from the start.
        script: YAML file that changes that: a list of ``at_s`` [s since its start] with faults by name; None for none.
        real_time_priority: SCHED_FIFO priority that is asked for; 0 does not ask.
    """

    twin: Annotated[str, registry.named("twin")]
    options: dict[str, Any] = {}
    faults: dict[str, Any] = {}
    script: Path | None = None
    real_time_priority: int = 40

    def __post_init__(self) -> None:
        registry.expect("twin", self.twin)
        self.kind.typed_options(self.options)
        self.kind.typed_faults(self.faults)

    @property
    def kind(self) -> TwinKind:
        """The twin's kind."""
        found: TwinKind = registry.find("twin", self.twin)
        return found

    @property
    def option_types(self) -> dict[str, type[msgspec.Struct]]:
        """Types of the settings that are mappings, by name."""
        return {"options": self.kind.options, "faults": self.kind.faults}


class FaultSwitches:
    """The faults of a twin as they are now.

    Args:
        kind: The twin's kind.
        values: Those of the start, by name.
    """

    def __init__(self, kind: TwinKind, values: dict[str, Any]) -> None:
        self._kind, self._values = kind, dict(values)
        self.faults = kind.typed_faults(values)

    def change(self, values: dict[str, Any], *, is_well: bool = False, where: str = "") -> None:
        """Change some, all others being switched off first where `is_well`.

        Raises:
            ValueError: one that the twin does not have, or not with such a value; nothing is changed then.
        """
        changed = values if is_well else self._values | values
        self.faults = self._kind.typed_faults(changed, where)
        self._values = dict(changed)

    def shown(self) -> dict[str, Any]:
        """Return those that are switched on, by name."""
        return {name: to_plain(getattr(self.faults, name)) for name in self._values}


class ScriptStep(msgspec.Struct, frozen=True):
    """What a script changes, and when [s since the start of the twin]."""

    at_s: float
    faults: dict[str, Any]


def read_script(path: Path, kind: TwinKind) -> list[ScriptStep]:
    """Return the steps of a script, in order.

    Raises:
        BadFile: it cannot be read.
        ConfigError: it is no list of changes, or one of them the twin does not know.
    """
    try:
        rows = safe_yaml.load(safe_yaml.read_bytes(path))
    except OSError as error:
        raise BadFile(f"{path}: cannot be read: {error.strerror}; expected the script of a robot twin") from None
    except safe_yaml.BadYaml as error:
        raise ConfigError(f"{path}: {error}") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(f"{path}: expected a list, each row with at_s and faults by name")
    steps: list[ScriptStep] = []
    switches = FaultSwitches(kind, {})
    for number, row in enumerate(rows, 1):
        values = dict(row)
        at_s = values.pop("at_s", None)
        if not isinstance(at_s, int | float) or (steps and at_s < steps[-1].at_s):
            raise ConfigError(f"{path} row {number}: at_s is {at_s!r}; expected seconds, not before the row above")
        try:
            switches.change(values, where=f"{path} row {number}")
        except ValueError as error:
            raise ConfigError(str(error)) from None
        steps.append(ScriptStep(float(at_s), values))
    return steps


def _expect(config: TwinConfig) -> None:
    kind = config.kind
    libraries.expect(f"the twin {kind.name}", kind.library, kind.extra)
    if config.script is not None:
        read_script(config.script, kind)


def main(config: TwinConfig, life: Life) -> int:
    """Run the twin until asked to stop; return the exit code."""
    kind = config.kind
    script = read_script(config.script, kind) if config.script is not None else []
    switches = FaultSwitches(kind, config.faults)
    twin = kind.make(kind.typed_options(config.options), switches.faults)
    try:
        with life.bus.watch([keys.TWIN]) as watch:
            requests = NewRequests(watch, keys.TWIN)
            life.configured({"server": life.name, STATED_AS: kind.name, "config": to_plain(config)})
            if not life.ready():
                return 0
            if config.real_time_priority:
                life.report(scheduling=real_time(config.real_time_priority))
            _run(life, twin, switches, requests, script)
    finally:
        twin.close()
    return 0


def _run(life: Life, twin: Twin, switches: FaultSwitches, requests: NewRequests, script: list[ScriptStep]) -> None:
    rate, clock = Rate(1.0 / twin.period_s, life.clock), life.clock
    began_s = said_s = clock.monotonic_s()
    life.report(faults=switches.shown(), **twin.health())
    while not life.stopping:
        rate.wait()
        twin.tick()
        now_s = clock.monotonic_s()
        while script and now_s - began_s >= script[0].at_s:
            step = script.pop(0)
            switches.change(step.faults)
            _apply(life, twin, switches, "script")
        if now_s - said_s >= _REPORT_S:
            said_s = now_s
            for answer in _obey(life, twin, switches, requests):
                life.report(changed=msgspec.to_builtins(answer))
            life.report(**msgspec.structs.asdict(rate.stats()), faults=switches.shown(), **twin.health())


def _obey(life: Life, twin: Twin, switches: FaultSwitches, requests: NewRequests) -> Iterator[TwinAnswer]:
    """Do what was asked for since the last call; yield the answer."""
    if (asked := requests.pop()) is None:
        return
    try:
        wanted = parse(asked.data, TwinRequest, "a request to a robot twin")
        if wanted.server not in ("", life.name):
            return
        switches.change(wanted.faults, is_well=wanted.is_well)
    except Refused as error:
        life.event("request-refused", severity="warning", reason=str(error))
    except ValueError as error:
        yield TwinAnswer(id=wanted.id, refused=str(error))
    else:
        _apply(life, twin, switches, wanted.who)
        yield TwinAnswer(id=wanted.id)


def _apply(life: Life, twin: Twin, switches: FaultSwitches, who: str) -> None:
    twin.change(switches.faults)
    life.event("twin-changed", severity="warning", faults=switches.shown(), who=who)


KIND = ServerKind(
    name="robot-twin",
    role="sensor",
    summary="a program at the other end of a real robot's cable that is no robot, with faults",
    config=TwinConfig,
    main=main,
    expect=_expect,
    loads_first=True,
)
