"""``python -m tests.fuzz --cases 1000000 --seed N``: a long campaign, with progress and figures."""

from __future__ import annotations

import sys
import time

import click

from tests.fuzz.campaign import Outcome, run, seed, sweep


@click.command()
@click.option("--cases", type=click.IntRange(1), default=100_000, show_default=True, help="Mutants in all.")
@click.option("--seed", "of", default="", help="Any text; without it, a new one.")
@click.option("--only", default="", help="Parsers whose names begin so.")
@click.option("--sweep", "is_sweep", is_flag=True, help="Instead of mutants, every token at every place.")
def main(cases: int, of: str, only: str, is_sweep: bool) -> None:
    """Give mutants of good values to every parser of values of the bus; exit code 1 when one ends by it."""
    from tests.fuzz.parsers import PARSERS

    of = of or seed()
    parsers = [parser for parser in PARSERS if parser.name.startswith(only)]
    began_s = time.monotonic()

    def tell(outcome: Outcome) -> None:
        done, passed_s = outcome.cases.total(), time.monotonic() - began_s
        left = "" if is_sweep else f" of {cases}, {passed_s / done * (cases - done):.0f} s left"
        click.echo(f"{done}{left}, {len(outcome.findings)} findings, {passed_s:.0f} s", err=True)

    outcome = sweep(parsers, tell) if is_sweep else run(cases, of, parsers, tell)
    for name, count in outcome.cases.items():
        mean_us, slowest_ms = outcome.seconds[name] / count * 1e6, outcome.slowest_s[name] * 1e3
        refused = f"{outcome.refused[name]} refused by an error" if outcome.refused[name] else ""
        click.echo(f"{name:<58} {count:>8} cases  {mean_us:>6.0f} us  slowest {slowest_ms:>6.1f} ms  {refused}")
    click.echo(str(outcome))
    sys.exit(1 if outcome.findings else 0)


if __name__ == "__main__":
    main()
