"""Scripted controllers of the paper, with the ``predict`` of Stable-Baselines3's policies."""

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import GAINS, Gains, gains
from uwoc_gym.baselines.nlpd import NLPDController
from uwoc_gym.baselines.pd import PDController

__all__ = ["GAINS", "Controller", "Gains", "NLPDController", "PDController", "gains"]
