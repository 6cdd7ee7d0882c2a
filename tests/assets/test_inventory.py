"""The inventory knows every file, where it would be found, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.assets.inventory import Item, inventory, motions
from station.errors import AssetMissing, UnknownName
from tests.assets.test_places import BUILT_IN, WALK, WALK_BYTES, put


def item(reference: str, *, verify: bool = False) -> Item:
    (found,) = [each for each in inventory(verify=verify) if each.reference == reference]
    return found


def test_every_file_has_the_place_where_it_is_found(environment: Path, cache: Path) -> None:
    assert item(WALK).where == "not here"
    assert item(WALK).path == cache / WALK.replace(":", "/")
    assert item(WALK).size_bytes == WALK_BYTES
    in_cache = put(cache, WALK, bytes(WALK_BYTES))
    assert (item(WALK).where, item(WALK).path) == ("cache", in_cache)
    in_environment = put(environment, WALK, b"my own walk")
    assert (item(WALK).where, item(WALK).path) == ("environment", in_environment)
    assert item(WALK).problem == f"has 11 bytes, {WALK_BYTES} expected"
    assert (item(WALK).licence, item(WALK).bundle) == ("MIT", "twist2-motions")


@pytest.mark.usefixtures("cache")
def test_what_is_built_in_is_listed_and_so_are_motions_without_a_file() -> None:
    built_in = {each.reference: each for each in inventory("builtin")}
    assert sorted(built_in) == [f"builtin:{name}" for name in BUILT_IN]
    assert {(each.where, each.licence) for each in built_in.values()} == {("built in", "Apache-2.0")}
    assert "builtin:wave" in motions()


def test_files_that_nobody_registered_are_listed_and_hidden_ones_are_not(environment: Path, cache: Path) -> None:
    put(environment, "ours:deep/x.onnx", b"12345")
    put(environment, "ours:.git")
    put(cache, ".partial:tmp123")
    found = [each for each in inventory() if each.where in ("environment", "cache")]
    assert [(each.reference, each.size_bytes, each.licence) for each in found] == [("ours:deep/x.onnx", 5, "")]


def test_a_whole_comparison_finds_what_the_size_does_not_tell(cache: Path) -> None:
    put(cache, WALK, bytes(WALK_BYTES))
    assert item(WALK).problem == ""
    assert "has sha256 " in item(WALK, verify=True).problem


@pytest.mark.usefixtures("cache")
def test_meshes_are_told_as_what_the_model_needs() -> None:
    assert item("twist2:g1/meshes/pelvis.STL").needed_by == "twist2:g1/g1_sim2sim_29dof.xml"
    assert item("twist2:g1/g1_sim2sim_29dof.xml").needed_by == ""


def test_a_wrong_name_and_a_wrong_environment_are_told(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnknownName, match=r"unknown collection 'twist' \(did you mean 'twist2'\?\)"):
        inventory("twist")
    monkeypatch.setenv("STATION_ASSETS", "/nowhere")
    with pytest.raises(AssetMissing, match="names /nowhere, which is not a folder"):
        inventory()
