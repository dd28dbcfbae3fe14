# SPDX-License-Identifier: Apache-2.0
"""Choice of the target LiDAR."""

from collections.abc import Mapping, Sequence

from multilica.results import PairRegistration, PreprocessedCloud


def choose_target(
    asked_for: str, clouds: Mapping[str, PreprocessedCloud], pairs: Sequence[PairRegistration]
) -> tuple[str, str]:
    """Choose the root of the result: the LiDAR that the user asks for, if any, else the one with the most overlap.

    Returns:
        The name of the target and the reason in words.
    """
    if asked_for:
        return asked_for, "set by --target"
    overlap = dict.fromkeys(clouds, 0.0)
    for pair in pairs:
        if pair.verdict.accepted:
            overlap[pair.target] += pair.fitness
            overlap[pair.source] += pair.fitness
    best = max(overlap, key=lambda name: (overlap[name], len(clouds[name].points_m)))
    if overlap[best] == 0.0:
        return best, "most points, as no pair was accepted"
    return best, f"most overlap, the fitness of its pairs adds up to {overlap[best]:.2f}"
