"""Where a scene's randomness comes from: one stream for each thing, so that none of them shifts another."""

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """The generator of one thing of a case; the same for the same seed and name, whatever else is drawn."""
    return np.random.default_rng(np.random.SeedSequence([seed, *name.encode()]))
