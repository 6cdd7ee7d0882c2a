"""From writes as they came to rows on one clock; the rule of each column follows from its role, and is told.

What makes the difference is the action. A policy step reads the state, then writes what it made of it, a few
milliseconds later; a row of data must hold both. So the action of a row is not what happens to be newest at its tick,
which would be the one before for every tick that falls into those milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from station.episode.reading import steps
from station.episode.reading.messages import Ints
from station.errors import EpisodeError
from station.export.columns import KeyColumns
from station.export.tracks import Recorded, Track, Words
from station.protocols import Floats

RULES = {
    "clock": "ticks exactly 1/fps apart on the episode's clock, from the first instant at which every column has a "
    "value to the last, put just behind the writes of the state so that their jitter repeats and skips none",
    "newest": "the newest value written at or before the tick",
    "step": "what the policy step made of the state of the same row: the first value that the same process wrote at or "
    "after that state; so action[t] is the one that was applied after state[t] had been read",
    "picture": "the picture taken nearest to the tick, before or after",
    "newest picture": "the newest picture taken at or before the tick, as a policy that runs has it at best",
    "gate": "as the policy step said it that made the action of the row; the newest at or before the tick where the "
    "action is of no step",
    "commander": "the newest at or before the tick",
}
"""How a row is made, in words, for people who train with it."""

_SLACK = 1.05  # a loop at its nominal rate may measure a little less
_NEAR = 0.8  # of its nominal rate: a loop that was busy; another recorder that polled has less

NANOSECONDS = 1_000_000_000

PictureRule = Literal["nearest", "newest"]
"""Which picture a row shows: the nearest to its tick, or the newest that was there."""

_LATEST = 99  # percentile of the writes that a tick shall come after
_MARGIN = 0.05  # of the writers' period
_STEADY = 0.5  # length of the mean of the phases as unit vectors: 1 when all agree, 0 when they are anywhere


class Column(NamedTuple):
    """A key in n rows: its m numbers, shape (n, m), and tick minus the time of the value, shape (n,) [s]."""

    values: Floats
    ages_s: Floats


class Pictures(NamedTuple):
    """A camera in n rows: which picture, in order of arrival and never descending, shape (n,); its age likewise."""

    numbers: Ints
    ages_s: Floats


@dataclass(frozen=True)
class Table:
    """Rows of one episode.

    Attributes:
        ticks_ns: Instants of the n rows, shape (n,) [ns since the epoch].
        state, action: By key. An age is negative where the value is of after the tick.
        pictures: By the key of the camera.
        head_s, tail_s: Recorded time before the first and after the last row [s].
        words: By key, the number of a row's word among `Words.names`, -1 before the first, shape (n,).
        lacks_own_step: Rows of whose step no action was recorded, so that a neighbouring step's stands there: that of
            the next step of the same process, else that of the one before; shape (n,).
    """

    ticks_ns: Ints
    state: Mapping[str, Column]
    action: Mapping[str, Column]
    pictures: Mapping[str, Pictures]
    head_s: float
    tail_s: float
    words: Mapping[str, Ints]
    lacks_own_step: NDArray[np.bool_]

    @property
    def without_own_step(self) -> int:
        """How many rows lack an action of their own step."""
        return int(np.count_nonzero(self.lacks_own_step))

    def part(self, begin: int, end: int) -> Table:
        """Return rows from `begin` to before `end`; what is left out counts as not recorded into rows."""
        rows = slice(begin, end)
        head_ns, tail_ns = self.ticks_ns[begin] - self.ticks_ns[0], self.ticks_ns[-1] - self.ticks_ns[end - 1]
        return Table(
            ticks_ns=self.ticks_ns[rows],
            state={key: Column(one.values[rows], one.ages_s[rows]) for key, one in self.state.items()},
            action={key: Column(one.values[rows], one.ages_s[rows]) for key, one in self.action.items()},
            pictures={key: Pictures(one.numbers[rows], one.ages_s[rows]) for key, one in self.pictures.items()},
            head_s=self.head_s + float(head_ns) * 1e-9,
            tail_s=self.tail_s + float(tail_ns) * 1e-9,
            words={key: codes[rows] for key, codes in self.words.items()},
            lacks_own_step=self.lacks_own_step[rows],
        )


def state_of_step(key: str, there: Iterable[str]) -> str | None:
    """Return the key of the state that a policy step reads before it writes a key; None for a key of no step.

    Args:
        key: The key.
        there: The keys that there are.
    """
    robot = steps.robot_of_step(key)
    return None if robot is None else steps.state_key(robot, there)


def rule_of(columns: KeyColumns, *, as_action: bool) -> str:
    """Return the name in `RULES` of what makes a key's column."""
    return "step" if as_action and columns.role == "policy" and steps.robot_of_step(columns.key) else "newest"


def resample(
    recorded: Recorded,
    state: Sequence[KeyColumns],
    action: Sequence[KeyColumns],
    fps: int,
    episode: str,
    shown: PictureRule = "nearest",
) -> Table:
    """Make the rows of one episode.

    Args:
        recorded: Tracks of all keys below, and of the states that steps of the action read; pictures of all cameras
            that are wanted.
        state, action: Keys of the state and of the action; a key may be both.
        fps: Rate of the rows [Hz].
        episode: Its id, for messages.
        shown: Which picture a row shows, of each camera.

    Raises:
        EpisodeError: a key has no value, `fps` is more than the state has, or no instant has all columns.
    """
    newest = [*state, *(one for one in action if rule_of(one, as_action=True) == "newest")]
    made = [one for one in action if rule_of(one, as_action=True) == "step"]
    for name, times in _all_times(recorded).items():
        if not len(times):
            raise EpisodeError(f"{episode}: {name} has no value that fits in it; leave the key out, or the episode")
    pairs = {one.key: _pairs(recorded, one.key, episode) for one in made}
    pace = _pace(recorded, state, made)
    _expect_rate(pace, state, fps, episode)
    first, last = _span(recorded, newest, pairs)
    ticks = ticks_at(first, last, fps, pace)
    if not len(ticks):
        raise EpisodeError(f"{episode}: no instant at which {_spoken(recorded)} all have a value; nothing to export")
    return _table(recorded, state, action, pairs, ticks, shown)


@dataclass(frozen=True)
class _Pairs:
    """Of each state while a policy ran: its time, the index of its action, and whether that is its own; ascending."""

    state_ns: Ints
    action: Ints
    is_own: NDArray[np.bool_]
    track: Track


def _pairs(recorded: Recorded, key: str, episode: str) -> _Pairs:
    """Pair every state with the first action that its own writer wrote at or after it."""
    state_key = state_of_step(key, recorded.tracks) or key
    states, actions = recorded.tracks[state_key], recorded.tracks[key]
    chosen = np.full(len(states.times_ns), -1, dtype=np.int64)
    is_own = np.zeros(len(chosen), dtype=np.bool_)
    for writer in np.unique(states.writers):
        of_states, of_actions = np.flatnonzero(states.writers == writer), np.flatnonzero(actions.writers == writer)
        times = states.times_ns[of_states]
        place = np.searchsorted(actions.times_ns[of_actions], times, side="left")
        is_there = place < len(of_actions)
        found = of_actions[place[is_there]]
        chosen[of_states[is_there]] = found
        until = np.append(times[1:], np.iinfo(np.int64).max)[is_there]
        is_own[of_states[is_there]] = actions.times_ns[found] < until
    followed = np.flatnonzero(is_own)
    if not len(followed):
        raise EpisodeError(
            f"{episode}: no value of {key} follows a state in {state_key}; name another key with --action"
        )
    kept = np.arange(followed[0], followed[-1] + 1)  # before and after that, no policy ran
    latest = np.maximum.accumulate(np.where(chosen[kept] >= 0, kept, -1))  # a process that ended writes no next one
    return _Pairs(states.times_ns[kept], chosen[latest], is_own[kept], actions)


def _all_times(recorded: Recorded) -> dict[str, Ints]:
    return {**{key: track.times_ns for key, track in recorded.tracks.items()}, **recorded.pictures}


def _pace(recorded: Recorded, state: Sequence[KeyColumns], made: Sequence[KeyColumns]) -> Ints:
    """Return the times of what the rows are about: the state that the policy steps read, else the fastest state."""
    if made:
        return recorded.tracks[state_of_step(made[0].key, recorded.tracks) or made[0].key].times_ns
    times = [recorded.tracks[one.key].times_ns for one in state]
    return max(times, key=len) if times else next(iter(recorded.tracks.values())).times_ns


def _expect_rate(pace: Ints, state: Sequence[KeyColumns], fps: int, episode: str) -> None:
    period = period_ns(pace)
    measured = NANOSECONDS / period if period > 0 else 0.0
    rate = max([measured, *(one.rate_hz for one in state if one.rate_hz and measured >= _NEAR * one.rate_hz)])
    if fps > rate * _SLACK:
        raise EpisodeError(
            f"{episode}: --fps {fps} is more than its state has ({rate:.3g} Hz), so rows would only repeat; "
            f"ask for {max(1, round(rate))} or less"
        )


def _span(recorded: Recorded, newest: Sequence[KeyColumns], pairs: Mapping[str, _Pairs]) -> tuple[int, int]:
    """Return the first and the last instant at which every column has a value [ns].

    A value that is written as things happen holds until the next one; one that is written at a rate holds until its
    last, because its writer may be gone.
    """
    firsts = [int(recorded.tracks[one.key].times_ns[0]) for one in newest]
    lasts = [int(recorded.tracks[one.key].times_ns[-1]) for one in newest if one.rate_hz is not None]
    firsts += [int(pair.state_ns[0]) for pair in pairs.values()]
    lasts += [int(pair.state_ns[-1]) for pair in pairs.values()]
    firsts += [int(times.min()) for times in recorded.pictures.values()]
    lasts += [int(times.max()) for times in recorded.pictures.values()]
    return max(firsts), min(lasts or [int(times[-1]) for times in _all_times(recorded).values()])


def _table(
    recorded: Recorded,
    state: Sequence[KeyColumns],
    action: Sequence[KeyColumns],
    pairs: Mapping[str, _Pairs],
    ticks: Ints,
    shown: PictureRule,
) -> Table:
    def newest(key: str) -> Column:
        track = recorded.tracks[key]
        index = np.searchsorted(track.times_ns, ticks, side="right") - 1
        return Column(track.values[index], ages_s(ticks, track.times_ns[index]))

    lacks_own_step, stepped_ns = np.zeros(len(ticks), dtype=np.bool_), ticks
    actions: dict[str, Column] = {}
    for key in (one.key for one in action):
        if (pair := pairs.get(key)) is None:
            actions[key] = newest(key)
            continue
        row = np.searchsorted(pair.state_ns, ticks, side="right") - 1
        index = pair.action[row]
        actions[key] = Column(pair.track.values[index], ages_s(ticks, pair.track.times_ns[index]))
        lacks_own_step |= ~pair.is_own[row]
        stepped_ns = pair.track.times_ns[index]
    choose = nearest if shown == "nearest" else newest_picture
    pictures = {
        key: Pictures(numbers := choose(times, ticks), ages_s(ticks, times[numbers]))
        for key, times in recorded.pictures.items()
    }
    every = _all_times(recorded).values()
    head_ns, tail_ns = ticks[0] - min(t.min() for t in every), max(t.max() for t in every) - ticks[-1]
    return Table(
        ticks_ns=ticks,
        state={one.key: newest(one.key) for one in state},
        action=actions,
        pictures=pictures,
        head_s=max(0.0, float(head_ns) * 1e-9),
        tail_s=max(0.0, float(tail_ns) * 1e-9),
        words={
            key: newest_word(words, stepped_ns if steps.robot_of_step(key) else ticks)
            for key, words in recorded.words.items()
        },
        lacks_own_step=lacks_own_step,
    )


def newest_word(words: Words, instants_ns: Ints) -> Ints:
    """Return the number of the newest word at each instant, -1 where there is none yet."""
    if not len(words.codes):
        return np.full(len(instants_ns), -1, dtype=np.int64)
    place = np.searchsorted(words.times_ns, instants_ns, side="right") - 1
    return np.where(place >= 0, words.codes[place], -1)


def nearest(times_ns: Ints, ticks_ns: Ints) -> Ints:
    """Return which of the times, given in order of arrival, is nearest to each tick; the earlier of two equally near.

    One that is not later than all before it is never chosen, so the result never descends: pictures can be taken
    from a file one after another.
    """
    ahead = _ascending(times_ns)
    times = times_ns[ahead]
    right = np.searchsorted(times, ticks_ns, side="left").clip(0, len(times) - 1)
    left = (right - 1).clip(0)
    is_left = np.abs(ticks_ns - times[left]) <= np.abs(times[right] - ticks_ns)
    return ahead[np.where(is_left, left, right)]


def newest_picture(times_ns: Ints, ticks_ns: Ints) -> Ints:
    """Return which of the times, given in order of arrival, is the newest at or before each tick; never descending.

    The first one stands for ticks before it.
    """
    ahead = _ascending(times_ns)
    place = np.searchsorted(times_ns[ahead], ticks_ns, side="right") - 1
    found: Ints = ahead[place.clip(0)]
    return found


def _ascending(times_ns: Ints) -> Ints:
    """Return which of the times are later than all before them."""
    newest = np.maximum.accumulate(times_ns)
    return np.append(0, 1 + np.flatnonzero(newest[1:] > newest[:-1]))


def ages_s(ticks: Ints, times: Ints) -> Floats:
    """Return how old values are at their ticks, both in nanoseconds since the epoch [s]."""
    return np.asarray((ticks - times) * 1e-9, dtype=np.float64)


def _spoken(recorded: Recorded) -> str:
    names = list(_all_times(recorded))
    return ", ".join(names[:4]) + (" …" if len(names) > 4 else "")


def ticks_at(first_ns: int, last_ns: int, fps: int, pace_ns: Ints) -> Ints:
    """Return the instants of a table, ascending; none when the last comes before the first.

    They are exactly 1/fps apart. The first one comes less than a period of the pace after `first_ns`, where most
    writes of the pace (the robot's state) are just over. Ticks that fell on the writes themselves would see, by a few
    microseconds of jitter, one value twice and the next one never.

    Args:
        first_ns, last_ns: Where the table may begin and must end [ns since the epoch].
        fps: Rate [Hz].
        pace_ns: When the values were written that the rows are made of, ascending.
    """
    start_ns = first_ns + _delay_ns(first_ns, fps, pace_ns)
    if start_ns > last_ns:
        start_ns = first_ns
    count = (last_ns - start_ns) * fps // NANOSECONDS + 1
    steps = np.arange(max(count, 0), dtype=np.int64)
    return start_ns + steps * NANOSECONDS // fps


def period_ns(times_ns: Ints) -> int:
    """Return the usual time between two writes, 0 for fewer than two [ns]."""
    return int(np.median(np.diff(times_ns))) if len(times_ns) > 1 else 0


def _delay_ns(first_ns: int, fps: int, pace_ns: Ints) -> int:
    """Return how long after an instant the writes of a steady pace are over, 0 for an unsteady one [ns]."""
    period = period_ns(pace_ns)
    if period <= 0:
        return 0
    rate = fps * max(1, round(NANOSECONDS / (fps * period)))  # of the clock, or as many times as fast
    angles = (pace_ns - first_ns) * rate % NANOSECONDS * (2 * np.pi / NANOSECONDS)
    mean = np.exp(1j * angles).mean()
    if abs(mean) < _STEADY:
        return 0
    off = np.angle(np.exp(1j * (angles - np.angle(mean))))  # -pi to pi: early or late
    over = np.angle(mean) + np.percentile(off, _LATEST) + 2 * np.pi * _MARGIN
    return int(over % (2 * np.pi) * NANOSECONDS / (2 * np.pi * rate))
