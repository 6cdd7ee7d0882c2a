"""What is fetched is whole and the pinned file, or it is not there; every failure names the address and the file."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from station.assets.fetch import FetchRequest, download, order, orders
from station.errors import AssetMissing, BadFile, UnknownName
from tests.assets.upstream import MESHES, MODEL, POLICY, REVISION, Fault, Server, install_lab
from tests.waiting import wait_until


def policy(server: Server) -> FetchRequest:
    known = server.collection()
    return order("lab", known, known.bundles[0])


def model(server: Server) -> FetchRequest:
    known = server.collection()
    return order("lab", known, known.bundles[1])


def files(cache: Path) -> list[str]:
    """All files of the cache but the lock."""
    every = (path.relative_to(cache).as_posix() for path in cache.rglob("*") if path.is_file())
    return sorted(set(every) - {".partial/lock"})


def test_a_file_is_fetched_with_its_content_and_told_by_bytes(server: Server, cache: Path) -> None:
    came: list[int] = []
    download(policy(server).wants, on_bytes=came.append)
    assert (cache / "lab/policy.onnx").read_bytes() == POLICY
    assert server.asked == [f"/{REVISION}/upstream/policy.onnx"]
    assert sum(came) == len(POLICY)
    assert files(cache) == ["lab/policy.onnx"]


def test_a_bundle_is_fetched_whole_with_names_that_need_quoting(server: Server, cache: Path) -> None:
    download(model(server).wants)
    assert files(cache) == ["lab/left foot.stl", "lab/model.xml", "lab/right_foot.stl"]
    assert (cache / "lab/left foot.stl").read_bytes() == MESHES["left foot.stl"]
    assert server.asked[-1].endswith("/model.xml"), "it is of no use before the rest is there"


def test_what_is_there_already_is_not_fetched_again(server: Server, cache: Path) -> None:
    download(policy(server).missing)
    again = policy(server)
    assert again.missing == []
    assert again.wants[0].here == cache / "lab/policy.onnx"


def test_a_good_file_of_the_environment_counts_as_there(server: Server, environment: Path) -> None:
    path = environment / "lab/policy.onnx"
    path.parent.mkdir()
    path.write_bytes(POLICY)
    assert policy(server).wants[0].here == path
    path.write_bytes(b"my own")
    (want,) = policy(server).missing
    assert want.shadow == path, "it will be found before what is fetched"


def test_a_file_that_was_put_there_by_hand_is_checked_like_any_other(server: Server, cache: Path) -> None:
    (want,) = policy(server).missing
    want.target.parent.mkdir(parents=True)
    want.target.write_bytes(POLICY)
    assert policy(server).missing == []
    want.target.write_bytes(POLICY[:-1] + b"?")
    assert policy(server).missing != [], "same size, other content"


def test_a_damaged_file_is_replaced(server: Server, cache: Path) -> None:
    path = cache / "lab/policy.onnx"
    path.parent.mkdir(parents=True)
    path.write_bytes(POLICY[:100])
    download(policy(server).missing)
    assert path.read_bytes() == POLICY


@pytest.mark.parametrize(
    ("fault", "error", "told"),
    [
        ("another", BadFile, "is pinned; it is another file, and nothing of it was kept"),
        ("longer", BadFile, f"more than the pinned {len(POLICY)} bytes came"),
        ("cut", AssetMissing, f" of {len(POLICY)} bytes; try again, or get it on another machine and put it at"),
        ("cut without a length", AssetMissing, f"broke off after {len(POLICY) // 2} of {len(POLICY)} bytes; try again"),
        ("missing", AssetMissing, "the server answered 404 Not Found; get it on another machine and put it at"),
    ],
)
def test_what_comes_wrong_is_refused_and_nothing_of_it_is_kept(
    server: Server, cache: Path, fault: Fault, error: type[Exception], told: str
) -> None:
    server.faults["upstream/policy.onnx"] = fault
    (want,) = policy(server).wants
    with pytest.raises(error) as caught:
        download([want])
    assert str(caught.value).startswith(f"{want.url}: ")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
    assert files(cache) == []


def test_a_damaged_file_stays_refused_when_what_comes_is_no_better(server: Server, cache: Path) -> None:
    path = cache / "lab/policy.onnx"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"damaged")
    server.faults["upstream/policy.onnx"] = "another"
    with pytest.raises(BadFile):
        download(policy(server).missing)
    assert path.read_bytes() == b"damaged"


def test_no_connection_is_told_with_the_address_the_reason_and_where_to_put_the_file(cache: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        nobody = Server(taken.getsockname()[1])
    (want,) = policy(nobody).wants
    with pytest.raises(AssetMissing) as caught:
        download([want])
    assert str(caught.value) == (
        f"{want.url}: could not be reached (Connection refused); "
        f"get it on another machine and put it at {cache}/lab/policy.onnx"
    )
    assert files(cache) == []


def test_a_name_that_cannot_be_looked_up_is_told_in_a_line(server: Server, cache: Path) -> None:
    server.url = "https://nobody.invalid/{revision}/{path}"
    with pytest.raises(AssetMissing, match=r"^https://nobody\.invalid/.*: could not be reached \([^()]+\); get it on"):
        download(policy(server).wants)


def test_files_that_came_before_one_that_failed_are_kept_and_not_fetched_again(server: Server, cache: Path) -> None:
    server.faults["upstream/right_foot.stl"] = "missing"
    with pytest.raises(AssetMissing, match=r"right_foot\.stl: the server answered 404"):
        download(model(server).wants)
    assert files(cache) == ["lab/left foot.stl"]
    del server.faults["upstream/right_foot.stl"]
    assert [want.reference for want in model(server).missing] == ["lab:right_foot.stl", "lab:model.xml"]
    download(model(server).missing)
    assert model(server).missing == []
    assert (cache / "lab/model.xml").read_bytes() == MODEL


@pytest.mark.usefixtures("processes")
def test_a_fetch_that_is_killed_leaves_no_file_and_the_next_one_cleans_up(
    server: Server, cache: Path, tmp_path: Path
) -> None:
    install_lab(tmp_path, server)
    server.faults["upstream/policy.onnx"] = "stalls"
    code = "from station.assets import fetch; fetch.download(fetch.orders(['lab-policy'])[0].wants)"
    python = [sys.executable, "-c", code]
    with subprocess.Popen(python, env={**os.environ, "PYTHONPATH": str(tmp_path)}) as killed:
        try:
            wait_until(lambda: _has_begun(cache / ".partial"))
            with pytest.raises(AssetMissing, match="another `station assets fetch` is at work there"):
                download(policy(server).wants)
        finally:
            killed.kill()
    (left,) = files(cache)
    assert left.startswith(".partial/"), "what came of it has no name that anybody would find"
    server.faults.clear()
    download(policy(server).wants)
    assert files(cache) == ["lab/policy.onnx"]


def test_a_cache_that_cannot_be_written_is_told_in_a_line(
    server: Server, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.parent.mkdir(parents=True)
    cache.write_text("a file where the folder should be")
    with pytest.raises(
        AssetMissing, match=r"cannot be written: .*; make room, or name another cache with XDG_CACHE_HOME"
    ):
        download(policy(server).wants)
    cache.unlink()
    cache.mkdir()
    (cache / "lab").write_text("a file where the folder should be")
    with pytest.raises(AssetMissing, match=r"lab/policy\.onnx: cannot be written: "):
        download(policy(server).wants)


@pytest.mark.usefixtures("cache")
def test_a_bundle_a_collection_and_a_reference_can_be_asked_for_each_once() -> None:
    every = ["twist2-checkpoint", "twist2-model", "twist2-motions"]
    assert [o.bundle.name for o in orders(["twist2"])] == every
    assert [o.bundle.name for o in orders(["twist2-model", "twist2:g1/meshes/pelvis.STL"])] == ["twist2-model"]
    with pytest.raises(UnknownName, match=r"unknown asset to fetch 'twist2-modl' \(did you mean 'twist2-model'\?\)"):
        orders(["twist2-modl"])


def _has_begun(partial: Path) -> bool:
    """Whether a download has brought its first bytes; before, the folder is tried with files that are gone at once."""
    try:
        return any(path.stat().st_size for path in partial.glob("tmp*"))
    except FileNotFoundError:
        return False
