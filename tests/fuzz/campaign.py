"""Many mutants to every parser: what may not be raised is a finding, told with what makes it again."""

from __future__ import annotations

import os
import random
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from tests.fuzz.mutants import every, mutant
from tests.fuzz.parsers import PARSERS, Parser

SEED_VARIABLE = "STATION_FUZZ_SEED"
_MOST_FINDINGS = 3  # of a parser: what breaks once breaks a thousand times


@dataclass(frozen=True)
class Finding:
    """A value that a parser may not end by.

    Attributes:
        parser: Its name.
        case: Number of the mutant.
        data: The value.
        error: Where and how it ended.
    """

    parser: str
    case: int
    data: bytes
    error: str

    def __str__(self) -> str:
        shown = repr(self.data[:300]) + ("…" if len(self.data) > 300 else "")
        return f"{self.parser}, case {self.case}: {shown}\n{self.error}"


@dataclass
class Outcome:
    """What came of a campaign: cases by parser, those that a parser refused with an error of its promise, findings."""

    seed: str
    cases: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    slowest_s: dict[str, float] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def __str__(self) -> str:
        again = f"again: {SEED_VARIABLE}={self.seed}, or python -m tests.fuzz --seed {self.seed}"
        told = "\n\n".join(str(finding) for finding in self.findings)
        return f"{told}\n\n{len(self.findings)} findings in {self.cases.total()} cases; {again}"


def seed() -> str:
    """Return the seed that the environment asks for: a text, ``random`` for a new one, or none for the usual one."""
    wanted = os.environ.get(SEED_VARIABLE, "12")
    return str(random.SystemRandom().randrange(10**9)) if wanted == "random" else wanted


def run(
    cases: int, of: str, parsers: Sequence[Parser] = PARSERS, tell: Callable[[Outcome], None] = lambda outcome: None
) -> Outcome:
    """Give each parser its share of so many mutants, in rounds so that progress says something of all of them."""
    return _give(_mutants(cases, of, parsers), Outcome(of), tell)


def sweep(parsers: Sequence[Parser] = PARSERS, tell: Callable[[Outcome], None] = lambda outcome: None) -> Outcome:
    """Give each parser its good values with every token at every place: what random mutants may miss."""
    values = ((parser, number, data) for parser in parsers for good in parser.valid for number, data in _each(good))
    return _give(values, Outcome("none, every token at every place"), tell)


def _give(values: Iterable[tuple[Parser, int, bytes]], outcome: Outcome, tell: Callable[[Outcome], None]) -> Outcome:
    broken: Counter[str] = Counter()
    with warnings.catch_warnings(), np.errstate(all="ignore"):  # a warning ends nobody
        warnings.simplefilter("ignore", RuntimeWarning)
        for parser, number, data in values:
            began_s = time.process_time()
            error = attempt(parser, data, outcome)
            took_s = time.process_time() - began_s
            outcome.cases[parser.name] += 1
            outcome.seconds[parser.name] += took_s  # type: ignore[assignment]
            outcome.slowest_s[parser.name] = max(took_s, outcome.slowest_s.get(parser.name, 0.0))
            if error and (broken := broken + Counter([parser.name]))[parser.name] <= _MOST_FINDINGS:
                outcome.findings.append(Finding(parser.name, number, data, error))
            if outcome.cases.total() % 10_000 == 0:
                tell(outcome)
    return outcome


def attempt(parser: Parser, data: bytes, outcome: Outcome | None = None) -> str:
    """Give a parser a value; return how it ended where it may not, else ""."""
    try:
        parser.parse(data)
    except parser.promise:
        if outcome is not None:
            outcome.refused[parser.name] += 1
    except Exception:  # noqa: BLE001 - whatever it is, it is a finding
        return traceback.format_exc(limit=-5, chain=False)
    return ""


def _mutants(cases: int, of: str, parsers: Sequence[Parser]) -> Iterator[tuple[Parser, int, bytes]]:
    for turn in range(cases):
        number, parser = turn // len(parsers), parsers[turn % len(parsers)]
        rng = random.Random(f"{of}/{parser.name}/{number}")
        yield parser, number, mutant(rng.choice(parser.valid), rng)


def _each(good: bytes) -> Iterator[tuple[int, bytes]]:
    yield from enumerate(every(good))
