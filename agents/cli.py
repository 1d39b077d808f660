"""The command `uwoc-gym`."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from typing import NoReturn

from uwoc_gym import __version__
from uwoc_gym.agents import interrupts, places
from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.reports import files
from uwoc_gym.parameters import SettingError

COMMANDS = {
    name: importlib.import_module(f"uwoc_gym.agents.commands.{name}")
    for name in (
        "list",
        "benchmark",
        "evaluate",
        "train",
        "tune",
        "tracker",
        "dataset",
        "protocol",
        "calibrate",
        "reproduce",
        "watch",
        "record",
        "replay",
        "speed",
    )
}
"""Module of each command, which has HELP, EXAMPLES, add_arguments(parser) and run(args)."""


PROGRAM = "uwoc-gym"

_FOLDERS = ("out", "ship")
"""Options that say a folder to be filled, which may be elsewhere."""

_OF_FILES = ("record", "replay")
"""Commands that fill no folder."""

LONGEST = 4000
"""Characters of an error that are shown."""


class _UsageError(CommandError):
    """The command line itself is wrong."""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        missing = message.partition("arguments are required: ")[2]
        if missing and not missing.startswith("-") and self.prog != PROGRAM:
            # Which an option before it has taken, if it was given.
            first = missing.partition(",")[0]
            message += f"; {first} must stand before options that take several words, such as --override"
        raise _UsageError(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog=PROGRAM, description="Keep an optical link between an AUV and a moving ship.")
    parser.add_argument("--version", action="version", version=f"uwoc-gym {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, module in COMMANDS.items():
        own = commands.add_parser(
            name,
            help=module.HELP,
            description=module.HELP[:1].upper() + module.HELP[1:] + ".",
            epilog=module.EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(own)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Returns:
        The exit status: 0, 1 for an error, 2 for wrong usage, 130 if interrupted, 143 by SIGTERM.
    """
    with interrupts.heard():
        return _run(argv)


def _run(argv: Sequence[str] | None) -> int:
    command = "uwoc-gym"
    try:
        args = _parser().parse_args(argv)
        command = f"uwoc-gym {args.command}"
        args.command_line = files.command_line(argv)
        with ExitStack() as folders:
            for option in _FOLDERS:
                given = getattr(args, option, None)
                if isinstance(given, str) and places.elsewhere(given) and args.command not in _OF_FILES:
                    with naming(f"--{option}"):
                        setattr(args, option, str(folders.enter_context(places.held(given))))
            return int(COMMANDS[args.command].run(args))
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except _UsageError as error:
        return _fail(command, str(error), 2)
    except (CommandError, SettingError) as error:
        return _fail(command, places.by_address(str(error)), 1)
    except BrokenPipeError:
        # The reader, such as `head`, has gone; nothing more may be flushed to it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        text = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
        return _fail(command, places.by_address(text), 1)
    except MemoryError:
        return _fail(command, "there isn't enough memory for that; ask for less at a time", 1)
    except KeyboardInterrupt:
        return _fail(command, "interrupted", interrupts.status())


def _fail(command: str, message: str, status: int) -> int:
    text = " ".join(message.split())
    print(f"{command}: error: {text if len(text) <= LONGEST else f'{text[:LONGEST]}...'}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
