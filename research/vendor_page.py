"""Fetches the libraries of the console's page, bundles them, and writes their hashes: `python -m research.vendor_page`.

Needs npm. The page itself needs neither npm nor a build: what this writes is committed. Run it when a library's version
here changes; `station/web/page/vendor/HASHES.json` says what was fetched, and a test compares it with the files.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import tempfile
from pathlib import Path

THREE, UPLOT, ESBUILD, AXE = "0.187.0", "1.6.32", "0.28.2", "4.14.1"
_ROOT = Path(__file__).resolve().parent.parent
PAGE_VENDOR, TEST_VENDOR = _ROOT / "station" / "web" / "page" / "vendor", _ROOT / "tests" / "web" / "vendor"

# fmt: off
USED_OF_THREE = (
    "BoxGeometry", "BufferAttribute", "BufferGeometry", "CapsuleGeometry", "Color", "CylinderGeometry",
    "DirectionalLight", "DynamicDrawUsage", "Group", "HemisphereLight", "Matrix4", "Mesh", "MeshBasicMaterial",
    "MeshStandardMaterial", "NeutralToneMapping", "PCFShadowMap", "PerspectiveCamera", "PlaneGeometry", "Quaternion",
    "RingGeometry", "Scene", "ShaderMaterial", "ShadowMaterial", "SphereGeometry", "Vector3", "WebGLRenderer",
)
# fmt: on
"""Only these leave the bundle, so that a bundler drops most of the rest."""


def main() -> None:
    """Write both `vendor` folders anew."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        packages = [f"three@{THREE}", f"uplot@{UPLOT}", f"esbuild@{ESBUILD}", f"axe-core@{AXE}"]
        _run(work, "npm", "install", "--silent", "--no-audit", "--no-fund", *packages)
        modules = work / "node_modules"
        entry = work / "three_used.js"
        entry.write_text(
            f"export {{ {', '.join(USED_OF_THREE)} }} from 'three';\n"
            "export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';\n"
            "export { mergeGeometries } from 'three/examples/jsm/utils/BufferGeometryUtils.js';\n"
        )
        for vendor in (PAGE_VENDOR, TEST_VENDOR):
            shutil.rmtree(vendor, ignore_errors=True)
            vendor.mkdir(parents=True)
        _run(
            work, "node_modules/.bin/esbuild", str(entry), "--bundle", "--minify", "--format=esm", "--target=es2022",
            "--legal-comments=inline", f"--outfile={PAGE_VENDOR / 'three.js'}",
        )  # fmt: skip
        shutil.copy(modules / "three" / "LICENSE", PAGE_VENDOR / "three.LICENSE")
        shutil.copy(modules / "uplot" / "dist" / "uPlot.esm.js", work / "uplot.js")
        _run(
            work, "node_modules/.bin/esbuild", "uplot.js", "--minify", "--format=esm", "--target=es2022",
            "--legal-comments=inline", f"--outfile={PAGE_VENDOR / 'uplot.js'}",
        )  # fmt: skip
        shutil.copy(modules / "uplot" / "dist" / "uPlot.min.css", PAGE_VENDOR / "uplot.css")
        shutil.copy(modules / "uplot" / "LICENSE", PAGE_VENDOR / "uplot.LICENSE")
        shutil.copy(modules / "axe-core" / "axe.min.js", TEST_VENDOR / "axe.min.js")
        shutil.copy(modules / "axe-core" / "LICENSE", TEST_VENDOR / "axe.LICENSE")
    _write_hashes(PAGE_VENDOR, {"three": (THREE, "MIT"), "uplot": (UPLOT, "MIT")})
    _write_hashes(TEST_VENDOR, {"axe": (AXE, "MPL-2.0")})


def _write_hashes(vendor: Path, libraries: dict[str, tuple[str, str]]) -> None:
    npm_names = {"axe": "axe-core"}
    facts = {}
    for path in sorted(vendor.iterdir()):
        library = path.name.split(".")[0]
        version, licence = libraries[library]
        name = npm_names.get(library, library)
        facts[path.name] = {
            "name": name,
            "version": version,
            "licence": licence,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "source": f"npm {name}@{version}",
        }
    (vendor / "HASHES.json").write_text(json.dumps(facts, indent=2) + "\n")


def _run(folder: Path, *command: str) -> None:
    subprocess.run(command, cwd=folder, check=True, timeout=300)


if __name__ == "__main__":
    main()
