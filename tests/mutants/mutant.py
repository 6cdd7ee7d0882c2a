"""One wrong patch, as it stands in the YAML files beside this module, and where it fits."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from station import safe_yaml

LINT_IMPORTS = "lint-imports"


class Mutant(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A small wrong patch of the product and the tests that must fail with it.

    Attributes:
        name: Short and unique, for `--only`.
        why: What would go wrong with a robot or its data if this were shipped.
        file: Path from the root of the repository.
        old: Text that stands exactly once in the file.
        new: What stands there instead.
        caught_by: Arguments of pytest (files or node ids, the sharpest that notice), or `lint-imports` alone.
    """

    name: str
    why: str
    file: str
    old: str
    new: str
    caught_by: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.old == self.new:
            raise ValueError(f"mutant {self.name!r} changes nothing: old and new are the same text")
        if not self.caught_by or (LINT_IMPORTS in self.caught_by and len(self.caught_by) > 1):
            raise ValueError(f"mutant {self.name!r}: caught_by names tests, or {LINT_IMPORTS} alone")

    def why_stale(self, root: Path) -> str | None:
        """Return one line that says why the patch does not fit the tree at `root`, None where it fits."""
        try:
            found = (root / self.file).read_text(encoding="utf-8").count(self.old)
        except FileNotFoundError:
            return f"there is no {self.file}; say where its code is now"
        if found == 1:
            return None
        return f"its old text stands {found} times in {self.file}, not once; take it from the code of today"

    def apply(self, root: Path) -> None:
        """Patch the tree at `root`, in a new file: the old one may be shared with other trees by a hard link."""
        path = root / self.file
        text = path.read_text(encoding="utf-8").replace(self.old, self.new)
        before = path.stat()
        path.unlink()
        path.write_text(text, encoding="utf-8")
        path.chmod(before.st_mode)
        # Python takes a compiled file for today's where the source has its length and its second: give it another one.
        os.utime(path, (before.st_atime, before.st_mtime + 2.0))


def load(folder: Path) -> list[Mutant]:
    """Read every mutant of the YAML files in a folder, by file and in their order.

    Raises:
        ValueError: one of them is wrong, or two have one name; the message names the file.
    """
    mutants: dict[str, Mutant] = {}
    for path in sorted(folder.glob("*.yaml")):
        try:
            listed = msgspec.convert(safe_yaml.load(path.read_text(encoding="utf-8")), list[Mutant])
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        for mutant in listed:
            if mutant.name in mutants:
                raise ValueError(f"{path}: there are two mutants {mutant.name!r}; a name is unique")
            mutants[mutant.name] = mutant
    return list(mutants.values())
