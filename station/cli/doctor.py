"""``station doctor``: why the robot does nothing."""

from __future__ import annotations

import json

import click
import msgspec

from station.cli.options import address_of, bus_option, json_option

_MARKS = {"ok": "[green]✓[/]", "warning": "[yellow]![/]", "broken": "[red]✗[/]"}


@click.command("doctor")
@bus_option
@json_option
def command(bus: str | None, as_json: bool) -> None:
    """Check every link from command to motor; exit code 1 when something is broken."""
    from rich.console import Console

    from station.cli.tables import plain
    from station.supervision import doctor

    findings = doctor.run(address_of(bus))
    if as_json:
        click.echo(json.dumps([msgspec.to_builtins(item) for item in findings]))
    else:
        console = Console(highlight=False)
        for item in findings:
            console.print(f"{_MARKS[item.level]} [bold]{plain(item.subject)}[/]: {plain(item.found)}", soft_wrap=True)
            if item.remedy:
                console.print(f"    → {plain(item.remedy)}", soft_wrap=True)
    raise SystemExit(1 if any(item.level == "broken" for item in findings) else 0)
