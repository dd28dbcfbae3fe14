# SPDX-License-Identifier: Apache-2.0
"""Random numbers of a simulation."""

import numpy as np


def random_stream(*keys: object) -> np.random.Generator:
    """Return random numbers for one purpose: another draw for one purpose does not change the others."""
    return np.random.default_rng(list("/".join(map(str, keys)).encode()))
