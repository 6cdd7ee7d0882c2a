"""``station describe``: what a robot says of itself, or what a key holds, with what it holds now."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from station.cli import candidates
from station.cli.options import bus_option, json_option
from station.errors import BusError, UsageError, did_you_mean
from station.printable import printable

if TYPE_CHECKING:
    from station.api.live import Station, Value
    from station.bus.contracts import Contracts
    from station.contract import Contract
    from station.description import RobotDescription


@click.command("describe")
@click.argument("name", default="", shell_complete=candidates.described)
@bus_option
@json_option
def command(name: str, bus: str | None, as_json: bool) -> None:
    """Describe NAME, a robot or a key; without it, every robot that is known.

    On a bus, robots are those that describe themselves there too, and a key shows what it holds now.
    """
    show(name, bus, as_json=as_json)


def show(name: str, bus: str | None, *, as_json: bool) -> None:
    """Print what a name stands for, a robot or a key; every robot for "".

    Raises:
        BusError: the bus that was named is not there.
        UsageError: it is no robot, and no key that anything describes.
    """
    with connected(bus) as (station, known):
        found, value = _find(name, known, station)
    if as_json:
        click.echo(json.dumps(_plain(found, value)))
    else:
        _print(found, value, known)


@contextmanager
def connected(bus: str | None) -> Iterator[tuple[Station | None, Contracts]]:
    """Give a line to the bus, and what is known of robots and keys; None where no bus is there and none was named.

    Raises:
        BusError: the bus that was named is not there.
    """
    from station.api.live import Station
    from station.bus import address as addresses
    from station.bus.contracts import Contracts

    try:
        station = Station(bus, name="describe")
    except BusError as error:
        if bus is not None:
            raise
        if addresses.ENVIRONMENT_VARIABLE in os.environ:
            click.echo(f"station: {error}; this is what is known without it", err=True)
        yield None, Contracts()
        return
    with station:
        yield station, station.contracts()


def _find(name: str, known: Contracts, station: Station | None) -> tuple[Any, Value | None]:
    """Return what a name stands for, all robots for none, and the value of a key.

    Raises:
        UsageError: it is no robot and no key that anything describes.
    """
    if not name:
        return [robot for each in known.robots() if (robot := known.robot(each)) is not None], None
    if (robot := known.robot(name)) is not None:
        return robot, None
    value = station.read(name) if station is not None else None
    if (contract := known.get(name)) is not None:
        return contract, value
    if value is not None:
        raise UsageError(f"key {name!r}: it is there, {len(value.data)} bytes, and nothing describes it")
    names = [*known.robots(), *(item.key for item in known.all())]
    raise UsageError(f"{name!r}: no robot, and no key that anything describes{did_you_mean(name, names)}")


def _plain(found: Any, value: Value | None) -> Any:
    import msgspec

    plain = msgspec.to_builtins(found)
    if value is None:
        return plain
    return plain | {"writer": value.writer, "written_ns": value.written_ns, "value": _shown(value)}


def _shown(value: Value) -> Any:
    """Return what a key holds, as JSON can have it; None where its bytes do not fit its contract."""
    try:
        if value.contract is not None and (value.contract.vector_codec or value.contract.codec == "f64-rows"):
            return value.vector().tolist()
        return value.json() if value.contract is not None and value.contract.codec == "json" else None
    except UsageError:
        return None


def _print(found: Any, value: Value | None, known: Contracts) -> None:
    from station.contract import Contract

    if isinstance(found, Contract):
        _print_key(found, value)
        return
    robots = found if isinstance(found, list) else [found]
    for index, robot in enumerate(robots):
        if index:
            click.echo()
        _print_robot(robot, known, is_whole=not isinstance(found, list))


def _print_robot(robot: RobotDescription, known: Contracts, *, is_whole: bool) -> None:
    from station.cli.tables import Column, plain, print_table

    stands = "stands on its own" if robot.has_base else "fixed to the ground"
    click.echo(printable(f"{robot.name}: {robot.model}, {len(robot.joints)} joints, {stands}"))
    if is_whole and robot.joints:
        limb_of = {joint: limb for limb, joints in robot.groups.items() for joint in joints}
        units = ("lower [rad]", "upper [rad]", "speed [rad/s]", "torque [N m]")
        columns = [Column("joint", "left"), Column("limb", "left"), *(Column(plain(unit)) for unit in units)]
        rows = []
        for joint in robot.joints:
            limits = (joint.lower, joint.upper, joint.speed, joint.torque)
            shown = ("–" if limit is None else f"{limit:g}" for limit in limits)
            rows.append((plain(joint.name), plain(limb_of.get(joint.name, "")), *shown))
        print_table(columns, rows)
    columns = [Column("key", "left"), Column("role", "left"), Column("numbers"), Column("rate"), Column("note", "left")]
    print_table(columns, [
        (plain(item.key), item.role, str(len(item.elements) or ""),
         "" if item.rate_hz is None else f"{item.rate_hz:g} Hz", plain(item.note))
        for item in known.of(robot.name)
    ])  # fmt: skip


def _print_key(contract: Contract, value: Value | None) -> None:
    from station.cli.tables import Column, plain, print_table

    note = f" — {contract.note}" if contract.note else ""
    click.echo(printable(f"{contract.key}: {contract.role}, {contract.codec}, {contract.family}{note}"))
    held = None if value is None else _shown(value)
    if value is not None:
        click.echo(printable(f"written by {value.writer or 'a program that stamps nothing'}, {len(value.data)} bytes"))
    names, now = contract.elements, held if isinstance(held, list) else []
    if names and value is not None and len(now) != len(names):
        click.echo(f"what it holds now does not fit: {len(now)} numbers for {len(names)} names")
    if names:
        fits = len(now) == len(names)
        columns = [Column("number"), Column("name", "left"), Column("unit", "left"), *([Column("now")] if fits else [])]
        print_table(columns, [
            (str(index), plain(item.name), plain(item.unit), *([f"{now[index]:.6g}"] if fits else []))
            for index, item in enumerate(names)
        ])  # fmt: skip
    elif held is not None:
        for line in json.dumps(held, indent=2).splitlines():
            click.echo(printable(line))
