"""Configuration is a type; YAML and ``--set`` only fill it in.

Every problem is one line that names the file or option, the key, what was expected and what came.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from station import safe_yaml
from station.errors import BadFile, ConfigError, did_you_mean

T = TypeVar("T", bound=msgspec.Struct)

_DURATION = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*(ms|s|min|h|)\s*$")
_EXPONENT = re.compile(r"^[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
_NO_CHOICE = "Invalid enum value "  # what comes behind it is the value, also where its place is not told
_MISSING = "Object missing required field "
_STEPS = re.compile(r"\[[^\]]*\]|[^.\[]+")
_SECONDS = {"ms": 1e-3, "s": 1.0, "": 1.0, "min": 60.0, "h": 3600.0}


def build(kind: type[T], values: Mapping[str, Any], *, where: str) -> T:
    """Make a configuration of a type from plain values.

    Args:
        kind: A `msgspec.Struct`; unknown keys are refused.
        values: What the user wrote.
        where: What the user calls the place, for the message: a file and step, or an option.

    Raises:
        ConfigError: an unknown key, a missing one, or a value of the wrong type.
    """
    _refuse_unknown_keys(kind, values, where)
    try:
        return msgspec.convert(dict(values), kind, strict=True, dec_hook=_decode_path)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{where}: {_plain(error, kind, values)}") from None


def build_options(kind: type[T], values: Mapping[str, Any], *, where: str) -> T:
    """As `build`, of a mapping within a configuration, whose ``__post_init__`` may raise nothing else.

    Raises:
        ValueError: as `build`.
    """
    try:
        return build(kind, values, where=where)
    except ConfigError as error:
        raise ValueError(str(error)) from None


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping.

    Raises:
        BadFile: the file is missing or unreadable.
        ConfigError: not YAML, or not a mapping.
    """
    try:
        text = safe_yaml.read_bytes(path).decode()
    except FileNotFoundError:
        near = did_you_mean(path.name, [p.name for p in path.parent.glob("*.yaml")]) if path.parent.is_dir() else ""
        raise BadFile(f"{path}: no such file{near}") from None
    except OSError as error:
        raise BadFile(f"{path}: cannot be read: {error.strerror}; expected a YAML file") from None
    except UnicodeDecodeError as error:
        raise BadFile(f"{path}: not UTF-8 text (byte {error.start}); expected a YAML file") from None
    return parse_yaml(text, where=str(path))


def parse_yaml(text: str, *, where: str) -> dict[str, Any]:
    """Read a YAML mapping from text; raises `ConfigError` like `read_yaml`."""
    try:
        data = safe_yaml.load(text)
    except safe_yaml.BadYaml as error:
        raise ConfigError(f"{where}: {error}") from None
    if not isinstance(data, dict):
        raise ConfigError(f"{where}: expected a mapping of keys to values, got {type(data).__name__}")
    return data


def overrides(options: Sequence[str], *, servers: Sequence[str] | None) -> dict[str, dict[str, Any]]:
    """Read ``--set`` options.

    Args:
        options: ``server.key=value`` when `servers` are given, else ``key=value``; values are YAML.
        servers: Names that may stand before the dot; None for the options of a single server.

    Returns:
        Values by key, by server (under ``""`` when `servers` is None).

    Raises:
        ConfigError: not of that form, or an unknown server.
    """
    result: dict[str, dict[str, Any]] = {}
    form = "key=value" if servers is None else "server.key=value"
    for option in options:
        name, equals, text = option.partition("=")
        server, dot, key = name.partition(".") if servers is not None else ("", ".", name)
        if not equals or not dot or not key:
            raise ConfigError(f"--set {option}: expected {form}")
        if servers is not None and server not in servers:
            raise ConfigError(
                f"--set {option}: no server {server!r}{did_you_mean(server, servers)}; "
                f"this runbook starts {', '.join(servers)}"
            )
        _assign(result.setdefault(server, {}), key, _value(text, option))
    return result


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with changes laid over them, mappings within mappings included."""
    result = dict(base)
    for key, value in changes.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return result


def seconds(value: str | float, *, where: str) -> float:
    """Return a duration in seconds; ``20``, ``20s``, ``500ms``, ``2min``, ``1h``."""
    match = _DURATION.match(str(value))
    found = float(match[1]) * _SECONDS[match[2]] if match is not None else math.inf
    if not math.isfinite(found):
        raise ConfigError(f"{where}: expected a duration such as 20s, 500ms or 2min, got {value!r}")
    return found


def to_plain(config: msgspec.Struct) -> dict[str, Any]:
    """Return a configuration as plain values that JSON and YAML can hold."""
    plain: dict[str, Any] = msgspec.to_builtins(config, enc_hook=str)
    return plain


def _assign(target: dict[str, Any], dotted: str, value: Any) -> None:
    *path, last = dotted.split(".")
    for key in path:
        target = target.setdefault(key, {})
    target[last] = value


def _value(text: str, option: str) -> Any:
    # "twist2:motions/x.pkl" and friends are text to YAML already; "a: b" would not be, and nobody means a mapping here.
    try:
        value = safe_yaml.load(text)
    except safe_yaml.BadYaml as error:
        raise ConfigError(f"--set {option}: the value is {error}; put quotes around text") from None
    if isinstance(value, str) and _EXPONENT.match(value):
        return float(value)  # YAML 1.1 takes 1e9 for text
    return text if isinstance(value, dict) else value


def _decode_path(kind: type, value: Any) -> Any:
    if issubclass(kind, Path):
        if isinstance(value, str):
            return Path(value)
        raise ValueError(f"expected a path, got {value!r}")
    raise NotImplementedError(f"{kind.__name__} from {value!r}")


def _refuse_unknown_keys(kind: type[msgspec.Struct], values: Mapping[str, Any], where: str) -> None:
    """Refuse keys that a type, or one of the types within it, does not have."""
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in values.items():
        if key not in fields:
            listed = ", ".join(sorted(fields)) or "none"
            raise ConfigError(f"{where}: unknown key {key!r}{did_you_mean(str(key), fields)}; known: {listed}")
        inner = fields[key]
        if get_origin(inner) is dict and _is_struct(of := get_args(inner)[1]) and isinstance(value, Mapping):
            for name, member in value.items():
                if not isinstance(member, Mapping):
                    raise ConfigError(f"{where}: {key}.{name}: expected a mapping, got {member!r}")
                _refuse_unknown_keys(of, member, f"{where}: {key}.{name}")
        elif _is_struct(inner) and isinstance(value, Mapping):
            _refuse_unknown_keys(inner, value, f"{where}: {key}")


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _plain(error: msgspec.ValidationError, kind: type[msgspec.Struct], values: Mapping[str, Any]) -> str:
    """Turn "Expected `float`, got `str` - at `$.rate_hz`" into "rate_hz: expected float, got 'fast'"."""
    text, _, path = str(error).partition(" - at `")
    place = path.rpartition("$")[2].rstrip("`").lstrip(".")
    value, wanted = _at(place, kind, values)
    if path.startswith("key`") and get_origin(wanted) is dict:
        wanted = get_args(wanted)[0]
    known = sorted(str(choice) for choice in choices(wanted))
    if text.startswith(_NO_CHOICE) and known:
        came = text.removeprefix(_NO_CHOICE)
        hint = did_you_mean(came.strip("'"), known)
        text = f"expected {' or '.join(known)}, got {came}{hint}"
    elif not isinstance(value, Mapping):
        text = re.sub(r"got `[^`]*`$", lambda _: f"got {value!r}", text)
    if text.startswith(_MISSING):
        text += _expected_in(wanted if place else kind, text.removeprefix(_MISSING).strip("`"))
    text = text.replace("`object`", "a mapping").replace("`", "").replace(_MISSING, "missing key ")
    text = text[:1].lower() + text[1:]
    return f"{place}: {text}" if place else text


def _expected_in(kind: Any, key: str) -> str:
    """Return in words what a key of a type may be, where it is one of a few choices, else nothing."""
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)} if _is_struct(kind) else {}
    known = sorted(map(str, choices(fields.get(key))))
    return f": expected {' or '.join(known)}" if known else ""


def _at(place: str, kind: Any, values: Any) -> tuple[Any, Any]:
    """Return the value at a place such as ``gate.hold_after_s`` or ``ids[0]``, and the type that is wanted there."""
    for step in _STEPS.findall(place):
        of = get_args(kind)
        if _is_struct(kind) and isinstance(values, Mapping) and step in values:
            fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
            values, kind = values[step], fields.get(step)
        elif get_origin(kind) in (list, tuple) and isinstance(values, list | tuple):
            number = int(step[1:-1])
            values, kind = values[number], of[number if number < len(of) and Ellipsis not in of else 0]
        elif get_origin(kind) is dict and step == "[...]":  # the message does not say which
            values, kind = {}, of[1]
        else:
            return {}, None
    return values, kind


def choices(wanted: Any) -> list[Any]:
    """Return what a Literal allows, one that may be absent too, in the order in which the type has it."""
    if get_origin(wanted) is Literal:
        return list(get_args(wanted))
    return [choice for part in get_args(wanted) for choice in choices(part)]
