"""`uwoc-gym list`: environment IDs, scenarios and policies."""

from __future__ import annotations

import argparse

from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import DESCRIPTIONS

HELP = "list environment IDs, scenarios and policies"
EXAMPLES = """\
examples:
  uwoc-gym list
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """This command has no options."""


def run(args: argparse.Namespace) -> int:
    """Print the lists; returns the exit status."""
    print("environment IDs and the scenarios that they fly:")
    for env_id, name in ENV_IDS.items():
        print(f"  {env_id:<24} {name:<14} {DESCRIPTIONS[name]}".rstrip())
    print("\npolicies:")
    for policy in POLICIES.values():
        print(f"  {policy.name:<24} {policy.description}")
    return 0
