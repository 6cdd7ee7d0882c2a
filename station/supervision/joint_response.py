"""What joints did: whether each follows its own target alone, and what motors do once nobody commands them. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from station.protocols import Floats
from station.supervision.figures import Bounds, Figure

# How a joint answers to its own target, 1 for as far as it was led. A soft joint of a limb that hangs has 0.14.
_ANSWERS = 0.05
_ALONE = 0.5  # of its own answer; that of any other joint is below
_STILL_S = 0.15  # a target that stands so long is not being led; it stands for a moment on its way back

_SOME_LOAD = 0.5  # of all joints together [N m]; with less there is no seeing whether they are held
_HELD = 0.5  # of the load at the start; with less at the end they are not held any more
_AT_START_S = 0.5
_MOVES_RAD_S = 0.05
_NOISES = 3.0  # times what speeds were at the start, where nothing moved
_DAMPED_FOR_S = 1.0  # after they began to move
_DAMPS = 1.5  # [N m s/rad]; the friction of a gear is below, what a firmware damps with above


def follows(time_s: Floats, asked: Floats, measured: Floats, names: Sequence[str]) -> list[Figure]:
    """Return for each joint that was led whether it went there, and it alone.

    While its target moves, what each joint did is compared with that target: 1 went as far, -1 as far the other way, 0
    did nothing that has to do with it. A joint that is held softly does not go as far, and comes late: by up to a
    quarter of its turn that is allowed for, beyond it late and the other way round are not told apart.

    Args:
        time_s: Of the rows, shape (k,) [s].
        asked, measured: Targets and positions, shape (k, n) [rad].
        names: Of the joints, n.
    """
    found = []
    for joint, name in enumerate(names):
        rows = _turn(time_s, asked[:, joint])
        if rows is None:
            continue
        answer = _answers(time_s, rows, _trendless(asked[rows, joint]), measured)
        own = float(answer[joint])
        others = np.where(np.arange(len(names)) == joint, 0.0, np.abs(answer))
        other = int(np.argmax(others))
        found.append(_response(name, own, names[other], float(others[other]), float(np.ptp(measured[rows, joint]))))
    return found


def _answers(time_s: Floats, rows: slice, led: Floats, measured: Floats) -> Floats:
    """Return how joints answer to a target, each as late as it answers most, shape (n,).

    How late is counted in seconds and not in rows: of a busy machine rows lack, and what comes behind such a hole is
    another joint's turn.

    Args:
        time_s: Of all rows [s].
        rows: In which the joint was led, k of them.
        led: The target there, without its trend, shape (k,) [rad].
        measured: Of all joints in all rows, shape (m, n) [rad].
    """
    at_s = time_s[rows]
    latest_s = min((at_s[-1] - at_s[0]) / 4.0, time_s[-1] - at_s[-1])
    shifts_s = np.linspace(0.0, latest_s, len(led) // 4 + 1)
    shifted = (np.stack([np.interp(at_s + by_s, time_s, each) for each in measured.T], axis=1) for by_s in shifts_s)
    found = np.array([_trendless(each).T @ led for each in shifted]) / (led @ led)
    return np.asarray(np.take_along_axis(found, np.abs(found).argmax(axis=0)[None], axis=0)[0])


def _response(name: str, own: float, other: str, others: float, moved_rad: float) -> Figure:
    wrong = ""
    if others > _ANSWERS and others > abs(own):
        wrong = f"{other} moved in its place"
    elif own <= -_ANSWERS:
        wrong = "it moved the wrong way"
    elif own < _ANSWERS:
        wrong = "it did not follow"
    elif others > _ALONE * own:
        wrong = f"{other} moved with it"
    text = f"moved by {moved_rad:.3f} rad, answers with {own:.2f}; of the others most {other}, with {others:.2f}"
    return Figure(
        name=name, text=f"{wrong}: {text}" if wrong else text, expected="it alone follows", is_good=not wrong,
        numbers={"answers": own, "moved_rad": moved_rad, "other": other, "other_answers": others},
    )  # fmt: skip


def _turn(time_s: Floats, target: Floats) -> slice | None:
    """Return the rows in which a joint is led, the longest such span; None where it is not."""
    moving = np.flatnonzero(np.abs(target - np.median(target)) > 1e-4)
    if len(moving) < 3:
        return None
    spans = np.split(moving, np.flatnonzero(np.diff(time_s[moving]) > _STILL_S) + 1)
    longest = max(spans, key=len)
    if len(longest) < 3:
        return None
    return slice(max(0, int(longest[0]) - 1), min(len(target), int(longest[-1]) + 2))


def _trendless(values: Floats) -> Floats:
    """Return columns without their mean and their drift."""
    line = np.stack([np.ones(len(values)), np.linspace(-1.0, 1.0, len(values))], axis=1)
    return np.asarray(values - line @ np.linalg.lstsq(line, values, rcond=None)[0])


def let_go(
    time_s: Floats, torque: Floats, speed: Floats, after: Bounds | None = None, *, since: str = "commands ceased"
) -> list[Figure]:  # fmt: skip
    """Return what motors do once nobody commands them: ``hold``, ``damp`` or ``limp``, and after how long.

    They hold where they bear in the end what they bore at the start. Otherwise they let go when the joints began to
    move; they are damped where torque went against speed meanwhile, and limp where hardly any came.

    Args:
        time_s: Of the rows since the commands ceased, shape (k,) [s]; below 0 before.
        torque: Shape (k, n) [N m].
        speed: Shape (k, n) [rad/s].
        after: When they are expected to let go [s].
        since: In words, from when time is counted.
    """
    at_start = time_s <= time_s[0] + _AT_START_S
    before = torque[at_start].mean(axis=0)
    load = float(np.linalg.norm(before))
    if not load > _SOME_LOAD:
        return [Figure(name="motors", text=f"cannot be told: they bore {load:.2g} N m at the start",
                       expected=f"more than {_SOME_LOAD:g} N m to bear", is_good=False)]  # fmt: skip
    at_end = torque[time_s >= time_s[-1] - _AT_START_S].mean(axis=0)
    share = float(at_end @ before) / load**2
    if share > _HELD:
        text = f"hold: stiff to the end, {time_s[-1]:.1f} s after {since}"
        numbers: dict[str, float | str] = {"do": "hold", "for_s": float(time_s[-1])}
        is_good = after is None or after.most is None
        return [Figure(name="motors", text=text, expected=_let_go_within(after), is_good=is_good, numbers=numbers)]
    fastest = np.abs(speed).max(axis=1)
    still = _NOISES * float(fastest[at_start].max())
    moves = np.flatnonzero((fastest > max(_MOVES_RAD_S, still)) & ~at_start)
    since_s = float(time_s[moves[0]]) if len(moves) else 0.0
    falls = (time_s >= since_s) & (time_s <= since_s + _DAMPED_FOR_S)
    damping = float(-(torque[falls] * speed[falls]).sum() / max(float((speed[falls] ** 2).sum()), 1e-12))
    do = "damp" if damping > _DAMPS else "limp"
    return [
        Figure(
            name="motors", text=f"{do}: {since_s:.2f} s after {since}, {damping:.2g} N m s/rad",
            expected=_let_go_within(after), is_good=after is None or after.hold(since_s, since_s),
            numbers={"do": do, "after_s": since_s, "damping": damping},
        )
    ]  # fmt: skip


def _let_go_within(after: Bounds | None) -> str:
    return f"let go {after} s later" if after is not None else ""


def bits(time_s: Floats, words: Floats, names: Sequence[str]) -> Figure:
    """Return which bits of some words came, by when they first did: shape (k,) [s] and (k, n), whole numbers."""
    found: dict[str, float | str] = {}
    told = []
    whole = np.nan_to_num(words).astype(np.int64)
    for bit in range(64):
        is_set = (whole >> bit) & 1 == 1
        if is_set.any():
            row = int(is_set.any(axis=1).argmax())
            found[f"{1 << bit:#x}"] = float(time_s[row])
            count = int(is_set.any(axis=0).sum())
            first = names[int(is_set[row].argmax())]
            told.append(f"{1 << bit:#x} after {time_s[row]:.2f} s, {count} of {len(names)}, first {first}")
    return Figure(name="bits", text="; ".join(told) or "none", numbers=found)
