"""The catalogue that is shipped: pinned, encrypted on its way, and true of the files that it was made from."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from adapters.catalogue import builtin, twist2
from adapters.motions.load import load
from station import registry
from station.assets import Bundle, Collection

SHIPPED = [builtin.COLLECTION, twist2.COLLECTION]


def bundle(name: str) -> Bundle:
    (found,) = [each for each in twist2.COLLECTION.bundles if each.name == name]
    return found


def test_the_shipped_collections_are_registered() -> None:
    assert registry.find("asset", "builtin") is builtin.COLLECTION
    assert registry.find("asset", "twist2") is twist2.COLLECTION


@pytest.mark.parametrize("collection", [each for each in SHIPPED if each.upstream])
def test_every_address_is_encrypted_and_names_a_whole_commit(collection: Collection) -> None:
    assert collection.upstream is not None
    assert re.fullmatch("[0-9a-f]{40}", collection.upstream.revision)
    for each in collection.bundles:
        assert each.licence
        for file in each.files:
            address = collection.upstream.url_of(file)
            assert address.startswith("https://raw.githubusercontent.com/")
            assert f"/{collection.upstream.repository}/{collection.upstream.revision}/" in address


def test_no_two_files_of_a_collection_have_one_name() -> None:
    paths = [file.path for each in twist2.COLLECTION.bundles for file in each.files]
    assert len(paths) == len(set(paths))


def test_what_is_built_in_is_there() -> None:
    assert all(path.is_file() for path in builtin.COLLECTION.built_in.values())
    assert {Path(name).suffix for name in builtin.COLLECTION.built_in} <= {".xml", ".onnx", ".json", ".yaml"}


def test_every_motion_that_is_listed_can_be_loaded() -> None:
    names = builtin.COLLECTION.motions()
    assert "wave" in names
    assert load(f"builtin:{names[0]}").duration_s > 0
    assert not set(names) & set(builtin.COLLECTION.built_in)


@pytest.mark.assets
def test_upstream_data_is_what_the_catalogue_pins(assets: Path) -> None:
    problems = {
        file.path: file.problem(assets / "twist2" / file.path)
        for each in twist2.COLLECTION.bundles
        for file in each.files
    }
    assert {path: problem for path, problem in problems.items() if problem} == {}


@pytest.mark.assets
def test_the_model_comes_last_and_with_every_mesh_that_it_names(assets: Path) -> None:
    files = bundle("twist2-model").files
    model = ElementTree.parse(assets / "twist2" / files[-1].path).getroot()
    named = {f"g1/meshes/{mesh.get('file')}" for mesh in model.iter("mesh") if mesh.get("file")}
    assert {file.path for file in files[:-1]} == named
    assert bundle("twist2-model").last_needs_all
