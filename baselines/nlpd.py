"""The paper's nonlinear PD controller."""

from __future__ import annotations

from collections.abc import Sequence

from uwoc_gym.baselines.controller import Controller
from uwoc_gym.baselines.gains import Gains
from uwoc_gym.scenario import Scenario


class NLPDController(Controller):
    """The nonlinear PD law (paper, sec. 3.2), by default with the gains calibrated to the paper's nominal NLPD row.

    Args:
        gains: A gain set or the name of one.
        scenario: See `Controller`.

    Raises:
        SettingError: There is no gain set or scenario of that name.

    Examples:
        >>> controller = NLPDController()
        >>> action, _ = controller.predict(np.zeros((8, 20), np.float32))
        >>> action.shape
        (8, 3)
    """

    def __init__(
        self, gains: str | Gains | Sequence[str | Gains] = "nlpd", scenario: str | Scenario = "Nominal"
    ) -> None:
        super().__init__(gains, scenario)
