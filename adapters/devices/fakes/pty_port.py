"""A serial port that can be plugged in and torn out: a pseudo terminal under a name as udev gives it."""

from __future__ import annotations

import os
import threading
import tty
from pathlib import Path


class PtyPort:
    """The port; whoever plays a device writes to it, and reads from it, with its lock held.

    Args:
        path: Its name, which is a link to the pseudo terminal while it is plugged in.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._master, self._slave = -1, -1
        self.plug()

    def plug(self) -> None:
        """Plug it in; nothing where it is."""
        with self._lock:
            if self._master >= 0:
                return
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            self.path.unlink(missing_ok=True)
            self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Tear it out: reads and writes of whoever has it open fail from now on."""
        with self._lock:
            if self._master < 0:
                return
            self.path.unlink(missing_ok=True)
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1
