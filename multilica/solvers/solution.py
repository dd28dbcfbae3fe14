# SPDX-License-Identifier: Apache-2.0
"""The result of a solver."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import RigidTransform
from multilica.results import Correspondences


@dataclass(frozen=True, slots=True)
class Solution:
    """Poses that matches support.

    Args:
        poses: ``T_target_source``, the most trusted first.
        graph_edges: of the consistency graph; 0 where the solver builds none.
        clique_size: members of the largest clique that was found; 0 where the solver looks for none.
    """

    poses: tuple[RigidTransform, ...] = ()
    graph_edges: int = 0
    clique_size: int = 0


def pose_of(matches: Correspondences, rotation: npt.ArrayLike, translation: npt.ArrayLike) -> RigidTransform:
    """Return ``T_target_source`` of matches from its rotation (3, 3) and its translation (3,) or (3, 1)."""
    flat = np.asarray(translation, dtype=np.float64).reshape(3)
    return RigidTransform.from_rotation_translation(matches.target, matches.source, np.asarray(rotation), flat)
