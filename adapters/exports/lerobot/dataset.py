"""From shards to a data set: episodes and tasks get their numbers, statistics are of all, a card tells of it."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from adapters.exports.lerobot import about, card, named, parquet, stats
from adapters.exports.lerobot.episode import ROWS, STATS, TOLD_S, EpisodeStats
from adapters.exports.lerobot.features import INDEX, info
from adapters.exports.lerobot.finished import PIXELS, PROVENANCE, Finished
from adapters.exports.lerobot.layouts import Episode, Layout, layout_of, write_json
from adapters.exports.lerobot.named import Names
from adapters.exports.lerobot.parquet import Columns
from adapters.exports.lerobot.plan import IMAGES, SUBTASK, Common, Plan
from station.errors import EpisodeError
from station.export.kind import Shard, SkippedEpisode

_TOLD = 3  # episodes of a note that are named
_CUT_S = 1.0  # without rows at the ends of an episode, that whoever exports is told of [s] ...
_CUT_SHARE = 0.05  # ... or this share of the episode, ...
_LITTLE_S = 0.2  # ... if it is more than keys and cameras differ by anyway [s]

TRAIN, VAL = "train", "val"

_LIMBS = {
    "leg": ("hip", "knee", "ankle"),
    "arm": ("shoulder", "elbow", "wrist"),
    "hand": ("hand",),
}
_QUANTITY = re.compile(r"_(pos|vel|torque|kp|kd|pos_from_default|previous_action)$")
_ELEMENT = re.compile(r"_(x|y|z|w|roll|pitch|yaw|\d+)$")
_SCALED = "scaled_"
_LANGUAGE = "human.task_description"


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the data set of shards, one of them in memory at a time.

    Raises:
        EpisodeError: a video has not as many pictures as its episode has rows.
        OSError: the disk refuses.
    """
    return _join(shards, left_out, plan, folder, None)


def join_to(had: Finished, shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], folder: Path) -> dict[str, Any]:
    """Make a data set of a finished one and of shards behind its episodes, as if all had been exported together.

    Tasks and names are numbered as they come, so those of the finished one keep their numbers, and so do its rows.

    Raises:
        EpisodeError, OSError: as `join`.
    """
    now = {lost.source.episode_id for lost in left_out} | {shard.source.episode_id for shard in shards}
    before = [lost for lost in had.left_out if lost.source.episode_id not in now]
    had.carry(folder)
    return _join(shards, [*before, *left_out], had.plan, folder, had)


def _join(
    shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path, had: Finished | None
) -> dict[str, Any]:
    first = len(had.shards) if had is not None else 0
    parts = split([*(had.shards if had is not None else ()), *shards], plan.val, plan.seed)
    ordered = [shard for part in parts.values() for shard in part]
    tasks = list(dict.fromkeys(shard.made.facts["task"] for shard in ordered))
    episodes = list(_numbered(ordered, tasks, plan))
    names = named.names_of(ordered, plan)
    totals = _totals(ordered[first:], episodes[first:], names, plan.fps, had)
    with _opened(plan, folder) as layout:
        for shard, episode in zip(ordered[first:], episodes[first:], strict=True):
            rows = {**parquet.read(shard.folder / ROWS), **_index(episode, plan.fps)}
            rows |= {column: those.renumbered(shard, rows[column]) for column, those in names.items()}
            if {len(values) for values in rows.values()} != {episode.length}:
                raise EpisodeError(
                    f"{shard.source.episode_id}: its shard has not {episode.length} rows; export it anew"
                )
            for column, values in rows.items():
                totals.columns[column].add(values)
            layout.add(_with_stats(episode, shard, names, plan.fps), rows)
        layout.finish(tasks, totals.result(), names[SUBTASK].names if SUBTASK in names else None)
    rows_in_all = sum(episode.length for episode in episodes)
    splits = ranges(parts)
    document = info(plan, episodes=len(episodes), rows=rows_in_all, tasks=len(tasks), splits=splits)
    write_json(folder / "meta/info.json", document)
    write_json(folder / "meta/modality.json", modality(plan.common))
    write_json(folder / "meta/names.json", named.document(names))
    ids = {name: [shard.source.episode_id for shard in part] for name, part in parts.items()}
    write_json(folder / "meta/splits.json", {"seed": plan.seed, "val": plan.val, "episodes": ids})
    write_json(folder / PROVENANCE, card.provenance(ordered, left_out, plan, had))
    (folder / PIXELS).write_bytes(
        msgspec.json.encode({name: counts.plain() for name, counts in totals.pictures.items()})
    )
    (folder / "README.md").write_text(card.text(ordered, left_out, plan, document, names), encoding="utf-8")
    return {
        "rows": rows_in_all,
        "tasks": len(tasks),
        "splits": splits,
        "layout": plan.layout,
        "cameras": [camera.name for camera in plan.common.pictures],
        "notes": list(notes(shards, plan)),
    }


def _cut(shard: Shard) -> tuple[float, str] | None:
    """Return how much of an episode can have no rows [s], and at which ends; None for little."""
    facts = shard.made.facts
    head_s, tail_s = (facts[f"{end}_s"] - facts["trim"][f"{end}_s"] for end in ("head", "tail"))
    cut_s, every_s = head_s + tail_s, shard.made.seconds + facts["head_s"] + facts["tail_s"]
    if cut_s <= max(_LITTLE_S, min(_CUT_S, _CUT_SHARE * every_s)):
        return None
    return cut_s, f"{head_s:.1f} at its beginning, {tail_s:.1f} at its end"


def notes(shards: Sequence[Shard], plan: Plan) -> Iterator[str]:
    """Yield what whoever asked for the data set should know, in a line each."""
    for what, has, cure in (
        ("cameras", "have cameras that the first one has not", "with --camera NAME they are"),
        ("parts", "move what does not move in the first one", "with --state KEYS --action KEYS they are"),
    ):
        with_others = [shard for shard in shards if shard.made.facts["missed"][what]]
        if with_others:
            names = sorted({name for shard in with_others for name in shard.made.facts["missed"][what]})
            yield (
                f"{len(with_others)} of {len(shards)} episodes ({with_others[0].source.episode_id} first) {has}, and "
                f"that are not in the data set: {', '.join(names)}; {cure}, and episodes without them are not"
            )
    with_depth = [shard for shard in shards if shard.made.facts["missed"].get("depth")]
    if with_depth:
        names = sorted({name for shard in with_depth for name in shard.made.facts["missed"]["depth"]})
        yield (
            f"{len(with_depth)} of {len(shards)} episodes ({with_depth[0].source.episode_id} first) have depth of "
            f"{', '.join(names)}, which is not in the data set; with --depth it is, in layout v3.0"
        )
    yield from _trim_notes(shards, plan)
    cut = {shard.source.episode_id: said for shard in shards if (said := _cut(shard))}
    if cut:
        longest = sorted(cut, key=lambda name: cut[name], reverse=True)[:_TOLD]
        told = ", ".join(f"{name} {cut[name][0]:.1f} s ({cut[name][1]})" for name in longest)
        more = f" and {len(cut) - _TOLD} more" if len(cut) > _TOLD else ""
        yield (
            f"{len(cut)} of {len(shards)} episodes have rows for a part of what was recorded only, since not every key "
            f"and camera reaches their ends: cut are {told}{more}; `station check` says which key or camera it was"
        )
    without = [shard for shard in shards if shard.made.facts["without_own_step"]]
    if without:
        rows = sum(shard.made.facts["without_own_step"] for shard in without)
        yield (
            f"{rows} rows in {len(without)} of {len(shards)} episodes ({without[0].source.episode_id} first) hold the "
            "action of a neighbouring step, since none of their own was recorded; README.md says how many each has"
        )


def _trim_notes(shards: Sequence[Shard], plan: Plan) -> Iterator[str]:
    """Yield what --trim left out, and where it had nothing to go by."""
    left_s = {shard.source.episode_id: sum(shard.made.facts["trim"][end] for end in ("head_s", "tail_s"))
              for shard in shards}  # fmt: skip
    trimmed = sorted((name for name in left_s if left_s[name] >= TOLD_S), key=lambda name: left_s[name], reverse=True)
    if trimmed:
        told = ", ".join(f"{name} {left_s[name]:.1f} s" for name in trimmed[:_TOLD])
        more = f" and {len(trimmed) - _TOLD} more" if len(trimmed) > _TOLD else ""
        every_s = sum(left_s.values()) + sum(shard.made.seconds for shard in shards)
        yield (
            f"--trim {plan.trim} left out {sum(left_s.values()):.1f} of {every_s:.1f} s, at the ends of "
            f"{len(trimmed)} of {len(shards)} episodes: {told}{more}; --trim none keeps all rows"
        )
    without = [shard for shard in shards if shard.made.facts["trim"]["why_not"]]
    if without:
        first = without[0]
        yield (
            f"--trim {plan.trim} left nothing out of {len(without)} of {len(shards)} episodes "
            f"({first.source.episode_id} first: {first.made.facts['trim']['why_not']})"
        )


class _Totals:
    """Statistics of all columns and cameras over all episodes."""

    def __init__(self) -> None:
        self.columns: dict[str, stats.Totals] = {}
        self.pictures: dict[str, stats.PixelCounts] = {}

    def know(self, measured: EpisodeStats, index: Mapping[str, stats.Stats]) -> None:
        for column, found in {**measured.columns, **index}.items():
            self.columns.setdefault(column, stats.Totals()).know(found)
        for column, counted in measured.pictures.items():
            self.pictures.setdefault(column, stats.PixelCounts()).merge(stats.PixelCounts(**counted))

    def result(self) -> dict[str, Any]:
        numbers = {column: total.result() for column, total in self.columns.items()}
        return {**numbers, **{name: stats.as_image(pixels.stats()) for name, pixels in self.pictures.items()}}


def _numbered(shards: Sequence[Shard], tasks: Sequence[str], plan: Plan) -> Iterator[Episode]:
    first_row = 0
    for number, shard in enumerate(shards):
        task = shard.made.facts["task"]
        videos = {camera.column: shard.folder / f"{camera.column}.mp4" for camera in plan.common.pictures}
        yield Episode(
            index=number, task=task, task_index=tasks.index(task), length=shard.made.rows, first_row=first_row,
            videos=videos, fields=about.fields(shard),
        )  # fmt: skip
        first_row += shard.made.rows


def _totals(
    shards: Sequence[Shard], episodes: Sequence[Episode], names: Mapping[str, Names], fps: int, had: Finished | None
) -> _Totals:
    """Return the statistics with all episodes known, and the rows of those that are there added."""
    totals = _Totals()
    if had is not None:
        for each in had.stats():
            totals.know(EpisodeStats(columns=each, pictures={}), {})
        totals.pictures |= had.pixels
    for shard, episode in zip(shards, episodes, strict=True):
        totals.know(_measured(shard), _joined_stats(episode, shard, names, fps))
    for rows in had.rows() if had is not None else ():
        for column, values in rows.items():
            totals.columns[column].add(values)
    return totals


def _index(episode: Episode, fps: int) -> Columns:
    """Return the columns that LeRobot itself gives every data set."""
    frames = np.arange(episode.length, dtype=np.int64)
    found = {
        "timestamp": frames / fps,
        "frame_index": frames,
        "episode_index": np.full(episode.length, episode.index),
        "index": episode.first_row + frames,
        "task_index": np.full(episode.length, episode.task_index),
    }
    return {name: found[name].astype(kind) for name, kind in INDEX.items()}


def _joined_stats(episode: Episode, shard: Shard, names: Mapping[str, Names], fps: int) -> dict[str, stats.Stats]:
    """Return the statistics of the columns whose numbers are those of the whole data set."""
    columns = {**_index(episode, fps), **{column: those.every(shard) for column, those in names.items()}}
    return {name: stats.of_rows(values) for name, values in columns.items()}


def _with_stats(episode: Episode, shard: Shard, names: Mapping[str, Names], fps: int) -> Episode:
    measured = _measured(shard)
    pictures = {name: stats.PixelCounts(**counted).stats() for name, counted in measured.pictures.items()}
    found = {
        **measured.columns,
        **_joined_stats(episode, shard, names, fps),
        **{name: stats.as_image(values) for name, values in pictures.items()},
    }
    return dataclasses.replace(episode, stats=found)


def _measured(shard: Shard) -> EpisodeStats:
    return msgspec.json.decode((shard.folder / STATS).read_bytes(), type=EpisodeStats)


@contextmanager
def _opened(plan: Plan, folder: Path) -> Iterator[Layout]:
    layout = layout_of(plan, folder)
    try:
        yield layout
    except BaseException:
        layout.abandon()
        raise


def split(shards: Sequence[Shard], share: float, seed: int) -> dict[str, list[Shard]]:
    """Return the shards for training, then those set aside, each in the order given.

    LeRobot knows a part of a data set as a range of episodes, so those set aside come last. At least one is set aside
    when a share is asked for and there are two, and at least one is left.
    """
    count = min(max(1, round(share * len(shards))), len(shards) - 1) if share > 0.0 else 0
    ranked = sorted(shards, key=lambda shard: _rank(shard.source.episode_id, seed))
    aside = {shard.source.episode_id for shard in ranked[:count]}
    return {
        TRAIN: [shard for shard in shards if shard.source.episode_id not in aside],
        VAL: [shard for shard in shards if shard.source.episode_id in aside],
    }


def ranges(parts: dict[str, list[Shard]]) -> dict[str, str]:
    """Return the parts as ranges of episodes, ``"0:80"``; an empty part is left out."""
    found: dict[str, str] = {}
    begin = 0
    for name, shards in parts.items():
        if shards:
            found[name] = f"{begin}:{begin + len(shards)}"
        begin += len(shards)
    return found


def _rank(episode_id: str, seed: int) -> str:
    return hashlib.sha256(f"{seed}:{episode_id}".encode()).hexdigest()


def modality(common: Common) -> dict[str, Any]:
    """Return the document: groups of consecutive numbers for state and action, cameras, and where the task stands."""
    return {
        "state": groups(common.state_names),
        "action": groups(common.action_names),
        "video": {camera.name: {"original_key": IMAGES + camera.name} for camera in common.cameras},
        "annotation": {_LANGUAGE: {"original_key": "task_index"}},
    }


def groups(names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return start and end (exclusive) of each group of consecutive names that belong together, by its name."""
    found: dict[str, dict[str, int]] = {}
    last = ""
    for index, name in enumerate(names):
        group = group_of(name)
        if group == last:
            next(reversed(found.values()))["end"] = index + 1
        else:
            found[_free(group, found)] = {"start": index, "end": index + 1}
        last = group
    return found


def group_of(name: str) -> str:
    """Return the part of the body, or of the root, that an element belongs to, with ``_vel`` … for no position."""
    name = name.rpartition(".")[2]  # without the key
    quantity = _QUANTITY.search(name)
    joint = name[: quantity.start()] if quantity else name
    suffix = f"_{quantity[1]}" if quantity and quantity[1] != "pos" else ""
    prefix = _SCALED if joint.startswith(_SCALED) else ""
    return prefix + _part(joint.removeprefix(prefix), is_joint=quantity is not None) + suffix


def _part(joint: str, *, is_joint: bool) -> str:
    words = joint.split("_")
    side = f"{words[0]}_" if words[0] in ("left", "right") else ""
    if is_joint:
        rest = words[1:] if side else words
        limb = next((limb for limb, joints in _LIMBS.items() if rest and rest[0] in joints), None)
        return side + (limb or (rest or words)[0])
    if words[0] == "root" and "quat" not in words:
        return "root"
    while _ELEMENT.search(joint):
        joint = _ELEMENT.sub("", joint)
    return joint


def _free(name: str, taken: Iterable[str]) -> str:
    """Return a name that is not taken: with a number behind it where the same part comes again."""
    names, number = set(taken), 2
    if name not in names:
        return name
    while f"{name}_{number}" in names:
        number += 1
    return f"{name}_{number}"
