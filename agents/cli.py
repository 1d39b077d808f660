"""The command `uwoc-gym`."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from uwoc_gym.agents.errors import UserError

import uwoc_gym
from uwoc_gym import ENV_IDS, SCENARIOS, SettingError


SCENARIO_NOTES = {
    "Nominal": "the paper's nominal run",
    "CurrentPulse": "Case I: a pulse of 350 N, 350 N, 350 N m at 30 s",
    "MassError": "Case II: the same, with masses 20 % above what controllers know",
    "Random": "start, path, masses, pulses, current and noise drawn each episode",
}


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise argparse.ArgumentTypeError("needs at least one name")
    return names


def _at_least_one(text: str) -> int:
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not allowed; it must be a whole number of at least 1")
    return number


def _seed(text: str) -> int:
    try:
        number = int(text)
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not allowed; it must be a whole number of at least 0")
    return number


def _list(arguments: argparse.Namespace) -> int:
    from uwoc_gym.agents.evaluate import POLICIES

    print("Environment IDs")
    for env_id, name in ENV_IDS.items():
        print(f"  {env_id:24} scenario {name}, {SCENARIOS[name].episode.duration_s:g} s")
    print("Scenarios")
    for name in SCENARIOS:
        print(f"  {name:24} {SCENARIO_NOTES.get(name, '')}")
    print("Policies")
    for name, (description, _) in POLICIES.items():
        print(f"  {name:24} {description}")
    print("A saved Stable-Baselines3 model (.zip) or module:callable is a policy too, a .json file a scenario.")
    return 0


def _benchmark(arguments: argparse.Namespace) -> int:
    from uwoc_gym.agents import benchmark
    from uwoc_gym.agents.evaluate import POLICIES

    complete = benchmark.run(
        arguments.policies or list(POLICIES),
        arguments.scenarios,
        arguments.episodes,
        arguments.seed,
        arguments.out,
        arguments.command_line,
        arguments.control_period,
    )
    if not complete:
        print("uwoc-gym: interrupted; what was finished is written.", file=sys.stderr)
        return 130
    print(f"Written to {arguments.out}.")
    return 0


def _speed(arguments: argparse.Namespace) -> int:
    from uwoc_gym.agents import speed

    speed.run(arguments.rounds, arguments.scale, arguments.out, arguments.command_line)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="uwoc-gym", description="An AUV that keeps an optical link to a moving ship.")
    parser.add_argument("--version", action="version", version=uwoc_gym.__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, run: object, summary: str, examples: str) -> argparse.ArgumentParser:
        command = commands.add_parser(
            name,
            help=summary,
            description=summary,
            epilog=f"examples:\n{examples}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(run=run)
        return command

    add("list", _list, "show environment IDs, scenarios and policies", "  uwoc-gym list")

    command = add(
        "benchmark",
        _benchmark,
        "fly policies through scenarios on the same seeds; print a table, write results and figures",
        "  uwoc-gym benchmark\n"
        "  uwoc-gym benchmark --policies pd,nlpd,my_agent.zip --scenarios Random --episodes 200\n"
        "  uwoc-gym benchmark --policies my_package.policies:make --scenarios my_scenario.json --out results/mine",
    )
    command.add_argument(
        "--policies", type=_names, help="names, .zip files, module:callable; default: every named policy"
    )
    command.add_argument("--scenarios", type=_names, default=list(SCENARIOS), help="names, IDs, .json files")
    command.add_argument("--episodes", type=_at_least_one, default=64, help="episodes where anything is drawn (64)")
    command.add_argument("--seed", type=_seed, default=10_000, help="first seed (10000)")
    command.add_argument("--control-period", type=float, help="time between actions [s]; default: the scenario's, 0.05")
    command.add_argument("--out", type=Path, default=Path("results/benchmark"), help="folder to write to")

    command = add(
        "speed",
        _speed,
        "steps per second beside Gymnasium's CartPole, with ratios",
        "  uwoc-gym speed\n  uwoc-gym speed --rounds 9 --out results/speed",
    )
    command.add_argument("--rounds", type=_at_least_one, default=5, help="alternating rounds (5)")
    command.add_argument("--scale", type=float, default=1.0, help="length of the measurements (1)")
    command.add_argument("--seed", type=_seed, default=0, help=argparse.SUPPRESS)
    command.add_argument("--out", type=Path, help="folder to write results.json to")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    given = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser().parse_args(given)
    arguments.command_line = shlex.join(["uwoc-gym", *given])
    try:
        status: int = arguments.run(arguments)
    except (UserError, SettingError) as error:
        print(f"uwoc-gym: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        print(f'uwoc-gym: {error.name} is missing: pip install "uwoc-gym[benchmark]"', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("uwoc-gym: interrupted.", file=sys.stderr)
        return 130
    return status


if __name__ == "__main__":
    sys.exit(main())
