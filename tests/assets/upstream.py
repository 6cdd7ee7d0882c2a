"""An upstream of a test: a real HTTP server on this machine, files that it serves, and what can go wrong with them."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Literal
from urllib.parse import unquote

from station.assets import Bundle, Collection, PinnedFile, Upstream

REVISION = "0123456789abcdef0123456789abcdef01234567"
POLICY = b"a policy " * 30_000
MODEL = b"<mujoco/>"
MESHES = {"left foot.stl": b"left" * 50, "right_foot.stl": b"right" * 50}

Fault = Literal["another", "longer", "cut", "cut without a length", "stalls", "missing"]


class Server:
    """Serves files below ``/REVISION/``; `faults` says what is wrong with which."""

    def __init__(self, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}/{{revision}}/{{path}}"
        self.files: dict[str, bytes] = {"upstream/policy.onnx": POLICY, "upstream/model.xml": MODEL}
        self.files |= {f"upstream/{name}": content for name, content in MESHES.items()}
        self.faults: dict[str, Fault] = {}
        self.asked: list[str] = []
        self.released = threading.Event()

    def collection(self) -> Collection:
        """The catalogue of what is served, as it should be."""
        policy = Bundle(name="lab-policy", about="a policy", licence="MIT", files=(pinned("policy.onnx", POLICY),))
        model = Bundle(
            name="lab-model", about="a model with meshes", licence="BSD-3-Clause", last_needs_all=True,
            files=(*(pinned(name, content) for name, content in MESHES.items()), pinned("model.xml", MODEL)),
        )  # fmt: skip
        upstream = Upstream(repository="lab/robots", revision=REVISION, url=self.url)
        return Collection(about="files of the lab", upstream=upstream, bundles=(policy, model))


def pinned(name: str, content: bytes) -> PinnedFile:
    return PinnedFile(
        path=name, upstream=f"upstream/{name}", size_bytes=len(content), sha256=hashlib.sha256(content).hexdigest()
    )


@contextmanager
def serving() -> Iterator[Server]:
    """Run a server in a thread of its own."""
    http = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    http.daemon_threads = True
    server = Server(http.server_port)
    http.upstream = server  # type: ignore[attr-defined]
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.released.set()
        http.shutdown()
        thread.join()
        http.server_close()


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        upstream: Server = self.server.upstream  # type: ignore[attr-defined]
        path = unquote(self.path)
        upstream.asked.append(path)
        name = path.removeprefix(f"/{REVISION}/")
        fault, content = upstream.faults.get(name), upstream.files.get(name)
        if content is None or fault == "missing":
            self.send_error(404)
            return
        if fault == "another":
            content = content[:-1] + b"?"
        if fault == "longer":
            content += b"and more"
        self.send_response(200)
        if fault != "cut without a length":
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        half = len(content) // 2
        self.wfile.write(content[:half])
        self.wfile.flush()
        if fault == "stalls":
            upstream.released.wait()
        if fault not in ("cut", "cut without a length", "stalls"):
            self.wfile.write(content[half:])

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


def install_lab(folder: Path, server: Server) -> None:
    """Write a package that registers the collection ``lab``, as somebody else's package does, into a folder."""
    collection = server.collection()
    assert collection.upstream is not None
    lines = [
        f'about = "{collection.about}"', "[upstream]",
        'repository = "lab/robots"', f'revision = "{REVISION}"', f'url = "{server.url}"',
    ]  # fmt: skip
    for bundle in collection.bundles:
        lines += [
            "[[bundles]]", f'name = "{bundle.name}"', f'about = "{bundle.about}"', f'licence = "{bundle.licence}"',
            'folder = "."', 'upstream_folder = "upstream"', f"last_needs_all = {str(bundle.last_needs_all).lower()}",
            "files = [", *(f'["{file.path}", {file.size_bytes}, "{file.sha256}"],' for file in bundle.files), "]",
        ]  # fmt: skip
    (folder / "lab.toml").write_text("\n".join(lines))
    (folder / "lab_files.py").write_text(
        "from pathlib import Path\nfrom station.assets import read_collection\n"
        "COLLECTION = read_collection(Path(__file__).with_name('lab.toml'))\n"
    )
    facts = folder / "lab_files-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-files\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[station.assets]\nlab = lab_files:COLLECTION\n")
