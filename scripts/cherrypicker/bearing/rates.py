"""How fruit trees grow by years, as rates: what an age says of lengths, laterals and radii.

The numbers of ``rates.yaml`` are counted on grown trees of known years (docs/lab/bearing.md).
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from cherrypicker.files import load_yaml

RATES_FILE = Path(__file__).with_name("rates.yaml")
LONG, SHORT = 0, 1


@dataclass(frozen=True)
class Rates:
    """What wood of a type (long, short) and an age (1, 2, ... and the last: or older) does.

    A state of the wood is (type, age, phase), in this order in vectors of `n_states`. A year's
    increment goes through `phases` of equal rate, so that its length is a gamma variate. What lies
    beyond short wood is short.
    """

    phases: int
    # (2, n_ages) float64: mean length of a year's increment, and how many laterals, and ends of
    # axes before their last year's wood, a metre has
    increment_m: np.ndarray
    laterals_a_m: np.ndarray
    ends_a_m: np.ndarray
    # (n_ages,) float64: chance that beyond long wood of an age the next increment is short
    goes_short: np.ndarray
    # (n_ages, 2, n_ages) float64: chance of a lateral's type and age, by the age of the long wood
    # that bears it: always less
    lateral: np.ndarray
    log_radius: np.ndarray  # (2, n_ages) float64: of radii in metres, within a tree
    log_radius_sd: np.ndarray
    log_radius_tree_sd: float  # how much a tree, or a scan of it, is thicker as a whole
    radius_run_m: float  # along which radii tell as much as one

    @property
    def n_ages(self) -> int:
        """Ages that are told apart; the last one is open."""
        return self.increment_m.shape[1]

    def of_states(self, table: np.ndarray) -> np.ndarray:
        """A table by type and age, (2, n_ages), as a vector over states, (n_states,) float64."""
        return np.repeat(table, self.phases)

    @cached_property
    def generator(self) -> np.ndarray:
        """Rates a metre from state to state towards the tip, (n_states, n_states) float64.

        Rows sum to less than 0 by the laterals and the ends that would have been seen.
        """
        ages, phases = self.n_ages, self.phases
        onwards = phases / self.increment_m
        rates = np.diag(-self.of_states(onwards + self.laterals_a_m + self.ends_a_m))
        for state, (kind, age, phase) in enumerate(np.ndindex(2, ages, phases)):
            rate = onwards[kind, age]
            if phase < phases - 1:
                rates[state, state + 1] += rate
            elif age > 0:
                # Of wood as old as the last age or older the next increment is as old half the time
                shares = [(age - 1, 1.0)] if age < ages - 1 else [(age - 1, 0.5), (age, 0.5)]
                short = 1.0 if kind == SHORT else self.goes_short[age]
                for beyond, share in shares:
                    for to, chance in ((LONG, 1.0 - short), (SHORT, short)):
                        rates[state, (to * ages + beyond) * phases] += rate * share * chance
        return rates

    @cached_property
    def end_rate(self) -> np.ndarray:
        """Rate a metre at which an axis ends in each state, (n_states,) float64."""
        rates = self.of_states(self.ends_a_m)
        rates.reshape(2, self.n_ages, self.phases)[:, 0, -1] += self.phases / self.increment_m[:, 0]
        return rates

    @cached_property
    def lateral_rate(self) -> np.ndarray:
        """Laterals a metre by the states of what bears and of their foot, (n_states, n_states)."""
        rates = np.zeros((2, self.n_ages, self.phases, 2, self.n_ages, self.phases))
        for kind, age in np.ndindex(2, self.n_ages):
            chance = self.lateral[age].copy()
            if kind == SHORT:
                chance[LONG] = 0.0
            if chance.any():
                rates[kind, age, ..., 0] = self.laterals_a_m[kind, age] / chance.sum() * chance
        n = 2 * self.n_ages * self.phases
        return rates.reshape(n, n)

    def steps(self, lengths: np.ndarray) -> np.ndarray:
        """Chances from state to state over lengths (n,) in m, (n, n_states, n_states) float64."""
        return expm(np.asarray(lengths)[:, None, None] * self.generator)


def read_rates() -> Rates:
    """Read the rates of ``rates.yaml``."""
    values: dict[str, Any] = {
        name: np.array(value, dtype=np.float64) if isinstance(value, list) else value
        for name, value in load_yaml(RATES_FILE).items()
    }
    return Rates(**values)
