"""A file of passwords that only its owner can read; nothing in it ever stands in an argument, a log or an episode.

One line ``user password`` for each user that its owner may be; ``station bus acl --passwords FILE`` writes one, and a
bus that `station bus start` opens to the network leaves one beside its socket. A file with a single word holds the
password of the server's default user.
"""

from __future__ import annotations

import os
from pathlib import Path

from station.atomic_file import write_atomic
from station.errors import ConfigError

_MOST_BYTES = 1 << 16


def beside(socket: Path) -> Path:
    """Return where a server of ours leaves the password that it asks for."""
    return socket.with_suffix(".password")


def read(path: Path) -> dict[str, str]:
    """Return passwords by user; the server's default user has the name "".

    Raises:
        ConfigError: the file cannot be read, others can read it too, or a line is no user and password.
    """
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            text = file.read(_MOST_BYTES + 1).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"password file {path}: cannot be read: {getattr(error, 'strerror', 'not text')}") from None
    if status.st_mode & 0o077:
        raise ConfigError(f"password file {path}: others can read it (mode {status.st_mode & 0o777:04o}); chmod 600 it")
    found: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if len(words) > 2:
            raise ConfigError(f"password file {path}, line {number}: expected `user password`")
        if words:
            found[words[0] if len(words) == 2 else ""] = words[-1]
    return found


def write(path: Path, passwords: dict[str, str]) -> None:
    """Write a file that only this user can read, in place of an older one: who has that one open gets nothing new.

    Raises:
        ConfigError: the file cannot be written.
    """
    text = "".join(f"{user} {password}".strip() + "\n" for user, password in passwords.items())
    try:
        write_atomic(path, text.encode(), mode=0o600)
    except OSError as error:
        raise ConfigError(f"password file {path}: cannot be written: {error.strerror}") from None
