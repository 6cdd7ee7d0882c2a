"""Somebody who types what a page of the docs says, in its order, and compares what it shows with what comes."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from tests.cli.running import Home
from tests.cli.screen import screen
from tests.docs.page import Shown, Stale, compared, page_picture, pictures_of, shown, unlike
from tests.waiting import wait_until

_LONGEST_S = 600.0
_QUALITY = 80  # of a page's JPEG
_INTERRUPT, _ECHO = b"\x03", "^C"
_PLACES = {"bus": "/run/user/1000/station", "data": "/lab/data", "home": "/home/ada", "cache": "/home/ada/.cache"}
"""As pages show them."""


@dataclass(frozen=True)
class Typed:
    """How a command of a page is typed.

    Attributes:
        instead: Another command, where the page's own needs a person, a device or another machine.
        elsewhere: Why it is not typed here; where it is.
        until: It goes on in the background once it has said this, until the end of the page.
        behind: Begins with this: a command in the background, which has to end by itself before.
        code: Exit code.
    """

    instead: str = ""
    elsewhere: str = ""
    until: str = ""
    behind: str = ""
    code: int = 0


class Reader:
    """Types the commands of pages in one folder, as a plain user with a home of his own.

    Args:
        home: What lives there.
        folder: His; packages in its `site` are installed.
        inside: The folder below it that he is in.
    """

    def __init__(self, home: Home, folder: Path, inside: str) -> None:
        self._folder = folder / inside
        home.data.mkdir()
        self._environment = home.environment | {
            "HOME": str(folder), "PYTHONPATH": str(folder / "site"), "COLUMNS": "120", "LINES": "50",
            "TERM": "xterm-256color", "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        }  # fmt: skip
        for display in ("DISPLAY", "WAYLAND_DISPLAY"):
            self._environment.pop(display, None)
        own = {"bus": str(Path(home.environment["XDG_RUNTIME_DIR"]) / "station"), "data": str(home.data),
               "home": str(folder), "cache": home.environment["XDG_CACHE_HOME"]}  # fmt: skip
        self._places = {place: _PLACES[name] for name, place in own.items()}

    def read(self, page: Path, how: Mapping[str, Typed], *, refresh: bool) -> int:
        """Type all commands of a page; return how many they were.

        Args:
            page: The page.
            how: Commands that are not simply typed, by how they begin.
            refresh: Write the values and the pictures of this run into the page.

        Raises:
            Stale: the page shows what they do not say.
            AssertionError: a command failed.
        """
        lines, unused = page.read_text(encoding="utf-8").splitlines(), set(how)
        running, stale, count = list[_Typing](), list[str](), 0

        def end(typing: _Typing) -> None:
            stale.extend(self._compare(typing, lines))
            running.remove(typing)

        try:
            for command in shown(page):
                begin = max((known for known in how if command.command.startswith(known)), key=len, default="")
                typed = how.get(begin, Typed())
                unused.discard(begin)
                if typed.elsewhere:
                    continue
                if typed.behind:
                    end(next(each for each in running if each.shown.command.startswith(typed.behind)))
                count += 1
                running.append(typing := _Typing(command, typed, self._environment, self._folder))
                if typed.until:
                    typing.wait_for(typed.until)
                else:
                    end(typing)
            while running:
                running[-1].interrupt()
                end(running[-1])
        finally:
            for typing in running:
                typing.kill()
        assert not unused, f"{page.name} has no command that begins with {sorted(unused)}"
        pictures = {picture: Image.open(self._folder / f"{picture.stem}.png") for picture in pictures_of(page)}
        if not refresh:
            stale += [f"{path.name}: {why}" for path, made in pictures.items() if (why := unlike(made, path))]
        if stale:
            raise Stale("\n\n".join(stale))
        if refresh:
            for path, made in pictures.items():
                page_picture(made).save(path, quality=_QUALITY, optimize=True)
            page.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return count

    def _compare(self, typing: _Typing, lines: list[str]) -> list[str]:
        """Wait for the end of a command, and put what it said into the lines of the page; return what is stale."""
        said = typing.finish()
        for place, name in self._places.items():
            said = said.replace(place, name)
        command, (stays, drawn) = typing.shown, screen(said)
        assert "Traceback" not in said, f"{command.command}:\n{said}"
        if any(line.strip() for line in command.told):
            try:
                fresh = compared(command.told, stays, drawn)
            except Stale as error:
                return [f"{command.command}: {error}"]
            lines[command.at : command.at + len(fresh)] = fresh
        return []


class _Typing:
    """A command that runs."""

    def __init__(self, shown: Shown, typed: Typed, environment: Mapping[str, str], folder: Path) -> None:
        self.shown, self._typed, self._said = shown, typed, ""
        command = typed.instead or shown.command
        self._process = subprocess.Popen(
            ["script", "-qfec", command, "/dev/null"], cwd=folder, env=environment, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        self._was_interrupted = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def wait_for(self, text: str) -> None:
        with contextlib.suppress(AssertionError):  # told with what it said
            wait_until(lambda: text in self._said or self._process.poll() is not None)
        assert text in self._said, f"{self.shown.command}: no {text!r} in:\n{self._said}"

    def interrupt(self) -> None:
        """Press Ctrl-C, if it still runs."""
        if self._process.poll() is None:
            self._was_interrupted = True
            self._type(_INTERRUPT)

    def finish(self) -> str:
        """Wait for its end; return all that it wrote."""
        code = self._process.wait(_LONGEST_S)
        self._reader.join()
        if self._process.stdin is not None:
            self._process.stdin.close()
        expected = {self._typed.code, 130} if self._was_interrupted else {self._typed.code}
        self._said = self._said.replace(_ECHO, "")
        assert code in expected, f"{self.shown.command} ended with {code}:\n{self._said}"
        return self._said

    def kill(self) -> None:
        self._process.kill()  # its terminal goes with it
        self._process.wait()

    def _type(self, keys: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(keys)
        self._process.stdin.flush()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with io.TextIOWrapper(self._process.stdout, encoding="utf-8", errors="replace", newline="") as stream:
            for line in stream:  # as it is written: a terminal goes back to the beginning of a line
                self._said += line
