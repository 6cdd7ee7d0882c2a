"""``station assets``: what is where, and how it comes here, as a user types it."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.assets.upstream import MODEL, POLICY, REVISION, Server, install_lab, serving
from tests.cli.running import Home, one_line
from tests.main_job.station_runs import ROOT
from tests.waiting import DEADLINE_S

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture
def server() -> Iterator[Server]:
    with serving() as made:
        yield made


@pytest.fixture
def lab(home: Home, tmp_path: Path, server: Server) -> Home:
    """A home without upstream data, where somebody's package offers files of a server on this machine."""
    (tmp_path / "packages").mkdir()
    install_lab(tmp_path / "packages", server)
    bare = home.without("STATION_ASSETS")
    bare.environment |= {
        "XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path / "packages"),
        "NO_PROXY": "127.0.0.1", "no_proxy": "127.0.0.1",
    }  # fmt: skip
    return bare


def cache_of(home: Home) -> Path:
    return Path(home.environment["XDG_CACHE_HOME"]) / "station" / "assets"


def rows(home: Home, *arguments: str) -> dict[str, str]:
    """Lines of the list by reference, with single spaces."""
    done = home.run("assets", "list", *arguments)
    table = done.stdout.split("\n\n")[0].splitlines()
    assert table[0].split() == ["file", "where", "size", "licence", "fetch"], done.stderr
    return {line.split("  ")[0]: " ".join(line.split()) for line in table[1:]}


def in_terminal(home: Home, *arguments: str, answer: str) -> tuple[int, str]:
    """Run a verb in a pseudo-terminal, answer its question; return exit code and all that was shown."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-m", "station", *arguments], cwd=ROOT, env=home.environment,
        stdin=theirs, stdout=theirs, stderr=theirs,
    ) as process:  # fmt: skip
        os.close(theirs)
        shown = ""
        while select.select([ours], [], [], DEADLINE_S)[0]:
            try:
                shown += os.read(ours, 4096).decode()
            except OSError:  # what Linux says when the other side has closed
                break
            if answer and "Download? [y/N]:" in shown:
                os.write(ours, f"{answer}\n".encode())
                answer = ""
        os.close(ours)
        return process.wait(DEADLINE_S), shown


def test_the_list_shows_place_size_licence_and_what_to_fetch(lab: Home) -> None:
    assert rows(lab)["lab:policy.onnx"] == "lab:policy.onnx not here 270.0 kB MIT lab-policy"
    assert rows(lab)["lab:model.xml + 2"] == "lab:model.xml + 2 not here 0.5 kB BSD-3-Clause lab-model"
    out = lab.run("assets", "list").stdout
    assert "motions that need no file: builtin:" in out
    assert "to download what is not here: station assets fetch lab-model lab-policy twist2-checkpoint" in out
    assert "left foot.stl" not in out, "meshes are counted"
    assert list(rows(lab, "lab")) == ["lab:model.xml + 2", "lab:policy.onnx"]


def test_the_list_for_programs_has_every_file(lab: Home) -> None:
    found = lab.json("assets", "list", "lab")
    assert [each["reference"] for each in found["files"]] == [
        "lab:left foot.stl", "lab:model.xml", "lab:policy.onnx", "lab:right_foot.stl",
    ]  # fmt: skip
    assert found["files"][2] == {
        "reference": "lab:policy.onnx", "where": "not here", "path": str(cache_of(lab) / "lab/policy.onnx"),
        "size_bytes": len(POLICY), "licence": "MIT", "bundle": "lab-policy", "needed_by": "", "problem": "",
    }  # fmt: skip
    assert found["motions"] == []
    assert "builtin:wave" in lab.json("assets", "list")["motions"]


def test_a_file_is_fetched_found_and_already_there(lab: Home) -> None:
    done = lab.run("assets", "fetch", "lab-policy", "--yes")
    path = cache_of(lab) / "lab/policy.onnx"
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"lab-policy: fetched, 1 file into {path.parent}\n"
    assert path.read_bytes() == POLICY
    assert lab.run("assets", "where", "lab:policy.onnx").stdout == f"{path}\n"
    assert rows(lab)["lab:policy.onnx"] == "lab:policy.onnx cache 270.0 kB MIT lab-policy"
    again = lab.run("assets", "fetch", "lab-policy")
    assert (again.returncode, again.stderr) == (0, "")
    assert again.stdout == f"lab-policy: already there, {path}\n"


def test_revision_address_size_hash_and_licence_are_shown_before_anything_is_downloaded(
    lab: Home, server: Server
) -> None:
    done = lab.run("assets", "fetch", "lab-policy")
    assert done.returncode == 2
    shown = [" ".join(line.split()) for line in done.stderr.splitlines()]
    assert shown[:5] == [
        "lab-policy: a policy", f"from lab/robots at {REVISION}", "licence MIT", "download 270.0 kB, 1 of 1 file",
        f"into {cache_of(lab)}/lab",
    ]  # fmt: skip
    assert shown[5].startswith(f"policy.onnx {len(POLICY)} bytes sha256 ")
    assert shown[6] == server.url.format(revision=REVISION, path="upstream/policy.onnx")
    assert shown[7] == (
        "station: assets fetch: there is no terminal to ask in; say --yes to download what is shown above"
    )
    assert server.asked == []


def test_a_dry_run_shows_the_same_and_asks_nothing(lab: Home, server: Server) -> None:
    done = lab.run("assets", "fetch", "lab", "--dry-run")
    assert (done.returncode, done.stderr) == (0, "")
    assert "lab-policy: a policy" in done.stdout
    assert "lab-model: a model with meshes" in done.stdout
    assert server.asked == []


def test_a_person_is_asked_and_no_means_no(lab: Home, server: Server) -> None:
    code, shown = in_terminal(lab, "assets", "fetch", "lab-model", answer="n")
    assert code == 1
    assert "station: nothing was downloaded" in shown
    assert server.asked == []
    code, shown = in_terminal(lab, "assets", "fetch", "lab-model", answer="y")
    assert code == 0, shown
    assert "lab-model: fetched, 3 files into" in shown
    assert (cache_of(lab) / "lab/model.xml").read_bytes() == MODEL


def test_a_damaged_file_is_refused_by_name_listed_and_fetched_again(lab: Home) -> None:
    assert lab.run("assets", "fetch", "lab", "--yes").returncode == 0
    path = cache_of(lab) / "lab/policy.onnx"
    path.write_bytes(POLICY[:-5])
    line = one_line(lab.run("assets", "where", "lab:policy.onnx"))
    assert line == (
        f"{path}: has 269995 bytes, 270000 expected: cut short or damaged; "
        "`station assets fetch lab-policy` gets it again"
    )
    assert rows(lab)["lab:policy.onnx"].endswith("lab-policy has 269995 bytes, 270000 expected")
    path.write_bytes(POLICY[:-1] + b"?")
    assert rows(lab)["lab:policy.onnx"].endswith("lab-policy"), "the size is right"
    assert lab.run("assets", "list", "lab", "--verify").returncode == 1
    assert "has sha256" in rows(lab, "lab", "--verify")["lab:policy.onnx"]
    assert lab.run("assets", "fetch", "lab", "--yes").stdout.startswith("lab-model: already there, ")
    assert lab.run("assets", "list", "lab", "--verify").returncode == 0


def test_a_damaged_mesh_is_named_in_the_row_of_its_model(lab: Home) -> None:
    assert lab.run("assets", "fetch", "lab-model", "--yes").returncode == 0
    mesh = cache_of(lab) / "lab/left foot.stl"
    mesh.write_bytes(b"cut")
    assert rows(lab)["lab:model.xml + 2"].endswith("lab-model lab:left foot.stl has 3 bytes, 200 expected")
    assert one_line(lab.run("assets", "where", "lab:model.xml")).startswith(f"{mesh}: has 3 bytes, 200 expected")
    mesh.unlink()
    assert rows(lab)["lab:model.xml + 2"].endswith("lab-model lab:left foot.stl is not here")


def test_what_comes_wrong_ends_in_a_line_and_leaves_nothing(lab: Home, server: Server) -> None:
    server.faults["upstream/policy.onnx"] = "another"
    done = lab.run("assets", "fetch", "lab-policy", "--yes")
    assert (done.returncode, done.stdout) == (2, "")
    assert "is pinned; it is another file, and nothing of it was kept" in done.stderr.splitlines()[-1]
    assert rows(lab)["lab:policy.onnx"].startswith("lab:policy.onnx not here")


def test_without_a_connection_the_last_line_says_where_to_put_the_file(lab: Home, tmp_path: Path) -> None:
    catalogue = tmp_path / "packages" / "lab.toml"
    text = catalogue.read_text()
    catalogue.write_text(text.replace(text.split('url = "')[1].split("/{")[0], "https://nobody.invalid"))
    done = lab.run("assets", "fetch", "lab-policy", "--yes")
    assert done.returncode == 1
    line = done.stderr.splitlines()[-1]
    assert line.startswith(f"station: https://nobody.invalid/{REVISION}/upstream/policy.onnx: could not be reached (")
    assert line.endswith(f"get it on another machine and put it at {cache_of(lab)}/lab/policy.onnx")
    path = cache_of(lab) / "lab/policy.onnx"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(POLICY)
    assert lab.run("assets", "fetch", "lab-policy").stdout == f"lab-policy: already there, {path}\n"


def test_a_file_of_the_environment_that_hides_what_was_fetched_is_told(lab: Home, tmp_path: Path) -> None:
    own = tmp_path / "environment" / "lab" / "policy.onnx"
    own.parent.mkdir(parents=True)
    own.write_bytes(b"my own")
    lab.environment["STATION_ASSETS"] = str(tmp_path / "environment")
    done = lab.run("assets", "fetch", "lab-policy", "--yes")
    assert done.returncode == 0
    assert done.stderr.splitlines()[-1] == (
        f"! lab:policy.onnx will still not be what was fetched: $STATION_ASSETS comes first and has another file, {own}"
    )
    assert lab.run("assets", "where", "lab:policy.onnx").stdout == f"{own}\n"


def test_where_without_a_reference_shows_the_folders_in_their_order(lab: Home, tmp_path: Path) -> None:
    out = lab.run("assets", "where").stdout
    assert [" ".join(line.split()) for line in out.splitlines()] == [
        "environment ($STATION_ASSETS is not set)", f"cache {cache_of(lab)}",
    ]  # fmt: skip
    lab.environment["STATION_ASSETS"] = str(tmp_path)
    assert f"environment  {tmp_path}\n" in lab.run("assets", "where").stdout


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["fetch"], 2, "Missing argument 'NAME...'"),
        (
            ["fetch", "lab-polcy"],
            2,
            "unknown asset to fetch 'lab-polcy' (did you mean 'lab-policy'?); known: lab-model,",
        ),
        (["fetch", "builtin"], 2, "unknown asset to fetch 'builtin'"),
        (["list", "lob"], 2, "unknown collection 'lob' (did you mean 'lab'?); known: builtin, lab, twist2"),
        (["where", "lab:policy.onnx"], 1, "not on this machine; `station assets fetch lab-policy` gets it (looked in"),
        (["where", "builtin:wave"], 1, "a motion that is made when it is played; it has no file"),
        (["where", "nothing.onnx"], 2, "nothing.onnx: no such file"),
        (["lst"], 2, "unknown `station assets` command 'lst' (did you mean 'list'?); known: fetch, list, where"),
    ],
)
def test_a_mistake_is_one_line(lab: Home, arguments: list[str], code: int, told: str) -> None:
    done = lab.run("assets", *arguments)
    assert told in one_line(done)
    assert done.returncode == code
