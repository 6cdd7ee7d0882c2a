"""Bytes made of good values by damage, structured and random; the same seed makes the same bytes."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Iterator
from typing import Any

NUMBERS = (
    b"1" + b"0" * 400, b"-1" + b"0" * 400, b"9" * 5000, b"1" + b"0" * 300, b"9223372036854775807",
    b"9223372036854775808", b"-9223372036854775808", b"-9223372036854775809", b"18446744073709551616", b"2147483648",
    b"1e308", b"-1e308", b"1e999", b"-1e999", b"1" + b"0" * 400 + b".5", b"1e-999", b"5e-324", b"NaN", b"Infinity",
    b"-Infinity", b"-0", b"-0.0", b"0", b"1", b"-1", b"0.5", b"00", b"1_0", b"+1", b".5", b"1.", b"0x10",
)  # fmt: skip
TEXTS = (
    b'""', b'"12"', b'"1e5"', b'"nan"', b'"' + b"x" * 5000 + b'"', b'"\\ud800"', b'"\\udc00\\ud800"', b'"\xff"',
    b'"\xed\xa0\x80"', b'"\\u0000"', b'"\\u001b[2J"', b'"[/x]"', b'"[bold]"', b'"{0}%s%n"', b'"../../etc/passwd"',
    b'"~nobody/x"', b'"builtin:../x"', b'"a:b"', b'"line\\nbreak"', b'"\\u202e"', b'"' + b"9" * 400 + b'"', b'"\n"',
)  # fmt: skip
OTHERS = (
    b"true", b"false", b"null", b"[]", b"{}", b"[[]]", b"[" * 60 + b"]" * 60, b"[" * 80 + b"]" * 80,
    b"[" * 900 + b"]" * 900, b"[" * 5000, b'{"a":' * 70 + b"1" + b"}" * 70, b'{"a":' * 900 + b"1" + b"}" * 900,
    b"[" + b"0," * 3000 + b"0]", b'{"a": 1, "a": "b"}', b'{"": {"": [null]}}', b"[1, 2", b'{"a"', b"nul", b"",
)  # fmt: skip
TOKENS = (*NUMBERS, *NUMBERS, *TEXTS, *OTHERS)  # numbers twice: they are what the bus carries most
FLOATS = (
    float("nan"), float("inf"), float("-inf"), 1.7e308, -1.7e308, 1e200, 1e19, -1e19, 2.0**53, 5e-324, -0.0, 0.0, 1.0,
)  # fmt: skip


class Raw(bytes):
    """JSON text, or what takes its place, that is written as it is."""


def mutant(valid: bytes, rng: random.Random) -> bytes:
    """Return a good value with one to three damages, or now and then bytes that never were one."""
    if rng.random() < 0.05:
        return rng.randbytes(rng.choice((0, 1, 4, 8, 35, 300)))
    data = valid
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = _damaged(data, rng)
    return data


def every(valid: bytes) -> Iterator[bytes]:
    """Yield a good value with each token at each of its places, one at a time; of one that is no JSON, the tokens."""
    places: list[tuple[Any, Any]] = []
    tree = _json(valid)
    _collect(tree, places)
    for inside, place in places:
        before = inside[place]
        for token in dict.fromkeys(TOKENS):
            inside[place] = Raw(token)
            yield _written(tree)
        inside[place] = before
    yield from dict.fromkeys(TOKENS)


def _damaged(data: bytes, rng: random.Random) -> bytes:
    tree = _json(data) if rng.random() < 0.8 else None
    if isinstance(tree, (dict, list)):
        return _written(_with_damage(tree, rng))
    if tree is None and data and len(data) % 4 == 0 and b"\0" in data and rng.random() < 0.7:
        return _with_float(data, rng)
    return rng.choice(_ON_BYTES)(data, rng)


def _json(data: bytes) -> Any:
    """Return the tree that bytes hold; None where they hold none, or one that a damage before made deep."""
    if data.count(b"[") + data.count(b"{") > 200:
        return None
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


def _with_damage(tree: Any, rng: random.Random) -> Any:
    """Return a tree with a damage somewhere: at its top, or at any place within it."""
    places: list[tuple[Any, Any]] = []
    _collect(tree, places)
    if not places or rng.random() < 0.05:
        return Raw(rng.choice(TOKENS))
    inside, place = rng.choice(places)
    kind = rng.random()
    if kind < 0.75:
        inside[place] = Raw(rng.choice(TOKENS))
    elif kind < 0.85:
        del inside[place]
    elif kind < 0.9:
        inside[place] = [inside[place]]
    elif isinstance(inside, dict):
        inside[rng.choice(("more", "", "\x1b", "name", "x" * 300))] = Raw(rng.choice(TOKENS))
    else:
        inside.extend([inside[place]] * rng.choice((1, 40)))
    return tree


def _collect(tree: Any, places: list[tuple[Any, Any]]) -> None:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for place, item in list(items):
        places.append((tree, place))
        _collect(item, places)


def _written(tree: Any) -> bytes:
    """Write a tree as JSON, and what is raw in it as it is."""
    if isinstance(tree, Raw):
        return bytes(tree)
    if isinstance(tree, dict):
        pairs = (json.dumps(name).encode() + b": " + _written(item) for name, item in tree.items())
        return b"{" + b", ".join(pairs) + b"}"
    if isinstance(tree, list):
        return b"[" + b", ".join(map(_written, tree)) + b"]"
    return json.dumps(tree).encode()


def _with_float(data: bytes, rng: random.Random) -> bytes:
    size, layout = rng.choice(((8, "<d"), (8, "<d"), (4, "<f")))
    at = rng.randrange(max(1, len(data) // size)) * size
    number = rng.choice(FLOATS) if size == 8 else float("nan")
    return data[:at] + struct.pack(layout, number) + data[at + size :]


def _replaced_word(data: bytes, rng: random.Random) -> bytes:
    words = data.split(b" ")
    words[rng.randrange(len(words))] = rng.choice(TOKENS)
    return b" ".join(words)


def _flipped(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 5))):
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
    return bytes(damaged)


_ON_BYTES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    lambda data, rng: data[: rng.randrange(len(data) + 1)],
    lambda data, rng: data + rng.choice((b"\0", b" ", b"}", b"x", b"\n1", data, b"\xff" * 7)),
    lambda data, rng: rng.choice((b"\xef\xbb\xbf", b" ", b"\0", b"-")) + data,
    lambda data, rng: data.decode("utf-8", "replace").encode(rng.choice(("utf-16", "utf-32"))),
    lambda data, rng: rng.choice(TOKENS),
    _replaced_word,
    _flipped,
)
