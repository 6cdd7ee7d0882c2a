"""What we give to the kernel has the layout and the numbers that its own header says."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

from adapters.cameras import v4l2_calls as calls

pytestmark = pytest.mark.usefixtures("processes")

STRUCTURES = {
    "v4l2_capability": calls.Capability,
    "v4l2_fmtdesc": calls.FormatDescription,
    "v4l2_frmsizeenum": calls.SizeDescription,
    "v4l2_frmivalenum": calls.IntervalDescription,
    "v4l2_pix_format": calls.PixelFormat,
    "v4l2_format": calls.Format,
    "v4l2_streamparm": calls.Parameters,
    "v4l2_requestbuffers": calls.BufferRequest,
    "v4l2_buffer": calls.Buffer,
    "v4l2_control": calls.Control,
}
OTHER_NAMES = {"range": "stepwise", "least": "stepwise.min", "most": "stepwise.max", "step": "stepwise.step"}
OURS_ALONE = ("rest", "alignment")
NUMBERS = [name for name in vars(calls) if name.isupper()]


class Place(NamedTuple):
    """A field within a structure: its path as we name it and as the header does, where it begins, and its size."""

    ours: str
    theirs: str
    offset: int
    size: int


def places(kind: type[ctypes.Structure | ctypes.Union], before: Place) -> Iterator[Place]:
    """Yield the fields of a structure, and of those within it."""
    for name, inner, *_ in kind._fields_:
        if name not in OURS_ALONE:
            theirs = OTHER_NAMES.get(name, name)
            offset = before.offset + getattr(kind, name).offset
            here = Place(f"{before.ours}.{name}", f"{before.theirs}.{theirs}", offset, ctypes.sizeof(inner))
            yield here
            if issubclass(inner, (ctypes.Structure, ctypes.Union)):
                yield from places(inner, here)


def said_by_the_header(folder: Path, asked: Mapping[str, str]) -> list[str]:
    """Compile expressions against the kernel's header; return a line with name and value of each."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not Path("/usr/include/linux/videodev2.h").exists():
        pytest.skip("no C compiler, or no header of the kernel's")
    lines = [f'printf("{name} %lu\\n", (unsigned long)({value}));' for name, value in asked.items()]
    source, program = folder / "said.c", folder / "said"
    heads = [f"#include <{name}>" for name in ("linux/videodev2.h", "stddef.h", "stdio.h")]
    source.write_text("\n".join([*heads, "int main(void) {", *lines, "return 0; }"]))
    subprocess.run([compiler, "-o", str(program), str(source)], check=True)
    return subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.splitlines()


def test_structures_and_numbers_are_those_of_the_kernels_header(tmp_path: Path) -> None:
    asked = {name: f"VIDIOC_{name}" for name in NUMBERS}
    ours = {name: getattr(calls, name) for name in NUMBERS}
    for name, kind in STRUCTURES.items():
        asked[name], ours[name] = f"sizeof(struct {name})", ctypes.sizeof(kind)
        for field in places(kind, Place(name, "", 0, 0)):
            path = field.theirs.removeprefix(".")
            asked[f"{field.ours} at"], ours[f"{field.ours} at"] = f"offsetof(struct {name}, {path})", field.offset
            asked[f"{field.ours} of"], ours[f"{field.ours} of"] = f"sizeof(((struct {name} *)0)->{path})", field.size
    assert [f"{name} {value}" for name, value in ours.items()] == said_by_the_header(tmp_path, asked)
    assert len(NUMBERS) == 13
