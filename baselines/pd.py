"""The paper's PD controller: the nonlinear law with every mu at 1."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from uwoc_gym.baselines.gains import Gains
from uwoc_gym.baselines.nlpd import NLPDController
from uwoc_gym.parameters import SettingError
from uwoc_gym.scenario import Scenario


class PDController(NLPDController):
    """The PD law (paper, sec. 3.2), by default with the paper's gains and feedforward.

    Args:
        gains: A gain set with every mu at 1, or the name of one.
        scenario: See `Controller`.

    Raises:
        SettingError: There is no gain set or scenario of that name, or a mu of the gain set isn't 1.
    """

    def __init__(self, gains: str | Gains | Sequence[str | Gains] = "pd", scenario: str | Scenario = "Nominal") -> None:
        super().__init__(gains, scenario)
        for gain_set, name in itertools.product(self.gain_sets, ("mu_p", "mu_v")):
            exponents = getattr(gain_set, name)
            if exponents != (1.0, 1.0, 1.0):
                raise SettingError(
                    f"Gains.{name} = {exponents!r} is not allowed for a PDController; every exponent must be 1 "
                    "(NLPDController takes those below)."
                )
