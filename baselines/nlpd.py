"""The paper's nonlinear PD controller."""

from __future__ import annotations

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import Gains

from uwoc_gym.scenario import Scenario


class NLPDController(Controller):
    """The law with gains that fall with the error (paper, theorem 1); arguments as for `Controller`."""

    def __init__(self, gain_set: str | Gains = "paper-nlpd", scenario: str | Scenario = "Nominal") -> None:
        super().__init__(gain_set, scenario)
