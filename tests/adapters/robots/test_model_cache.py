"""Compiled models are kept, found again, and made anew when they are torn or out of date."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from adapters.robots import model_cache
from station.errors import BadFile

_PENDULUM = """
<mujoco>
  <asset><mesh name="bob" file="bob.obj"/></asset>
  <worldbody><body name="arm"><joint name="hinge"/><geom type="mesh" mesh="bob"/></body></worldbody>
</mujoco>
"""
_TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def pendulum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "bob.obj").write_text(_TETRAHEDRON)
    path = tmp_path / "pendulum.xml"
    path.write_text(_PENDULUM)
    return path


def _no_change(spec: mujoco.MjSpec) -> None:
    pass


def _cached() -> list[Path]:
    return sorted(model_cache.folder().iterdir())


def test_a_second_load_takes_the_cached_model(pendulum: Path) -> None:
    first = model_cache.load(pendulum, _no_change)

    def must_not_run(spec: mujoco.MjSpec) -> None:
        raise AssertionError("compiled again")

    second = model_cache.load(pendulum, must_not_run)
    assert len(_cached()) == 1
    assert (second.nq, second.nmesh, second.body_mass[1]) == (first.nq, first.nmesh, first.body_mass[1])


def test_what_compiling_read_from_files_is_not_kept_in_memory(pendulum: Path) -> None:
    mujoco.mj_clearCache(mujoco.mj_getCache())
    assert model_cache.load(pendulum, _no_change).nmesh == 1
    assert mujoco.mj_getCacheSize(mujoco.mj_getCache()) == 0


def test_a_changed_mesh_an_included_file_and_a_salt_each_make_another_model(pendulum: Path) -> None:
    keys = {model_cache.model_hash(pendulum), model_cache.model_hash(pendulum, b"salt")}
    (pendulum.parent / "bob.obj").write_text(_TETRAHEDRON.replace("v 1 0 0", "v 2 0 0"))
    keys.add(model_cache.model_hash(pendulum))
    pendulum.write_text(_PENDULUM.replace("<worldbody>", '<include file="more.xml"/><worldbody>'))
    (pendulum.parent / "more.xml").write_text("<mujoco><option timestep='0.001'/></mujoco>")
    keys.add(model_cache.model_hash(pendulum))
    (pendulum.parent / "more.xml").write_text("<mujoco><option timestep='0.002'/></mujoco>")
    keys.add(model_cache.model_hash(pendulum))
    assert len(keys) == 5


@pytest.mark.parametrize("spoil", ["cut", "flip", "empty"])
def test_a_torn_cached_model_is_made_anew(pendulum: Path, spoil: str) -> None:
    model_cache.load(pendulum, _no_change)
    (torn,) = _cached()
    data = bytearray(torn.read_bytes())
    data[len(data) // 2] ^= 0xFF
    torn.write_bytes({"cut": bytes(data[: len(data) // 2]), "flip": bytes(data), "empty": b""}[spoil])
    model = model_cache.load(pendulum, _no_change)
    assert model.nmesh == 1
    (mended,) = _cached()
    assert mended.read_bytes() != bytes(data)


def test_the_cache_forgets_the_models_used_longest_ago(pendulum: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model_cache.load(pendulum, _no_change, salt=b"first")
    (first,) = _cached()
    monkeypatch.setattr(model_cache, "SIZE_LIMIT_BYTES", first.stat().st_size * 3 // 2)
    model_cache.load(pendulum, _no_change, salt=b"second")
    (left,) = _cached()
    assert left != first


def test_a_cache_that_cannot_be_written_costs_only_time(pendulum: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = pendulum.parent / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert model_cache.load(pendulum, _no_change).nmesh == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("<mujoco", "not a MuJoCo model"),
        ("<manifest/>", "MuJoCo refused it"),
        (_PENDULUM.replace("bob.obj", "gone.obj"), "gone.obj"),
    ],
)
def test_a_bad_model_file_is_named_in_one_line(pendulum: Path, text: str, expected: str) -> None:
    pendulum.write_text(text)
    with pytest.raises(BadFile) as caught:
        model_cache.load(pendulum, _no_change)
    assert str(pendulum) in str(caught.value)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_model_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"gone\.xml: no such file"):
        model_cache.load(tmp_path / "gone.xml", _no_change)
