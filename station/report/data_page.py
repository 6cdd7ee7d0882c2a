"""The first part of a report: all episodes together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from statistics import median

from station.bus import contracts
from station.contract import Contract
from station.episode.quality.findings import Spread
from station.report import figures
from station.report.episode_page import anchor, badge
from station.report.episode_tables import words
from station.report.gather import Episode, UnreadableEpisode
from station.report.html import Child, Html, details, join, table, tag

_MOST_KEYS = 200


def summary(episodes: Sequence[Episode], unread: Sequence[UnreadableEpisode], *, title: str, pictured: int) -> Html:
    """Return what is to be said of all episodes.

    Args:
        episodes: The episodes, oldest first.
        unread: Those that cannot be reported on.
        title: Title of the report.
        pictured: How many of them have pictures below.
    """
    if len(episodes) == 1 and not unread:  # its own section says all of it
        return tag("h1", title, id="top")
    times = [started for episode in episodes if (started := episode.started) is not None]
    parts = [
        tag("h1", title, id="top"),
        tag("p", _when(times), class_="soft"),
        _tiles(episodes),
        tag("div", _verdicts(episodes), _lengths(episodes), class_="card"),
        _reasons(episodes),
        _discarded(episodes),
        _people(episodes),
        _latency(episodes),
        _unread(unread),
        _index(episodes, pictured),
    ]
    return join(parts)


def _when(times: Sequence[datetime]) -> str:
    if not times:
        return "nothing says when they were recorded"
    first, last = min(times), max(times)
    return f"recorded {first:%Y-%m-%d %H:%M} to {last:%H:%M}" if first.date() == last.date() else (
        f"recorded {first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M}"
    )  # fmt: skip


def _tiles(episodes: Sequence[Episode]) -> Html:
    seconds = sum(episode.quality.length_s for episode in episodes)
    pace = figures.pace(episodes)
    said = [episode.quality.success for episode in episodes if episode.quality.success is not None]
    lengths = [episode.quality.length_s for episode in episodes]
    tiles = {
        "episodes": str(len(episodes)),
        "robot time": _long(seconds),
        "median length": _long(median(lengths)) if lengths else "–",
        "takes per hour": _rate(pace.per_hour),
        "of them not rejected": _rate(pace.good_per_hour),
        "successes": f"{sum(said)} of {len(said)}" if said else "not said",
    }
    text = (
        f"Takes per hour are measured over {pace.sessions} session(s) with {pace.takes} takes in {pace.hours:.2f} h, "
        f"from the first start of a session to its last end, resets between takes included; a pause of more than "
        f"{figures.BREAK_S / 60:.0f} minutes ends a session."
    )
    shown = [tag("div", tag("b", value), tag("span", name), class_="tile") for name, value in tiles.items()]
    return join([tag("div", shown, class_="tiles"), tag("p", text, class_="soft") if pace.sessions else None])


def _verdicts(episodes: Sequence[Episode]) -> Html:
    counts = figures.counts(episodes)
    bars = [
        tag(
            "div",
            f"{count} {verdict}",
            class_=verdict,
            style=f"flex:{count}",
            title=f"{count} of {len(episodes)} {verdict}",
        )
        for verdict, count in counts.items()
        if count
    ]
    return join([tag("h3", "Verdicts"), tag("div", bars, class_="stack")])


def _lengths(episodes: Sequence[Episode]) -> Html | None:
    bins = figures.lengths(episodes)
    if len(episodes) < 3:
        return None
    top = max(sum(one.counts.values()) for one in bins)
    columns = [
        tag(
            "div",
            [
                tag("i", "", class_=verdict, style=f"height:{100 * count / top:.2f}%")
                for verdict, count in one.counts.items()
                if count
            ],
            title=f"{one.from_s:g} to {one.to_s:g} s: {sum(one.counts.values())} episodes",
        )
        for one in bins
    ]  # fmt: skip
    ends = tag(
        "div",
        tag("span", f"{bins[0].from_s:g} s"),
        tag("span", f"most: {top}"),
        tag("span", f"{bins[-1].to_s:g} s"),
        class_="axis",
    )
    return join([tag("h3", "Lengths"), tag("div", columns, class_="chart"), ends])


def _reasons(episodes: Sequence[Episode]) -> Html | None:
    rows = [
        (tag("b", rule), str(reject) if reject else "", str(usable) if usable else "", text)
        for rule, reject, usable, text in figures.reasons(episodes)
    ]
    if not rows:
        return None
    head = ("rule", "rejected", "usable", "for example")
    return tag("div", tag("h3", "Why episodes are not good"), table(head, rows), class_="card")


def _discarded(episodes: Sequence[Episode]) -> Html | None:
    found = [episode for episode in episodes if episode.quality.discarded]
    if not found:
        return None
    rows = [
        (_link(episode), _started(episode), episode.manifest.operator.id, episode.discarded_for or "nobody said why")
        for episode in found
    ]
    head = ("episode", "started", "operator", "why")
    return tag("div", tag("h3", f"Discarded ({len(found)})"), table(head, rows), class_="card")


def _people(episodes: Sequence[Episode]) -> Html | None:
    """Return a row for each task and operator, where there are several."""
    groups: dict[tuple[str, str], list[Episode]] = {}
    for episode in episodes:
        groups.setdefault((episode.manifest.task.name, episode.manifest.operator.id), []).append(episode)
    if len(groups) < 2:
        return None
    rows = []
    for (task, operator), group in sorted(groups.items()):
        counts, pace = figures.counts(group), figures.pace(group)
        said = [one.quality.success for one in group if one.quality.success is not None]
        rows.append((
            task, operator or "–", str(len(group)), *(str(counts[verdict]) for verdict in figures.VERDICTS),
            f"{sum(said)} of {len(said)}" if said else "–", _long(sum(one.quality.length_s for one in group)),
            _rate(pace.per_hour),
        ))  # fmt: skip
    head = ("task", "operator", "episodes", *figures.VERDICTS, "successes", "robot time", "takes per hour")
    return tag("div", tag("h3", "Tasks and operators"), table(head, rows), class_="card")


def _latency(episodes: Sequence[Episode]) -> Html | None:
    """Return each stage of a policy step over all episodes that ran by the clock."""
    found: dict[str, list[tuple[Spread, Episode]]] = {}
    for episode in episodes:
        for steps in () if episode.quality.lock_step else episode.quality.steps:
            for name, spread in {"age of the command at use": steps.command_age, **steps.stages}.items():
                if spread.p99_s is not None:
                    found.setdefault(name, []).append((spread, episode))
    if not found:
        return None
    rows: list[Sequence[Child]] = []
    for name, spreads in found.items():
        worst, where = max(spreads, key=lambda item: item[0].p99_s or 0.0)
        p50, p99 = median(one.p50_s or 0.0 for one, _ in spreads), median(one.p99_s or 0.0 for one, _ in spreads)
        rows.append((words(name), str(len(spreads)), _ms(p50), _ms(p99), _ms(worst.p99_s or 0.0), _link(where)))
    head = ("latency of each stage", "episodes", "p50, median episode", "p99, median episode", "p99, worst", "in")
    return tag(
        "div", tag("h3", "Latency of each stage over all episodes"), table(head, rows, class_="numbers"), class_="card"
    )


def _unread(unread: Sequence[UnreadableEpisode]) -> Html | None:
    if not unread:
        return None
    rows = [(one.name, tag("span", one.problem, class_="bad")) for one in unread]
    return tag("div", tag("h3", f"Not in this report ({len(unread)})"), table(("episode", "why"), rows), class_="card")


def _index(episodes: Sequence[Episode], pictured: int) -> Html:
    rows = []
    for episode in episodes:
        quality = episode.quality
        error = next(
            (steps.mean_joint_error_rad for steps in quality.steps if steps.mean_joint_error_rad is not None), None
        )
        first = next((reason for reason in quality.reasons if reason.verdict == quality.verdict), None)
        rows.append((
            _link(episode), badge(quality.verdict), _started(episode), f"{quality.length_s:.1f} s",
            episode.manifest.operator.id or "–", {None: "–", True: "yes", False: "no"}[quality.success],
            "–" if error is None else f"{error:.3f} rad", first.rule if first else "",
        ))  # fmt: skip
    head = ("episode", "verdict", "started", "length", "operator", "success", "joint error", "first reason")
    left_out = len(episodes) - pictured
    note = (
        f"Time line and pictures are drawn for {pictured} of them; name an episode to have it drawn."
        if left_out
        else None
    )
    return tag(
        "div", tag("h3", "Episodes"), table(head, rows), tag("p", note, class_="soft") if note else None, class_="card"
    )


def _link(episode: Episode) -> Html:
    return tag("a", episode.name, href=f"#{anchor(episode)}")


def _started(episode: Episode) -> str:
    started = episode.started
    return "" if started is None else f"{started:%Y-%m-%d %H:%M}"


def _rate(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _ms(value_s: float) -> str:
    return f"{value_s * 1e3:.1f} ms"


def _long(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def columns(keys: Iterable[str], recorded: Mapping[str, Contract]) -> Html | None:
    """Return every key with what its contract says: as it was recorded where that was read, else as it is today."""
    found = {key: contract for key in keys if (contract := recorded.get(key) or contracts.contract(key)) is not None}
    rows = [_row(found[key]) for key in sorted(found, key=lambda key: (not found[key].elements, key))][:_MOST_KEYS]
    if not rows:
        return None
    text = (
        "The names and units of these numbers are the columns of an export, which takes them from the same contracts; "
        "they are recorded beside the values. In a LeRobot data set, unless other keys were named, observation.state "
        "is robot_state_… (of an arm state_joints_…), action is command_used_…, observation.images.NAME is "
        "camera_image_NAME; the columns age_s.* say how old each was at time_ns, the instant of the row. README.md in "
        "the data set has all of its own."
    )
    head = ("key", "role", "rate", "numbers", "what it holds")
    return tag(
        "div",
        tag("h3", "What each column is", id="columns"),
        tag("p", text, class_="soft"),
        table(head, rows),
        class_="card",
    )


def _row(contract: Contract) -> tuple[Html | str, ...]:
    rate = "on events" if contract.rate_hz is None else f"{contract.rate_hz:g} Hz"
    names = [(str(n), tag("code", element.name), element.unit) for n, element in enumerate(contract.elements)]
    note = tag("span", contract.note)
    unfolded = details(f"{len(names)} columns", table(("", "name", "unit"), names)) if names else None
    count = str(len(names)) if names else contract.codec
    return tag("code", contract.key), contract.role, rate, count, tag("div", note, unfolded)
