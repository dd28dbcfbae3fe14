# SPDX-License-Identifier: Apache-2.0
"""Made registrations of pairs, for the stages that only compare them."""

import numpy as np

from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Reason, Registration, Stability, Verdict, VisibilityScore

ACCEPTED = Verdict("accept")
UNCERTAIN = Verdict("uncertain", (Reason("imprecise", 0.03, 0.02, "sigma 30 mm, limit 20 mm"),))


def undecided(*codes):
    return Verdict("undecided", tuple(Reason(code, 0.0, 1.0, f"made {code}") for code in codes))


def pose(target, source, xyz_m=(0.0, 0.0, 0.0), yaw_rad=0.0):
    return RigidTransform.from_xyz_rpy(target, source, xyz_m, (0.0, 0.0, yaw_rad))


def pair(T_target_source, verdict=ACCEPTED, fitness=0.5, registrations=()):
    """Make a registration; without `registrations` its evidence is its fitness."""
    return PairRegistration(
        T_target_source.target,
        T_target_source.source,
        T_target_source,
        fitness,
        0.05,
        100,
        converged=True,
        iterations=5,
        engine="made",
        verdict=verdict,
        registrations=registrations,
    )


def registration(T_target_source, perturbed_offset_m=0.0):
    score = VisibilityScore(200, 0, 0, 0, np.eye(6), np.zeros(0, dtype=np.uint8))
    stability = Stability(0.005, 1e-3, 0.3, perturbed_offset_m, 0.0)
    return Registration(-1, T_target_source, score, 0.5, 0.05, 1.0, np.zeros((0, 3)), stability=stability)
