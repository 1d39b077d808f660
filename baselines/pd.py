"""The paper's PD controller: the NLPD with every exponent at 1."""

from __future__ import annotations

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import Gains

from uwoc_gym.parameters import SettingError
from uwoc_gym.scenario import Scenario


class PDController(Controller):
    """The law with constant gains; arguments as for `Controller`.

    Raises:
        SettingError: The gain set has an exponent other than 1.
    """

    def __init__(self, gain_set: str | Gains = "paper-pd", scenario: str | Scenario = "Nominal") -> None:
        super().__init__(gain_set, scenario)
        if not self.gains.linear:
            raise SettingError(
                f"PDController takes gains whose mu_p and mu_v are all 1; those of {gain_set!r} aren't. Use NLPDController."
            )
