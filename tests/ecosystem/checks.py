"""What a library's script runs: checks that say in a line what they did, and what came of each, as lines of JSON.

Each script runs in an environment that holds its library, this package and nothing that either doesn't need, so that
this module imports neither the tests nor their tools.
"""

from __future__ import annotations

import json
import re
import runpy
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

Check = Callable[[], str | None]

CHECKS: list[Check] = []


class NotApplicable(Exception):
    """What isn't meant for an environment such as this one, and why."""


def check(function: Check) -> Check:
    """Put a function among the checks; its docstring says what it runs, what it returns is a remark on the result."""
    CHECKS.append(function)
    return function


def block(page: str, marker: str, changes: dict[str, str]) -> dict[str, Any]:
    """Run the block of Python on a page in docs/ that a text stands in.

    Args:
        page: The page's name.
        marker: The text.
        changes: What is replaced in it first, each of which stands there once.

    Returns:
        What the block leaves.
    """
    text = (Path(__file__).parents[2] / "docs" / page).read_text(encoding="utf-8")
    (code,) = (each for each in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if marker in each)
    for before, after in changes.items():
        assert code.count(before) == 1, before
        code = code.replace(before, after)
    Path("block.py").write_text(code, encoding="utf-8")
    return runpy.run_path("block.py", run_name="__main__")


def outcome(function: Check) -> tuple[str, str]:
    """What came of a function: "works", "doesn't apply" or "fails", and what there is to say of it."""
    try:
        return "works", function() or ""
    except NotApplicable as error:
        return "doesn't apply", str(error)
    except Exception as error:
        traceback.print_exc()
        return "fails", " ".join(f"{type(error).__name__}: {error}".split())[:300]


def main(chosen: list[str]) -> int:
    """Run the checks, or those that are named; returns the exit status."""
    warnings.simplefilter("ignore")
    failed = False
    for function in CHECKS:
        if chosen and function.__name__ not in chosen:
            continue
        result, remark = outcome(function)
        failed |= result == "fails"
        said = {"what": " ".join((function.__doc__ or "").split()).rstrip("."), "result": result, "remark": remark}
        print(json.dumps(said, ensure_ascii=False), flush=True)
    return int(failed)


def run() -> None:
    """What a script ends with."""
    sys.exit(main(sys.argv[1:]))
