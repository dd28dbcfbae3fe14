# SPDX-License-Identifier: Apache-2.0
"""Motion of a registered pose after perturbations, which tells whether the scene constrains it."""

from multilica.config import FineConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud, register
from multilica.registration.poses import arc_between_m, moved
from multilica.results import Stability
from multilica.results.registrations import weakest_sigmas


def perturbed_ends(
    clouds: tuple[GicpCloud, GicpCloud],
    pose: RigidTransform,
    weakest_direction: FloatArray,
    perturbation_m: float,
    fine: FineConfig,
) -> tuple[RigidTransform, RigidTransform]:
    """Register target and source from both sides of the pose, perturbed along `VisibilityScore.weakest_direction`."""
    pushes = (side * perturbation_m * weakest_direction for side in (-1.0, 1.0))
    starts = (moved(pose, push[:3] / LEVER_ARM_M, push[3:]) for push in pushes)
    back, forth = (register(*clouds, start, fine).T_target_source for start in starts)
    return back, forth


def check_stability(
    thinned: tuple[GicpCloud, GicpCloud] | None,
    pose: RigidTransform,
    information: FloatArray | None,
    ends: tuple[RigidTransform, RigidTransform],
    perturbation_m: float,
    fine: FineConfig,
) -> Stability:
    """Measure the motion of a registered pose after a perturbation, and with fewer points.

    Along a tunnel a registration stays at the perturbed pose. A chance fit of ground and shrubs depends on single
    points. A well constrained pose returns to within a fraction of a millimetre.

    Args:
        thinned: target and source with fewer points; None where they have few anyway.
        pose: where GICP ended.
        ends: of `perturbed_ends` for that pose.
    """
    of_fewer = pose if thinned is None else register(*thinned, pose, fine).T_target_source
    return Stability(
        *weakest_sigmas(information),
        perturbation_m,
        perturbed_offset_m=max(arc_between_m(pose, end) for end in ends),
        thinned_offset_m=arc_between_m(pose, of_fewer),
    )
