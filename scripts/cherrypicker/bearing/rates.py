"""How fruit trees grow by years, as rates: what an age says of lengths, laterals and radii.

The numbers of ``rates.yaml`` are counted on grown trees of known years (docs/lab/bearing.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.linalg import expm

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

    @cached_property
    def state_type(self) -> np.ndarray:
        """Type of each state, (n_states,) int64."""
        return np.repeat([LONG, SHORT], self.n_ages * self.phases)

    @cached_property
    def state_age(self) -> np.ndarray:
        """Age of each state, (n_states,) int64."""
        return np.tile(np.repeat(np.arange(1, self.n_ages + 1), self.phases), 2)

    def of_states(self, table: np.ndarray) -> np.ndarray:
        """A table by type and age as a vector over states, (n_states,) float64."""
        return table[self.state_type, self.state_age - 1]

    @cached_property
    def generator(self) -> np.ndarray:
        """Rates a metre from state to state towards the tip, (n_states, n_states) float64.

        Rows sum to less than 0 by the laterals and the ends that would have been seen.
        """
        n, ages, phases = len(self.state_age), self.n_ages, self.phases
        rates = np.zeros((n, n))
        for state in range(n):
            kind, age, last = self.state_type[state], self.state_age[state], state % phases + 1
            rate = phases / self.increment_m[kind, age - 1]
            rates[state, state] -= (
                rate + self.laterals_a_m[kind, age - 1] + self.ends_a_m[kind, age - 1]
            )
            if last < phases:
                rates[state, state + 1] += rate
            elif age > 1:
                # Of wood as old as the last age or older the next increment is as old half the time
                shares = [(age - 1, 1.0)] if age < ages else [(age - 1, 0.5), (age, 0.5)]
                short = 1.0 if kind == SHORT else self.goes_short[age - 1]
                for beyond, share in shares:
                    for to, chance in ((LONG, 1.0 - short), (SHORT, short)):
                        first = (to * ages + beyond - 1) * phases
                        rates[state, first] += rate * share * chance
        return rates

    @cached_property
    def end_rate(self) -> np.ndarray:
        """Rate a metre at which an axis ends in each state, (n_states,) float64."""
        is_last = np.arange(len(self.state_age)) % self.phases == self.phases - 1
        grown = is_last * (self.state_age == 1) * self.phases / self.of_states(self.increment_m)
        return grown + self.of_states(self.ends_a_m)

    @cached_property
    def lateral_rate(self) -> np.ndarray:
        """Laterals a metre by the states of what bears and of their foot, (n_states, n_states)."""
        n, phases = len(self.state_age), self.phases
        rates = np.zeros((n, n))
        for state in range(n):
            kind, age = self.state_type[state], self.state_age[state]
            chance = self.lateral[age - 1].copy()
            if kind == SHORT:
                chance[LONG] = 0.0
            total = chance.sum()
            if total > 0:
                rate = self.laterals_a_m[kind, age - 1] / total
                rates[state, ::phases] = rate * chance.ravel()
        return rates

    def steps(self, lengths: np.ndarray) -> np.ndarray:
        """Chances from state to state over lengths (n,) in m, (n, n_states, n_states) float64."""
        return expm(np.asarray(lengths)[:, None, None] * self.generator)


def read_rates() -> Rates:
    """Read the rates of ``rates.yaml``."""
    numbers = yaml.safe_load(RATES_FILE.read_text(encoding="utf-8"))
    values: dict[str, Any] = {
        name: np.array(value, dtype=np.float64) if isinstance(value, list) else value
        for name, value in numbers.items()
    }
    return Rates(**values)
