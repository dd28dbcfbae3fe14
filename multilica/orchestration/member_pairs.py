# SPDX-License-Identifier: Apache-2.0
"""Registrations between the members of two merged groups."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from multilica.config import RefineConfig
from multilica.orchestration.pairs import PreparedLidar
from multilica.registration.plane_fit import fit_planes
from multilica.registration.poses import arc_between_m
from multilica.registration.sensor_biases import prior_sigmas
from multilica.results import Group, PairRegistration

# Members whose fit ends farther from the pose of their groups see different surfaces, if others end nearer.
_LARGEST_STEP_M = 0.05


def fit_members(
    merge: PairRegistration,
    group: Group,
    other: Group,
    lidars: Mapping[str, PreparedLidar],
    config: RefineConfig,
) -> tuple[PairRegistration, ...]:
    """Fit each pair of members of two groups, at the registered pose of the groups.

    The points of a group have no common rings and ranges, so the registration of the groups knows nothing of the biases
    of their LiDARs. Those of their members do.

    Returns:
        The fits that end near the given pose. If none does, that pose is less accurate than they are, and all count.
        The given registration alone where both groups are single LiDARs, or no members fit.
    """
    if len(group.poses) == len(other.poses) == 1 or merge.information is None:
        return (merge,)
    near, far = list[PairRegistration](), list[PairRegistration]()
    for name, added in product(group.members, other.members):
        pose = group.poses[name].inverse() @ merge.T_target_source @ other.poses[added]
        clouds = (lidars[name].side.cloud, lidars[added].side.cloud)
        sigmas = np.concatenate([prior_sigmas(each, config) for each in (name, added)])
        fit = fit_planes(*clouds, pose, sigmas)
        if fit.biases is None:
            continue
        of_members = replace(
            merge,
            target=name,
            source=added,
            T_target_source=fit.pose,
            information=fit.information,
            bias_information=fit.biases,
        )
        (near if arc_between_m(fit.pose, pose) < _LARGEST_STEP_M else far).append(of_members)
    return tuple(near or far) or (merge,)
