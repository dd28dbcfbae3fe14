# SPDX-License-Identifier: Apache-2.0
"""Register the best hypothesis of a pair to the last millimetre."""

from __future__ import annotations

from dataclasses import replace

from multilica.config import FineConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration
from multilica.stages.gicp import register_narrower
from multilica.stages.registration_cloud import RegistrationCloud

__all__ = ["register_pair"]


def register_pair(
    first: RegistrationCloud,
    second: RegistrationCloud,
    T_first_second: RigidTransform,
    hypothesis: int,
    config: FineConfig,
    threads: int,
) -> PairRegistration:
    """GICP of the narrower cloud into the wider, which are the source and the target of the result.

    Args:
        hypothesis: index of the hypothesis that the start came from, -1 if it came from a merge.
    """
    return replace(register_narrower(first, second, T_first_second, config, threads), hypothesis=hypothesis)
