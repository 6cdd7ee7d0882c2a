"""A catalogue is complete and safe, or it is refused where it is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from station import registry
from station.assets import PinnedFile, Upstream, read_collection
from station.errors import BadFile
from tests.assets.upstream import REVISION

HASH = "0" * 64
WHOLE = f"""
about = "files of the lab"
[upstream]
repository = "lab/robots"
revision = "{REVISION}"
url = "https://example.org/{{revision}}/{{path}}"
[[bundles]]
name = "lab-policy"
about = "a policy"
licence = "MIT"
folder = "ckpts"
upstream_folder = "assets/ckpts"
files = [["walk 1.onnx", 12, "{HASH}"]]
"""


def test_a_catalogue_says_where_a_file_comes_from_and_where_it_goes(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(WHOLE)
    collection = read_collection(tmp_path / "lab.toml")
    (bundle,) = collection.bundles
    (file,) = bundle.files
    assert collection.upstream is not None
    assert file.path == "ckpts/walk 1.onnx"
    assert collection.upstream.url_of(file) == f"https://example.org/{REVISION}/assets/ckpts/walk%201.onnx"
    assert collection.pinned("ckpts/walk 1.onnx") == (bundle, file)
    assert collection.pinned("ckpts/walk 2.onnx") is None


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("https://", "http://", "url 'http://example.org/{revision}/{path}': expected https://"),
        ("https://", "file://", "expected https://"),
        (HASH, "abc", "sha256 of ckpts/walk 1.onnx: expected 64 hex digits, got 'abc'"),
        ("12,", "0,", "size_bytes of ckpts/walk 1.onnx: expected more than 0, got 0"),
        ('folder = "ckpts"', 'folder = "../.."', "expected one that stays below the collection's folder"),
        ('licence = "MIT"\n', "", "missing required field `licence`"),
        ("about =", "abuot =", "abuot"),
        ("[upstream]", "[upstream", "not a catalogue of files"),
    ],
)
def test_a_catalogue_with_a_mistake_is_refused_with_where_it_is(
    tmp_path: Path, before: str, after: str, told: str
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(WHOLE.replace(before, after))
    with pytest.raises(BadFile) as caught:
        read_collection(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert told in str(caught.value)


def test_only_a_server_of_this_machine_may_be_asked_without_encryption() -> None:
    for url in ("http://127.0.0.1:8000/{path}", "http://localhost/{path}", "https://example.org/{path}"):
        assert Upstream(repository="a/b", revision="c", url=url).url == url
    with pytest.raises(ValueError, match="expected https://"):
        Upstream(repository="a/b", revision="c", url="http://127.0.0.1.example.org/{path}")


def test_a_copy_is_compared_by_size_and_by_hash(tmp_path: Path) -> None:
    file = PinnedFile(path="x", upstream="x", size_bytes=3, sha256=HASH)
    copy = tmp_path / "x"
    assert file.problem(copy) == "is not there"
    copy.write_bytes(b"ab")
    assert file.problem(copy) == "has 2 bytes, 3 expected"
    copy.write_bytes(b"abc")
    assert file.problem(copy, whole=False) == ""
    assert file.problem(copy) == "has sha256 ba7816bf8f01…, 000000000000… expected"


def test_bundles_of_all_registered_collections_have_names_of_their_own() -> None:
    names = [bundle.name for key in registry.names("asset") for bundle in registry.find("asset", key).bundles]
    assert len(names) == len(set(names))
    assert not set(names) & set(registry.names("asset")), "a collection's name stands for all that it offers"
