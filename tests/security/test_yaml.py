"""YAML of strangers: plain data of a bounded size, or one line that says why not."""

from __future__ import annotations

import contextlib
import tracemalloc
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from station import config, safe_yaml
from station.episode.storage.manifest import Manifest, dump_manifest, parse_manifest
from station.errors import BadFile, ConfigError, EpisodeError, UsageError
from station.supervision import runbook
from tests.examples import examples

_LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
)
_MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 10)}]}}\n" for i in range(1, 12)
)
BAD = {
    "a billion laughs": (_LAUGHS, "more than 200000 values"),
    "a billion merges": (_MERGES, "more than 200000 values"),
    "alias in itself": ("a: &a [*a]", "stands within what it names"),
    "brackets": ("[" * 100_000, "50 deep|maximum nesting depth"),  # PyYAML 6.0.4 has a bound of its own, met earlier
    "braces": ("{a: " * 100_000, "50 deep"),
    "indents": ("\n".join(" " * level + "a:" for level in range(1000)), "50 deep"),
    "questions": ("? " * 50_000, "50 deep"),
    "too many values": ("[" + "1," * 300_000 + "]", "more than 200000 values"),
    "too many bytes": ("a: " + "x" * 9_000_000, "more than 8000000 bytes"),
    "python object": ("!!python/object/apply:os.system ['touch pwned']", "expected plain data"),
    "python name": ("!!python/name:os.system", "expected plain data"),
    "python tuple": ("!!python/tuple [1]", "expected plain data"),
    "tag of its own": ("!command 1", "expected plain data"),
    "endless number": ("a: " + "9" * 5000, "a number of 5000 characters"),
    "endless number in base 60": ("a: " + "1:" * 100_000 + "1", "a number of"),
    "endless number by tag": ("a: !!int '" + "9" * 5000 + "'", "a number of"),
    "no day": ("a: 2026-13-45", "cannot be read"),
    "no truth": ("a: !!bool maybe", "cannot be read"),
    "no number": ("a: !!int ''", "cannot be read"),
    "no time": ("a: !!timestamp x", "cannot be read"),
    "no bytes": ("a: !!binary x", "not YAML"),
    "no key": ("{[a]: b}", "unhashable key"),
    "nothing meant": ("*x", "undefined alias"),
    "control characters": ("a: \x1b[31m", "not YAML"),
    "two documents": ("a: 1\n---\nb: 2", "another document"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_plain_data_of_a_bounded_size_is_refused_in_a_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, reason = BAD[name]
    monkeypatch.chdir(tmp_path)
    tracemalloc.start()
    try:
        with pytest.raises(safe_yaml.BadYaml, match=reason) as refused:
            safe_yaml.load(text)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100_000_000
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 250
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", BAD)
def test_runbooks_settings_and_manifests_are_read_so(name: str, tmp_path: Path) -> None:
    text, reason = BAD[name]
    path = tmp_path / "book.yaml"
    path.write_text(text)
    for read in (config.read_yaml, lambda file: runbook.load(file, ())):
        with pytest.raises(ConfigError, match=reason) as refused:
            read(path)
        assert "\n" not in str(refused.value)
    with pytest.raises(EpisodeError, match=reason):
        parse_manifest(text.encode(), "manifest.yaml")
    with pytest.raises(UsageError):
        config.overrides([f"motion.loop={text}"], servers=["motion"])


def test_files_without_an_end_or_without_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="more than 8000000 bytes"):
        config.read_yaml(Path("/dev/zero"))
    binary = tmp_path / "book.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadFile, match="not UTF-8"):
        config.read_yaml(binary)


def test_anchors_that_stand_for_little_are_fine() -> None:
    assert safe_yaml.load("a: &a {x: [1, 2]}\nb: *a\nc: {<<: *a, y: 2}") == {
        "a": {"x": [1, 2]}, "b": {"x": [1, 2]}, "c": {"x": [1, 2], "y": 2},
    }  # fmt: skip


def test_a_manifest_as_large_as_they_come_is_read() -> None:
    manifest = Manifest(episode_id="x", motions=[{"file": f"{i}.pkl", "sha256": "0" * 64} for i in range(200)])
    manifest.servers = {f"server {i}": {"config": {f"key {k}": k / 7 for k in range(100)}} for i in range(200)}
    assert parse_manifest(dump_manifest(manifest), "manifest.yaml") == manifest


_WORDS = st.sampled_from([
    "a", "1", "-1", "01", "0x1f", "1_000", "1:30", ".5", "1e3", "1.5e+3", ".inf", "-.INF", ".nan", "~", "null", "Null",
    "true", "False", "yes", "off", "=", "<<", "2026-11-25", "''", "'1'", '"a b"', "!!str", "!!int", "&", "&a", "*a",
    "?", "-", ":", ",", "[", "]", "{", "}", "|", ">", "#", "---", "...",
])  # fmt: skip
_GAPS = st.sampled_from([" ", "\n", "\n  ", "\n- ", ": ", ", "])
_DOCUMENTS = st.lists(st.tuples(_WORDS, _GAPS).map("".join), max_size=12).map("".join)


@settings(max_examples=examples(300), deadline=None)
@given(_DOCUMENTS)
def test_it_is_what_the_library_reads(text: str) -> None:
    """Whatever is built on the way: equal by value, type and order, or refused by both."""
    try:
        expected = yaml.safe_load(text)
    except (yaml.YAMLError, *safe_yaml._ODD):
        with pytest.raises(safe_yaml.BadYaml):
            safe_yaml.load(text)
        return
    with contextlib.suppress(safe_yaml.BadYaml):  # of tags of its own, and of aliases in themselves
        assert repr(safe_yaml.load(text)) == repr(expected)


@settings(max_examples=examples(300), deadline=None)
@given(st.one_of(st.text(max_size=60), st.text("{}[]&*!?:-,|>%@`\"'# \n\tab01<", max_size=60)))
def test_any_text_is_data_or_refused(text: str) -> None:
    with contextlib.suppress(safe_yaml.BadYaml):
        safe_yaml.load(text)
