"""Runbooks: what a person and the station do, in order, before a robot moves.

A runbook is YAML; see `runbooks/` and `docs/runbooks.md`. Reading one validates every step and every server's
configuration, so that a typing mistake is found before anything starts.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec

from station import config, packages, registry
from station.bus.client import Bus
from station.errors import ConfigError, StationError, UsageError, did_you_mean
from station.life import arm_request, controller_request, policy_request, twin_request
from station.life.server import ServerKind
from station.supervision.checks import KINDS, Check
from station.supervision.measure import Measure

IfItDies = Literal["ask", "end", "restart"]

_ONLY_TELL = ("recorder", "sensor", "console")  # roles that move nothing by themselves
_ANSWER = re.compile(r"[A-DF-Za-df-z0-9][A-Za-z0-9_-]*")
SERVER_NAME = re.compile(r"[A-Za-z0-9_-]+")
"""What servers and machines may be called."""
_STEP_KINDS = ("check", "confirm", "start", "note", "arm", "disarm", "policy", "release-motors", "twin", "measure",
               "ask")  # fmt: skip


class CheckStep(msgspec.Struct, frozen=True, kw_only=True):
    """An automatic check, by name, with what it needs (a host, an interface, a key and a rate)."""

    check: str
    what: Check

    def __str__(self) -> str:
        return f"check {self.check} {_chosen(self.what)}".rstrip()  # type: ignore[arg-type]  # every one is a Struct


class Arming(msgspec.Struct, frozen=True, kw_only=True):
    """What a step asks for that arms or disarms the robot of a server; "" for every low-level server."""

    action: arm_request.Action
    server: str = ""
    within_s: float = arm_request.WITHIN_S

    def run(self, bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Ask for it and wait until it is done.

        Raises:
            NotReady: no answer in time.
            Refused: the server said no.
        """
        done = arm_request.ask(bus, self.action, name=self.server, reason="runbook", within_s=self.within_s)
        return "; ".join(f"{name} {arm_request.story(self.action, states)}" for name, states in done.items())

    def __str__(self) -> str:
        return f"{self.action} {self.server}".rstrip()


class TakingOver(msgspec.Struct, frozen=True, kw_only=True):
    """What a step asks for: another policy to drive a robot, given by its name or its server's; "" for the only robot
    that has several policies."""

    policy: str
    robot: str = ""
    within_s: float = policy_request.WITHIN_S

    def run(self, bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Ask for it and wait until it is done.

        Raises:
            NotReady: no answer in time.
            Refused: it does not take over, with the reason.
        """
        return f"{policy_request.ask(bus, self.policy, name=self.robot, within_s=self.within_s)}: {self.policy} drives"

    def __str__(self) -> str:
        return f"policy {self.policy}" + f" robot={self.robot}" * bool(self.robot)


class Releasing(msgspec.Struct, frozen=True, kw_only=True):
    """What a step asks for: a controller of the robot's own to let go of its motors. The robot goes limp."""

    server: str
    within_s: float = controller_request.RELEASED_WITHIN_S

    def run(self, bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Ask for it and wait until it is done.

        Raises:
            NotReady: no answer in time.
            Refused: it does not let go, with the reason.
        """
        robot = arm_request.robot_of(bus, self.server)
        controller_request.ask(bus, robot, "release", within_s=self.within_s)
        return f"{robot}: its own controller has let go of the motors"

    def __str__(self) -> str:
        return f"release-motors {self.server}"


class TwinChange(msgspec.Struct, frozen=True, kw_only=True):
    """What a step asks of a robot twin, given by its registered name: other faults, and time for it to get there."""

    twin: str
    faults: dict[str, Any]
    then_wait_s: float = 0.0
    within_s: float = twin_request.WITHIN_S

    def run(self, bus: Bus, _data: Path, stop: threading.Event) -> str:
        """Ask for it and wait until it is done.

        Raises:
            NotReady: no such twin runs, or no answer in time.
            Refused: it has no such fault.
        """
        twin_request.ask(bus, self.twin, self.faults, within_s=self.within_s)
        bus.clock.wait(stop, self.then_wait_s)
        return f"the twin {self.twin} has {', '.join(f'{name}={value}' for name, value in self.faults.items())}"

    def __str__(self) -> str:
        return f"twin {self.twin} {' '.join(f'{name}={value}' for name, value in self.faults.items())}".rstrip()


class AskStep(CheckStep, frozen=True, kw_only=True):
    """Something is asked of a robot; a check, in that it may fail and is answered by the station."""

    def __str__(self) -> str:
        return str(self.what)


class ConfirmStep(msgspec.Struct, frozen=True, kw_only=True):
    """A sentence that a person says yes to."""

    confirm: str

    def __str__(self) -> str:
        return f"confirm: {self.confirm}"


class QuestionStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A question that a person answers with one of some words, which is kept."""

    ask: str
    answers: tuple[str, ...]

    def __post_init__(self) -> None:
        if len(self.answers) < 2:
            raise ValueError(f"answers: expected two words at least, got {len(self.answers)}")
        for word in self.answers:
            if not _ANSWER.fullmatch(word):
                raise ValueError(
                    f"answers: {word!r} cannot be typed: expected letters, digits, - and _, and no e at its beginning, "
                    "since SPACE and e are the emergency stop"
                )

    def __str__(self) -> str:
        return f"ask: {self.ask}"


class MeasureStep(msgspec.Struct, frozen=True, kw_only=True):
    """What a stream says for a while is measured, compared with what is expected, and kept."""

    what: Measure

    def __str__(self) -> str:
        return str(self.what)


class NoteStep(msgspec.Struct, frozen=True, kw_only=True):
    """A sentence that is shown and recorded."""

    note: str

    def __str__(self) -> str:
        return f"note: {self.note}"


class StartStep(msgspec.Struct, frozen=True, kw_only=True):
    """A server to start, with its validated configuration.

    Attributes:
        start: Its name on the bus; that of its kind, unless the step says with `server` which kind it is.
        kind: What it is.
        config: Its configuration.
        host: The machine that it runs on, by the name under which that has joined the bus; "" for this one.
        ready_within_s: Longest time for loading, and for becoming active [s].
        if_it_dies: ``ask`` the person who attends and stay up meanwhile, where nobody attends as ``end``; ``end``
            takes the station down; ``restart`` starts it again at once, however often it dies after a while.
    """

    start: str
    kind: ServerKind
    config: msgspec.Struct
    host: str = ""
    ready_within_s: float = 20.0
    if_it_dies: IfItDies = "ask"

    def __str__(self) -> str:
        kind = "" if self.start == self.kind.name else f"({self.kind.name}) "
        where = f"on {self.host} " if self.host else ""
        return f"start {self.start} {where}{kind}{_chosen(self.config)}".rstrip()


Step = CheckStep | ConfirmStep | MeasureStep | NoteStep | QuestionStep | StartStep


class Runbook(msgspec.Struct, frozen=True, kw_only=True):
    """A validated runbook.

    Attributes:
        name, description: What it is called, and is for.
        robot: Which robot it drives, to be compared with what runs; "" where a setting of such a server was changed.
        robot_is_real: Whether people stand beside the robot: confirmations then need a person.
        steps: What happens, in order.
        stop_order: Names of servers in the order they are stopped after a failure.
        text: The file as it was read, for the manifest.
    """

    name: str
    robot: str
    steps: tuple[Step, ...]
    stop_order: tuple[str, ...]
    description: str = ""
    robot_is_real: bool = False
    text: str = ""

    @property
    def servers(self) -> tuple[StartStep, ...]:
        """The servers that it starts, in order."""
        return tuple(step for step in self.steps if isinstance(step, StartStep))

    def expect_found(self) -> None:
        """Check that the files and libraries that its servers here need are on this machine; nothing is loaded.

        Raises:
            StationError: one is not; the message names step and server.
        """
        for number, step in enumerate(self.steps, 1):
            if not isinstance(step, StartStep) or step.kind.expect is None or step.host:
                continue
            try:
                step.kind.expect(step.config)
            except StationError as error:
                kind = UsageError if isinstance(error, UsageError) else StationError
                raise kind(f"runbook {self.name} step {number} ({step.start}): {error}") from None

    @property
    def low_level(self) -> tuple[StartStep, ...]:
        """Those of them that drive a robot."""
        return tuple(_low_level(self.steps))


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    runbook: str
    robot: str
    steps: list[dict[str, Any]]
    description: str = ""
    robot_is_real: bool = False
    on_failure: list[dict[str, str]] = []


def shipped() -> dict[str, Path]:
    """Return the files of the runbooks that ship with the station, by name."""
    return {path.stem: path for path in sorted(packages.RUNBOOKS.glob("*.yaml"))}


def find(reference: str) -> Path:
    """Return the file of a runbook: a path, or the name of one that ships with the station.

    Raises:
        UsageError: it is neither.
    """
    path, known = Path(reference), shipped()
    if reference in known:
        return known[reference]
    if reference and (path.is_file() or path.suffix):
        return path
    listed = f"{', '.join(known)} (`station runbooks list` says what each is for), or the path of a file of yours"
    if not reference:
        raise UsageError(f"which runbook? Name one of {listed}")
    raise UsageError(f"unknown runbook {reference!r}{did_you_mean(reference, known)}; expected one of {listed}")


def describe(path: Path) -> tuple[str, str]:
    """Return which robot a runbook's file says that it drives, and what it is for.

    Raises:
        BadFile, ConfigError: it is no runbook.
    """
    file = config.build(_File, config.read_yaml(path), where=str(path))
    return file.robot, file.description


def load(
    path: Path, sets: Sequence[str] = (), hosts: Sequence[str] = (), *, first: Sequence[str] = ()
) -> Runbook:  # fmt: skip
    """Read and validate a runbook.

    Args:
        path: The YAML file.
        sets: ``server.key=value`` options laid over the file.
        hosts: ``server=host`` options likewise, ``server=`` for this machine.
        first: Servers to start before all that it says, where it does not start them itself.

    Raises:
        BadFile, ConfigError, UnknownName: naming the file, step and key.
    """
    data = config.read_yaml(path)
    file = config.build(_File, data, where=str(path))
    listed = [str(step["start"]) for step in file.steps if "start" in step]
    before = [{"start": name} for name in first if name not in listed]
    names = [*(step["start"] for step in before), *listed]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{path}: starts server {name!r} {names.count(name)} times; expected once")
    changes = config.overrides(sets, servers=names)
    places = _places(hosts, names)
    placed = [
        raw | {"host": places[raw["start"]]} if raw.get("start") in places else raw for raw in (*before, *file.steps)
    ]
    steps = tuple(_step(raw, changes, f"{path} step {n}") for n, raw in enumerate(placed, 1))
    if not names:
        raise ConfigError(f"{path}: starts nothing; expected at least one step such as `- start: motion`")
    _expect_started_before_asked(steps, str(path))
    return Runbook(
        name=file.runbook,
        robot="" if any(step.start in changes for step in _low_level(steps)) else file.robot,
        description=file.description,
        robot_is_real=file.robot_is_real,
        steps=steps,
        stop_order=_stop_order(file, names, str(path)),
        text=path.read_text(encoding="utf-8"),
    )


def _places(hosts: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Return on which machine servers are to run, by name."""
    found = {}
    for text in hosts:
        name, is_given, host = text.partition("=")
        if not is_given or name not in names:
            hint = "" if name in names else did_you_mean(name, names)
            raise UsageError(
                f"--on {text}{hint}: expected SERVER=HOST, with a server that the runbook starts: {', '.join(names)}"
            )
        found[name] = host
    return found


def _low_level(steps: Iterable[Step]) -> Iterator[StartStep]:
    return (step for step in steps if isinstance(step, StartStep) and step.kind.role == "low-level")


def _step(raw: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]], where: str) -> Step:
    kind = next((name for name in _STEP_KINDS if name in raw), None)
    if kind is None:
        first = next(iter(raw), "")
        raise ConfigError(
            f"{where}: unknown step {first!r}{did_you_mean(str(first), _STEP_KINDS)}; known: {', '.join(_STEP_KINDS)}"
        )
    if kind == "start":
        return _start(raw, changes, where)
    if kind == "check":
        return _check(raw, where)
    if kind == "measure":
        return _measure(raw, where)
    if isinstance(answers := raw.get("answers"), list):  # yes and no are true and false to YAML
        raw = {**raw, "answers": [("yes" if a else "no") if isinstance(a, bool) else a for a in answers]}
    if kind in _OF_WORDS:
        return config.build(_OF_WORDS[kind], raw, where=where)
    return _asked(raw, kind, where)


def _start(raw: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]], where: str) -> StartStep:
    known = ("start", "server", "host", "with", "ready_within", "if_it_dies")
    for key in raw:
        if key not in known:
            raise ConfigError(f"{where}: unknown key {key!r}{did_you_mean(key, known)}; known: {', '.join(known)}")
    name = str(raw["start"])
    kind: ServerKind = registry.find("server", str(raw.get("server", name)))
    if not SERVER_NAME.fullmatch(name):
        raise ConfigError(f"{where}: start: expected a name of letters, digits, - and _, got {name!r}")
    host = str(raw.get("host") or "")
    if host and not SERVER_NAME.fullmatch(host):
        raise ConfigError(f"{where} ({name}): host: expected a name of letters, digits, - and _, got {host!r}")
    given = raw.get("with") or {}
    if not isinstance(given, dict):
        raise ConfigError(f"{where} ({name}): with: expected a mapping of settings, got {given!r}")
    values = config.merged(given, changes.get(name, {}))
    return StartStep(
        start=name,
        kind=kind,
        config=config.build(kind.config, values, where=f"{where} ({name})"),
        host=host,
        ready_within_s=config.seconds(raw.get("ready_within", 20), where=f"{where}: ready_within"),
        if_it_dies=_if_it_dies(raw, kind, where),
    )


def _if_it_dies(raw: Mapping[str, Any], kind: ServerKind, where: str) -> IfItDies:
    """Return what a runbook wants; or else what only tells is started again, and what moves a robot is asked about."""
    value = raw.get("if_it_dies", "restart" if kind.role in _ONLY_TELL else "ask")
    for known in get_args(IfItDies):
        if value == known:
            return known  # type: ignore[no-any-return]  # one of the literal's own
    raise ConfigError(f"{where}: if_it_dies: expected {', '.join(get_args(IfItDies))}, got {value!r}")


def _check(raw: Mapping[str, Any], where: str) -> CheckStep:
    name = str(raw["check"])
    if name not in KINDS:
        raise ConfigError(f"{where}: unknown check {name!r}{did_you_mean(name, KINDS)}; known: {', '.join(KINDS)}")
    arguments = {key: value for key, value in raw.items() if key != "check"}
    what: Any = config.build(KINDS[name], arguments, where=f"{where} (check {name})")
    return CheckStep(check=name, what=what)


_OF_WORDS: dict[str, type[ConfirmStep | NoteStep | QuestionStep]] = {
    "confirm": ConfirmStep, "note": NoteStep, "ask": QuestionStep,
}  # fmt: skip


def _measure(raw: Mapping[str, Any], where: str) -> MeasureStep:
    known = ("measure", "stream", "for", "expect", "follows", "after_commands", "if_not")
    for key in raw:
        if key not in known:
            raise ConfigError(f"{where}: unknown key {key!r}{did_you_mean(key, known)}; known: {', '.join(known)}")
    for key in ("stream", "for"):
        if key not in raw:
            raise ConfigError(f"{where} (measure): missing key {key}")
    values = {key: value for key, value in raw.items() if key != "for"}
    values["for_s"] = config.seconds(raw["for"], where=f"{where}: for")
    return MeasureStep(what=config.build(Measure, values, where=f"{where} (measure)"))


_ASKED: dict[str, tuple[Any, tuple[str, ...]]] = {
    "arm": (Arming, ("server",)),
    "disarm": (Arming, ("server",)),
    "policy": (TakingOver, ("policy", "robot")),
    "release-motors": (Releasing, ("server",)),
    "twin": (TwinChange, ("twin", "faults", "then_wait")),
}
"""What is asked of a robot or its twin, by the step's name: its type, and its fields; the first is the step's own."""


def _asked(raw: Mapping[str, Any], kind: str, where: str) -> AskStep:
    what, (own, *others) = _ASKED[kind]
    known = (kind, *others, "within")
    for key in raw:
        if key not in known:
            raise ConfigError(f"{where}: unknown key {key!r}{did_you_mean(key, known)}; known: {', '.join(known)}")
    values = {own: raw[kind] if own == kind else raw[kind] or "", **{key: raw[key] for key in others if key in raw}}
    if what is Arming:
        values["action"] = kind
    for key in ("within", "then_wait"):
        if key in raw:
            values[f"{key}_s"] = config.seconds(values.pop(key, raw[key]), where=f"{where}: {key}")
    return AskStep(check=kind, what=config.build(what, values, where=f"{where} ({kind})"))


def _expect_started_before_asked(steps: Sequence[Step], where: str) -> None:
    started: list[str] = []
    policies: list[str] = []
    for number, step in enumerate(steps, 1):
        if isinstance(step, StartStep):
            started.append(step.start)
            own: str | None = getattr(step.config, "policy", None)  # "": that of the robot, which no setting names
            policies += [*getattr(step.config, "policies", ()), *([] if own is None else [own])]
        what = step.what if isinstance(step, CheckStep) else None
        if isinstance(what, TakingOver) and not {what.policy, ""} & set(policies):
            raise ConfigError(
                f"{where} step {number}: {step}{did_you_mean(what.policy, policies)}: no server that a step before it "
                f"starts has this policy in its settings (`policy`, `policies`); "
                f"by then: {', '.join(policies) or 'none'}"
            )
        name = what.server if isinstance(what, Arming | Releasing) else ""
        if name and name not in started:
            raise ConfigError(
                f"{where} step {number}: {step}{did_you_mean(name, started)}: no step before it starts that server; "
                f"started by then: {', '.join(started) or 'none'}"
            )


def _stop_order(file: _File, names: Sequence[str], where: str) -> tuple[str, ...]:
    order = []
    for step in file.on_failure:
        name = step.get("stop", "")
        if list(step) != ["stop"]:
            raise ConfigError(f"{where}: on_failure: expected steps such as `stop: motion`, got {step!r}")
        order.append(name)
        if name not in names:
            raise ConfigError(
                f"{where}: on_failure stops {name!r}{did_you_mean(name, names)}; it starts {', '.join(names) or 'none'}"
            )
    return (*order, *(name for name in reversed(names) if name not in order))


def _chosen(values: msgspec.Struct) -> str:
    """Return the settings that differ from their defaults, as ``key=value``."""
    plain = config.to_plain(values)
    chosen = {field.encode_name: plain[field.encode_name] for field in msgspec.structs.fields(values)
              if field.required or plain[field.encode_name] != _default(field)}  # fmt: skip
    return " ".join(f"{key}={_short(value)}" for key, value in chosen.items())


def _default(field: msgspec.structs.FieldInfo) -> Any:
    if field.default_factory is not msgspec.NODEFAULT:
        return msgspec.to_builtins(field.default_factory(), enc_hook=str)
    return msgspec.to_builtins(field.default, enc_hook=str)


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "…"
