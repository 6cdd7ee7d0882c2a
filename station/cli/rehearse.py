"""``station rehearse``: motions through policy and simulation, offline."""

from __future__ import annotations

import glob
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click
import msgspec

from station import assets, registry
from station.cli.options import json_option
from station.cli.tables import Column, print_table
from station.errors import UnknownName

if TYPE_CHECKING:
    from station.rehearse import Rehearsal


@click.command("rehearse")
@click.argument("motions", nargs=-1, required=True)
@click.option("--policy", required=True, help="Name of the policy family (twist2, twist, …).")
@click.option("--checkpoint", default="", help="File of the policy.  [default: the family's]")
@click.option("--robot-model", default=None, help="MJCF of the robot.  [default: the station's]")
@click.option("--physics-dt", "physics_dt_s", default=0.001, show_default=True, help="Physics time step [s].")
@click.option("--holes", type=click.Choice(["refuse", "bridge"]), default="refuse", show_default=True,
              help="What is done with bad frames inside a motion.")  # fmt: skip
@click.option("--jobs", default=0, help="Processes side by side.  [default: one per core]")
@json_option
def command(
    motions: Sequence[str], policy: str, checkpoint: str, robot_model: str | None, physics_dt_s: float,
    holes: str, jobs: int, as_json: bool,
) -> None:  # fmt: skip
    """Run MOTIONS (files, or patterns such as 'twist2:motions/*.pkl') in a closed loop and print how each went.

    Exit code 1 when the robot fell in any of them.
    """
    from station.life.rig import DEFAULT_ROBOT_MODEL, RigConfig
    from station.rehearse import rehearse_all

    if policy not in (known := registry.names("policy")):
        raise UnknownName("policy", policy, known)  # before any motion is read
    named = [reference for motion in motions for reference in _expand(motion)]
    config = RigConfig(
        policy=policy, checkpoint=checkpoint, robot_model=robot_model or DEFAULT_ROBOT_MODEL, physics_dt_s=physics_dt_s
    )
    done: list[Rehearsal] = []

    def tell(result: Rehearsal) -> None:
        done.append(result)
        click.echo(f"{len(done)}/{len(named)} {result.motion}", err=True)

    results = rehearse_all(named, config, holes=holes, jobs=jobs, on_done=tell)
    if as_json:
        click.echo(json.dumps({"motions": msgspec.to_builtins(results)}))
    else:
        _print(results)
    raise SystemExit(1 if any(result.fell for result in results) else 0)


def _expand(motion: str) -> list[str]:
    """Return the references that a pattern names; anything that is no pattern is left for the loader."""
    if not glob.has_magic(motion):
        return [motion]
    found, base = assets.expand(motion), assets.root()
    if base is None or ":" not in motion:
        return [str(path) for path in found]
    return [f"{(rel := path.relative_to(base)).parts[0]}:{'/'.join(rel.parts[1:])}" for path in found]


def _print(results: Sequence[Rehearsal]) -> None:
    columns = [Column("motion", "left"), *map(Column, ("fell", "joint error", "height error", "simulated", "speed"))]
    rows = [
        (
            result.motion,
            f"[red]at {result.fell_at_s:.1f} s[/]" if result.fell_at_s is not None else "[green]no[/]",
            _number(result.mean_joint_error_rad, "rad"),
            _number(result.mean_root_height_error_m, "m"),
            f"{result.seconds:.1f} s",
            f"{result.speed_x_realtime:.1f} x",
        )
        for result in results
    ]
    print_table(columns, rows)


def _number(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}"
