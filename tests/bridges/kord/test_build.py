"""The same source is linked with kord-api where that is installed: here, a package that has its names."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.tiers import ROOT

SOURCE = ROOT / "bridges/kord"

PACKAGE = """
if(NOT TARGET {name}::{name})
    add_library({name}::{name} INTERFACE IMPORTED)
    target_include_directories({name}::{name} INTERFACE "{include}")
endif()
"""


def _configure(compiler: dict[str, str], build: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return _cmake(compiler, "-S", SOURCE, "-B", build, "-DSTATION_KORD_PYTHON=OFF", *options)


def _cmake(compiler: dict[str, str], *arguments: Path | str) -> subprocess.CompletedProcess[str]:
    command = ["cmake", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=compiler)


@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", ["kord_api", "kord-api"])
def test_both_spellings_of_the_package_are_found_and_nothing_of_the_simulator_is_needed(
    name: str, tmp_path: Path, compiler: dict[str, str]
) -> None:
    headers, package = tmp_path / "include", tmp_path / "package"
    shutil.copytree(SOURCE / "sim/include", headers)
    package.mkdir()
    (package / f"{name}Config.cmake").write_text(PACKAGE.format(name=name, include=headers))
    build = tmp_path / "build"
    done = _configure(compiler, build, f"-D{name}_DIR={package}")
    assert f"linked with {name}::{name}" in done.stdout, done.stdout + done.stderr
    if name == "kord_api":  # compiling once is enough
        built = _cmake(compiler, "--build", build, "--parallel", "2")
        assert built.returncode == 0, built.stdout[-3000:]
        assert list(build.rglob("*backend_kord*.o"))
        assert not list(build.rglob("*plant*.o"))


def test_a_build_for_real_controllers_without_kord_api_is_refused_in_words(
    tmp_path: Path, compiler: dict[str, str]
) -> None:
    done = _configure(compiler, tmp_path, "-DSTATION_KORD_BACKEND=kord")
    assert done.returncode != 0
    assert "kord-api is neither there as kord_api nor as kord-api" in " ".join(done.stderr.split())


def test_without_kord_api_the_simulator_is_built(tmp_path: Path, compiler: dict[str, str]) -> None:
    assert "linked with kord_sim" in _configure(compiler, tmp_path).stdout
