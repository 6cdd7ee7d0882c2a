"""``python -m tests.corruption``."""

from __future__ import annotations

import signal
import sys

from tests.corruption.bench import main

if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # a shell's background job would ignore the first
        signal.signal(number, signal.default_int_handler)
    sys.exit(main())
