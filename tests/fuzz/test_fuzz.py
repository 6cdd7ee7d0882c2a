"""No value of the bus ends what reads it: thousands of mutants, and a registry of parsers that is whole."""

from __future__ import annotations

import contextlib
import json
import math
import re
from pathlib import Path

import pytest

from station.bus import codec
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.errors import StationError
from tests.fuzz import campaign
from tests.fuzz.parsers import CONFIG, PARSERS, Parser, dumped, health
from tests.fuzz.readers import READERS, episode_of_mutants

ROOT = Path(__file__).parents[2]
CASES = 4_000
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of arithmetic with huge numbers; it ends nobody
READS_VALUES = re.compile(
    r"\b(codec\.parse_\w+|msgspec\.json\.(decode|Decoder)|json\.loads|stamps?\.(decode|integer)\(|estop\.read\("
    r"|events\.decode\(|decode_health\()"
)
READS_FILES = {
    "station.cli.serve": "its own command line",
    "station.bus.codec": "is the decoder",
    "station.episode.compacting.compact": "metadata of a file",
    "station.episode.storage.drops": "metadata of a file",
    "station.episode.storage.progress": "resume.json",
    "station.episode.writing.checkpoint": "checkpoint.json",
    "station.export.shards": "its own record of a shard",
    "station.episode.replaying.resimulate": "runs a robot; what it reads passes timing_row and parse_facts",
    "station.rehearse": "a configuration from the process that started it",
    "station.web.keyring": "its own secrets",
    "station.web.player": "typed orders of the console that started it",
    "station.web.players": "frames of a player of its own",
    "station.suite.trial": "a configuration from the process that started it",
    "adapters.devices.fakes.pico.script": "the script of a fake",
    "adapters.devices.fakes.script": "the script of a fake",
    "adapters.devices.fakes.webxr.wearer": "what a server says to a fake page of its own user",
    "adapters.exports.lerobot.dataset": "its own statistics of a shard",
    "adapters.exports.lerobot.finished": "a data set of its own",
    "adapters.foreign.twist2_file": "a recording of another recorder",
    "adapters.motions.npz_file": "a motion of its own",
    "adapters.policies.holosoma": "metadata of a checkpoint",
    "adapters.policies.holosoma_wbt": "metadata of a checkpoint",
    "adapters.policies.motion_tracking": "what its exporter says of a checkpoint",
}
"""Modules whose JSON is no value of the bus: anybody may write to the bus, not anybody to these."""


@pytest.mark.parametrize("parser", PARSERS, ids=lambda parser: parser.name)
def test_a_good_value_is_read(parser: Parser) -> None:
    for value in parser.valid:
        parser.parse(value)


LONG, HUGE = "x" * 5000, 10**400
FOUND = (
    ("command action_body_unitree_g1_with_hands", dumped([HUGE] * 35)),
    ("stamp", b"%d 2 %d a.b.c.d" % (HUGE, HUGE)),
    ("heartbeat", dumped(json.loads(health()) | {"name": LONG, "wall_ns": 1})),
    ("heartbeat", dumped(json.loads(health()) | {"wall_ns": HUGE})),
    ("drawn", dumped(CONFIG | {"robot_facts": {"model": LONG}})),
    ("drawn", dumped(CONFIG | {"robot_facts": {"model": "~nobody_of_that_name/x"}})),
    ("drawn", dumped(CONFIG | {"robot_facts": ["model"]})),
    ("recorder hears station:config:g1", dumped(CONFIG | {"policy": {"rate_hz": HUGE}})),
    ("progress station:config:g1", dumped(CONFIG | {"policy": {"name": "[/x]"}})),
    ("progress station:config:motion", dumped(CONFIG | {"motion": {"duration_s": "long"}})),
    ("progress station:config:motion", dumped(CONFIG | {"motion": {"duration_s": -1e308}})),
    ("progress station:config:motion", dumped(CONFIG | {"motion": {"clips": [{"name": "a", "start_s": []}]}})),
    ("progress station:server:g1", health().replace(b'"falls":1', b'"falls":"many"')),
    ("progress command_gate_unitree_g1_with_hands", dumped({"state": "[/x]"})),
    ("robot's side command_used_unitree_g1_with_hands", codec.f64([math.nan] * 35)),
    ("device operator_twist_pico", codec.f64([1e200] * 6)),
    ("device operator_controls_pico", dumped({"left_trigger": 1e308})),
)
"""Values that once ended a parser, or passed where they must not, by the parser's name."""


@pytest.mark.parametrize(("name", "data"), FOUND, ids=[f"{number}-{name}" for number, (name, _) in enumerate(FOUND)])
def test_what_once_ended_a_parser_does_so_no_more(name: str, data: bytes) -> None:
    assert campaign.attempt(next(parser for parser in PARSERS if parser.name == name), data) == ""


def test_no_mutant_of_a_value_ends_what_reads_it() -> None:
    outcome = campaign.run(CASES, campaign.seed())
    assert outcome.cases.total() == CASES
    assert min(outcome.cases[parser.name] for parser in PARSERS) >= CASES // len(PARSERS)
    assert not outcome.findings, str(outcome)


def test_no_mutant_that_was_recorded_ends_a_reader_of_episodes(tmp_path: Path) -> None:
    seed = campaign.seed()
    folder = episode_of_mutants(tmp_path, 25, seed)
    for reader in READERS:
        with contextlib.suppress(StationError):
            reader.read(open_episode(folder))


def test_an_episode_of_mutants_has_steps_that_are_measured(tmp_path: Path) -> None:
    measured = check(open_episode(episode_of_mutants(tmp_path, 100, "1")))
    assert max(found.steps for found in measured.steps) > 30
    assert max(found.compared_steps for found in measured.steps) > 3


def test_every_module_that_reads_values_of_the_bus_is_among_those_that_are_fuzzed() -> None:
    reading = {module_name(path) for path in sources() if READS_VALUES.search(path.read_text(encoding="utf-8"))}
    read = [parser.modules for parser in PARSERS] + [reader.modules for reader in READERS]
    fuzzed = {module for modules in read for module in modules}
    assert reading - fuzzed - READS_FILES.keys() == set(), "add a parser to tests/fuzz/parsers.py or readers.py"
    assert READS_FILES.keys() <= reading
    assert not READS_FILES.keys() & (fuzzed - {"station.bus.codec"})


def sources() -> list[Path]:
    return [path for folder in ("station", "servers", "adapters") for path in sorted((ROOT / folder).rglob("*.py"))]


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)
