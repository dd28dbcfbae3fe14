# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of a pose in its weakest directions."""

import numpy as np

from multilica.geometry import FloatArray


def weakest_sigmas(information: FloatArray | None) -> tuple[float | None, float | None]:
    """Return `weakest_deviations` of a pose with that (6, 6) information; None where it has none."""
    if information is None:
        return None, None
    return weakest_deviations(np.asarray(np.linalg.pinv(information, hermitian=True)))


def weakest_deviations(covariance: FloatArray) -> tuple[float, float]:
    """Return the largest standard deviations of position (m) and rotation (rad) of a (6, 6) covariance.

    The order is rotation, then translation.
    """
    variances = np.linalg.eigvalsh(covariance[3:, 3:])[-1], np.linalg.eigvalsh(covariance[:3, :3])[-1]
    sigma_m, sigma_rad = (float(np.sqrt(max(variance, 0.0))) for variance in variances)
    return sigma_m, sigma_rad
