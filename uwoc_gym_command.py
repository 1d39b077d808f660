"""The first lines of the command `uwoc-gym`, which answer Ctrl-C while all that it needs is imported."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def _stop(number: int, frame: FrameType | None) -> None:
    # Nothing has begun that would have to be ended, and an exception would come out of an import as a traceback.
    os.write(2, b"uwoc-gym: error: interrupted\n")
    os._exit(128 + number)


def main() -> int:
    """Import the command and run it; returns the exit status."""
    before = {number: signal.signal(number, _stop) for number in (signal.SIGINT, signal.SIGTERM)}
    from uwoc_gym.agents import cli

    try:
        for number, handler in before.items():
            signal.signal(number, handler)
        return cli.main()
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
