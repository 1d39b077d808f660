"""Being asked to stop: by Ctrl-C, or by SIGTERM, which ends everything as Ctrl-C does."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from types import FrameType

_ONE_REQUEST_S = 1.0
"""A signal that comes again within this time is the same request, such as one to a process and to its group."""

_received: list[int] = []


def status() -> int:
    """The exit status of a command that was asked to stop: 130 after Ctrl-C, 143 after SIGTERM."""
    return 128 + (_received[-1] if _received else signal.SIGINT)


@contextmanager
def _handling(numbers: tuple[int, ...], handle: object) -> Iterator[None]:
    before = {}
    # Outside the main thread Python lets nobody set handlers.
    with suppress(ValueError):
        before = {number: signal.signal(number, handle) for number in numbers}  # type: ignore[arg-type]
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def heard() -> Iterator[None]:
    """Let SIGTERM raise KeyboardInterrupt, as Ctrl-C does; see `check`."""
    _received.clear()

    def interrupt(number: int, frame: FrameType | None) -> None:
        _received.append(number)
        raise KeyboardInterrupt

    with _handling((signal.SIGINT, signal.SIGTERM), interrupt):
        yield


def check() -> None:
    """Raise KeyboardInterrupt if one was asked for and got lost, as it may in what others do while they are imported.

    Raises:
        KeyboardInterrupt: It was.
    """
    if _received:
        raise KeyboardInterrupt


@contextmanager
def noted() -> Iterator[list[int]]:
    """A list that Ctrl-C and SIGTERM add themselves to instead of stopping what is under way.

    The second request raises KeyboardInterrupt.
    """
    asked: list[int] = []
    first = 0.0

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal first
        if asked:
            if time.monotonic() - first < _ONE_REQUEST_S:
                return
            raise KeyboardInterrupt
        first = time.monotonic()
        asked.append(number)
        _received.append(number)

    with _handling((signal.SIGINT, signal.SIGTERM), note):
        yield asked


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Processes begun in the block don't hear Ctrl-C: their parent answers it, by ending them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # It would let signals through again when the first process begins.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
