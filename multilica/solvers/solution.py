# SPDX-License-Identifier: Apache-2.0
"""What a solver finds."""

from dataclasses import dataclass

from multilica.geometry import RigidTransform


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
