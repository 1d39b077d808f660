"""Bad inputs, in code and on command lines: how many there are, and how many are refused as they should be."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.trust import test_commands, test_refusals
from tests.trust.figures import none_of, share


def measure(long: bool) -> list[tuple[str, str]]:
    """Try them all; there is but one form, which the tests hold too."""
    code = test_refusals.counts()
    with tempfile.TemporaryDirectory() as folder:
        wrong: list[str] = []
        lines = test_commands.counts(Path(folder), wrong)
    tried, typed = code.pop("tried"), lines.pop("tried")
    return [
        *((f"bad inputs to code: {words}", share(count, tried)) for words, count in code.items()),
        *((f"bad command lines: {words}", share(count, typed)) for words, count in lines.items()),
        ("bad command lines: what was wrong", none_of(wrong)),
    ]
