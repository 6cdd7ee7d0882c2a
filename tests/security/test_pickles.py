"""Motion files that try everything a pickle can: each is refused in one line, and nothing of it is run."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.motions import pickle_survey, pkl_file
from station.errors import BadFile
from tests.adapters.motions.made import content, smooth, write_pkl

_MEMORY = 1 << 27  # bytes of address space beyond what numpy and Python take themselves
_PATIENCE_S = 60.0


def _text(text: str) -> bytes:
    return b"\x8c" + bytes([len(text)]) + text.encode()


def _global(module: str, name: str) -> bytes:
    return _text(module) + _text(name) + b"\x93"


def _long(value: int) -> bytes:
    data = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
    return b"\x8b" + struct.pack("<I", len(data)) + data


def _motion(item: bytes, key: str = "fps") -> bytes:
    """A dict that has one of a motion's keys, with any instructions for its value."""
    return b"\x80\x04}" + _text(key) + item + b"s."


def _array(shape: bytes, *, code: bytes = b"", data: bytes = b"C\x08" + bytes(8)) -> bytes:
    """Numpy's own way to make an array, with any instructions for its shape."""
    core = "numpy._core.multiarray"
    code = code or _text("f8")
    made = _global(core, "_reconstruct") + _global("numpy", "ndarray") + b"K\x00\x85C\x01b\x87R"
    dtype = _global("numpy", "dtype") + code + b"\x89\x88\x87R"
    return made + b"(K\x01" + shape + dtype + b"\x89" + data + b"tb"


_RUN = _text("touch pwned") + b"\x85R"
_NESTED_TUPLE = b")" + b"2\x86" * 64  # each step a pair of the one before: 2 ** 64 items
_WIDE_LIST = b"]" + b"".join(b"\x940](" + b"h%b" % bytes([i]) * 50 + b"e" for i in range(5))  # 50 ** 5 items
_NESTED_LIST = b"]" + b"".join(b"\x940](h%bh%be" % (bytes([i]), bytes([i])) for i in range(64))

CALLS = {
    "os.system": _global("os", "system") + _RUN,
    "posix.system": _global("posix", "system") + _RUN,
    "subprocess": _global("subprocess", "call") + _RUN,
    "eval": _global("builtins", "eval") + _text("__import__('os').system('touch pwned')") + b"\x85R",
    "exec": _global("builtins", "exec") + _text("open('pwned','w')") + b"\x85R",
    "open": _global("builtins", "open") + _text("pwned") + _text("w") + b"\x86R",
    "import": _global("builtins", "__import__") + _text("antigravity") + b"\x85R",
    "runpy": _global("runpy", "run_path") + _text("/tmp/x.py") + b"\x85R",
    "pickle within": _global("pickle", "loads") + b"C\x01.\x85R",
    "marshal": _global("marshal", "loads") + b"C\x01.\x85R",
    "ctypes": _global("ctypes", "CDLL") + _text("libc.so.6") + b"\x85R",
    "numpy.load": _global("numpy", "load") + _text("x.npy") + b"\x85R",
    "numpy file": _global("numpy", "memmap") + _text("pwned") + b"\x85R",
    "numpy.f2py": _global("numpy.f2py.diagnose", "run") + b")R",
    "numpy eval": _global("numpy.testing._private.utils", "runstring") + _RUN,
    "torch": _global("torch._utils", "_rebuild_tensor_v2") + b")R",
    "old style": b"cos\nsystem\n(S'touch pwned'\ntR",
    "instance": b"(S'touch pwned'\nios\nsystem\n",
    "object": b"(cos\nsystem\nS'touch pwned'\no",
    "new object": _global("builtins", "object") + b")\x81",
    "new object with keywords": _global("builtins", "object") + b")}\x92",
    "persistent id": b"Pos.system\n",
    "binary persistent id": _text("os.system") + b"Q",
    "extension": b"\x82\x01",
    "out of band": b"\x97",
    "out of band, read only": b"C\x01x\x98",
    "getattr": _global("builtins", "getattr") + _global("numpy", "dtype") + _text("__class__") + b"\x86R",
    "dots in a name": _global("numpy", "dtype.__class__.__base__.__subclasses__") + b")R",
    "dots to a global": _global("numpy.core.multiarray", "_reconstruct.__globals__"),
    "attrgetter": _global("operator", "attrgetter") + _text("system") + b"\x85R",
    "methodcaller": _global("operator", "methodcaller") + _text("x") + b"\x85R",
    "reduce": _global("functools", "reduce") + b")R",
    "map": _global("builtins", "map") + b")R",
    "copyreg": _global("copyreg", "_reconstructor") + b")R",
    "copyreg extension": _global("copyreg", "add_extension") + b")R",
    "names from the memo": _text("os") + b"\x94" + _text("system") + b"\x94" + b"00h\x00h\x01\x93" + _RUN,
    "name in two halves": _text("numpy") + _text("os.system") + b"\x93" + _RUN,
    "name that is no text": b"C\x02os" + b"C\x06system" + b"\x93" + _RUN,
    "name that is an array": b"]]\x93" + _RUN,
    "state of a name": _global("numpy", "dtype") + b"}" + _text("__init__") + b"Nsb",
    "slots of a name": _global("numpy", "dtype") + b"N}" + _text("_call") + b"Ns\x86b",
    "state of a class": _global("numpy", "ndarray") + b"}" + _text("__reduce__") + b"Nsb",
    "items of a name": _global("numpy", "dtype") + _text("a") + b"Ns",
    "encode": _global("_codecs", "encode") + _text("x") + _text("zlib_codec") + b"\x86R",
    "decode": _global("_codecs", "decode") + _text("x") + _text("rot13") + b"\x86R",
    "a call of ndarray": _global("numpy", "ndarray") + _long(1 << 40) + b"\x85R",
}
BOMBS = {
    "key that takes for ever to hash": _NESTED_TUPLE + b"Ns",
    "key that takes for ever, of many": b"(" + _NESTED_TUPLE + b"Nu",
    "key hidden by an empty state": _NESTED_TUPLE + b"NbNs",
    "key from the memo": _NESTED_TUPLE + b"\x940h\x00Ns",
    "key that breaks the stack": b")" + b"\x85" * 500_000 + b"Ns",
    "set that takes for ever": b"\x8f(" + _NESTED_TUPLE + b"\x90",
    "frozen set": b"(" + _NESTED_TUPLE + b"\x91",
    "memo index of 32 GB": b"Nr\xff\xff\xff\x7f",
    "memo index in text": b"Np99999999999999999999\n",
    "bytes of 8 EB": b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f",
    "text of 4 GB": b"X\xff\xff\xff\xff",
    "bytearray of 8 EB": b"\x96\xff\xff\xff\xff\xff\xff\xff\x7f",
    "frame of 8 EB": b"\x95\xff\xff\xff\xff\xff\xff\xff\x7f",
    "number of 2 GB": b"\x8b\xff\xff\xff\x7f",
    "number in endless text": b"I" + b"9" * 10_000 + b"\n",
}
VALUES = {
    "lists within lists within lists": _NESTED_LIST,
    "wide lists within lists": _WIDE_LIST,
    "list in itself": b"]\x94h\x00a",
    "deep list": b"]" * 100_000 + b"a" * 99_999,
    "number beyond every float": _long(1 << 40_000),
    "array of 8 EB": _array(_long(1 << 60) + b"\x85"),
    "array of endless sides": _array(b"(" + (_long(1 << 8000) + b"\x94") + b"h\x00" * 30 + b"t"),
    "array of a million sides": _array(b"(" + b"K\x01" * 1_000_000 + b"t"),
    "array of nested shape": _array(_NESTED_TUPLE),
    "array of nested lists": _array(_NESTED_LIST),
    "array of negative size": _array(b"J\xff\xff\xff\xff\x85"),
    "array of objects": _array(b"K\x01\x85", code=_text("O8")),
    "array of a hidden structure": _array(b"K\x01\x85", code=_text("f8,O")),
    "array of huge items": _array(b"K\x01\x85", code=_text("f8,V2000000000")),
    "array of a nested code": _array(b"K\x01\x85", code=_NESTED_LIST),
    "array without its state": _global("numpy._core.multiarray", "_reconstruct") + b")R",
    "array of an array": _array(b"K\x01\x85", data=_array(b"K\x01\x85")),
    "codec of nested lists": _global("_codecs", "encode") + _text("x") + _NESTED_LIST + b"\x86R",
}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(tmp_path)
    yield tmp_path / "motion.pkl"
    assert not (tmp_path / "pwned").exists()


def refusal(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(BadFile) as refused:
        pkl_file.load(path)
    message = str(refused.value)
    assert "\n" not in message
    assert len(message) < 500
    return message


@pytest.mark.parametrize("name", CALLS)
def test_a_pickle_that_reaches_for_code_is_refused_and_runs_nothing(file: Path, name: str) -> None:
    refusal(file, b"\x80\x05" + CALLS[name] + b".")
    refusal(file, _motion(CALLS[name]))


@pytest.mark.parametrize("name", [*BOMBS, *VALUES])
def test_a_pickle_that_would_take_all_memory_or_for_ever_is_refused(file: Path, name: str) -> None:
    refusal(file, b"\x80\x04}" + BOMBS[name] + b"." if name in BOMBS else _motion(VALUES[name]))


def test_a_refusal_names_what_was_asked_for(file: Path) -> None:
    assert "posix.system" in refusal(file, _motion(CALLS["posix.system"]))
    assert "tuple as its key" in refusal(file, b"\x80\x04}" + _NESTED_TUPLE + b"Ns.")
    assert "more items than it has bytes" in refusal(file, _motion(VALUES["wide lists within lists"]))


@pytest.mark.usefixtures("processes")
def test_bombs_are_refused_within_a_bounded_memory(tmp_path: Path) -> None:
    """In a process that may not have much: what is refused must not have been built first."""
    for number, name in enumerate([*BOMBS, *VALUES]):
        data = b"\x80\x04}" + BOMBS[name] + b"." if name in BOMBS else _motion(VALUES[name])
        (tmp_path / f"{number}.pkl").write_bytes(data)
    script = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "from adapters.motions import pkl_file\n"
        "from station.errors import BadFile\n"
        "used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[2]), resource.RLIM_INFINITY))\n"
        "for path in sorted(Path(sys.argv[1]).glob('*.pkl')):\n"
        "    try:\n"
        "        pkl_file.load(path)\n"
        "    except BadFile as error:\n"
        "        assert 'MemoryError' not in str(error), error\n"
        "    else:\n"
        "        sys.exit(f'{path} was read')\n"
    )
    arguments = [sys.executable, "-c", script, str(tmp_path), str(_MEMORY)]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_honest_files_of_every_protocol_pass_the_survey(file: Path) -> None:
    motion = smooth()
    for protocol in range(6):
        value = {**content(motion), "link_body_list": [f"body {i}" for i in range(30)], "local_body_pos": None}
        write_pkl(file, value, protocol)
        pickle_survey.check(file.read_bytes())
        np.testing.assert_array_equal(pkl_file.load(file).q, motion.q)


def test_the_survey_follows_what_the_reader_does_with_plain_data() -> None:
    values = [{"a": [1, (2, 3), {"b": b"x", 4: None}]}, [[]] * 5, ("x", 1.5, True, 1 << 80), {}, [], ()]
    for value in values:
        for protocol in range(6):
            pickle_survey.check(pickle.dumps(value, protocol))
