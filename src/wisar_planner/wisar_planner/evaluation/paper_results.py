"""What the paper reports, to stand beside our own numbers.

Ewers, Anderson and Thomson (2024), "Deep reinforcement learning for time-critical wilderness
search and rescue using drones": the tables of probability over distance and of distance to find.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PaperResult:
    """One method's line in the paper, means with standard deviations.

    Attributes
    ----------
    method : str
        The paper's name of the method.
    p_d, p_d_std : float
        Probability seen.
    e_p, e_p_std : float
        Probability efficiency at the longest distance.
    found_pct : float
        Persons found, percent.
    dtf_m, dtf_std_m : float
        Distance to find of the found, m.
    """

    method: str
    p_d: float
    p_d_std: float
    e_p: float
    e_p_std: float
    found_pct: float
    dtf_m: float
    dtf_std_m: float

    def flown_per_person_m(self, budget_m: float) -> float:
        """Return the mean distance until a person is found or the budget is spent, m."""
        found = self.found_pct / 100.0
        return found * self.dtf_m + (1.0 - found) * budget_m


#: The paper's results by the name of our planner that is the same method.
PAPER_RESULTS: Mapping[str, PaperResult] = {
    "lawnmower": PaperResult("lawnmower", 0.06, 0.04, 0.08, 0.06, 7.77, 282.63, 146.62),
    "lhc_gw_conv": PaperResult("LHC_GW_CONV", 0.09, 0.06, 0.12, 0.08, 11.86, 249.37, 145.70),
    "sac": PaperResult("SAC-FS-CNN", 0.15, 0.04, 0.19, 0.04, 19.00, 239.61, 138.16),
}
