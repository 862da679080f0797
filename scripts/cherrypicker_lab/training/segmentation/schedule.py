"""Course of a training: its length, its rates, what the kept weights are a mean of."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Schedule:
    """Course of a training."""

    epochs: int = 35
    batch_spheres: int = 16
    spheres_per_cloud: int = 8  # spheres cut from each cloud in an epoch
    # learning_rate, final_learning_rate: adam's rate at the start and the end; it decays by an
    # equal factor each step
    learning_rate: float = 0.003
    final_learning_rate: float = 3e-5
    color_dropout: float = 0.25  # share of the clouds shown without colour
    seed: int = 0
    # Stop after this time, with the rate falling over it rather than over the epochs; for a machine
    # whose load is not known beforehand. Two such runs differ.
    minutes: float | None = None
    # {"exponential", "cosine"}: how the rate falls: by an equal factor each step, or along half a
    # cosine
    course: str = "exponential"
    # Batches over which the rate rises to its course, for a start from trained weights
    warmup: int = 0
    # Decay of the running mean of the weights that is kept in place of the last ones; 0 keeps the
    # last ones
    average: float = 0.0
    # Loss weights are the class frequencies to this power, inverted: 0 weighs points alike
    class_balance: float = 0.5

    def rate(self, progress, n_batches=None):
        """Adam's rate at a share `progress` of the run, after `n_batches` batches of it."""
        progress = min(progress, 1.0)
        first, last = self.learning_rate, self.final_learning_rate
        if self.course == "cosine":
            rate = last + (first - last) * 0.5 * (1 + np.cos(np.pi * progress))
        else:
            rate = first * (last / first) ** progress
        if n_batches is not None and n_batches < self.warmup:
            rate *= (n_batches + 1) / self.warmup
        return float(rate)
