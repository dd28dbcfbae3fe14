# SPDX-License-Identifier: Apache-2.0
"""The ground that the vehicle stands on."""

from multilica.stages.ground.ground_plane import estimate_ground, estimate_level, middle_of

__all__ = ["estimate_ground", "estimate_level", "middle_of"]
