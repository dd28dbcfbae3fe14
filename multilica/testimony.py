# SPDX-License-Identifier: Apache-2.0
"""What beams say of a pose, weighed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray

__all__ = ["LEVER_ARM_M", "Testimony"]

LEVER_ARM_M = 10.0
"""Distance at which a rotation is compared with a translation."""

VIOLATION_WEIGHT = 30.0
"""A point in proven-empty space outweighs this many on common surfaces: the true pose makes hardly any."""

STRUCTURE_VIOLATION_WEIGHT = 60.0
"""The same among points off the commonest plane, of which a wrong pose on the ground has few that count at all."""

STRAY_SHARE = 0.003
"""So many points in empty space, as a share of all that agree, happen by chance: foliage, glass, what moved."""

STRAY_STRUCTURE_POINTS, STRAY_STRUCTURE_SHARE = 2, 0.001
"""The same of points off the commonest plane, of which there are fewer: a number, and a share of all that agree."""

FEW_POINTS = 10
"""Shares of structure begin at one and need some points to fall: a bush behind a trunk says little in a field."""


@dataclass(frozen=True, slots=True, eq=False)
class Testimony:
    """What the beams of both sides say of each other's points.

    Args:
        agree: points on a surface that the other side measured.
        violate: points in space that the other side's beams passed through.
        occluded: points behind a measured surface, of which nothing is known.
        unseen: points outside the other side's field of view.
        information: (6, 6) sum of J J^T over the agreeing points, J = (turn, shift) by which a small motion lifts a
            point off its surface; order rotation, translation in the target's axes about the source's origin,
            rotations scaled by `LEVER_ARM_M`.
        labels: (N,) `BeamLabel` of each probe of the source, by the target's beams.
        structure_agree, structure_violate, structure_occluded: the same counts over structure alone: closed surfaces
            off the commonest orientation, so walls and vehicles, not the ground.
        target_labels: (M,) `BeamLabel` of each probe of the target, by the source's beams.
        seen_through_m: distance at which the beams of one side pass through the place of the other's sensor and
            through all around it, so that nothing can carry a sensor there; 0 where they do not.
    """

    agree: int
    violate: int
    occluded: int
    unseen: int
    information: FloatArray
    labels: npt.NDArray[np.uint8]
    structure_agree: int = 0
    structure_violate: int = 0
    structure_occluded: int = 0
    target_labels: npt.NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    seen_through_m: float = 0.0

    @property
    def weakest_direction(self) -> FloatArray:
        """(6,) unit vector of the motion that `held_by` speaks of; order as `information`."""
        return np.asarray(np.linalg.eigh(self.information)[1][:, 0])

    @property
    def commonest_normal(self) -> FloatArray:
        """(3,) unit normal that most agreeing points share, mostly that of the ground."""
        return np.asarray(np.linalg.eigh(self.information[3:, 3:])[1][:, -1])

    @property
    def slide_direction(self) -> FloatArray:
        """(3,) unit vector along which the pose can be shifted most easily, the rotation free to follow."""
        turn, cross, shift = self.information[:3, :3], self.information[:3, 3:], self.information[3:, 3:]
        return np.asarray(np.linalg.eigh(shift - cross.T @ np.linalg.pinv(turn) @ cross)[1][:, 0])

    @property
    def distinctive(self) -> float:
        """Agreeing points off the commonest orientation of surfaces: one plane, the ground, fits nearly everywhere."""
        return float(self.agree - np.linalg.eigvalsh(self.information[3:, 3:])[-1])

    @property
    def evidence(self) -> float:
        """Distinctive agreement, weighed by what is not hidden, less what contradicts it; poses rank by it."""
        against = max(0.0, self.violate - STRAY_SHARE * self.agree)
        weighed = self.distinctive * self.shared_share - VIOLATION_WEIGHT * against
        return min(weighed, 0.0) if self.seen_through_m else weighed

    @property
    def held_by(self) -> float:
        """How many points hold the pose in its weakest direction: the smallest eigenvalue of the information."""
        return float(np.linalg.eigvalsh(self.information)[0])

    @property
    def shared_share(self) -> float:
        """How much of the structure in view both sides saw; the rest is hidden from one of them."""
        agree = self.structure_agree + FEW_POINTS
        return agree / (agree + self.structure_occluded)

    @property
    def explained_share(self) -> float:
        """How much of the structure in view is where the other side saw some, rather than hidden or in empty space.

        Sensors of one vehicle see the world from nearly the same place: little of it is hidden from one of them alone.
        """
        violate = max(0.0, self.structure_violate - STRAY_STRUCTURE_POINTS - STRAY_STRUCTURE_SHARE * self.agree)
        against = self.structure_occluded + STRUCTURE_VIOLATION_WEIGHT * violate
        agree = self.structure_agree + FEW_POINTS
        return agree / (agree + against)

    @property
    def violation_share(self) -> float:
        """Violations as a share of the points that the beams decide on."""
        return self.violate / max(1, self.agree + self.violate)
