"""What a person must know of a data set: ``README.md`` in words, ``meta/station.json`` for programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from adapters.exports.lerobot.plan import ACTION, AGE, STATE, TIME, Plan
from station.export.columns import KeyColumns, unique_names
from station.export.kind import Shard, SkippedEpisode
from station.export.resample import RULES, rule_of
from station.software import software

_MOST_ROWS = 200  # of a table; a card of thousands of episodes is read by nobody, and all stand in station.json


def provenance(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: msgspec.Struct) -> dict[str, Any]:
    """Return where every episode comes from, what was left out and why, and the plan."""
    return {
        "software": msgspec.to_builtins(software()),
        "plan": msgspec.to_builtins(plan),
        "rules": RULES,
        "episodes": [
            {
                "episode_index": number,
                "episode_id": shard.source.episode_id,
                "rows": shard.made.rows,
                **shard.made.facts,
            }
            for number, shard in enumerate(shards)
        ],
        "left_out": [{"episode_id": each.source.episode_id, "reason": each.reason} for each in left_out],
    }


def text(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, info: dict[str, Any]) -> str:
    """Return the card."""
    length = f"{_counted(info['total_episodes'], 'episode')}, {info['total_frames'] / plan.fps / 60:.1f} minutes"
    parts = [
        _head(),
        f"# {info['robot_type']}: {length} at {plan.fps} Hz\n",
        f"LeRobot data set, layout {plan.layout}, exported from recordings by Teleop Station. Splits: "
        + ", ".join(f"{name} {span}" for name, span in info["splits"].items())
        + f" (seed {plan.seed}; the ids stand in `meta/splits.json`).\n",
        _rows_text(plan),
        _columns_text(plan),
        _elements_text("State", STATE, plan.common.state),
        _elements_text("Action", ACTION, plan.common.action),
        _tasks_text(shards),
        _episodes_text(shards, plan),
        _left_out_text(left_out),
    ]
    return "\n".join(part for part in parts if part)


def _head() -> str:
    """Return what the hub reads."""
    lines = ["---", "tags:", "- LeRobot", "task_categories:", "- robotics", "configs:", "- config_name: default",
             "  data_files: data/*/*.parquet", "---", ""]  # fmt: skip
    return "\n".join(lines)


def _rows_text(plan: Plan) -> str:
    common = plan.common
    lines = ["## How a row is made", "", f"- clock: {RULES['clock']}"]
    for column, keys, as_action in ((STATE, common.state, False), (ACTION, common.action, True)):
        lines += [f"- `{column}`, key `{one.key}`: {RULES[rule_of(one, as_action=as_action)]}" for one in keys]
    if common.is_every_part:
        lines.append("- hands and neck: those whose command or state changed in the first episode")
    if common.cameras:
        lines.append(f"- pictures: {RULES['picture']}; the video is {plan.codec}, every second frame a key frame")
    lines += [
        "",
        "`timestamp` is the number of the row over the rate, as LeRobot wants it. Real instants and ages stand in",
        f"`{TIME}` and `{AGE}*` (tick minus the time of the value; negative where the value is of after the tick).",
        "",
    ]
    return "\n".join(lines)


def _columns_text(plan: Plan) -> str:
    common = plan.common
    rows = [
        (f"`{STATE}`", "as listed below", _listed(one.key for one in common.state)),
        (f"`{ACTION}`", "as listed below", _listed(one.key for one in common.action)),
        *((f"`{camera.column}`", f"{camera.width} x {camera.height} pixels", f"`{camera.key}`")
          for camera in common.cameras),
        (f"`{AGE}{STATE}`, `{AGE}{ACTION}`", "s, one per key", "age of the value at the tick"),
        *((f"`{camera.age_column}`", "s", "age of the picture at the tick") for camera in common.cameras),
        (f"`{TIME}`", "ns since the epoch", "the tick, on the episode's clock"),
    ]  # fmt: skip
    return _table("## Columns", ("column", "unit", "from"), rows)


def _elements_text(title: str, column: str, keys: Sequence[KeyColumns]) -> str:
    names = unique_names(keys)
    units = [unit for one in keys for unit in one.units]
    rows = [(str(number), f"`{name}`", unit) for number, (name, unit) in enumerate(zip(names, units, strict=True))]
    return _table(f"## {title}: elements of `{column}`", ("index", "name", "unit"), rows)


def _tasks_text(shards: Sequence[Shard]) -> str:
    counts = Counter(shard.made.facts["task"] for shard in shards)
    return _table("## Tasks", ("task", "episodes"), [(_safe(task), str(count)) for task, count in counts.items()])


def _episodes_text(shards: Sequence[Shard], plan: Plan) -> str:
    rows = [_episode_row(number, shard, plan) for number, shard in enumerate(shards[:_MOST_ROWS])]
    titles = ("index", "episode", "s", "left at its ends, s", "sha256 of the recording", "policy", "remarks")
    found = _table("## Episodes", titles, rows)
    return found + (f"{len(shards) - _MOST_ROWS} more in `meta/station.json`.\n" if len(shards) > _MOST_ROWS else "")


def _episode_row(number: int, shard: Shard, plan: Plan) -> tuple[str, ...]:
    facts = shard.made.facts
    remarks = [f"{count} values of `{key}` did not fit" for key, count in facts["skipped"].items()]
    if facts["without_own_step"]:
        remarks.append(f"{facts['without_own_step']} rows with the action of a neighbouring step")
    for what, names in facts["missed"].items():
        if names:
            remarks.append(f"{what} that are not in the data set: {', '.join(names)}")
    for camera, found in facts["pictures"].items():
        remarks.append(f"{camera}: {found['distinct']} pictures")
        if found["bad"]:
            remarks.append(f"{camera}: {found['bad']} could not be read")
    checkpoint = f"`{facts['checkpoint_sha256'][:12]}`" if facts["checkpoint_sha256"] else ""
    hashes = " ".join(f"`{value[:12]}`" for value in facts["sha256"].values())
    ends = f"{facts['head_s']:.1f} + {facts['tail_s']:.1f}"
    seconds = f"{shard.made.rows / plan.fps:.1f}"
    policy = f"{_safe(facts['policy'])} {checkpoint}".strip()
    return str(number), shard.source.episode_id, seconds, ends, hashes, policy, _safe("; ".join(remarks))


def _left_out_text(left_out: Sequence[SkippedEpisode]) -> str:
    if not left_out:
        return "## Left out\n\nNothing.\n"
    rows = [(each.source.episode_id, _safe(each.reason)) for each in left_out[:_MOST_ROWS]]
    return _table(f"## Left out: {len(left_out)}", ("episode", "why"), rows)


def _table(title: str, titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [title, "", f"| {' | '.join(titles)} |", f"|{' --- |' * len(titles)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows), ""])


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}{'s' if number != 1 else ''}"


def _safe(words: str) -> str:
    """Return text that breaks no table: what an episode says of itself is anybody's."""
    return " ".join(words.replace("|", "/").replace("<", "(").replace(">", ")").split())
