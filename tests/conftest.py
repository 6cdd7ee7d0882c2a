"""What every test may ask for: upstream data, a real bus, real processes; and how a run reports itself."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
import itertools
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from station import python_child
from station.bus.address import BusAddress
from station.software import software
from tests import examples, figures, leftovers, progress, tiers
from tests.figures import Figures
from tests.network_link import link
from tests.shared_bus import SharedBus
from tests.warm.starts import WarmStarts

python_child.spare_processors()  # as `station` does: a child with other variables than the fork server starts cold

_ENOUGH_GB = 4.0  # ten times what a run of the suite needs
NO_UPSTREAM_DATA = "STATION_ASSETS does not name a folder with upstream data"

_warm = pytest.StashKey[WarmStarts]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--changed-builds", action="store_true", help="build tier: only if its sources or compiler changed"
    )
    parser.addoption("--new-examples", action="store_true", help="draw other random examples than the last run")
    parser.addoption("--write-figures", action="store_true", help="proof tier: write its figures into docs/")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """Return what ``-n auto`` means; xdist asks for ``-n logical`` too."""
    from tests import workers

    return workers.here() if config.option.numprocesses == "auto" else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Return what gives tests to processes, where they are given by module."""
    from tests import workers

    return workers.OneTwinAtATime(config, log) if config.getoption("dist") == "loadscope" else None


def _keep_off_the_disk() -> None:
    """Keep temporary files in memory, where there is plenty: a disk that stalls for seconds says nothing of code."""
    shared = Path("/dev/shm")
    if "TMPDIR" in os.environ or not shared.is_dir():
        return
    place = os.statvfs(shared)
    free_gb = min(place.f_bavail * place.f_frsize, os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")) / 1e9
    if free_gb > _ENOUGH_GB and not place.f_flag & os.ST_NOEXEC:  # some tests run what they build
        os.environ["TMPDIR"] = tempfile.tempdir = str(shared)


def _own_temporary_folder(config: pytest.Config) -> None:
    """Give this run its own folder for temporary files: files that one run left have failed tests of a later one.

    It is removed at the end of the run. The folders of pytest (`tmp_path`) stay, to see why a test failed.
    """
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
    folder = tempfile.mkdtemp(prefix="tests-")
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    config.add_cleanup(
        lambda: shutil.rmtree(folder, ignore_errors=True)
    )  # a child that ends now may remove its own files


def pytest_configure(config: pytest.Config) -> None:
    """Obey Ctrl-C, so that every child does: a shell's background job, and all that it starts, would ignore it."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ["XDG_CONFIG_HOME"] = "/proc/nowhere"  # never there: whoever runs the tests may have rules and defaults
    # How long an example takes is the machine's business. The same code gets the same verdict: new examples are drawn
    # where defects are looked for (`make hunt`, proofs).
    is_proof = config.getoption("-m") == "proof"
    if not is_proof:
        _keep_off_the_disk()
    if not hasattr(config, "workerinput"):  # a worker of pytest-xdist uses the folder of its run
        _own_temporary_folder(config)
    is_new = bool(config.getoption("--new-examples")) or is_proof
    examples.draw_new(is_new)
    settings.register_profile(
        "patient", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow],
        derandomize=not is_new, max_examples=examples.examples(100),
    )  # fmt: skip
    settings.load_profile("patient")
    config.pluginmanager.register(progress.Progress(config), "station-progress")
    if not progress.distributes(config):
        starts = config.stash[_warm] = WarmStarts()
        starts.install()
        software()  # asks git, once in a process
        tiers.watch()


def pytest_unconfigure(config: pytest.Config) -> None:
    if (starts := config.stash.get(_warm, None)) is not None:
        starts.uninstall()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Search for nothing that can be freed while tests and modules come, which stay: it took a tenth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    tiers.mark(items)
    if config.getoption("--changed-builds") and not os.environ.get("CI") and tiers.is_built(config):
        unchanged = pytest.mark.skip(reason="build tier: neither sources nor compiler changed since it was green")
        for item in items:
            if item.get_closest_marker("build"):
                item.add_marker(unchanged)


def pytest_collection_finish() -> None:
    """Leave thousands of tests and modules, which stay, out of each search for what can be freed."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Hold each test to its tier, its fixtures too."""
    with tiers.held_to(item):
        return (yield)


def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any]) -> None:
    if fixturedef.scope not in ("function", "session"):
        leftovers.SHARED.add(f"{fixturedef.baseid}::{fixturedef.argname}")


def pytest_fixture_post_finalizer(fixturedef: pytest.FixtureDef[Any]) -> None:
    leftovers.SHARED.discard(f"{fixturedef.baseid}::{fixturedef.argname}")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """See that there is what a test needs that is marked with `assets` or `torch`, before any of its fixtures; figures
    name the test."""
    item.config.stash[figures.TEST] = item.nodeid
    if item.get_closest_marker("torch") and importlib.util.find_spec("torch") is None:
        pytest.skip("needs the extra 'torch'")
    if item.get_closest_marker("assets"):
        _upstream_data()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Add to the report of a failure what the processes of the test said, and what is on its bus."""
    report: Any = yield
    if report.failed:
        report.sections.extend(leftovers.evidence(item))
    return report


@pytest.fixture(scope="session")
def assets() -> Path:
    """Folder with upstream data; for tests that are marked with `assets`."""
    return _upstream_data()


def _upstream_data() -> Path:
    """Return the folder; a machine without it skips, CI fails."""
    value = os.environ.get("STATION_ASSETS")
    if value and Path(value).is_dir():
        return Path(value)
    if os.environ.get("CI"):
        pytest.fail(NO_UPSTREAM_DATA)
    pytest.skip(NO_UPSTREAM_DATA)


@pytest.fixture(scope="session", autouse=True)
def _own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Compile robot models into a cache of this test run; fixtures that several tests share have folders of it too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        _away_from_user(patch, tmp_path_factory.mktemp("run"))
        yield


@pytest.fixture(scope="session")
def _folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Paths for folders, numbered here: a numbered folder of pytest costs a look at all that there are."""
    runs = tmp_path_factory.mktemp("runs")
    return (runs / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def _own_runtime_folder(_folders: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Give every test folders of its own."""
    folder = next(_folders)
    folder.mkdir(mode=0o700)
    _away_from_user(monkeypatch, folder)


def _away_from_user(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Keep away from a station that the user may be running: its bus, its stops, its episodes."""
    patch.setenv("XDG_RUNTIME_DIR", str(folder))
    patch.setenv("XDG_STATE_HOME", str(folder / "state"))
    patch.setenv("STATION_DATA", str(folder / "data"))
    for suffix in ("", "_USER", "_PASSWORD", "_PASSWORD_FILE", "_CA", "_CERT", "_KEY"):
        patch.delenv(f"STATION_BUS{suffix}", raising=False)
    patch.delenv("STATION_BULK", raising=False)


@pytest.fixture(autouse=True)
def _leaves_nothing() -> Iterator[None]:
    """Fail the test that leaves processes, files in the checkout, or real-time scheduling to those after it."""
    with leftovers.none_left():
        yield


@pytest.fixture(scope="session")
def real_time() -> None:
    """Require a user who may ask for SCHED_FIFO: a robot twin has to be punctual at 500 Hz, whatever else runs."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        why = "this user may not ask for SCHED_FIFO (`ulimit -r`), and a robot twin in real time needs it"
        if os.environ.get("CI"):
            pytest.fail(why)
        pytest.skip(why)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.fixture(scope="session")
def processes() -> None:
    """Real processes: a test that uses this belongs to the tier `station`."""


@pytest.fixture(scope="session")
def network_links(processes: None) -> None:
    """Require a user who may connect network namespaces, each of which stands for a computer (`tests.network_link`)."""
    if why_not := link.why_not():
        if os.environ.get("CI"):
            pytest.fail(why_not)
        pytest.skip(why_not)


@pytest.fixture(scope="session")
def proof(request: pytest.FixtureRequest) -> Figures:
    """A promise about time, measured: a test that uses this belongs to the tier `proof`; figures go into docs/."""
    return Figures(request.config)


@pytest.fixture(scope="session")
def _shared_bus(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedBus]:
    with contextlib.closing(SharedBus(tmp_path_factory.mktemp("bus"))) as bus:
        yield bus


@pytest.fixture
def bus_server(_shared_bus: SharedBus) -> BusAddress:
    """Address of a real server without keys, clients or changed settings; the tests of a run share its process."""
    return _shared_bus.empty()


@pytest.fixture(scope="session")
def kord() -> Any:
    """The native bridge to Kassow controllers, with their simulator; a machine without it skips, CI fails."""
    try:
        import station_kord
    except ImportError as error:
        message = f"station_kord is not built ({error}): pip install ./bridges/kord"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return station_kord
