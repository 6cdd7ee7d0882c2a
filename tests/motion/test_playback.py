from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.commands import twist, twist2
from adapters.motions.clip import Clip
from station.blends import VELOCITY_FADE_S
from station.motion.playback import Frame, Playback
from station.protocols import CommandFormat, Floats
from tests.adapters.motions.made import smooth

DT = 0.02
CLIP = Clip(smooth())
FORMAT = twist2.FORMAT
VELOCITIES = [0, 1, 5]


def at(time_s: float) -> Floats:
    return FORMAT.encode(CLIP.at(time_s), CLIP.joint_names)


def play(playback: Playback, seconds: float) -> list[Frame]:
    return [playback.step(DT) for _ in range(round(seconds / DT))]


def play_until(playback: Playback, phase: str, at_most_s: float = 20.0) -> list[Frame]:
    frames = []
    while playback.phase != phase:
        frames.append(playback.step(DT))
        assert len(frames) * DT < at_most_s
    return frames


def test_the_first_vector_is_the_default_and_one_second_later_comes_the_first_frame() -> None:
    playback = Playback(CLIP, FORMAT)
    first = playback.step(0.0)
    np.testing.assert_array_equal(first.command, FORMAT.default)
    assert first.phase == "entering"
    frames = play(playback, 1.0)
    np.testing.assert_allclose(frames[24].command, (FORMAT.default + at(0.0)) / 2)
    assert [frame.phase for frame in frames[-2:]] == ["entering", "playing"]
    np.testing.assert_array_equal(frames[-1].command, at(0.0))
    assert frames[-1].time_s == 0.0


def test_playing_samples_the_motion_once_per_step() -> None:
    playback = Playback(CLIP, FORMAT)
    play(playback, 1.0)
    for number, frame in enumerate(play(playback, 2.0), start=1):
        assert frame.time_s == pytest.approx(number * DT)
        assert frame.frame_index == int(number * DT * 30 + 1e-6)
        np.testing.assert_allclose(frame.command, at(number * DT), atol=1e-12)


def test_a_lead_samples_the_motion_ahead_as_stock_does() -> None:
    playback = Playback(CLIP, FORMAT, lead_s=DT)
    first = play(playback, 1.0)[-1]
    assert first.time_s == DT
    np.testing.assert_allclose(first.command, at(DT), atol=1e-12)


def test_the_last_frame_is_sent_and_two_seconds_later_the_default_exactly() -> None:
    playback = Playback(CLIP, FORMAT)
    last = play_until(playback, "leaving")[-2]
    assert last.time_s == CLIP.duration_s
    np.testing.assert_allclose(last.command, at(CLIP.duration_s), atol=1e-12)
    frames = play_until(playback, "done")
    assert len(frames) == 99  # the hundredth step of the blend, counted from the one that began it
    np.testing.assert_array_equal(frames[-1].command, FORMAT.default)
    np.testing.assert_array_equal(playback.step(DT).command, FORMAT.default)
    assert playback.is_complete


def test_leaving_is_linear_from_the_last_vector_sent_and_velocities_are_gone_after_200_ms() -> None:
    playback = Playback(CLIP, FORMAT)
    sent = play(playback, 2.5)[-1].command
    assert np.abs(sent[VELOCITIES]).min() > 0.0
    assert playback.leave()
    assert not playback.leave()
    for step, frame in enumerate(play(playback, 2.0), start=1):
        wanted = sent + (FORMAT.default - sent) * step / 100
        wanted[VELOCITIES] = sent[VELOCITIES] * max(1.0 - step / 10, 0.0)
        np.testing.assert_allclose(frame.command, wanted, atol=1e-12)
    assert playback.is_done
    assert not playback.is_complete


def test_leaving_where_one_stands_already_takes_no_time() -> None:
    playback = Playback(CLIP, FORMAT, wait_for_start=True)
    playback.step(DT)
    playback.leave()
    np.testing.assert_array_equal(playback.step(DT).command, FORMAT.default)
    assert playback.is_done


def test_waiting_sends_the_default_until_the_start() -> None:
    playback = Playback(CLIP, FORMAT, wait_for_start=True)
    for frame in play(playback, 3.0):
        assert frame.phase == "waiting"
        np.testing.assert_array_equal(frame.command, FORMAT.default)
    assert playback.start()
    assert not playback.start()
    assert play(playback, 1.0)[-1].phase == "playing"


def test_a_pause_holds_the_pose_and_eases_every_velocity_to_zero() -> None:
    playback = Playback(CLIP, FORMAT)
    before = play(playback, 2.0)[-1]
    assert abs(before.command[VELOCITIES]).max() > 0.4
    assert playback.pause()
    after = play(playback, 3.0)[-1]
    assert after.phase == "paused"
    assert after.time_s == before.time_s
    assert not after.command[VELOCITIES].any()
    kept = [index for index in range(35) if index not in VELOCITIES]
    np.testing.assert_allclose(after.command[kept], before.command[kept], atol=1e-12)


def test_after_a_pause_the_motion_goes_on_where_it_stood() -> None:
    playback = Playback(CLIP, FORMAT)
    before = play(playback, 2.0)[-1]
    playback.pause()
    play(playback, 3.0)
    assert playback.resume()
    assert not playback.resume()
    frames = play_until(playback, "playing")
    np.testing.assert_allclose(frames[-1].command, before.command, atol=1e-12)
    assert playback.step(DT).time_s == pytest.approx(before.time_s + DT)


def test_a_pause_while_entering_takes_no_less_time_than_the_entering_would_have() -> None:
    playback = Playback(CLIP, FORMAT, enter_s=5.0)
    play(playback, 1.0)
    playback.pause()
    frames = play(playback, 4.0)
    steps = np.abs(np.diff([frame.command for frame in frames], axis=0))
    assert (steps.max(axis=0) <= np.abs(FORMAT.default - at(0.0)) / (4.0 / DT) + 1e-9)[6:].all()


def test_a_seek_blends_over_a_second_and_is_counted() -> None:
    playback = Playback(CLIP, FORMAT)
    play(playback, 1.5)
    blends = playback.blends
    assert playback.seek(2.0)
    frames = play_until(playback, "playing")
    assert len(frames) == 50
    np.testing.assert_allclose(frames[-1].command, at(2.0), atol=1e-12)
    assert playback.blends == blends + 1


def test_a_seek_in_a_pause_stays_a_pause_and_one_before_the_start_waits() -> None:
    playback = Playback(CLIP, FORMAT, wait_for_start=True)
    assert playback.seek(1.0)
    assert playback.phase == "waiting"
    playback.start()
    assert play(playback, 1.0)[-1].time_s == 1.0
    playback.pause()
    assert playback.seek(99.0)
    frame = play(playback, 2.0)[-1]
    assert (frame.phase, frame.time_s) == ("paused", CLIP.duration_s)


def test_a_loop_blends_from_the_last_frame_into_the_first() -> None:
    playback = Playback(CLIP, FORMAT, loop=True)
    frames = play(playback, 1.0 + 3 * (CLIP.duration_s + 1.2))
    assert playback.loops == 3
    assert {frame.phase for frame in frames} == {"entering", "playing"}
    playback.loop = False
    play_until(playback, "done")


def test_at_the_end_it_may_hold_and_start_again() -> None:
    playback = Playback(CLIP, FORMAT, at_end="hold")
    play_until(playback, "paused")
    frame = play(playback, 5.0)[-1]
    assert (frame.phase, frame.time_s) == ("paused", CLIP.duration_s)
    assert not frame.command[VELOCITIES].any()
    playback.resume()
    assert play(playback, 1.02)[-1].time_s == pytest.approx(DT)


def test_what_makes_no_sense_is_turned_down() -> None:
    playback = Playback(CLIP, FORMAT)
    assert not playback.resume()
    assert not playback.start()
    assert not playback.seek(float("nan"))
    playback.leave()
    assert not playback.pause()
    assert not playback.seek(1.0)
    play_until(playback, "done")
    assert not playback.leave()


def test_a_process_that_was_stopped_for_a_minute_makes_no_jump() -> None:
    playback = Playback(CLIP, FORMAT)
    before = play(playback, 1.5)[-1]
    assert playback.step(60.0).time_s == pytest.approx(before.time_s + 0.1)


PERIODS = [DT, 0.01]

OPERATIONS: dict[str, Callable[[Playback, float], Any]] = {
    "start": lambda playback, _: playback.start(),
    "pause": lambda playback, _: playback.pause(),
    "resume": lambda playback, _: playback.resume(),
    "seek": lambda playback, number: playback.seek(number),
    "loop": lambda playback, number: setattr(playback, "loop", number > 1.0),
    "leave": lambda playback, _: playback.leave(),
    "none": lambda *_: None,
}


def reachable(command_format: CommandFormat) -> tuple[Floats, Floats]:
    """Largest step of the motion itself, and the widest span of anything that is sent, per element."""
    vectors = np.array(
        [command_format.encode(CLIP.at(t), CLIP.joint_names) for t in np.arange(0, CLIP.duration_s + DT, DT / 4)]
    )
    step = 4 * np.abs(np.diff(vectors, axis=0)).max(axis=0)
    everything = np.concatenate([vectors, [command_format.default], np.zeros((1, len(command_format.default)))])
    return step, np.ptp(everything, axis=0)


BOUNDS = {command_format.name: reachable(command_format) for command_format in (twist.FORMAT, twist2.FORMAT)}


@settings(max_examples=40, deadline=None)
@given(
    command_format=st.sampled_from([twist.FORMAT, twist2.FORMAT]),
    script=st.lists(
        st.tuples(st.sampled_from(sorted(OPERATIONS)), st.floats(-1, 5), st.integers(0, 90), st.sampled_from(PERIODS)),
        max_size=12,
    ),
    options=st.fixed_dictionaries(
        {"loop": st.booleans(), "wait_for_start": st.booleans(), "at_end": st.sampled_from(["exit", "hold"]),
         "lead_s": st.sampled_from([0.0, DT])}
    ),
)  # fmt: skip
def test_whatever_is_asked_vectors_are_finite_steps_are_bounded_and_the_end_is_the_default(
    command_format: CommandFormat, script: list[tuple[str, float, int, float]], options: dict[str, Any]
) -> None:
    step, span = BOUNDS[command_format.name]
    shortest_s = np.full(len(span), 0.5)
    shortest_s[list(command_format.velocities)] = VELOCITY_FADE_S
    bound = np.maximum(step, span * DT / shortest_s) + 1e-9
    playback = Playback(CLIP, command_format, **options)
    sent = playback.step(0.0).command
    for name, number, steps, dt_s in script:
        OPERATIONS[name](playback, number)
        for _ in range(steps):
            frame = playback.step(dt_s)
            assert np.isfinite(frame.command).all()
            assert (np.abs(frame.command - sent) <= bound).all()
            assert 0.0 <= frame.time_s <= CLIP.duration_s
            sent = frame.command
    playback.leave()
    frames = [playback.step(DT) for _ in range(101)]
    assert playback.is_done
    np.testing.assert_array_equal(frames[-1].command, command_format.default)


@given(st.lists(st.sampled_from(sorted(OPERATIONS)), max_size=8))
@settings(max_examples=10, deadline=None)
def test_the_same_requests_give_the_same_vectors(script: list[str]) -> None:
    runs = []
    for _ in range(2):
        playback = Playback(CLIP, FORMAT)
        frames = []
        for name in script:
            OPERATIONS[name](playback, 1.5)
            frames += play(playback, 0.6)
        runs.append(np.array([frame.command for frame in frames]))
    np.testing.assert_array_equal(runs[0], runs[1])
