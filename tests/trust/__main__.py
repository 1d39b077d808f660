"""What is held on trust, measured: `python -m tests.trust [--long] [--out FILE] [TOPIC ...]`.

A topic is a module of this folder with `measure(long)`, which gives what was measured in words, and the figure. The
short form is what the tests hold too; the long one is for a release. The exit status is 1 if anything was found wrong.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import shlex
import sys
import time
import traceback
from pathlib import Path

from tests.trust.figures import Wrong
from uwoc_gym.agents.reports import files, tables

TOPICS: dict[str, str] = {
    "inputs": "bad inputs to code and commands",
    "scenarios": "random scenarios that are accepted",
    "hashes": "episodes bit for bit over batches, threads, autoreset and processes",
    "kills": "commands killed at random moments",
    "writes": "writes that fail",
    "caches": "Numba's cache cold, warm, missing, full and damaged",
    "files": "damaged files",
    "memory": "memory over many steps",
}
"""What each topic is about."""


def measured(name: str, long: bool) -> list[tuple[str, str]]:
    """The figures of a topic; one that breaks gives its error as a figure that is wrong."""
    try:
        found: list[tuple[str, str]] = importlib.import_module(f"tests.trust.{name}").measure(long)
    except Exception as error:
        traceback.print_exc()
        return [(TOPICS[name], Wrong(f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"))]
    return found


def main(argv: list[str] | None = None) -> int:
    """Measure and report; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.trust", description=__doc__.partition(":")[0] + ".")
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help=f"what to measure (default: {' '.join(TOPICS)})")
    parser.add_argument("--long", action="store_true", help="as for a release, which takes the better part of an hour")
    parser.add_argument("--out", type=Path, metavar="FILE", help="Markdown file for the table")
    args = parser.parse_args(argv)
    for name in args.topics:
        if name not in TOPICS:
            parser.error(f"TOPIC {name!r} is not allowed; it must be one of {', '.join(TOPICS)}")
    rows: list[list[str]] = []
    wrong = 0
    for name in args.topics or TOPICS:
        print(f"{name}: {TOPICS[name]} ...", file=sys.stderr, flush=True)
        begun = time.perf_counter()
        found = measured(name, args.long)
        own = sum(isinstance(figure, Wrong) for _, figure in found)
        wrong += own
        end = f"{own} wrong" if own else "all as it should be"
        print(f"{name}: {end}, {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
        for words, figure in found:
            text = tables.escaped(figure)
            rows.append([name, tables.escaped(words), f"**{text}**" if isinstance(figure, Wrong) else text])
    table = tables.grid(["topic", "measured", "figure"], rows)
    print(table)
    if args.out is not None:
        command = shlex.join(["python", "-m", "tests.trust", *(sys.argv[1:] if argv is None else argv)])
        versions = ", ".join(f"{package} {version}" for package, version in files.versions().items())
        today = datetime.date.today().isoformat()
        files.write_text(args.out, f"Measured on {today} by `{command}`, with {versions}.\n\n{table.rstrip()}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
