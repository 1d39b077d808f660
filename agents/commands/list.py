"""`uwoc-gym list`: environment IDs, scenarios and policies."""

from __future__ import annotations

import argparse

from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.registry import ENV_IDS

HELP = "list environment IDs, scenarios and policies"
EXAMPLES = """\
examples:
  uwoc-gym list
"""

DESCRIPTIONS = {
    "Nominal": "the paper's nominal run: calm water, the ship on its circle, 150 s",
    "CurrentPulse": "the paper's Case I: a force pulse at 30 s (noise, whose level it doesn't give, is off)",
    "MassError": "the paper's Case II: Case I with masses 20 % above what controllers know",
    "StrongPulse": "Case I with a pulse of 1500 N, 1500 N, 1500 N m, at which the printed PD loses the link",
    "PaperCaseI": "Case I with the pulse and noise that come nearest to its table; actions every 0.005 s, 60 s",
    "PaperCaseII": "Case II likewise",
    "Random": "everything drawn from the seed: ship's path, start, masses, pulses, current, noise; 60 s",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """This command has no options."""


def run(args: argparse.Namespace) -> int:
    """Print the lists; returns the exit status."""
    print("environment IDs and the scenarios that they fly:")
    for env_id, name in ENV_IDS.items():
        print(f"  {env_id:<24} {name:<14} {DESCRIPTIONS.get(name, '')}".rstrip())
    print("\npolicies:")
    for policy in POLICIES.values():
        print(f"  {policy.name:<24} {policy.description}")
    return 0
