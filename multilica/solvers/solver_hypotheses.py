# SPDX-License-Identifier: Apache-2.0
"""Result of a solver."""

from dataclasses import dataclass

from multilica.geometry import FloatArray

__all__ = ["SolverHypotheses"]


@dataclass(frozen=True, slots=True, eq=False)
class SolverHypotheses:
    """Poses, the most trusted first; not yet distinct, not yet verified.

    Args:
        poses: (4, 4) matrices that take source points to the target frame.
        graph_nodes, graph_edges: size of the consistency graph; 0 where the solver builds none.
    """

    poses: tuple[FloatArray, ...]
    graph_nodes: int = 0
    graph_edges: int = 0
