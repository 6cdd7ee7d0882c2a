"""All K tests once more in C++, under sanitizers: races of the threads, and memory that is not one's own."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.tiers import ROOT

SOURCE = ROOT / "bridges/kord"


@pytest.mark.timeout(900)
@pytest.mark.parametrize("sanitizer", ["thread", "address"])
def test_all_tests_in_cpp_pass_under_a_sanitizer(
    proof: object, sanitizer: str, tmp_path: Path, compiler: dict[str, str]
) -> None:
    done = subprocess.run(
        [SOURCE / "tools/sanitize.sh", sanitizer, tmp_path],
        capture_output=True, text=True, timeout=850, check=False, env=compiler,
    )  # fmt: skip
    if "cannot find -l" in done.stderr:
        pytest.skip(f"the compiler has no library for its {sanitizer} sanitizer")
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "tests, 0 failed" in done.stdout
