"""A look at the instructions of a pickle before any of them is obeyed.

Some harm is done while a pickle is read, before anything in it could be looked at: a tuple that holds itself sixty
times over takes the age of the universe to hash when it is made the key of a dict, an index of the memo claims
gigabytes, a deep nest breaks the stack. So the instructions are followed here with the kinds of the values alone.
"""

from __future__ import annotations

import pickletools
from typing import Any

# Other ways to call or build than the allow-listed names, and what plain data does not have; numpy's pickles use none.
_REFUSED = frozenset(
    ["PERSID", "BINPERSID", "INST", "OBJ", "NEWOBJ", "NEWOBJ_EX", "EXT1", "EXT2", "EXT4", "NEXT_BUFFER",
     "READONLY_BUFFER", "EMPTY_SET", "ADDITEMS", "FROZENSET"]
)  # fmt: skip
_PUTS = frozenset(["PUT", "BINPUT", "LONG_BINPUT"])
_GETS = frozenset(["GET", "BINGET", "LONG_BINGET"])
_SETS = {"SETITEM": 2, "SETITEMS": 0, "DICT": 0}  # by how many items a single one takes; 0: all above the mark
_MARK, _TUPLE = "mark", "tuple"
_MOST_INSTRUCTIONS = 20_000_000  # some minutes of them; a clip of an hour in lists of numbers takes 4 million
_MEMO_SLACK = 1024  # the reader keeps its memo in an array: one with a huge index would claim gigabytes


class Unfit(Exception):
    """The pickle does what plain data does not need."""


def check(data: bytes) -> None:
    """Follow a pickle's instructions.

    Raises:
        Unfit: one of them does not belong in a motion file.
        ValueError, IndexError: it is no pickle, or cut short.
    """
    stack: list[str] = []
    memo: dict[int, str] = {}
    for number, (opcode, argument, _) in enumerate(pickletools.genops(data)):
        name = opcode.name
        if name in _REFUSED:
            raise Unfit(f"pickle instruction {name} does not belong in a motion file")
        if number > _MOST_INSTRUCTIONS:
            raise Unfit(f"more than {_MOST_INSTRUCTIONS} pickle instructions")
        if name in _PUTS or name == "MEMOIZE":
            index = len(memo) if name == "MEMOIZE" else int(argument or 0)
            if index > 2 * len(memo) + _MEMO_SLACK:
                raise Unfit(f"pickle memo index {str(index)[:20]} is beyond the file")
            memo[index] = stack[-1]
        elif name in _GETS:
            stack.append(memo.get(int(argument or 0), _TUPLE))
        elif name == "DUP":
            stack.append(stack[-1])
        elif name == "BUILD":
            stack.pop()  # the state; what it is given to keeps its kind
        else:
            if name in _SETS:
                _check_keys(stack, _SETS[name])
            _step(stack, opcode)


def _check_keys(stack: list[str], count: int) -> None:
    first = len(stack) - count if count else _last_mark(stack) + 1
    if _TUPLE in stack[first::2]:
        raise Unfit("a dict with a tuple as its key does not belong in a motion file")


def _step(stack: list[str], opcode: Any) -> None:
    """Take off the stack what an instruction takes, and put on it the kinds of what it leaves."""
    takes = [item.name for item in opcode.stack_before]
    if "mark" in takes:
        below = takes.index("mark")
        del stack[_last_mark(stack) :]
        takes = takes[:below]
    if takes:
        if len(stack) < len(takes):
            raise IndexError("an instruction finds too little on the stack")
        del stack[len(stack) - len(takes) :]
    stack.extend(item.name for item in opcode.stack_after)


def _last_mark(stack: list[str]) -> int:
    for index in range(len(stack) - 1, -1, -1):
        if stack[index] == _MARK:
            return index
    raise IndexError("an instruction finds no mark on the stack")
