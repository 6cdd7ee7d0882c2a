"""Every error of this package, in one tree.

    KordError               something in the world is not as needed
    ├── NotConnected        no session: not connected yet, lost, or closed
    ├── Refused             a command that cannot be taken now: not engaged, faulted, moving, another mode
    │   └── OutOfLimits     a command that no arm of this kind may follow; says which joint, by how much
    └── BadOption           a value that fits no session; also a ValueError

A message is one line: what was wrong, what was expected, what came, what to do.
"""

from __future__ import annotations


class KordError(Exception):
    """Base of all errors of this package."""


class NotConnected(KordError):
    """There is no session with a controller."""


class Refused(KordError):
    """A command that cannot be taken in the state that the arm is in."""


class OutOfLimits(Refused):
    """A joint position or velocity beyond its limit."""


class BadOption(KordError, ValueError):
    """An option, limit or profile that fits no session."""
