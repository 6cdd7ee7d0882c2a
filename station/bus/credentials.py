"""Who we are on a protected bus: names and passwords from the environment or from a file that only we can read.

Nothing here is ever an argument of a process, a line of a log or a part of an episode. The file has one line
``user password`` for each user that its owner may be; ``station bus acl --passwords FILE`` writes one, and a bus that
`station bus start` opens to the network leaves one beside its socket. A file with a single word holds the password of
the server's default user.
"""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from station.bus.address import PASSWORD_FILE_VARIABLE, USER_VARIABLE, BusAddress
from station.errors import ConfigError

_MOST_BYTES = 1 << 16


def for_role(address: BusAddress, role: str) -> BusAddress:
    """Return the address with the user of a role, where a file of passwords has one; else as it is.

    So a server that a supervisor starts logs in as what it is, not as its supervisor. A user that the environment
    names is meant, and stays.
    """
    file = None if os.environ.get(USER_VARIABLE) else os.environ.get(PASSWORD_FILE_VARIABLE)
    password = read_file(Path(file)).get(role) if file else None
    return address if password is None else msgspec.structs.replace(address, username=role, password=password)


def read_file(path: Path) -> dict[str, str]:
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


def write_file(path: Path, passwords: dict[str, str]) -> None:
    """Write a file that only this user can read, in place of an older one.

    Raises:
        ConfigError: the file cannot be written.
    """
    text = "".join(f"{user} {password}".strip() + "\n" for user, password in passwords.items())
    try:
        path.unlink(missing_ok=True)  # one that others have open, or may read, must not get the new ones
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(text)
    except OSError as error:
        raise ConfigError(f"password file {path}: cannot be written: {error.strerror}") from None
