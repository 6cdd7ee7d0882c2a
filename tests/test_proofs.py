"""Promises about time are asked for in proofs, and nowhere else."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.tiers import ROOT

CLOCKS = {"monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns"}
OF_THE_MACHINE = {"time", "SYSTEM"}
OF_LATENESS = {"tests.lateness", "tests.late_verdicts"}
MAY_EXCUSE = {"tests/late_verdicts.py", "tests/progress.py", "tests/test_lateness.py"}
"""What judges and prints lateness, and its own test."""

FILES = sorted((ROOT / "tests").rglob("*.py"))


def is_proof(path: Path) -> bool:
    return path.name.startswith("test_proof_")


@cache
def texts() -> list[tuple[Path, str]]:
    return [(path, path.read_text(encoding="utf-8")) for path in FILES]


def trees(*words: str) -> list[tuple[Path, ast.Module]]:
    """Return the proofs and the files in which any of some words stands; to parse all of them takes seconds."""
    return [(path, ast.parse(text)) for path, text in texts() if is_proof(path) or any(word in text for word in words)]


def imported(tree: ast.Module) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module or "", *(f"{node.module}.{name.name}" for name in node.names)}
    return found


def is_duration(node: ast.AST) -> bool:
    """Whether an expression subtracts from the reading of the machine's clock; in virtual time durations are exact."""
    return (
        isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Sub)
        and isinstance(node.left, ast.Call)
        and isinstance(node.left.func, ast.Attribute)
        and node.left.func.attr in CLOCKS
        and isinstance(node.left.func.value, ast.Name)
        and node.left.func.value.id in OF_THE_MACHINE
    )


def bounds_a_duration(node: ast.AST) -> bool:
    """Whether a comparison says how long something took at most; no busy machine breaks a lower bound."""
    if not isinstance(node, ast.Compare):
        return False
    for left, operator, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
        if isinstance(operator, ast.Lt | ast.LtE) and is_duration(left):
            return True
        if isinstance(operator, ast.Gt | ast.GtE) and is_duration(right):
            return True
    return False


def test_only_proofs_excuse_a_machine_that_was_late() -> None:
    found = {
        str(path.relative_to(ROOT)) for path, tree in trees("lateness", "late_verdicts") if imported(tree) & OF_LATENESS
    }
    assert [name for name in sorted(found - MAY_EXCUSE) if not is_proof(Path(name))] == []


def test_only_proofs_say_how_long_something_takes_at_most() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, tree in trees(*CLOCKS)
        if not is_proof(path)
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert) and any(map(bounds_a_duration, ast.walk(node.test)))
    ]
    assert found == [], "ask that it happened, and for how long in a proof"


def test_proofs_and_nothing_else_stand_in_files_of_their_own() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}::{node.name}"
        for path, tree in trees("proof")
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
        if ("proof" in {argument.arg for argument in node.args.args}) != is_proof(path)
    ]
    assert wrong == []
