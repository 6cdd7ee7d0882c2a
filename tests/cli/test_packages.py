"""Packages of others that have the names of ours: a line says what was found where, and what to do."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from station import packages
from tests.cli.running import Home, one_line

RUN = "import sys; sys.path.insert(0, {folder!r}); from station.cli.main import main; sys.argv[0] = 'station'; main()"

pytestmark = pytest.mark.usefixtures("processes")


def distribution(folder: Path, package: str = "adapters") -> Path:
    """Somebody else's distribution that is installed into a folder; return the folder."""
    (folder / package).mkdir(parents=True)
    (folder / package / "__init__.py").write_text("import what_it_needs_and_is_not_here\n")
    metadata = folder / f"{package}-1.2.1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2.1\n")
    (metadata / "RECORD").write_text(f"{package}/__init__.py,,\n{package}-1.2.1.dist-info/METADATA,,\n")
    return folder


def run(home: Home, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a verb in a Python that looks into a folder first, as into that of packages that came before ours."""
    return subprocess.run(
        [sys.executable, "-B", "-c", RUN.format(folder=str(folder)), *arguments],
        cwd=folder.parent, env=home.environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


def run_module(home: Home, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a verb as a module in a folder, which Python looks into first."""
    return subprocess.run(
        [sys.executable, "-B", "-m", "station", *arguments],
        cwd=folder, env=home.environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


def test_a_distribution_that_hides_ours_is_named_with_what_to_do(home: Home, tmp_path: Path) -> None:
    theirs = distribution(tmp_path / "site") / "adapters"
    for line in ("up --dry-run g1-demo", "serve g1 --list-keys", "rehearse builtin:bow"):
        assert one_line(run(home, theirs.parent, *line.split())) == (
            f"package adapters: Python imports {theirs}, of the distribution adapters 1.2.1, in place of ours, "
            f"{packages.HOME / 'adapters'}; pip uninstall adapters, or give the station an environment of its own"
        )


def test_a_folder_on_pythonpath_that_hides_ours_is_named(home: Home, tmp_path: Path) -> None:
    theirs = tmp_path / "project" / "servers"
    theirs.mkdir(parents=True)
    (theirs / "__init__.py").touch()
    home.environment["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{theirs.parent}"
    assert one_line(run_module(home, tmp_path, "up", "--dry-run", "g1-demo")) == (
        f"package servers: Python imports {theirs} in place of ours, {packages.HOME / 'servers'}; "
        f"take {theirs.parent} off $PYTHONPATH, or give the station an environment of its own"
    )


def test_a_module_in_the_current_folder_that_hides_ours_is_named(home: Home, tmp_path: Path) -> None:
    (tmp_path / "adapters.py").touch()
    done = run_module(home, tmp_path, "serve", "motion", "--list-keys")
    assert f"Python imports {tmp_path / 'adapters.py'} in place of ours" in one_line(done)
    assert "; start the station in another folder, or" in done.stderr


def test_a_folder_of_data_with_the_name_of_ours_hides_nothing(home: Home, tmp_path: Path) -> None:
    for name in ("adapters", "servers", "runbooks", "manifests"):
        (tmp_path / "site" / name).mkdir(parents=True)
    for name in ("runbooks", "manifests"):
        (tmp_path / "site" / name / "__init__.py").touch()
    done = run(home, tmp_path / "site", "up", "--dry-run", "g1-demo")
    assert done.returncode == 0, done.stderr


def test_a_doctor_finds_it(home: Home, tmp_path: Path) -> None:
    theirs = distribution(tmp_path / "site") / "adapters"
    done = run(home, theirs.parent, "doctor")
    assert done.returncode == 1
    assert done.stdout.startswith(f"✗ package adapters: Python imports {theirs}, of the distribution adapters 1.2.1")
    assert "    → pip uninstall adapters, or give" in done.stdout
    assert "✓ versions: python " in done.stdout


def test_an_installation_that_is_older_than_its_files_is_told(home: Home, tmp_path: Path) -> None:
    ours = importlib.metadata.distribution(packages.DISTRIBUTION)
    kept = [entry for entry in ours.entry_points if entry.group != "station.families"]
    metadata = tmp_path / "site" / "teleop_station-0.0.1.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {packages.DISTRIBUTION}\nVersion: 0.0.1\n")
    lines = [f"[{entry.group}]\n{entry.name} = {entry.value}\n" for entry in kept if entry.group != "console_scripts"]
    (metadata / "entry_points.txt").write_text("".join(lines))
    expected = "nothing of ours is registered as family: the installation is older than its files"
    done = run(home, tmp_path / "site", "doctor")
    assert f"✗ installation: {expected}\n    → install it again: pip install -e ." in done.stdout
    assert expected in run(home, tmp_path / "site", "keys").stderr


def test_a_distribution_that_was_installed_into_the_folder_of_ours_is_named(home: Home, tmp_path: Path) -> None:
    site = tmp_path / "site"
    for name in ("station", "adapters", "servers", "runbooks"):
        shutil.copytree(packages.HOME / name, site / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(distribution(tmp_path / "theirs"), site, dirs_exist_ok=True)
    expected = (
        f"package adapters: adapters 1.2.1 is in the same folder, {site / 'adapters'}; one has written over files of "
        "the other; pip uninstall adapters, then pip install --force-reinstall --no-deps teleop-station, "
        "or give the station an environment of its own"
    )
    said = one_line(run(home, site, "rehearse", "builtin:wave"))
    assert said == f"{expected} (No module named 'what_it_needs_and_is_not_here')"
    done = run(home, site, "doctor")
    assert f"! package adapters: {expected.partition(': ')[2].partition('; pip')[0]}" in done.stdout
