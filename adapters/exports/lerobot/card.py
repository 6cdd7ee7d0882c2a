"""What a person must know of a data set: ``README.md`` in words, ``meta/station.json`` for programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from adapters.exports.lerobot import depth_codes
from adapters.exports.lerobot.about import MEANING
from adapters.exports.lerobot.episode import words_of
from adapters.exports.lerobot.finished import Finished
from adapters.exports.lerobot.named import Names
from adapters.exports.lerobot.plan import ACTION, AGE, COMMANDER, GATE, STATE, SUBTASK, TIME, VERSION, Plan
from station.export import trim as trims
from station.export.columns import KeyColumns, unique_names
from station.export.kind import Shard, SkippedEpisode
from station.export.resample import RULES, rule_of
from station.export.trim import Trimmed
from station.export.words import GATE_STATES
from station.software import software

_MOST_ROWS = 200  # of a table; a card of thousands of episodes is read by nobody, and all stand in station.json


def provenance(
    shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, had: Finished | None = None
) -> dict[str, Any]:
    """Return where every episode comes from, what was left out and why, the plan, and what made and added to it."""
    ours = msgspec.to_builtins(software())
    added = [] if had is None else [*had.added, {"from_episode": len(had.shards), "software": ours}]
    return {
        "format": VERSION,
        "software": ours if had is None else had.software,
        "added": added,
        "plan": msgspec.to_builtins(plan),
        "rules": {**RULES, "trim": trims.RULES[plan.trim]},
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


def text(
    shards: Sequence[Shard],
    left_out: Sequence[SkippedEpisode],
    plan: Plan,
    info: dict[str, Any],
    names: Mapping[str, Names],
) -> str:
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
        _numbers_text("Gate", GATE, GATE_STATES),
        _numbers_text("Commanders", COMMANDER, names[COMMANDER].names),
        _tasks_text(shards),
        _fields_text(plan),
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
    lines.append(f"- rate: {plan.fps} Hz, as {plan.fps_as}")
    lines.append(f"- rows of an episode (`--trim {plan.trim}`): {trims.RULES[plan.trim]}")
    if common.cameras:
        lines += [
            f"- pictures: {RULES['picture' if plan.pictures == 'nearest' else 'newest picture']}",
            f"- video: {plan.codec}, {_key_frames(plan.gop)}",
        ]
    if common.depths:
        lines.append(f"- depth: {depth_codes.RULE}")
    lines += [
        "",
        "`timestamp` is the number of the row over the rate, as LeRobot wants it. Real instants and ages stand in",
        f"`{TIME}` and `{AGE}*` (tick minus the time of the value; negative where the value is of after the tick).",
        "",
    ]
    return "\n".join(lines)


def _key_frames(gop: int) -> str:
    if gop == 1:
        return "every frame a key frame, so that one frame is decoded for one that is read"
    return (
        f"a key frame every {gop} frames, so that up to {gop} frames, {(gop + 1) / 2:g} on average, are decoded for "
        "one that is read at random"
    )


def _columns_text(plan: Plan) -> str:
    common = plan.common
    rows = [
        (f"`{STATE}`", "as listed below", _listed(one.key for one in common.state)),
        (f"`{ACTION}`", "as listed below", _listed(one.key for one in common.action)),
        *((f"`{camera.column}`", f"{camera.width} x {camera.height} pixels", f"`{camera.key}`")
          for camera in common.pictures),
        (f"`{AGE}{STATE}`, `{AGE}{ACTION}`", "s, one per key", "age of the value at the tick"),
        *((f"`{camera.age_column}`", "s", "age of the picture at the tick") for camera in common.pictures),
        (f"`{TIME}`", "ns since the epoch", "the tick, on the episode's clock"),
        (f"`{GATE}`", "number of a name, below", "what the robot's gate did with the command"),
        (f"`{COMMANDER}`", "number of a name, below", "who commanded: server, and its device or motion file"),
        *([(f"`{SUBTASK}`", "number of a text in `meta/subtasks`", "the operator's newest mark; the text is empty "
            "before the first one")] if plan.subtasks == "marks" else []),
    ]  # fmt: skip
    return _table("## Columns", ("column", "unit", "from"), rows)


def _elements_text(title: str, column: str, keys: Sequence[KeyColumns]) -> str:
    names = unique_names(keys)
    units = [unit for one in keys for unit in one.units]
    rows = [(str(number), f"`{name}`", unit) for number, (name, unit) in enumerate(zip(names, units, strict=True))]
    return _table(f"## {title}: elements of `{column}`", ("index", "name", "unit"), rows)


def _numbers_text(title: str, column: str, names: Sequence[str]) -> str:
    """Return what the numbers of a column stand for."""
    rows = [("-1", "not recorded"), *((str(number), _safe(name)) for number, name in enumerate(names[:_MOST_ROWS]))]
    more = f"{len(names) - _MOST_ROWS} more in `meta/names.json`.\n" if len(names) > _MOST_ROWS else ""
    return _table(f"## {title}: numbers of `{column}`, as in `meta/names.json`", ("number", "name"), rows) + more


def _fields_text(plan: Plan) -> str:
    place = "meta/episodes" if plan.layout == "v3.0" else "meta/episodes.jsonl"
    rows = [(_listed(fields.split(", ")), what) for fields, what in MEANING.items()]
    return _table(f"## Fields of each episode, in `{place}`", ("field", "what"), rows)


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
    if trim := words_of(Trimmed(**facts["trim"]), plan.trim):
        remarks.append(trim)
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
