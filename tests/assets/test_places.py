"""A reference is looked for as a path, below ``$STATION_ASSETS``, in the cache, and in the program, in this order."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.catalogue import builtin
from station import assets
from station.errors import AssetMissing, BadFile

WALK = "twist2:motions/0807_yanjie_walk_001.pkl"
WALK_BYTES = 310_717
BUILT_IN = sorted(builtin.COLLECTION.built_in)


def put(folder: Path, reference: str, content: bytes = b"x") -> Path:
    path = folder / reference.replace(":", "/")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def message(reference: str) -> str:
    with pytest.raises((AssetMissing, BadFile)) as caught:
        assets.resolve(reference)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_path_is_itself_whatever_the_places_hold(environment: Path, tmp_path: Path) -> None:
    put(environment, "twist2:walk.pkl")
    plain = put(tmp_path, "walk.pkl")
    assert assets.find(plain) == (plain, "path")


def test_a_path_that_is_missing_suggests_its_neighbour(tmp_path: Path) -> None:
    put(tmp_path, "walk.pkl")
    with pytest.raises(BadFile, match=r"no such file \(did you mean 'walk.pkl'\?\)"):
        assets.resolve(tmp_path / "wlak.pkl")
    with pytest.raises(BadFile, match="there is no folder"):
        assets.resolve(tmp_path / "nowhere" / "walk.pkl")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadFile, match=r"empty/walk.pkl: no such file$"):
        assets.resolve(tmp_path / "empty" / "walk.pkl")


def test_the_environment_comes_before_the_cache_and_the_cache_before_the_program(
    environment: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = f"builtin:{BUILT_IN[0]}"
    in_environment, in_cache = put(environment, reference), put(cache, reference)
    assert assets.find(reference) == (in_environment, "environment")
    in_environment.unlink()
    assert assets.find(reference) == (in_cache, "cache")
    in_cache.unlink()
    assert assets.find(reference) == (builtin.COLLECTION.built_in[BUILT_IN[0]], "built in")
    monkeypatch.delenv("STATION_ASSETS")
    assert assets.find(reference).place == "built in"


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("name", BUILT_IN)
def test_what_is_built_in_needs_no_environment(name: str) -> None:
    assert assets.resolve(f"builtin:{name}").is_file()


def test_collections_that_nobody_registered_are_folders_of_the_environment(environment: Path) -> None:
    path = put(environment, "ours:deep/in/it.onnx")
    assert assets.resolve("ours:deep/in/it.onnx") == path


def test_a_file_that_can_be_fetched_is_told_with_how_and_where_it_was_looked_for(cache: Path) -> None:
    assert message(WALK) == (
        f"{WALK}: not on this machine; `station assets fetch twist2-motions` gets it "
        f"(looked in {cache}/twist2; $STATION_ASSETS is not set)"
    )


def test_a_file_that_nobody_knows_is_told_with_where_it_was_looked_for(environment: Path, cache: Path) -> None:
    put(environment, "ours:policy_1.onnx")
    assert message("ours:policy_2.onnx") == (
        "ours:policy_2.onnx: no such file (did you mean 'policy_1.onnx'?); `station assets list` shows what there is "
        f"(looked in {environment}/ours and {cache}/ours)"
    )


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize(
    ("reference", "told"),
    [
        ("twst2:motions/x.pkl", "no collection 'twst2' (did you mean 'twist2'?)"),
        ("twist2:ckpt/twist2_1017_20k.onnx", "(did you mean 'ckpts/twist2_1017_20k.onnx'?)"),
        ("twist2:motions/0807_yanjie_walk_01.pkl", "(did you mean 'motions/0807_yanjie_walk_001.pkl'?)"),
        ("twist2:pelvis.STL", "no such file"),
        ("builtin:nothing.xml", "and the program; $STATION_ASSETS is not set)"),
        ("builtin:wave", "a motion that is made when it is played; it has no file"),
        ("twist2:../secret", "leaves its collection; expected twist2:PATH/BELOW, or a plain path"),
        ("twist2:/etc/passwd", "leaves its collection"),
    ],
)
def test_a_reference_that_leads_nowhere(reference: str, told: str) -> None:
    assert told in message(reference)


def test_an_environment_that_is_no_folder_is_refused_even_when_the_cache_has_the_file(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(cache, "ours:x.onnx")
    monkeypatch.setenv("STATION_ASSETS", "/nowhere")
    assert "$STATION_ASSETS names /nowhere, which is not a folder" in message("ours:x.onnx")


def test_a_cached_file_of_the_wrong_size_is_refused_by_name(cache: Path) -> None:
    path = put(cache, WALK, bytes(100))
    assert message(WALK) == (
        f"{path}: has 100 bytes, {WALK_BYTES} expected: cut short or damaged; "
        "`station assets fetch twist2-motions` gets it again"
    )
    put(cache, WALK, bytes(WALK_BYTES))
    assert assets.resolve(WALK) == path, "its hash is looked at when it is fetched, and by list --verify"


def test_a_cached_model_without_its_meshes_is_refused_by_the_name_of_the_first(cache: Path) -> None:
    put(cache, "twist2:g1/g1_sim2sim_29dof.xml", bytes(27_123))
    assert message("twist2:g1/g1_sim2sim_29dof.xml").startswith(f"{cache}/twist2/g1/meshes/head_link.STL: is not there")


def test_a_users_own_file_may_differ_from_the_pinned_one(environment: Path) -> None:
    path = put(environment, WALK, b"my own walk")
    assert assets.resolve(WALK) == path


def test_a_pattern_gathers_the_files_of_all_places_and_the_first_place_wins(environment: Path, cache: Path) -> None:
    both = put(environment, "ours:m/b.pkl"), put(environment, "ours:m/c.csv")
    put(cache, "ours:m/b.pkl")
    only = put(cache, "ours:m/a.pkl")
    assert assets.expand("ours:m/*.pkl") == [only, both[0]]
    assert assets.references("ours:m/*") == ["ours:m/a.pkl", "ours:m/b.pkl", "ours:m/c.csv"]


@pytest.mark.usefixtures("cache")
def test_a_pattern_finds_what_is_built_in() -> None:
    suffix = Path(BUILT_IN[0]).suffix
    names = [name for name in BUILT_IN if name.endswith(suffix)]
    assert assets.references(f"builtin:*{suffix}") == [f"builtin:{name}" for name in names]


def test_a_pattern_of_paths_and_no_pattern_at_all(tmp_path: Path) -> None:
    paths = [put(tmp_path, name) for name in ("a.pkl", "b.pkl")]
    assert assets.expand(f"{tmp_path}/*.pkl") == paths
    assert assets.expand(str(paths[1])) == [paths[1]]
    assert assets.references("twist2:not/looked/for.pkl") == ["twist2:not/looked/for.pkl"]


@pytest.mark.usefixtures("cache")
def test_a_pattern_that_matches_nothing_says_what_to_fetch(tmp_path: Path) -> None:
    with pytest.raises(AssetMissing, match=r"walk_\*\.pkl: not on this machine; `station assets fetch twist2-motions`"):
        assets.expand("twist2:motions/0807_yanjie_walk_*.pkl")
    with pytest.raises(AssetMissing, match=r"twist2:\*\.bvh: no such file"):
        assets.expand("twist2:*.bvh")
    with pytest.raises(BadFile, match="no file matches"):
        assets.expand(f"{tmp_path}/*.pkl")


def test_a_damaged_file_among_those_of_a_pattern_is_refused_by_name(cache: Path) -> None:
    path = put(cache, WALK, b"cut")
    with pytest.raises(BadFile, match=f"{path}: has 3 bytes"):
        assets.expand("twist2:motions/*.pkl")
