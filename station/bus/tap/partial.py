"""Commands that carry a part of a value or a step of it: what their key holds afterwards."""

from __future__ import annotations

from collections.abc import Callable

Command = list[bytes]


_LARGEST = 64 << 20  # bytes, the largest value that a bus of ours takes


def after(command: Command, before: bytes) -> bytes | None:
    """Return what the key of a command of `PARTIAL` holds after it.

    Args:
        command: The command.
        before: What the key held; b"" where it did not exist.

    Returns:
        The value; None where it would be larger than a bus of ours takes.
    """
    name = command[0].upper()
    reach = int(command[2]) // _PER_BYTE[name] if name in _PER_BYTE else 0
    return PARTIAL[name](before, command) if reach <= _LARGEST else None


def _set_range(before: bytes, command: Command) -> bytes:
    start, part = int(command[2]), command[3]
    return before[:start].ljust(start, b"\0") + part + before[start + len(part) :]


def _set_bit(before: bytes, command: Command) -> bytes:
    place, bit = int(command[2]), int(command[3])
    value = bytearray(before.ljust(place // 8 + 1, b"\0"))
    mask = 0x80 >> place % 8
    value[place // 8] = value[place // 8] & ~mask | (mask if bit else 0)
    return bytes(value)


def _step(sign: int, step: int | None = None) -> Callable[[bytes, Command], bytes]:
    """Return what adds a step, or what the command says, to a decimal number; a key that does not exist counts as 0."""
    return lambda before, command: b"%d" % (int(before or b"0") + sign * (int(command[2]) if step is None else step))


_PER_BYTE = {b"SETRANGE": 1, b"SETBIT": 8}  # places that a byte has, of commands that name one
PARTIAL: dict[bytes, Callable[[bytes, Command], bytes]] = {
    b"APPEND": lambda before, command: before + command[2],
    b"SETRANGE": _set_range,
    b"SETBIT": _set_bit,
    b"INCR": _step(1, 1),
    b"DECR": _step(-1, 1),
    b"INCRBY": _step(1),
    b"DECRBY": _step(-1),
}
"""By command: from what its key held before to what it holds afterwards."""
