"""What ``station check`` and ``station audit`` say of an episode, each in a process of its own; what of it is new."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from tests.corruption.files import MANIFEST
from tests.corruption.parts import Harm

ROOT = Path(__file__).parents[2]
UNREADABLE = "not checked"
RANKS = ("good", "usable", "reject", UNREADABLE)
NEAR_S = 1.0
"""A reason that names an instant names that of the harm if it is so near to its beginning, end or middle [s]."""

Cell = Literal["full", "key", "told", "missed", "no fit", "failed"]

_TIMEOUT_S = 300.0
_INSTANT = re.compile(
    r"(?<!for )(?<!last )(?<!than )(?<![\d.])(\d+(?:\.\d+)?)(?= ?s\b| ?(?:to|and|until|–|-) ?\d+(?:\.\d+)? ?s\b)"
)
_FROM_END = re.compile(r"\blast (\d+(?:\.\d+)?) ?s\b")
_DURATION = re.compile(r"^timing:.*?^  duration_s: ([\d.]+)", re.MULTILINE | re.DOTALL)
_TIME_FIELDS = {"at_s", "from_s", "to_s", "begin_s", "end_s", "first_s", "last_s"}
_CHANGES = re.compile(r"\b(?=[0-9a-f]*\d)[0-9a-f]{6,}…?|\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Verdict:
    """What was said of an episode.

    Attributes:
        verdict: ``good``, ``usable``, ``reject``, or ``not checked`` for an episode that could not be read.
        reasons: Rule, verdict, text, and whatever else stands in each reason.
        audit: In short what ``station audit`` found.
        audit_code: Its exit code; 0 where nothing is different.
        length_s: How long the episode is, by its manifest [s]; 0 where that does not say.
    """

    verdict: str
    reasons: list[dict[str, Any]] = field(default_factory=list)
    audit: str = ""
    audit_code: int = 0
    length_s: float = 0.0

    def to_plain(self) -> dict[str, Any]:
        return asdict(self)


def judge(folder: Path, *, is_audited: bool = True) -> Verdict:
    """Check an episode, and audit it; by the rules that ship."""
    done = _station("check", str(folder), "--json", "--no-write")
    if done.stdout.startswith("{"):
        quality = json.loads(done.stdout)
        verdict, reasons = quality["verdict"], list(quality["reasons"])
    else:
        verdict = UNREADABLE
        reasons = [{"rule": UNREADABLE, "verdict": "reject", "text": _last_line(done)}]
        if done.returncode != 2:
            reasons[0]["rule"] = "crashed"
    said = _DURATION.search((folder / MANIFEST).read_text(encoding="utf-8"))
    length_s = float(said[1]) if said else 0.0
    if not is_audited:
        return Verdict(verdict, reasons, length_s=length_s)
    audit = _station("audit", str(folder), "--json")
    return Verdict(verdict, reasons, _audit_words(audit), audit.returncode, length_s)


def new_reasons(found: Verdict, before: Verdict) -> list[dict[str, Any]]:
    """Return the reasons that were not given before: by rule, severity and words, whatever the numbers in them."""
    known = {_words(reason) for reason in before.reasons}
    return [reason for reason in found.reasons if _words(reason) not in known]


def cell(found: Verdict, before: Verdict, harm: Harm) -> Cell:
    """Say how well a check told a harm.

    Returns:
        ``full`` for a reason that names what was harmed and, where it has a beginning, when; ``key`` for one that names
        only what; ``told`` for any new reason or a worse verdict; ``missed``.
    """
    reasons = new_reasons(found, before)
    if any(reason["rule"] == "crashed" for reason in reasons):
        return "failed"
    naming = [reason for reason in reasons if _names(reason, harm)]
    if any(harm.from_s is None or _times(reason, harm, found.length_s) for reason in naming):
        return "full"
    if naming:
        return "key"
    return "told" if reasons or RANKS.index(found.verdict) > RANKS.index(before.verdict) else "missed"


def _names(reason: dict[str, Any], harm: Harm) -> bool:
    text = " ".join(str(value) for value in _leaves(reason))
    return any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text) for name in harm.names if name)


def _times(reason: dict[str, Any], harm: Harm, length_s: float) -> bool:
    """Whether a reason says an instant of the harm: its beginning, its end, its middle, or how long before the end."""
    assert harm.from_s is not None
    text = str(reason.get("text", ""))
    told = [float(number) for number in _INSTANT.findall(text)]
    told += [length_s - float(number) for number in _FROM_END.findall(text) if length_s]
    told += [float(value) for name, value in _fields(reason) if name in _TIME_FIELDS and isinstance(value, int | float)]
    to_s = harm.from_s if harm.to_s is None else harm.to_s
    instants = (harm.from_s, to_s, (harm.from_s + to_s) / 2)
    return any(abs(at_s - instant) <= NEAR_S for at_s in told for instant in instants)


def _fields(node: Any, name: str = "") -> list[tuple[str, Any]]:
    if isinstance(node, dict):
        return [found for key, value in node.items() for found in _fields(value, key)]
    if isinstance(node, list):
        return [found for value in node for found in _fields(value, name)]
    return [(name, node)]


def _leaves(node: Any) -> list[Any]:
    return [value for _, value in _fields(node)]


def _words(reason: dict[str, Any]) -> tuple[str, str, str]:
    return str(reason["rule"]), str(reason["verdict"]), _CHANGES.sub("#", str(reason.get("text", "")))


def _audit_words(done: subprocess.CompletedProcess[str]) -> str:
    if not done.stdout.startswith(("{", "[")):
        return f"refused: {_last_line(done)}"
    found = json.loads(done.stdout)
    told = []
    for each in found if isinstance(found, list) else [found]:
        if "error" in each:
            told.append(f"refused: {each['error']}")
        parts = [(name, each[name]["different"]) for name in ("observations", "commands", "targets") if name in each]
        parts = [("actions", each["different"]), *parts] if "different" in each else parts
        told += [f"{count} {name}" for name, count in parts if count]
        told += [f"{each[name]} {name}" for name in ("states_different",) if each.get(name)]
    if not told:
        return "equal" if done.returncode == 0 else "nothing to compare"
    return ", ".join(told)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit code {done.returncode}"


def _station(*words: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"XDG_CONFIG_HOME": "/proc/nowhere"}
    return subprocess.run(
        [sys.executable, "-m", "station", *words],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False,
    )  # fmt: skip
