from __future__ import annotations

import contextlib
import pickle
import pickletools
from pathlib import Path

import numpy as np
import pytest

from adapters.motions import pkl_file
from station.errors import BadFile
from tests.adapters.motions.made import content, smooth, write_pkl

MOTION = smooth()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "motion.pkl"


def refusal(path: Path) -> str:
    with pytest.raises(BadFile) as refused:
        pkl_file.load(path)
    message = str(refused.value)
    assert "\n" not in message
    assert path.name in message
    return message


@pytest.mark.parametrize("protocol", range(6))
def test_every_pickle_protocol_gives_the_same_frames(file: Path, protocol: int) -> None:
    raw = pkl_file.load(write_pkl(file, content(MOTION), protocol))
    assert raw.fps == MOTION.fps
    np.testing.assert_array_equal(raw.root_pos, MOTION.root_pos)
    np.testing.assert_array_equal(raw.root_quat_wxyz, MOTION.root_quat_wxyz)
    np.testing.assert_array_equal(raw.q, MOTION.q)


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_names_of_numpy_before_version_2_are_read_as_well(file: Path, protocol: int) -> None:
    data = pickle.dumps({**content(MOTION), "fps": 30.0}, protocol=protocol)
    new, old = b"numpy._core.", b"numpy.core."
    file.write_bytes(b"".join(_renamed(data, new, old)))
    np.testing.assert_array_equal(pkl_file.load(file).q, MOTION.q)


def _renamed(data: bytes, new: bytes, old: bytes) -> list[bytes]:
    """Re-write a pickle's module names, unframed."""
    parts = []
    ends = [*[position for _, _, position in pickletools.genops(data)][1:], len(data)]
    for (opcode, argument, position), end in zip(pickletools.genops(data), ends, strict=True):
        if opcode.name == "FRAME":
            continue
        if opcode.name == "GLOBAL":
            parts.append(data[position:end].replace(new, old))
        elif opcode.name == "SHORT_BINUNICODE" and str(argument).startswith(new.decode()):
            text = str(argument).encode().replace(new, old)
            parts.append(b"\x8c" + bytes([len(text)]) + text)
        else:
            parts.append(data[position:end])
    return parts


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4", "<i4"])
def test_arrays_of_other_number_types_and_layouts_are_read(file: Path, dtype: str, order: str) -> None:
    q = np.asarray(np.round(MOTION.q * 10), dtype=dtype, order=order)  # type: ignore[call-overload]
    for protocol in (2, 4, 5):
        np.testing.assert_array_equal(pkl_file.load(write_pkl(file, {**content(MOTION), "dof_pos": q}, protocol)).q, q)


def test_a_file_of_gmr_without_body_positions_is_read(file: Path) -> None:
    value = {**content(MOTION), "local_body_pos": None, "link_body_list": None}
    assert len(pkl_file.load(write_pkl(file, value))) == len(MOTION)


def test_23_joints_of_twist_get_wrists_at_zero(file: Path) -> None:
    kept = [*range(19), *range(22, 26)]
    raw = pkl_file.load(write_pkl(file, {**content(MOTION), "dof_pos": MOTION.q[:, kept]}))
    np.testing.assert_array_equal(raw.q[:, kept], MOTION.q[:, kept])
    assert not raw.q[:, [19, 20, 21, 26, 27, 28]].any()
    assert len(raw.filled) == 6


def test_a_rate_given_by_hand_takes_the_place_of_the_one_in_the_file(file: Path) -> None:
    assert pkl_file.load(write_pkl(file, content(MOTION)), fps=60.0).fps == 60.0


class _Runs:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        import os

        return os.system, ("touch pwned",)


def test_a_pickle_that_runs_a_command_is_refused_by_name_and_runs_nothing(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "posix.system" in refusal(write_pkl(file, {**content(MOTION), "fps": _Runs()}))
    file.write_bytes(b"cos\nsystem\n(S'touch pwned'\ntR.")
    assert "os.system" in refusal(file)
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize(
    "name", ["builtins eval", "builtins getattr", "numpy load", "numpy.core.multiarray fromfile", "functools partial",
             "numpy ndarray.tofile", "numpy.core.multiarray _reconstruct.__globals__"],
)  # fmt: skip
def test_no_other_global_is_reachable(file: Path, name: str) -> None:
    module, attribute = name.split()
    for data in (f"c{module}\n{attribute}\n.".encode(), b"\x80\x04" + _text(module) + _text(attribute) + b"\x93."):
        file.write_bytes(data)
        assert f"{module}.{attribute}" in refusal(file)


def _text(text: str) -> bytes:
    return b"\x8c" + bytes([len(text)]) + text.encode()


@pytest.mark.parametrize(
    "data",
    [
        b"cnumpy\ndtype\n(S'O8'\nI00\nI01\ntR.",  # object dtype
        b"cnumpy\nndarray\n(I1\ntR.",  # a call that numpy's pickles never make
        b"cnumpy\nndarray\n}b.",  # changes what a name stands for
        b"c_codecs\nencode\n(S'x'\nS'zlib_codec'\ntR.",
        b"(icopyreg\n_reconstructor\n.",
        b"Ppersistent\n.",
        b"}r\xff\xff\xff\x7f.",  # memo index that would claim 32 GB
        b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.",  # bytes of a length that no memory has
        b"\x80\x04\x95",
        b"garbage",
        b"\x80\x09.",
        b"I1\n.",
        b"((((((((.",
        b".",
    ],
)
def test_bytes_that_are_no_motion_are_refused_in_one_line(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    refusal(file)


def test_object_arrays_and_structured_arrays_are_refused(file: Path) -> None:
    assert "dtype" in refusal(write_pkl(file, {**content(MOTION), "dof_pos": np.array([{}, []], dtype=object)}))
    structured = np.zeros(5, dtype=[("a", "f8"), ("b", "f8")])
    assert "dtype" in refusal(write_pkl(file, {**content(MOTION), "dof_pos": structured}))


def test_a_file_cut_short_anywhere_is_refused_in_one_line(file: Path) -> None:
    whole = pickle.dumps(content(smooth(frames=3)))
    for length in (0, 1, 2, 50, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:length])
        refusal(file)


def test_flipped_bytes_never_escape_as_another_error(file: Path) -> None:
    whole = pickle.dumps(content(smooth(frames=3)), protocol=2)
    random = np.random.default_rng(0)
    for _ in range(300):
        data = bytearray(whole)
        for place in random.integers(0, len(data), 3):
            data[place] = random.integers(256)
        file.write_bytes(data)
        with contextlib.suppress(BadFile):
            pkl_file.load(file)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"fps": 0.0}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"fps": "30"}, "fps"),
        ({"root_pos": np.zeros((90, 2))}, "(90, 2)"),
        ({"root_pos": [[0.0, 0.0, 1.0]] * 90}, "list"),
        ({"root_rot": np.zeros((90, 3))}, "(90, 3)"),
        ({"root_rot": None}, "NoneType"),
        ({"dof_pos": np.zeros((90, 28))}, "28 joints"),
        ({"dof_pos": np.zeros((89, 29))}, "89"),
        ({"dof_pos": np.zeros((90, 29), dtype=bool)}, "bool"),
        ({"local_body_pos": np.zeros(3)}, "local_body_pos"),
        ({"surprise": 1}, "surprise"),
    ],
)
def test_a_wrong_value_is_named_with_what_was_expected(file: Path, change: dict[str, object], expected: str) -> None:
    message = refusal(write_pkl(file, {**content(MOTION), **change}))
    assert expected in message


def test_missing_keys_other_types_and_single_frames_are_refused(file: Path) -> None:
    value = content(MOTION)
    del value["dof_pos"]
    assert "dof_pos" in refusal(write_pkl(file, value))
    assert "list" in refusal(write_pkl(file, [1, 2]))
    assert "at least 2" in refusal(write_pkl(file, content(smooth(frames=1))))


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    assert "No such file" in refusal(tmp_path / "absent.pkl")
    (tmp_path / "folder.pkl").mkdir()
    assert "not a file" in refusal(tmp_path / "folder.pkl")
