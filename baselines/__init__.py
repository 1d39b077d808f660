"""Scripted controllers of the paper, with the ``predict`` of Stable-Baselines3's policies."""

from uwoc_gym.baselines.controller import Controller, NLPDController, PDController
from uwoc_gym.baselines.gains import GAINS, Gains, gains

__all__ = ["GAINS", "Controller", "Gains", "NLPDController", "PDController", "gains"]
