"""Named corruptions: each takes the copy of an episode, spoils one thing as a fault or a hand would, and says what.

Most are sealed: the manifest agrees with the spoiled files, as if the recorder itself had recorded this; so a check
cannot live by counting messages or hashing files alone. Those of `manifest` and `files` are hands on a finished
episode, and nothing is made to agree. A recipe that does not fit an episode (no camera, no policy) raises
`DoesNotFit`.
"""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tests.corruption import pictures
from tests.corruption.files import (
    CAMERAS,
    MANIFEST,
    ONE_S,
    SIGNALS,
    DoesNotFit,
    Episode,
    Message,
    Stream,
    chunk_places,
)
from tests.corruption.parts import Harm, Robot, half_ns, keep, luck, noise, renumber, unit_scale

MS = 1_000_000


@dataclass(frozen=True)
class Recipe:
    """A kind of corruption.

    Attributes:
        name, group, what: Its name, the group that it is listed in, a line for people.
        is_sealed: As `Episode.save` takes it.
        apply: Spoils an episode; the second is the folder of another one of the same kind.
    """

    name: str
    group: str
    what: str
    is_sealed: bool
    apply: Callable[[Episode, Path], Harm]


RECIPES: dict[str, Recipe] = {}


def recipe(group: str, *, is_sealed: bool = True) -> Callable[[Callable[..., Harm]], Callable[..., Harm]]:
    """Register a function of an episode, or of an episode and another one; its docstring is the line for people."""

    def register(apply: Callable[..., Harm]) -> Callable[..., Harm]:
        name = apply.__name__.replace("_", "-")
        takes_two = apply.__code__.co_argcount == 2
        made = apply if takes_two else lambda episode, _other: apply(episode)
        RECIPES[name] = Recipe(name, group, (apply.__doc__ or "").strip(), is_sealed, made)
        return apply

    return register


def spoil(name: str, folder: Path, other: Path) -> Harm:
    """Spoil the episode in a folder, in place.

    Raises:
        DoesNotFit: there is nothing in it that this could spoil.
    """
    made = CONTROL if name == CONTROL.name else RECIPES[name]
    episode = Episode(folder)
    harm = made.apply(episode, other)
    episode.save(is_sealed=made.is_sealed)
    return harm


# -- Presence ---------------------------------------------------------------------------------------------------------


@recipe("presence")
def robot_ends_at_half(episode: Episode) -> Harm:
    """The robot's server dies: nothing of it in the second half."""
    robot = Robot(episode)
    end_ns = half_ns(robot.state.messages)
    streams = robot.by_writer_of(robot.state)
    keep(episode, streams, lambda one: one.log_ns < end_ns)
    return Harm((*(stream.key for stream in streams), robot.state.writer), episode.at_s(end_ns))


@recipe("presence")
def state_ends_at_half(episode: Episode) -> Harm:
    """The state alone has no second half."""
    state = Robot(episode).state
    end_ns = half_ns(state.messages)
    keep(episode, [state], lambda one: one.log_ns < end_ns)
    return Harm((state.key,), episode.at_s(end_ns))


@recipe("presence")
def state_begins_late(episode: Episode) -> Harm:
    """The state begins 3 s late."""
    state = Robot(episode).state
    begin_ns = state.messages[0].log_ns + 3 * ONE_S
    keep(episode, [state], lambda one: one.log_ns >= begin_ns)
    return Harm((state.key,), episode.at_s(state.messages[0].log_ns), episode.at_s(begin_ns))


@recipe("presence")
def target_ends_at_half(episode: Episode) -> Harm:
    """What the motors got is not there in the second half."""
    target = Robot(episode).target
    end_ns = half_ns(target.messages)
    keep(episode, [target], lambda one: one.log_ns < end_ns)
    return Harm((target.key,), episode.at_s(end_ns))


@recipe("presence")
def commands_end_at_half(episode: Episode) -> Harm:
    """The operator's commands end, though the gate goes on as if they came."""
    commands = Robot(episode).commands
    end_ns = half_ns(commands[0].messages)
    keep(episode, commands, lambda one: one.log_ns < end_ns)
    return Harm(tuple(stream.key for stream in commands), episode.at_s(end_ns))


@recipe("presence")
def device_ends_at_half(episode: Episode) -> Harm:
    """The operator's device says nothing in the second half, though commands go on."""
    streams = [stream for key, stream in episode.streams().items() if key.startswith("operator_")]
    if not streams:
        raise DoesNotFit("no device of an operator")
    end_ns = half_ns(streams[0].messages)
    keep(episode, streams, lambda one: one.log_ns < end_ns)
    return Harm((*(stream.key for stream in streams), streams[0].writer), episode.at_s(end_ns))


@recipe("presence")
def state_is_gone(episode: Episode) -> Harm:
    """The key of the robot's state is not in the recording."""
    state = Robot(episode).state
    keep(episode, [state], lambda _: False)
    return Harm((state.key,))


@recipe("presence")
def command_used_is_gone(episode: Episode) -> Harm:
    """The key of the command after the gate, which is the action of a data set, is not in the recording."""
    used = Robot(episode).used
    keep(episode, [used], lambda _: False)
    return Harm((used.key,))


@recipe("presence")
def gate_is_gone(episode: Episode) -> Harm:
    """What the gate did is not in the recording."""
    robot = Robot(episode)
    gate = robot.get(f"command_gate_{robot.name}")
    keep(episode, [gate], lambda _: False)
    return Harm((gate.key,))


@recipe("presence")
def steps_are_gone(episode: Episode) -> Harm:
    """No step of the robot's control loop is in the recording: only states."""
    robot = Robot(episode)
    streams = [each for each in robot.by_writer_of(robot.state) if each.role == "policy"]
    keep(episode, streams, lambda _: False)
    return Harm((*(stream.key for stream in streams), robot.name))


@recipe("presence")
def camera_ends_at_half(episode: Episode) -> Harm:
    """A camera has no pictures in the second half."""
    camera = pictures.cameras(episode)[0]
    end_ns = half_ns(camera.messages)
    keep(episode, [camera], lambda one: one.log_ns < end_ns)
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(end_ns))


@recipe("presence")
def camera_begins_late(episode: Episode) -> Harm:
    """A camera begins 3 s late."""
    camera = pictures.cameras(episode)[0]
    begin_ns = camera.messages[0].log_ns + 3 * ONE_S
    keep(episode, [camera], lambda one: one.log_ns >= begin_ns)
    names = (camera.key, pictures.camera_name(camera))
    return Harm(names, episode.at_s(camera.messages[0].log_ns), episode.at_s(begin_ns))


@recipe("presence")
def camera_without_a_picture(episode: Episode) -> Harm:
    """A camera's server ran and not one picture of it is there."""
    camera = pictures.cameras(episode, 2)[0]
    keep(episode, [camera], lambda _: False)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("presence")
def camera_silent_for_a_second(episode: Episode) -> Harm:
    """A camera has no picture for a second, and counts on as if nothing had been."""
    camera = pictures.cameras(episode)[0]
    begin_ns = half_ns(camera.messages)
    keep(episode, [camera], lambda one: not begin_ns <= one.log_ns < begin_ns + ONE_S)
    renumber(episode, camera.key, is_picture=True)
    at_s = episode.at_s(begin_ns)
    return Harm((camera.key, pictures.camera_name(camera)), at_s, at_s + 1.0)


@recipe("presence")
def state_silent_for_half_a_second(episode: Episode) -> Harm:
    """The state has a hole of half a second, and counts on as if nothing had been."""
    state = Robot(episode).state
    begin_ns = half_ns(state.messages)
    keep(episode, [state], lambda one: not begin_ns <= one.log_ns < begin_ns + ONE_S // 2)
    renumber(episode, state.key)
    return Harm((state.key,), episode.at_s(begin_ns), episode.at_s(begin_ns) + 0.5)


# -- Losses -----------------------------------------------------------------------------------------------------------


def _delete(episode: Episode, stream: Stream, wanted: Callable[[int], bool], *, renumbered: bool) -> None:
    gone = {id(one) for index, one in enumerate(stream.messages) if not wanted(index)}
    keep(episode, [stream], lambda one: id(one) not in gone)
    if renumbered:
        renumber(episode, stream.key, is_picture=pictures.is_picture(stream.key))


def _few(stream: Stream, share: float) -> set[int]:
    count = len(stream.messages)
    return set(luck(stream.key).sample(range(1, count - 1), max(1, round(share * count))))


@recipe("losses")
def state_5_percent_deleted(episode: Episode) -> Harm:
    """One state in twenty is deleted."""
    state = Robot(episode).state
    gone = _few(state, 0.05)
    _delete(episode, state, lambda index: index not in gone, renumbered=False)
    return Harm((state.key,))


@recipe("losses")
def state_5_percent_deleted_renumbered(episode: Episode) -> Harm:
    """One state in twenty is deleted, and the rest counted anew."""
    state = Robot(episode).state
    gone = _few(state, 0.05)
    _delete(episode, state, lambda index: index not in gone, renumbered=True)
    return Harm((state.key,))


@recipe("losses")
def state_one_deleted(episode: Episode) -> Harm:
    """A single state is deleted."""
    state = Robot(episode).state
    middle = len(state.messages) // 2
    at_s = episode.at_s(state.messages[middle].log_ns)
    _delete(episode, state, lambda index: index != middle, renumbered=False)
    return Harm((state.key,), at_s)


@recipe("losses")
def state_one_deleted_renumbered(episode: Episode) -> Harm:
    """A single state is deleted, and the rest counted anew."""
    state = Robot(episode).state
    middle = len(state.messages) // 2
    at_s = episode.at_s(state.messages[middle].log_ns)
    _delete(episode, state, lambda index: index != middle, renumbered=True)
    return Harm((state.key,), at_s)


@recipe("losses")
def command_used_5_percent_deleted_renumbered(episode: Episode) -> Harm:
    """One command after the gate in twenty is deleted, and the rest counted anew."""
    used = Robot(episode).used
    gone = _few(used, 0.05)
    _delete(episode, used, lambda index: index not in gone, renumbered=True)
    return Harm((used.key,))


@recipe("losses")
def state_2_percent_twice(episode: Episode) -> Harm:
    """One state in fifty is written twice."""
    state = Robot(episode).state
    twice = {id(state.messages[index]) for index in _few(state, 0.02)}
    episode.signals.replace(lambda one: [one, one.copy()] if id(one) in twice else [one])
    return Harm((state.key,))


@recipe("losses")
def state_reordered(episode: Episode) -> Harm:
    """In one place in fifty two neighbouring states have changed places, times and numbers and all."""
    state = Robot(episode).state
    for index in _few(state, 0.02):
        one, two = state.messages[index - 1], state.messages[index]
        fields = ("sequence", "publish_ns", "data", "stamp")
        before = {name: getattr(one, name) for name in fields}
        for name in fields:
            setattr(one, name, getattr(two, name))
            setattr(two, name, before[name])
    return Harm((state.key,))


@recipe("losses")
def pictures_each_tenth_deleted(episode: Episode) -> Harm:
    """Every tenth picture is deleted."""
    camera = pictures.cameras(episode)[0]
    _delete(episode, camera, lambda index: index % 10 != 5, renumbered=False)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("losses")
def pictures_each_tenth_deleted_renumbered(episode: Episode) -> Harm:
    """Every tenth picture is deleted, and the rest counted anew."""
    camera = pictures.cameras(episode)[0]
    _delete(episode, camera, lambda index: index % 10 != 5, renumbered=True)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("losses")
def state_at_half_the_rate(episode: Episode) -> Harm:
    """Every second state repeats the one before: the sensor is read half as often as it is told."""
    robot = Robot(episode)
    robot.edit(lambda values, _names, _stream: values[np.arange(len(values)) // 2 * 2])
    return Harm((robot.state.key,))


# -- Times ------------------------------------------------------------------------------------------------------------


def _move(stream: Stream, ns: int, *, arrival: bool = False, from_ns: int = 0) -> None:
    for message in stream.messages:
        if message.log_ns >= from_ns:
            message.move(ns, arrival=arrival)


@recipe("times")
def state_stamped_100_ms_late(episode: Episode) -> Harm:
    """The state's stamps say 100 ms later than it was."""
    state = Robot(episode).state
    _move(state, 100 * MS)
    return Harm((state.key,))


@recipe("times")
def state_stamped_100_ms_early(episode: Episode) -> Harm:
    """The state's stamps say 100 ms earlier than it was."""
    state = Robot(episode).state
    _move(state, -100 * MS)
    return Harm((state.key,))


@recipe("times")
def state_values_200_ms_old(episode: Episode) -> Harm:
    """The robot tells what it measured 200 ms ago, with the stamps of now."""
    robot = Robot(episode)

    def old(values: np.ndarray, _names: list[str], stream: Stream) -> np.ndarray:
        times = stream.times_ns
        return values[np.maximum(np.searchsorted(times, times - 200 * MS, side="right") - 1, 0)]

    robot.edit(old)
    return Harm((robot.state.key,))


@recipe("times")
def camera_200_ms_late(episode: Episode) -> Harm:
    """What a camera shows is 200 ms older than its times say."""
    camera = pictures.cameras(episode)[0]
    for message in camera.messages:
        message.move(200 * MS, arrival=True)
        pictures.move_capture(message, 200 * MS)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("times")
def camera_stamped_200_ms_late(episode: Episode) -> Harm:
    """A camera's times of capture lie 200 ms after the truth, most of them after the picture's arrival."""
    camera = pictures.cameras(episode)[0]
    for message in camera.messages:
        message.move(0, captured_ns=200 * MS)
        pictures.move_capture(message, 200 * MS)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("times")
def camera_stamped_300_ms_early(episode: Episode) -> Harm:
    """A camera's times of capture lie 300 ms before the truth."""
    camera = pictures.cameras(episode)[0]
    for message in camera.messages:
        message.move(0, captured_ns=-300 * MS)
        pictures.move_capture(message, -300 * MS)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("times")
def clock_of_the_robot_jumps_a_second(episode: Episode) -> Harm:
    """From half on the clock of the robot's server is a second ahead."""
    robot = Robot(episode)
    from_ns = half_ns(robot.state.messages)
    streams = robot.by_writer_of(robot.state)
    for stream in streams:
        _move(stream, ONE_S, from_ns=from_ns)
    return Harm((*(stream.key for stream in streams), robot.state.writer), episode.at_s(from_ns))


@recipe("times")
def clock_of_the_recorder_jumps_a_second(episode: Episode) -> Harm:
    """From half on all times of the signals are a second later."""
    state = Robot(episode).state
    from_ns = half_ns(state.messages)
    for stream in episode.streams().values():
        _move(stream, ONE_S, arrival=True, from_ns=from_ns)
    return Harm(tuple(episode.streams()), episode.at_s(from_ns))


@recipe("times")
def clock_of_the_robot_drifts(episode: Episode) -> Harm:
    """The clock of the robot's server loses 300 ms over the episode."""
    robot = Robot(episode)
    begin, end = robot.state.messages[0].log_ns, robot.state.messages[-1].log_ns
    streams = robot.by_writer_of(robot.state)
    for stream in streams:
        for message in stream.messages:
            share = min(1.0, max(0.0, (message.log_ns - begin) / (end - begin)))
            message.move(-round(share * 300 * MS))
    return Harm((*(stream.key for stream in streams), robot.state.writer))


@recipe("times")
def all_moved_by_an_hour(episode: Episode) -> Harm:
    """Every time of every message is an hour later; the clock of the episode and the manifest say otherwise."""
    recordings = [episode.signals, *([episode.cameras] if (episode.folder / CAMERAS).exists() else [])]
    for recording in recordings:
        for message in recording.messages():
            message.move(3600 * ONE_S, arrival=True)
            if pictures.is_picture(recording.channels[message.channel].topic):
                pictures.move_capture(message, 3600 * ONE_S)
    return Harm((SIGNALS, *episode.streams()))


def _shift_used(episode: Episode, steps: int) -> Harm:
    used = Robot(episode).used
    values = used.values
    used.put(values[np.clip(np.arange(len(values)) + steps, 0, len(values) - 1)])
    return Harm((used.key,))


@recipe("times")
def command_used_4_steps_ahead(episode: Episode) -> Harm:
    """The command after the gate stands 4 steps ahead of its time."""
    return _shift_used(episode, 4)


@recipe("times")
def command_used_15_steps_ahead(episode: Episode) -> Harm:
    """The command after the gate stands 15 steps ahead of its time."""
    return _shift_used(episode, 15)


@recipe("times")
def command_used_4_steps_late(episode: Episode) -> Harm:
    """The command after the gate stands 4 steps behind its time."""
    return _shift_used(episode, -4)


@recipe("times")
def command_used_15_steps_late(episode: Episode) -> Harm:
    """The command after the gate stands 15 steps behind its time."""
    return _shift_used(episode, -15)


@recipe("times")
def commands_stamped_after_use(episode: Episode) -> Harm:
    """The operator's commands are stamped 80 ms later than they were, after the step that used them."""
    robot = Robot(episode)
    for stream in robot.commands:
        _move(stream, 80 * MS)
    return Harm(tuple(stream.key for stream in robot.commands))


@recipe("times")
def steps_say_commands_came_after_use(episode: Episode) -> Harm:
    """The times of the steps say that each command was written 80 ms after it was used."""
    timing = Robot(episode).timing
    column = timing.names.index("command_written")
    values = timing.values
    values[:, column] += np.where(values[:, column] > 0, 80.0 * MS, 0.0)
    _put_integers(timing, values)
    return Harm((timing.key,))


@recipe("times")
def steps_without_times(episode: Episode) -> Harm:
    """All instants of the steps are zero from half on."""
    timing = Robot(episode).timing
    values, from_ns = timing.values, half_ns(timing.messages)
    columns = [index for index, unit in enumerate(timing.units) if unit == "ns"]
    values[np.ix_(timing.times_ns >= from_ns, columns)] = 0
    _put_integers(timing, values)
    return Harm((timing.key,), episode.at_s(from_ns))


def _put_integers(stream: Stream, values: np.ndarray) -> None:
    for message, row in zip(stream.messages, values, strict=True):
        message.data = json.dumps([int(each) for each in row]).encode()


@recipe("times")
def pictures_taken_in_a_burst(episode: Episode) -> Harm:
    """For 3 s a camera's pictures carry the time of the first of them: their clock stood still."""
    camera = pictures.cameras(episode)[0]
    begin_ns = half_ns(camera.messages)
    for message in camera.messages:
        if begin_ns <= message.log_ns < begin_ns + 3 * ONE_S:
            message.move(0, captured_ns=begin_ns - message.log_ns)
            pictures.move_capture(message, begin_ns - message.log_ns)
    at_s = episode.at_s(begin_ns)
    return Harm((camera.key, pictures.camera_name(camera)), at_s, at_s + 3.0)


# -- Pictures ---------------------------------------------------------------------------------------------------------


def _spoil_pictures(episode: Episode, how: Callable[[np.ndarray], np.ndarray], *, from_half: bool = False) -> Harm:
    camera = pictures.cameras(episode)[0]
    from_ns = half_ns(camera.messages) if from_half else 0
    pictures.change([one for one in camera.messages if one.log_ns >= from_ns], how)
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(from_ns) if from_half else None)


@recipe("pictures")
def black_from_half_on(episode: Episode) -> Harm:
    """A camera is black in the second half."""
    return _spoil_pictures(episode, np.zeros_like, from_half=True)


@recipe("pictures")
def black(episode: Episode) -> Harm:
    """A camera is black."""
    return _spoil_pictures(episode, np.zeros_like)


@recipe("pictures")
def nearly_black(episode: Episode) -> Harm:
    """A camera is black but for its noise: the cap is on."""
    chance = noise("nearly black")
    return _spoil_pictures(episode, lambda image: np.abs(chance.normal(0.0, 3.0, image.shape)))


@recipe("pictures")
def white(episode: Episode) -> Harm:
    """A camera is white."""
    return _spoil_pictures(episode, lambda image: np.full_like(image, 255))


@recipe("pictures")
def saturated(episode: Episode) -> Harm:
    """A camera is so much overexposed that most of it is white."""
    return _spoil_pictures(episode, lambda image: image.astype(float) * 3.0 + 120.0)


@recipe("pictures")
def grey(episode: Episode) -> Harm:
    """A camera shows one grey, as a driver does that has no signal."""
    return _spoil_pictures(episode, lambda image: np.full_like(image, 128))


@recipe("pictures")
def frozen_for_the_last_5_s(episode: Episode) -> Harm:
    """A camera repeats one picture for the last 5 s, with running stamps."""
    camera = pictures.cameras(episode)[0]
    from_ns = camera.messages[-1].log_ns - 5 * ONE_S
    jpeg = pictures.jpeg_of(next(one for one in camera.messages if one.log_ns >= from_ns))
    for message in camera.messages:
        if message.log_ns >= from_ns:
            pictures.put_jpeg(message, jpeg)
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(from_ns))


@recipe("pictures")
def frozen_for_a_second(episode: Episode) -> Harm:
    """A camera repeats one picture for a second in the middle of motion."""
    camera = pictures.cameras(episode)[0]
    begin, end = Robot(episode).liveliest(1.0)
    within = [one for one in camera.messages if begin <= one.log_ns < end]
    for message in within:
        pictures.put_jpeg(message, pictures.jpeg_of(within[0]))
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(begin), episode.at_s(end))


@recipe("pictures")
def frozen(episode: Episode) -> Harm:
    """A camera repeats one picture throughout, with running stamps."""
    camera = pictures.cameras(episode)[0]
    jpeg = pictures.jpeg_of(camera.messages[len(camera.messages) // 2])
    for message in camera.messages:
        pictures.put_jpeg(message, jpeg)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("pictures")
def frozen_with_fresh_noise(episode: Episode) -> Harm:
    """A camera shows one scene throughout though the robot that carries it moves; its noise is fresh each time."""
    camera = pictures.cameras(episode)[0]
    scene = pictures.decoded(camera.messages[len(camera.messages) // 2]).astype(float)
    chance = noise("frozen with noise")
    pictures.change(camera.messages, lambda _: scene + chance.normal(0.0, 2.0, scene.shape))
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("pictures")
def each_second_picture_repeats(episode: Episode) -> Harm:
    """Every second picture is the one before."""
    camera = pictures.cameras(episode)[0]
    for before, message in zip(camera.messages[::2], camera.messages[1::2], strict=False):
        pictures.put_jpeg(message, pictures.jpeg_of(before))
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("pictures")
def tenth_of_the_pictures_cut_off(episode: Episode) -> Harm:
    """Every tenth JPEG file lacks its second half."""
    camera = pictures.cameras(episode)[0]
    for message in camera.messages[5::10]:
        jpeg = pictures.jpeg_of(message)
        pictures.put_jpeg(message, jpeg[: len(jpeg) // 2])
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("pictures")
def three_pictures_of_garbage(episode: Episode) -> Harm:
    """Three pictures hold random bytes."""
    camera = pictures.cameras(episode)[0]
    chance, middle = luck("garbage"), len(camera.messages) // 2
    for message in camera.messages[middle : middle + 3]:
        pictures.put_jpeg(message, chance.randbytes(len(pictures.jpeg_of(message))))
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(camera.messages[middle].log_ns))


@recipe("pictures")
def garbage_inside_a_jpeg(episode: Episode) -> Harm:
    """Ten pictures have the head and tail of a JPEG file, and zeros in their second third."""
    camera = pictures.cameras(episode)[0]
    middle = len(camera.messages) // 2
    for message in camera.messages[middle : middle + 10]:
        jpeg = pictures.jpeg_of(message)
        third = len(jpeg) // 3
        pictures.put_jpeg(message, jpeg[:third] + bytes(third) + jpeg[2 * third :])
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(camera.messages[middle].log_ns))


@recipe("pictures")
def empty_pictures(episode: Episode) -> Harm:
    """Three pictures have no bytes."""
    camera = pictures.cameras(episode)[0]
    middle = len(camera.messages) // 2
    for message in camera.messages[middle : middle + 3]:
        pictures.put_jpeg(message, b"")
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(camera.messages[middle].log_ns))


@recipe("pictures")
def resolution_changes(episode: Episode) -> Harm:
    """From half on a camera's pictures are half as wide and high."""
    return _spoil_pictures(
        episode, lambda image: pictures.resized(image, image.shape[0] // 2, image.shape[1] // 2), from_half=True
    )


@recipe("pictures")
def depth_frozen(episode: Episode) -> Harm:
    """Depth repeats one picture throughout, with running stamps; the colour beside it is sound."""
    stream = pictures.depth(episode)
    file = pictures.jpeg_of(stream.messages[len(stream.messages) // 2])
    for message in stream.messages:
        pictures.put_jpeg(message, file)
    return Harm((stream.key, pictures.camera_name(stream)))


@recipe("pictures")
def depth_all_zero_from_half_on(episode: Episode) -> Harm:
    """From half on depth has not one pixel that was measured: the projector went out."""
    stream = pictures.depth(episode)
    from_ns = half_ns(stream.messages)
    head = pictures.jpeg_of(stream.messages[0])[16:24]  # of a PNG file: width and height
    nothing = pictures.no_depth(int.from_bytes(head[:4]), int.from_bytes(head[4:]))
    for message in stream.messages:
        if message.log_ns >= from_ns:
            pictures.put_jpeg(message, nothing)
    return Harm((stream.key, pictures.camera_name(stream)), episode.at_s(from_ns))


@recipe("pictures")
def tenth_of_the_depth_cut_off(episode: Episode) -> Harm:
    """Every tenth depth picture lacks its second half."""
    stream = pictures.depth(episode)
    for message in stream.messages[5::10]:
        file = pictures.jpeg_of(message)
        pictures.put_jpeg(message, file[: len(file) // 2])
    return Harm((stream.key, pictures.camera_name(stream)))


@recipe("pictures")
def cameras_swapped(episode: Episode) -> Harm:
    """Two cameras have changed names."""
    one, two = pictures.cameras(episode, 2)[:2]
    return _swap(episode, one, two, 0)


@recipe("pictures")
def cameras_swapped_from_half_on(episode: Episode) -> Harm:
    """Two cameras change names in the middle, as two devices do whose USB hub was reset."""
    one, two = pictures.cameras(episode, 2)[:2]
    return _swap(episode, one, two, half_ns(one.messages))


def _swap(episode: Episode, one: Stream, two: Stream, from_ns: int) -> Harm:
    for left, right in zip(one.messages, two.messages, strict=False):
        if left.log_ns >= from_ns:
            jpegs = pictures.jpeg_of(left), pictures.jpeg_of(right)
            pictures.put_jpeg(left, jpegs[1])
            pictures.put_jpeg(right, jpegs[0])
    names = (one.key, two.key, pictures.camera_name(one), pictures.camera_name(two))
    return Harm(names, episode.at_s(from_ns) if from_ns else None)


@recipe("pictures")
def exposure_jumps(episode: Episode) -> Harm:
    """A camera's exposure hunts: for a second a quarter of the light, then all of it, to and fro."""
    camera = pictures.cameras(episode)[0]
    begin = camera.messages[0].log_ns
    dark = [one for one in camera.messages if (one.log_ns - begin) // ONE_S % 2]
    pictures.change(dark, lambda image: image * 0.25)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("pictures")
def heavily_blurred(episode: Episode) -> Harm:
    """A camera is out of focus: nothing smaller than a tenth of the picture is to be seen."""
    return _spoil_pictures(episode, lambda image: pictures.blurred(image, image.shape[0] // 20))


@recipe("pictures")
def blurred_from_half_on(episode: Episode) -> Harm:
    """A camera's focus goes, or its lens gets a drop, in the middle."""
    return _spoil_pictures(episode, lambda image: pictures.blurred(image, image.shape[0] // 20), from_half=True)


@recipe("pictures")
def colours_swapped_from_half_on(episode: Episode) -> Harm:
    """From half on red and blue have changed places."""
    return _spoil_pictures(episode, lambda image: image[:, :, ::-1], from_half=True)


@recipe("pictures")
def upside_down_from_half_on(episode: Episode) -> Harm:
    """From half on a camera hangs upside down."""
    return _spoil_pictures(episode, lambda image: image[::-1, ::-1], from_half=True)


@recipe("pictures")
def lower_half_grey(episode: Episode) -> Harm:
    """From half on the lower half of each picture is one grey, as of frames that USB has cut."""

    def cut(image: np.ndarray) -> np.ndarray:
        made = image.copy()
        made[image.shape[0] // 2 :] = 128
        return made

    return _spoil_pictures(episode, cut, from_half=True)


@recipe("pictures")
def nothing_but_noise(episode: Episode) -> Harm:
    """From half on a camera shows noise."""
    chance = noise("nothing but noise")
    return _spoil_pictures(episode, lambda image: chance.integers(0, 256, image.shape), from_half=True)


@recipe("pictures")
def pictures_in_reverse_order(episode: Episode) -> Harm:
    """A camera's pictures come in reverse order, with running stamps."""
    camera = pictures.cameras(episode)[0]
    jpegs = [pictures.jpeg_of(one) for one in camera.messages]
    for message, jpeg in zip(camera.messages, reversed(jpegs), strict=True):
        pictures.put_jpeg(message, jpeg)
    return Harm((camera.key, pictures.camera_name(camera)))


@recipe("pictures")
def pictures_shuffled(episode: Episode) -> Harm:
    """For 3 s a camera's pictures are in random order, with running stamps."""
    camera = pictures.cameras(episode)[0]
    begin, end = Robot(episode).liveliest(3.0)
    within = [one for one in camera.messages if begin <= one.log_ns < end]
    jpegs = [pictures.jpeg_of(one) for one in within]
    luck("shuffled").shuffle(jpegs)
    for message, jpeg in zip(within, jpegs, strict=True):
        pictures.put_jpeg(message, jpeg)
    return Harm((camera.key, pictures.camera_name(camera)), episode.at_s(begin), episode.at_s(end))


@recipe("pictures")
def pictures_of_another_episode(episode: Episode, other: Path) -> Harm:
    """A camera shows another episode, with the stamps of this one."""
    camera = pictures.cameras(episode)[0]
    theirs = {stream.key: stream for stream in pictures.cameras(Episode(other))}.get(camera.key)
    if theirs is None:
        raise DoesNotFit(f"the other has no {camera.key}")
    for index, message in enumerate(camera.messages):
        pictures.put_jpeg(message, pictures.jpeg_of(theirs.messages[index % len(theirs.messages)]))
    return Harm((camera.key, pictures.camera_name(camera)))


# -- States -----------------------------------------------------------------------------------------------------------


def _held(robot: Robot, begin: int, end: int) -> None:
    def hold(values: np.ndarray, _names: list[str], stream: Stream) -> np.ndarray:
        within = np.flatnonzero((stream.times_ns >= begin) & (stream.times_ns < end))
        if len(within):
            values[within] = values[within[0]]
        return values

    robot.edit(hold)


def _frozen(episode: Episode, seconds: float) -> Harm:
    robot = Robot(episode)
    begin, end = robot.liveliest(seconds)
    _held(robot, begin, end)
    return Harm((robot.state.key,), episode.at_s(begin), episode.at_s(end))


@recipe("states")
def state_frozen_for_a_second(episode: Episode) -> Harm:
    """The state repeats itself for a second in the middle of motion."""
    return _frozen(episode, 1.0)


@recipe("states")
def state_frozen_for_3_s(episode: Episode) -> Harm:
    """The state repeats itself for 3 s in the middle of motion."""
    return _frozen(episode, 3.0)


@recipe("states")
def state_frozen(episode: Episode) -> Harm:
    """The state repeats itself throughout."""
    robot = Robot(episode)
    times = robot.state.times_ns
    _held(robot, int(times[0]), int(times[-1]) + 1)
    return Harm((robot.state.key,))


def _joint(robot: Robot, how: Callable[[np.ndarray, str], np.ndarray]) -> Harm:
    """Change what is told of the joint that moves most: `how(column, kind)`; kind is ``pos``, ``vel`` or ``torque``."""
    joint = robot.most_moved().removesuffix("_pos")

    def edit(values: np.ndarray, names: list[str], _stream: Stream) -> np.ndarray:
        for index, name in enumerate(names):
            for kind in ("pos", "vel", "torque"):
                if name == f"{joint}_{kind}":
                    values[:, index] = how(values[:, index], kind)
        return values

    robot.edit(edit)
    return Harm((joint, f"{joint}_pos", f"{joint}_vel", joint.replace("_", " "), robot.state.key))


@recipe("states")
def one_joint_stuck(episode: Episode) -> Harm:
    """One joint tells one angle and no velocity throughout, though it is commanded to move."""
    return _joint(Robot(episode), lambda column, kind: np.full_like(column, column[0] if kind != "vel" else 0.0))


@recipe("states")
def one_joint_off_by_half_a_radian(episode: Episode) -> Harm:
    """One joint's zero is wrong by 0.5 rad."""
    return _joint(Robot(episode), lambda column, kind: column + (0.5 if kind == "pos" else 0.0))


@recipe("states")
def one_joint_slips(episode: Episode) -> Harm:
    """One joint's encoder slips by 0.3 rad in the middle, and stays there."""
    robot = Robot(episode)
    harm = _joint(
        robot, lambda column, kind: column + (0.3 * (np.arange(len(column)) > len(column) / 2) if kind == "pos" else 0)
    )
    return Harm(harm.names, episode.at_s(robot.state.messages[len(robot.state.messages) // 2].log_ns))


@recipe("states")
def one_joint_reversed(episode: Episode) -> Harm:
    """One joint's sign is wrong."""
    return _joint(Robot(episode), lambda column, _kind: -column)


def _swapped(names: list[str], wanted: Callable[[str], bool]) -> list[int]:
    """Return for each element the one on the other side."""
    found = list(range(len(names)))
    for index, name in enumerate(names):
        other = name.replace("left_", "right_") if "left_" in name else name.replace("right_", "left_")
        if wanted(name) and other != name and other in names:
            found[index] = names.index(other)
    return found


def _swap_sides(episode: Episode, wanted: Callable[[str], bool]) -> Harm:
    robot = Robot(episode)
    if _swapped(robot.state.names, wanted) == list(range(len(robot.state.names))):
        raise DoesNotFit("it has no sides")
    robot.edit(lambda values, names, _stream: values[:, _swapped(names, wanted)])
    names = [name.removesuffix("_pos") for name in robot.state.names if name.endswith("_pos") and wanted(name)]
    return Harm((robot.state.key, *names))


@recipe("states")
def legs_swapped(episode: Episode) -> Harm:
    """The left leg's joints stand where the right one's should, and the other way round."""
    return _swap_sides(episode, lambda name: any(part in name for part in ("hip", "knee", "ankle")))


@recipe("states")
def left_and_right_swapped(episode: Episode) -> Harm:
    """All joints of the left side stand where those of the right one should, and the other way round."""
    return _swap_sides(episode, lambda _name: True)


def _recontract(stream: Stream, how: Callable[[list[dict[str, str]]], list[dict[str, str]]]) -> None:
    for number in {message.channel for message in stream.messages}:
        channel = stream.recording.channels[number]
        contract = json.loads(channel.metadata["contract"])
        contract["elements"] = how(contract["elements"])
        channel.metadata["contract"] = json.dumps(contract, separators=(",", ":"))


@recipe("states")
def names_permuted(episode: Episode) -> Harm:
    """The contract of the state names the positions in another order: each bears the name of the next joint."""
    state = Robot(episode).state

    def permuted(elements: list[dict[str, str]]) -> list[dict[str, str]]:
        places = [index for index, element in enumerate(elements) if element["name"].endswith("_pos")]
        made = list(elements)
        for index, source in zip(places, places[1:] + places[:1], strict=True):
            made[index] = elements[source]
        return made

    _recontract(state, permuted)
    return Harm((state.key,))


@recipe("states")
def contract_says_degrees(episode: Episode) -> Harm:
    """The contract of the state says degrees; the numbers are radians."""
    state = Robot(episode).state
    _recontract(state, lambda listed: [each | {"unit": each["unit"].replace("rad", "deg")} for each in listed])
    return Harm((state.key,))


@recipe("states")
def state_in_degrees(episode: Episode) -> Harm:
    """The state holds degrees where the contract says radians."""
    robot = Robot(episode)
    robot.edit(lambda values, _names, stream: values * unit_scale(stream, "rad", 180 / math.pi))
    return Harm((robot.state.key,))


@recipe("states")
def command_used_in_degrees(episode: Episode) -> Harm:
    """The command after the gate holds degrees where the contract says radians."""
    used = Robot(episode).used
    used.put(used.values * unit_scale(used, "rad", 180 / math.pi))
    return Harm((used.key,))


@recipe("states")
def velocities_tripled(episode: Episode) -> Harm:
    """Velocities of all joints are three times what they are."""
    return _velocities(episode, 3.0)


@recipe("states")
def velocities_zero(episode: Episode) -> Harm:
    """Velocities of all joints are zero."""
    return _velocities(episode, 0.0)


@recipe("states")
def velocities_reversed(episode: Episode) -> Harm:
    """Velocities of all joints have the wrong sign."""
    return _velocities(episode, -1.0)


def _velocities(episode: Episode, factor: float) -> Harm:
    robot = Robot(episode)

    def scale(values: np.ndarray, names: list[str], _stream: Stream) -> np.ndarray:
        return values * np.array([factor if name.endswith("_vel") else 1.0 for name in names])

    robot.edit(scale)
    return Harm((robot.state.key,))


def _orientation(
    episode: Episode, how: Callable[[np.ndarray], np.ndarray], pattern: str = r"(^|_)q(uat_)?[wxyz]$"
) -> Harm:
    """Change the quaternion (or what `pattern` says) of all states, shape (n, 4)."""
    robot = Robot(episode)
    keys = []

    def edit(values: np.ndarray, names: list[str], stream: Stream) -> np.ndarray:
        columns = [index for index, name in enumerate(names) if re.search(pattern, name)]
        if columns:
            keys.append(stream.key)
            values[:, columns] = how(values[:, columns])
        return values

    robot.edit(edit)
    if not keys:
        raise DoesNotFit(f"no state has {pattern}")
    return Harm(tuple(keys))


@recipe("states")
def quaternion_halved(episode: Episode) -> Harm:
    """The quaternion has half its length."""
    return _orientation(episode, lambda quat: quat * 0.5)


@recipe("states")
def quaternion_xyzw(episode: Episode) -> Harm:
    """The quaternion's order is xyzw where the contract says wxyz."""
    return _orientation(episode, lambda quat: quat[:, [1, 2, 3, 0]])


@recipe("states")
def quaternion_conjugated(episode: Episode) -> Harm:
    """The quaternion turns the other way."""
    return _orientation(episode, lambda quat: quat * [1, -1, -1, -1])


@recipe("states")
def gyro_in_degrees(episode: Episode) -> Harm:
    """The gyro is in deg/s where the contract says rad/s."""
    return _orientation(episode, lambda gyro: gyro * 180 / math.pi, r"gyro_[xyz]$")


@recipe("states")
def gyro_of_another_frame(episode: Episode) -> Harm:
    """The gyro's axes are those of another frame: x is y, y is minus x."""
    return _orientation(episode, lambda gyro: gyro[:, [1, 0, 2]] * [1, -1, 1], r"gyro_[xyz]$")


@recipe("states")
def gyro_zero(episode: Episode) -> Harm:
    """The gyro says zero throughout."""
    return _orientation(episode, np.zeros_like, r"gyro_[xyz]$")


@recipe("states")
def nan_in_2_percent(episode: Episode) -> Harm:
    """One state in fifty has a number that is none."""
    return _put_odd(episode, math.nan, _few(Robot(episode).state, 0.02))


@recipe("states")
def one_infinity(episode: Episode) -> Harm:
    """One number of one state is infinite."""
    middle = len(Robot(episode).state.messages) // 2
    harm = _put_odd(episode, math.inf, {middle})
    return Harm(harm.names, episode.at_s(Robot(episode).state.messages[middle].log_ns))


def _put_odd(episode: Episode, value: float, rows: set[int]) -> Harm:
    robot = Robot(episode)
    values, joint = robot.state.values, robot.most_moved()
    values[sorted(rows), robot.state.names.index(joint)] = value
    robot.state.put(values)
    return Harm((robot.state.key, joint, joint.removesuffix("_pos")))


@recipe("states")
def five_spikes(episode: Episode) -> Harm:
    """Five times a joint is 1.5 rad away for one state."""
    robot = Robot(episode)
    count = len(robot.state.messages)
    rows = [count // 3 + number * count // 12 for number in range(5)]
    times, joint = robot.state.times_ns[rows], robot.most_moved()

    def edit(values: np.ndarray, names: list[str], stream: Stream) -> np.ndarray:
        if joint in names:
            values[np.isin(stream.times_ns, times), names.index(joint)] += 1.5
        return values

    robot.edit(edit)
    return Harm(
        (robot.state.key, joint, joint.removesuffix("_pos")), episode.at_s(int(times[0])), episode.at_s(int(times[-1]))
    )


@recipe("states")
def state_noisy(episode: Episode) -> Harm:
    """All positions have noise of 0.05 rad."""
    robot, chance = Robot(episode), noise("state noisy")
    rows = len(robot.state.messages)
    added = {name: chance.normal(0.0, 0.05, rows) for name in robot.state.names if name.endswith("_pos")}

    def edit(values: np.ndarray, names: list[str], _stream: Stream) -> np.ndarray:
        for index, name in enumerate(names):
            if name in added:
                values[:, index] += added[name][np.arange(len(values)) % rows]
        return values

    robot.edit(edit)
    return Harm((robot.state.key,))


@recipe("states")
def state_coarse(episode: Episode) -> Harm:
    """Positions come in steps of 0.1 rad."""
    robot = Robot(episode)

    def edit(values: np.ndarray, names: list[str], _stream: Stream) -> np.ndarray:
        columns = [index for index, name in enumerate(names) if name.endswith("_pos")]
        values[:, columns] = np.round(values[:, columns], 1)
        return values

    robot.edit(edit)
    return Harm((robot.state.key,))


@recipe("states")
def one_state_too_short(episode: Episode) -> Harm:
    """Three states lack their last number."""
    state = Robot(episode).state
    middle = len(state.messages) // 2
    width = len(state.messages[middle].data) // len(state.values[middle])
    for message in state.messages[middle : middle + 3]:
        message.data = message.data[:-width]
    return Harm((state.key,), episode.at_s(state.messages[middle].log_ns))


@recipe("states")
def state_of_another_episode_spliced_in(episode: Episode, other: Path) -> Harm:
    """From half on the states are another episode's, with the stamps of this one."""
    robot, theirs = Robot(episode), Robot(Episode(other)).streams
    from_ns = half_ns(robot.state.messages)

    def splice(values: np.ndarray, _names: list[str], stream: Stream) -> np.ndarray:
        donor = theirs[stream.key].values
        rows = np.flatnonzero(stream.times_ns >= from_ns)
        values[rows] = donor[(np.arange(len(rows)) + len(donor) // 3) % len(donor)]
        return values

    robot.edit(splice)
    return Harm((robot.state.key,), episode.at_s(from_ns))


# -- Commands ---------------------------------------------------------------------------------------------------------


@recipe("commands")
def commands_zeroed(episode: Episode) -> Harm:
    """What the operator sent is zero throughout; what the robot used is not."""
    commands = Robot(episode).commands
    for stream in commands:
        stream.put(np.zeros_like(stream.values))
    return Harm(tuple(stream.key for stream in commands))


@recipe("commands")
def commands_replaced_by_noise(episode: Episode) -> Harm:
    """What the operator sent is noise; what the robot used is not."""
    command, chance = Robot(episode).commands[0], noise("commands")
    command.put(command.values + chance.normal(0.0, 0.3, command.values.shape))
    return Harm((command.key,))


def _others(stream: Stream, other: Path) -> np.ndarray:
    theirs = Episode(other).streams().get(stream.key)
    if theirs is None:
        raise DoesNotFit(f"the other has no {stream.key}")
    values = theirs.values
    return values[(np.arange(len(stream.messages)) + len(values) // 3) % len(values)]


@recipe("commands")
def commands_of_another_episode(episode: Episode, other: Path) -> Harm:
    """What the operator sent is another episode's; what the robot used is not."""
    command = Robot(episode).commands[0]
    command.put(_others(command, other))
    return Harm((command.key,))


@recipe("commands")
def command_used_of_another_episode(episode: Episode, other: Path) -> Harm:
    """The command after the gate is another episode's."""
    used = Robot(episode).used
    used.put(_others(used, other))
    return Harm((used.key,))


@recipe("commands")
def command_used_zeroed(episode: Episode) -> Harm:
    """The command after the gate is zero throughout."""
    used = Robot(episode).used
    used.put(np.zeros_like(used.values))
    return Harm((used.key,))


@recipe("commands")
def command_used_jitters(episode: Episode) -> Harm:
    """The command after the gate jitters by 0.05 rad."""
    used, chance = Robot(episode).used, noise("jitter")
    added = chance.normal(0.0, 0.05, used.values.shape) * (unit_scale(used, "rad", 2.0) - 1.0)
    used.put(used.values + added)
    return Harm((used.key,))


@recipe("commands")
def command_used_frozen_from_half_on(episode: Episode) -> Harm:
    """The command after the gate repeats itself in the second half."""
    return _frozen_from_half(episode, Robot(episode).used)


@recipe("commands")
def targets_replaced_by_noise(episode: Episode) -> Harm:
    """What the motors got is noise."""
    target, chance = Robot(episode).target, noise("targets")
    target.put(chance.normal(0.0, 0.3, target.values.shape))
    return Harm((target.key,))


@recipe("commands")
def targets_frozen_from_half_on(episode: Episode) -> Harm:
    """What the motors got repeats itself in the second half."""
    return _frozen_from_half(episode, Robot(episode).target)


def _frozen_from_half(episode: Episode, stream: Stream) -> Harm:
    from_ns = half_ns(stream.messages)
    values, rows = stream.values, np.flatnonzero(stream.times_ns >= from_ns)
    if np.ptp(values[rows], axis=0).max() < 1e-3:
        raise DoesNotFit(f"{stream.key} stands there anyway")
    values[rows] = values[rows[0]]
    stream.put(values)
    return Harm((stream.key,), episode.at_s(from_ns))


@recipe("commands")
def gains_doubled(episode: Episode) -> Harm:
    """The gains that the motors got are twice those of the policy."""
    target = Robot(episode).target
    columns = target.columns(lambda name: name.endswith(("_kp", "_kd")))
    if not columns:
        raise DoesNotFit("no gains")
    values = target.values
    values[:, columns] *= 2.0
    target.put(values)
    return Harm((target.key,))


@recipe("commands")
def observations_replaced(episode: Episode, other: Path) -> Harm:
    """What the policy saw is another episode's."""
    robot = Robot(episode)
    seen = robot.get(f"policy_obs_{robot.name}")
    seen.put(_others(seen, other))
    return Harm((seen.key,))


@recipe("commands")
def observations_a_step_late(episode: Episode) -> Harm:
    """What the policy saw stands one step behind its time."""
    robot = Robot(episode)
    seen = robot.get(f"policy_obs_{robot.name}")
    seen.put(seen.values[np.maximum(np.arange(len(seen.messages)) - 1, 0)])
    return Harm((seen.key,))


@recipe("commands")
def policy_actions_scaled(episode: Episode) -> Harm:
    """What the policy said is 10 % too large."""
    robot = Robot(episode)
    said = robot.get(f"policy_action_{robot.name}")
    said.put(said.values * 1.1)
    return Harm((said.key,))


@recipe("commands")
def gate_repeats_itself(episode: Episode) -> Harm:
    """The gate says throughout what it said in the middle: that it waited, entered or left is not told."""
    robot = Robot(episode)
    gate = robot.get(f"command_gate_{robot.name}")
    said = gate.messages[len(gate.messages) // 2].data
    for message in gate.messages:
        message.data = said
    return Harm((gate.key,))


# -- Manifest ---------------------------------------------------------------------------------------------------------


def _set(episode: Episode, path: str, value: str) -> Harm:
    """Put another scalar into the text of the manifest, in its place; everything else stays byte for byte.

    Raises:
        DoesNotFit: it has none there, or the same.
    """
    node: Any = yaml.compose(episode.text, yaml.SafeLoader)
    for part in path.split("."):
        if isinstance(node, yaml.SequenceNode) and part.isdigit() and int(part) < len(node.value):
            node = node.value[int(part)]
        elif isinstance(node, yaml.MappingNode):
            node = next((found for key, found in node.value if key.value == part), None)
        else:
            node = None
    if not isinstance(node, yaml.ScalarNode) or node.value == value:
        raise DoesNotFit(f"{path} is not there, or {value} already")
    episode.text = episode.text[: node.start_mark.index] + value + episode.text[node.end_mark.index :]
    return Harm((path, path.rsplit(".", maxsplit=1)[-1], path.split(".", maxsplit=1)[0], MANIFEST))


def _of(episode: Episode, wanted: Callable[[dict[str, Any]], bool]) -> str:
    """Return the name of the first server whose facts fit."""
    name = next((name for name, facts in episode.manifest["servers"].items() if wanted(facts)), None)
    if name is None:
        raise DoesNotFit("no such server")
    return str(name)


OTHER_HASH = "0123456789abcdef" * 4


@recipe("manifest", is_sealed=False)
def task_changed(episode: Episode) -> Harm:
    """The manifest names another task."""
    return _set(episode, "task.name", "fold")


@recipe("manifest", is_sealed=False)
def instruction_changed(episode: Episode) -> Harm:
    """The manifest has another instruction."""
    return _set(episode, "task.instruction", "fold the towel")


@recipe("manifest", is_sealed=False)
def operator_changed(episode: Episode) -> Harm:
    """The manifest names another operator."""
    return _set(episode, "operator.id", "mallory")


@recipe("manifest", is_sealed=False)
def motion_hash_changed(episode: Episode) -> Harm:
    """The manifest has another hash of the motion's file."""
    return _set(episode, "motions.0.sha256", OTHER_HASH)


@recipe("manifest", is_sealed=False)
def revision_changed(episode: Episode) -> Harm:
    """The manifest says that another revision of the software recorded this."""
    return _set(episode, "recorder.software.revision", OTHER_HASH[:40])


@recipe("manifest", is_sealed=False)
def policy_renamed(episode: Episode) -> Harm:
    """The manifest names another policy."""
    return _set(episode, "policy.name", "some-other")


@recipe("manifest", is_sealed=False)
def checkpoint_hash_changed(episode: Episode) -> Harm:
    """The manifest has another hash of the policy's checkpoint."""
    return _set(episode, "policy.sha256", OTHER_HASH)


@recipe("manifest", is_sealed=False)
def success_flipped(episode: Episode) -> Harm:
    """The manifest says that the operator called it a success, which nobody did."""
    return _set(episode, "quality_flags.success", "true")


@recipe("manifest", is_sealed=False)
def model_hash_changed(episode: Episode) -> Harm:
    """The manifest has another hash of the robot's model."""
    return _set(episode, "robot.facts.model_sha256", OTHER_HASH)


@recipe("manifest", is_sealed=False)
def gains_in_the_manifest_changed(episode: Episode) -> Harm:
    """The manifest says other gains of the policy."""
    return _set(episode, "policy.facts.kp.0", "12.5")


@recipe("manifest", is_sealed=False)
def started_a_day_later(episode: Episode) -> Harm:
    """The manifest says that it was recorded a day later."""
    started = str(episode.manifest["timing"]["started"])
    day = int(started[8:10])
    return _set(episode, "timing.started", f"'{started[:8]}{day % 28 + 1:02d}{started[10:]}'")


@recipe("manifest", is_sealed=False)
def duration_doubled(episode: Episode) -> Harm:
    """The manifest says twice the duration."""
    return _set(episode, "timing.duration_s", str(2 * episode.manifest["timing"]["duration_s"]))


@recipe("manifest", is_sealed=False)
def losses_hidden(episode: Episode) -> Harm:
    """A fifth of the states is deleted, and the manifest still says that none was lost."""
    state = Robot(episode).state
    _delete(episode, state, lambda index: index % 5 != 2, renumbered=True)
    return Harm((state.key, SIGNALS))


@recipe("manifest", is_sealed=False)
def manifest_of_another_episode(episode: Episode, other: Path) -> Harm:
    """The manifest is another episode's."""
    episode.text = (other / MANIFEST).read_text(encoding="utf-8")
    return Harm((MANIFEST, "episode_id", SIGNALS, other.name))


# -- Files ------------------------------------------------------------------------------------------------------------


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    begin, length = chunk_places(path)[len(chunk_places(path)) // 2]
    data[begin + length // 2] ^= 0x10
    path.unlink()
    path.write_bytes(data)


@recipe("files", is_sealed=False)
def one_byte_of_the_signals_flipped(episode: Episode) -> Harm:
    """One bit of the signals has changed on the disk; checksums are those of before."""
    _flip(episode.folder / SIGNALS)
    return Harm((SIGNALS,))


@recipe("files", is_sealed=False)
def one_byte_of_the_cameras_flipped(episode: Episode) -> Harm:
    """One bit of the pictures has changed on the disk; checksums are those of before."""
    if not (episode.folder / CAMERAS).exists():
        raise DoesNotFit("no camera")
    _flip(episode.folder / CAMERAS)
    return Harm((CAMERAS,))


@recipe("files", is_sealed=False)
def one_number_of_the_signals_changed(episode: Episode) -> Harm:
    """One number of one state is another by a hair, and all checksums of the file are right."""
    state = Robot(episode).state
    values = state.values
    values[len(values) // 2, 0] += 0.001
    state.put(values)
    return Harm((SIGNALS, state.key))


@recipe("files", is_sealed=False)
def one_picture_replaced(episode: Episode) -> Harm:
    """One picture is the one before, and all checksums of the file are right."""
    camera = pictures.cameras(episode)[0]
    middle = len(camera.messages) // 2
    pictures.put_jpeg(camera.messages[middle], pictures.jpeg_of(camera.messages[middle - 1]))
    return Harm((CAMERAS, camera.key, pictures.camera_name(camera)))


def _take(episode: Episode, other: Path, name: str) -> Harm:
    if not (episode.folder / name).exists() or not (other / name).exists():
        raise DoesNotFit(f"no {name}")
    (episode.folder / name).unlink()
    shutil.copyfile(other / name, episode.folder / name)
    return Harm((name, other.name))


@recipe("files", is_sealed=False)
def cameras_of_another_episode(episode: Episode, other: Path) -> Harm:
    """The file of pictures is another episode's."""
    return _take(episode, other, CAMERAS)


@recipe("files", is_sealed=False)
def signals_of_another_episode(episode: Episode, other: Path) -> Harm:
    """The file of signals is another episode's."""
    return _take(episode, other, SIGNALS)


def _remade(path: Path, data: bytes) -> None:
    path.unlink()
    path.write_bytes(data)


@recipe("files", is_sealed=False)
def signals_truncated(episode: Episode) -> Harm:
    """The last tenth of the signals is not there."""
    path = episode.folder / SIGNALS
    data = path.read_bytes()
    _remade(path, data[: len(data) * 9 // 10])
    return Harm((SIGNALS,))


@recipe("files", is_sealed=False)
def cameras_truncated(episode: Episode) -> Harm:
    """The last tenth of the pictures is not there."""
    path = episode.folder / CAMERAS
    if not path.exists():
        raise DoesNotFit("no camera")
    data = path.read_bytes()
    _remade(path, data[: len(data) * 9 // 10])
    return Harm((CAMERAS,))


@recipe("files", is_sealed=False)
def signals_with_a_tail(episode: Episode) -> Harm:
    """Behind the end of the signals stand 1000 bytes that do not belong there."""
    path = episode.folder / SIGNALS
    _remade(path, path.read_bytes() + luck("tail").randbytes(1000))
    return Harm((SIGNALS,))


@recipe("files", is_sealed=False)
def zeros_in_the_signals(episode: Episode) -> Harm:
    """A block of 4096 bytes of the signals is zeros, as after a crash of the file system."""
    path = episode.folder / SIGNALS
    data = bytearray(path.read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 4096] = bytes(4096)
    _remade(path, bytes(data))
    return Harm((SIGNALS,))


@recipe("files", is_sealed=False)
def cameras_deleted(episode: Episode) -> Harm:
    """The file of pictures is not there."""
    path = episode.folder / CAMERAS
    if not path.exists():
        raise DoesNotFit("no camera")
    path.unlink()
    return Harm((CAMERAS, "camera", "cameras"))


@recipe("files", is_sealed=False)
def manifest_among_the_signals_changed(episode: Episode) -> Harm:
    """The copies of the manifest among the signals name another operator."""
    before = str(episode.manifest["operator"].get("id", ""))
    for attachment in episode.signals.attachments():
        document = yaml.safe_load(attachment.data)
        document.setdefault("operator", {})["id"] = before + "-not"
        attachment.data = yaml.safe_dump(document, sort_keys=False).encode()
    return Harm((MANIFEST, SIGNALS, "operator", "operator.id"))


@recipe("files", is_sealed=False)
def manifest_among_the_signals_gone(episode: Episode) -> Harm:
    """The copies of the manifest among the signals are not there."""
    attachments = episode.signals.attachments()
    episode.signals.parts = [part for part in episode.signals.parts if part not in attachments]
    return Harm((MANIFEST, SIGNALS))


def unchanged(episode: Episode, _other: Path) -> Harm:
    """Nothing: the files are taken apart and put together again. What is said of it is no catch."""
    episode.signals.messages()
    if (episode.folder / CAMERAS).exists():
        episode.cameras.messages()
    return Harm(())


CONTROL = Recipe("unchanged", "control", (unchanged.__doc__ or "").strip(), True, unchanged)


def messages_of(folder: Path, name: str = SIGNALS) -> list[Message]:
    """Return what a file holds, for tests of the recipes."""
    return list(Episode(folder)._recording(name).messages())
