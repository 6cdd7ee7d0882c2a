"""The benchmarks run and make tables; how fast anything is, no test asks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import report
from benchmarks.harness import Benchmark, Row, Target, alternate, compare, p99
from tests.dds_domains import domain

pytestmark = [pytest.mark.usefixtures("processes"), pytest.mark.timeout(300)]

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "benchmarks", *arguments], cwd=ROOT, capture_output=True, text=True, timeout=280,
        check=False,
    )  # fmt: skip


def test_a_quick_run_of_bus_and_loop_prints_a_table_of_each_and_writes_the_page(tmp_path: Path) -> None:
    page = tmp_path / "performance.md"
    result = run("bus", "loop", "--quick", "--write", "--page", str(page), "--width", "200")
    assert result.returncode == 0, result.stderr
    for line in ("write 5 keys, paced, p50", "read 4 keys, hot, p50", "`Rate`, quiet: jitter p99"):
        assert re.search(re.escape(line) + r".*ms.*ms.* x ", result.stdout), result.stdout
    text = page.read_text()
    assert "## Bus" in text
    assert "## Loop jitter" in text
    assert "| read 4 keys, hot, p50 |" in text
    assert "`python -m benchmarks bus loop --quick`" in text
    report.write(page, {}, ("bus", "loop"))
    assert page.read_text() == text, "what did not run stays as it is"


def test_a_quick_run_of_a_g1s_wire_compares_messages_and_periods() -> None:
    pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")
    with domain(0):
        result = run("dds", "--quick", "--width", "200")
    assert result.returncode == 0, result.stderr
    for line in ("take and check a LowState, p50", "make and write a LowCmd, p99", "period: both, p99", "period: CPU"):
        assert re.search(re.escape(line) + r".* x ", result.stdout), result.stdout


def test_the_checksum_that_a_baseline_makes_bit_after_bit_is_that_of_the_wire() -> None:
    types = pytest.importorskip("adapters.robots.g1.dds.types", reason="needs the extra 'g1'")
    from adapters.robots.g1.dds import messages
    from benchmarks.dds import checksum_by_bits

    for record, kind in ((messages.new_state(), types.LowState), (messages.new_command(), types.LowCmd)):
        record["motors"]["q"][0, :29], record["mode_machine"] = 0.3, 5
        signed = messages.signed(record)
        assert checksum_by_bits(kind.deserialize(signed)) == messages.checksum(signed)


def test_an_unknown_benchmark_is_refused_with_the_names_of_those_there_are() -> None:
    result = run("buss")
    assert result.returncode == 2
    assert "did you mean 'bus'?" in result.stderr


def test_a_benchmark_that_needs_upstream_data_says_so_and_is_left_out_without_it(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "STATION_ASSETS"}
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks", "sim", "--quick"], cwd=ROOT, capture_output=True, text=True, timeout=280,
        check=False, env=environment,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    told = " ".join(result.stdout.split())
    assert (
        "left out, needs upstream data: twist2:ckpts/twist2_1017_20k.onnx: not on this machine; `station assets" in told
    )


def test_contenders_take_turns_and_every_other_round_goes_backwards() -> None:
    turns: list[str] = []

    def contender(name: str) -> list[float]:
        turns.append(name)
        return [1.0]

    taken = alternate({"a": lambda: contender("a"), "b": lambda: contender("b")}, 3)
    assert turns == ["a", "b", "b", "a", "a", "b"]
    assert taken == {"a": [[1.0]] * 3, "b": [[1.0]] * 3}


def test_a_ratio_is_the_median_of_the_ratios_of_the_rounds() -> None:
    row = compare("x", "ms", [[1.0], [8.0], [9.0]], [[2.0], [2.0], [3.0]], baseline="other")
    assert (row.ours, row.theirs, row.ratio) == (8.0, 2.0, 3.0)


def test_a_figure_of_a_round_is_what_was_asked_for_scaled_to_its_unit() -> None:
    row = compare("x", "ms", [[0.001] * 50 + [0.5] * 50], by=p99, scale=1e3)
    assert row.ours == 500.0
    assert row.verdict == ""


def test_a_target_is_of_the_figure_or_of_the_ratio_and_bounds_from_above_or_below() -> None:
    def verdict(target: Target) -> str:
        return Row(what="x", unit="s", ours=2.0, baseline="b", theirs=1.0, ratio=2.0, target=target).verdict

    assert verdict(Target(limit=2.0)) == "met"
    assert verdict(Target(limit=1.9)) == "not met"
    assert verdict(Target(limit=3.0, sense=">=")) == "not met"
    assert verdict(Target(limit=1.5, of="ratio")) == "not met"


def test_writing_one_section_of_the_page_keeps_the_others(tmp_path: Path) -> None:
    def section(name: str, ours: float) -> dict[str, str]:
        benchmark = Benchmark(name=name, title=name.title(), method="How.", run=lambda _: [])
        return {name: report.section(benchmark, [Row(what="x", unit="s", ours=ours)], "command")}

    page, order = tmp_path / "docs" / "page.md", ("one", "two")
    report.write(page, section("two", 1.0), order)
    report.write(page, section("one", 2.0), order)
    report.write(page, section("two", 3.0), order)
    text = page.read_text()
    assert text.index("## One") < text.index("## Two")
    assert "| x | 2 s |" in text
    assert "| x | 3 s |" in text
    assert "| x | 1 s |" not in text
