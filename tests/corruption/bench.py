"""A bench that judges ``station check`` from outside: which corruptions of an episode does it tell, and how well?

::

    python -m tests.corruption                          every recipe on three episodes that it makes
    python -m tests.corruption --episodes DIR DIR2      on episodes that are there; each has the next as a donor
    python -m tests.corruption --only black --only frozen
    python -m tests.corruption --list                   the recipes, a line each
    python -m tests.corruption --json                   all verdicts and reasons, for scripts
    python -m tests.corruption --sound 40               40 sound episodes beside busy loops: what is said of them
    python -m tests.corruption --live 20                20 stations in which a process is killed, stopped, slowed

A recipe (`tests.corruption.recipes`) takes the copy of an episode and spoils one thing, with the plain MCAP library.
Then ``station check --json`` judges it, and ``station audit --json``, each in a process of its own, by the rules that
ship. What is said of the episode as it was, or of one that was only taken apart and put together again, is no catch.

A cell of the table says how well a corruption was told:

====== ===================================================================================================
full   a new reason names what was harmed (key, camera, joint, file or field) and when, or it was harmed throughout
key    a new reason names what, not when
told   a new reason, or a worse verdict, that names something else
MISSED nothing new
FAILED ``station check`` crashed
====== ===================================================================================================

A kind counts as caught where it is told in every episode that it fits, as caught with a reason where each is ``full``.
The last column is the audit's word: it counts apart.

Results are kept in the work folder, by episode, recipe and code of the station, so that a run that was interrupted goes
on, and another one tries only what a change of the code may have changed. The exit code is 0 where all were caught.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from tests.corruption import live, sound, stations
from tests.corruption.files import CAMERAS, DoesNotFit
from tests.corruption.judging import ROOT, Verdict, cell, judge, new_reasons
from tests.corruption.parts import Harm
from tests.corruption.recipes import CONTROL, RECIPES, spoil
from tests.warm.starts import WarmStarts

ORIGINAL = "as it was"
ATTEMPTS = 3
BROKE = "the recipe broke"
CELLS = ("full", "key", "told", "missed", "failed")
"""From the best to the worst."""


class Trial(NamedTuple):
    """A recipe to be tried: on which episode, with which other one, under which name results are kept."""

    episode: str
    folder: Path
    other: Path
    recipe: str
    key: str


class Bench:
    """Tries recipes on episodes, and keeps what came.

    Attributes:
        results: By name of episode and recipe: verdict, reasons, harm, audit; or why the recipe does not fit.
    """

    def __init__(self, work: Path, episodes: dict[str, tuple[Path, Path]], *, is_audited: bool = True) -> None:
        self.episodes = episodes
        self.results: dict[tuple[str, str], dict[str, Any]] = {}
        self._file = work / "results.jsonl"
        self._code = code_hash()
        self._kept = _read(self._file)
        self._is_audited = is_audited

    def run(self, names: Sequence[str], jobs: int) -> None:
        """Try recipes, and the episodes as they are, on every episode."""
        trials = [
            Trial(episode, folder, other, name, f"{self._code} {_identity(folder, other)} {name} {self._is_audited}")
            for name in (ORIGINAL, CONTROL.name, *names)
            for episode, (folder, other) in self.episodes.items()
        ]
        began_s, known = time.monotonic(), [trial for trial in trials if trial.key in self._kept]
        for trial in known:
            self.results[trial.episode, trial.recipe] = self._kept[trial.key]
        todo = [trial for trial in trials if trial.key not in self._kept]
        _say(f"{len(trials)} trials, {len(known)} of them are known\n")
        pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin)
        try:
            waiting = {pool.submit(attempt, trial, is_audited=self._is_audited): trial for trial in todo}
            for count, done in enumerate(as_completed(waiting), 1):
                trial, result = waiting[done], done.result()
                self.results[trial.episode, trial.recipe] = result
                with self._file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"trial": trial.key} | result) + "\n")
                left_s = (time.monotonic() - began_s) / count * (len(todo) - count)
                words = f"{count}/{len(todo)}  {left_s:4.0f} s left  {trial.episode}: {trial.recipe}"
                _say(f"\r{words:<100.100}" if sys.stderr.isatty() else f"{words}\n" if count % 20 == 0 else "")
        finally:
            pool.shutdown(cancel_futures=True)
        _say("\n")

    def cell(self, episode: str, name: str) -> str:
        """Return how well a corruption of an episode was told, or ``no fit``."""
        result = self.results[episode, name]
        if "no_fit" in result:
            return "no fit"
        return cell(_verdict(result), self._before(episode, name), _harm(result))

    def rules(self, name: str) -> list[str]:
        """Return which rules told a corruption, in any episode."""
        found = [
            reason["rule"]
            for episode in self._fitting(name)
            for reason in new_reasons(_verdict(self.results[episode, name]), self._before(episode, name))
        ]
        return list(dict.fromkeys(found))

    def audit(self, name: str) -> list[str]:
        """Return what the audit says now and did not of the episode as it was."""
        told = []
        for episode in self._fitting(name):
            found, before = _verdict(self.results[episode, name]), self._before(episode, name)
            if (found.audit, found.audit_code) != (before.audit, before.audit_code):
                told.append(found.audit)
        return list(dict.fromkeys(told))

    def worst(self, name: str) -> str:
        """Return the worst cell of a corruption, over the episodes that it fits; ``no fit`` where there is none."""
        cells = [self.cell(episode, name) for episode in self._fitting(name)]
        return max(cells, key=CELLS.index, default="no fit")

    def missed(self) -> dict[str, str]:
        """Return each corruption that was not told in every episode that it fits, and in which it was not."""
        found = {}
        for name in self._tried():
            episodes = [each for each in self._fitting(name) if self.cell(each, name) in ("missed", "failed")]
            if episodes:
                found[name] = ", ".join(episodes)
        return found

    def counts(self) -> dict[str, int]:
        """Return how many kinds were tried, caught, caught by name, by name and time; and what else there is."""
        worst = {name: self.worst(name) for name in self._tried()}
        fitting = [name for name, each in worst.items() if each != "no fit"]
        rank = {name: CELLS.index(worst[name]) for name in fitting}
        missed = [name for name in fitting if rank[name] >= CELLS.index("missed")]
        return {
            "kinds": len(fitting),
            "caught": len(fitting) - len(missed),
            "caught, names what": sum(each <= CELLS.index("key") for each in rank.values()),
            "caught, names what and when": sum(each == 0 for each in rank.values()),
            "missed, but told in some of its episodes": sum(
                any(self.cell(each, name) in CELLS[:3] for each in self._fitting(name)) for name in missed
            ),
            "missed, but the audit differs": sum(bool(self.audit(name)) for name in missed),
            "crashed": sum(each == "failed" for each in worst.values()),
            "recipes that broke": sum(BROKE in each.get("no_fit", "") for each in self.results.values()),
        }

    def table(self) -> str:
        """Return what came of each kind, for people."""
        episodes = list(self.episodes)
        lines = [_line("kind", episodes, "told by", "audit")]
        group = ""
        for name in self._tried():
            if RECIPES[name].group != group:
                group = RECIPES[name].group
                lines.append(f"-- {group}")
            cells = [self.cell(episode, name) for episode in episodes]
            shown = ["" if each == "no fit" else each.upper() if each in CELLS[3:] else each for each in cells]
            lines.append(_line(name, shown, ", ".join(self.rules(name)), "; ".join(self.audit(name))))
        lines.append("")
        for episode in episodes:
            for name in (ORIGINAL, CONTROL.name):
                found = _verdict(self.results[episode, name])
                told = "; ".join(f"{reason['rule']}: {reason['text']}" for reason in found.reasons)
                lines.append(f"{episode} {name}: {found.verdict}{' – ' * bool(told)}{told}; audit: {found.audit}")
        lines += [f"{name} in {episode}: {result['no_fit']}" for (episode, name), result in self.results.items()
                  if BROKE in result.get("no_fit", "")]  # fmt: skip
        lines += ["", *(f"{count:4} {what}" for what, count in self.counts().items())]
        lines += [f"missed: {name} ({episodes})" for name, episodes in self.missed().items()]
        return "\n".join(lines)

    def to_plain(self) -> dict[str, Any]:
        """Return everything, for scripts."""
        rows = [
            {"episode": episode, "kind": name, "cell": self.cell(episode, name) if name in RECIPES else "", **result}
            for (episode, name), result in self.results.items()
        ]
        return {"counts": self.counts(), "missed": self.missed(), "rows": rows}

    def _tried(self) -> list[str]:
        names = {name for _, name in self.results}
        return [name for name in RECIPES if name in names]

    def _fitting(self, name: str) -> list[str]:
        return [episode for episode in self.episodes if "no_fit" not in self.results[episode, name]]

    def _before(self, episode: str, name: str) -> Verdict:
        return _verdict(self.results[episode, CONTROL.name if RECIPES[name].is_sealed else ORIGINAL])


def _begin() -> None:
    """Prepare a process of the pool: its children are forked from one that has imported what they need."""
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    WarmStarts().install()


def attempt(trial: Trial, *, is_audited: bool) -> dict[str, Any]:
    """Spoil a copy of an episode and have it judged; in a process of the pool."""
    with tempfile.TemporaryDirectory(prefix="stc-") as name:
        copy = Path(name) / trial.folder.name
        shutil.copytree(trial.folder, copy)
        harm = Harm(())
        if trial.recipe != ORIGINAL:
            try:
                harm = spoil(trial.recipe, copy, trial.other)
            except DoesNotFit as error:
                return {"no_fit": str(error)}
            except Exception as error:  # noqa: BLE001  a recipe that breaks must not hide what the others find
                return {"no_fit": f"{BROKE}: {type(error).__name__}: {error}"}
        found = judge(copy, is_audited=is_audited)
    return {"harm": [harm.names, harm.from_s, harm.to_s]} | found.to_plain()


def make_episodes(work: Path) -> dict[str, tuple[Path, Path]]:
    """Return an episode of each kind, and another of it, by name; real stations make those that are not there."""
    found = {}
    for name, kind in stations.KINDS.items():
        folders = (work / "episodes" / name, work / "episodes" / f"{name}-other")
        for folder, is_other in zip(folders, (False, True), strict=True):
            if not (folder / "manifest.yaml").exists():
                _record(kind, folder, is_other=is_other)
        found[name] = folders
    if not stations.HAS_ARMS:
        _say("no arm: station_kord is not built (pip install ./bridges/kord)\n")
    return found


def _record(kind: stations.Kind, folder: Path, *, is_other: bool) -> None:
    """Record an episode, again where a check finds fault with it: what is said of the sound one hides what is new."""
    for attempts_left in reversed(range(ATTEMPTS)):
        _say(f"recording {folder.name} for {kind.seconds:g} s …\n")
        stations.record(kind, folder, other=is_other)
        if is_other or not judge(folder, is_audited=False).reasons or not attempts_left:
            return


def given_episodes(folders: Sequence[Path]) -> dict[str, tuple[Path, Path]]:
    """Return folders by name, each with the next of those that have, or lack, pictures as it does."""
    found = {}
    for index, folder in enumerate(folders):
        following = [*folders[index + 1 :], *folders[: index + 1]]
        other = next(each for each in following if (each / CAMERAS).exists() == (folder / CAMERAS).exists())
        found[folder.name] = (folder.absolute(), other.absolute())
    return found


def code_hash() -> str:
    """Return a hash of all code, rules and models that a verdict may depend on."""
    found = hashlib.sha256()
    own = [Path(__file__).parent / f"{name}.py" for name in ("files", "parts", "pictures", "recipes")]
    listed = [path for folder in ("station", "adapters") for path in sorted((ROOT / folder).rglob("*"))]
    for path in (*own, *listed):
        if path.suffix in (".py", ".yaml", ".json", ".onnx", ".xml"):
            found.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.corruption", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--episodes", metavar="DIR", nargs="+", type=Path, help="spoil these, and make none")
    parser.add_argument("--only", metavar="NAME", action="append", default=[], help="this recipe alone; may repeat")
    parser.add_argument("--list", action="store_true", help="print the recipes and try none")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument("--no-audit", action="store_true", help="ask `station check` alone")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time (default: %(default)s)")
    parser.add_argument("--work", type=Path, default=default_work(), help="folder for episodes and results")
    parser.add_argument(
        "--sound", metavar="N", type=int, help="make N sound episodes on a busy machine, and judge them"
    )
    parser.add_argument("--live", metavar="N", type=int, help="break N stations while they record, and judge that")
    parser.add_argument("--seed", type=int, default=1, help="of what --live breaks (default: %(default)s)")
    asked = parser.parse_args(arguments)
    if unknown := set(asked.only) - set(RECIPES):
        parser.error(f"there is no recipe {', '.join(sorted(unknown))}; --list shows all")
    if asked.list:
        _print("".join(f"{made.name:<44} {made.what}\n" for made in RECIPES.values()))
        return 0
    asked.work.mkdir(parents=True, exist_ok=True)
    if asked.sound is not None:
        return sound.run(asked.sound, asked.work)
    if asked.live is not None:
        return live.run(asked.live, asked.work, asked.seed)
    bench = Bench(
        asked.work,
        given_episodes(asked.episodes) if asked.episodes else make_episodes(asked.work),
        is_audited=not asked.no_audit,
    )
    bench.run([name for name in RECIPES if not asked.only or name in asked.only], max(1, asked.jobs))
    _print((json.dumps(bench.to_plain()) if asked.json else bench.table()) + "\n")
    return 0 if not bench.missed() else 1


def default_work() -> Path:
    """Where episodes and results are kept from run to run."""
    return Path(tempfile.gettempdir()) / f"station-corruption-{os.getuid()}"


def _line(name: str, cells: Sequence[str], rules: str, audit: str) -> str:
    return " ".join([f"{name:<44}", *(f"{each:<9}" for each in cells), f"{rules:<60}", audit]).rstrip()


def _identity(*folders: Path) -> str:
    """Return what tells episodes from others of the same name."""
    found = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.iterdir()):
            found.update(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}".encode())
    return found.hexdigest()[:16]


def _read(path: Path) -> dict[str, dict[str, Any]]:
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            result = json.loads(line)
        except ValueError:  # the last line of a run that was killed
            continue
        found[result.pop("trial")] = result
    return found


def _verdict(result: dict[str, Any]) -> Verdict:
    return Verdict(**{name: result[name] for name in Verdict.__dataclass_fields__})


def _harm(result: dict[str, Any]) -> Harm:
    names, from_s, to_s = result["harm"]
    return Harm(tuple(names), from_s, to_s)


def _say(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()


def _print(text: str) -> None:
    sys.stdout.write(text)
