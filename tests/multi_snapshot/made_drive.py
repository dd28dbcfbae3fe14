# SPDX-License-Identifier: Apache-2.0
"""Made registrations of views of a drive whose truth is known."""

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.registration.poses import moved
from multilica.results import DriveView, PairRegistration, ViewPair

SIGMA = np.array([1e-4] * 3 + [2e-3] * 3)
LIDARS = {
    name: RigidTransform.from_xyz_rpy(
        "A", name, [-1.2 * index, 0.4 * index, 0.1 * index], [0.02 * index, 0.1 * index, 2.1 * index]
    )
    for index, name in enumerate("ABC")
}
STOPS = {
    f"stop {index + 1}": RigidTransform.from_xyz_rpy(
        "A", "A", [6.0 * index, index * index, 0.1 * index], [0.01 * index, 0.02, 0.9 * index]
    )
    for index in range(4)
}
STRAIGHT = {
    f"stop {index + 1}": RigidTransform.from_xyz_rpy("A", "A", [5.0 * index, 0, 0], [0, 0, 0]) for index in range(4)
}


def view_pose(view, stops=STOPS):
    """The pose of a view in the frame of A at the first stop."""
    return stops[view.stop] @ LIDARS[view.lidar]


def pair(target, source, rng=None, noise=1.0, off=None, stops=STOPS):
    """A pair of views such as "A1" and "B3", with noise if there are random numbers, and off by a motion (6,)."""
    target, source = (DriveView(each[0], f"stop {each[1]}") for each in (target, source))
    pose = view_pose(target, stops=stops).inverse() @ view_pose(source, stops=stops)
    if rng is not None:
        error = noise * SIGMA * rng.normal(size=6)
        pose = moved(pose, error[:3], error[3:])
    if off is not None:
        pose = moved(pose, np.asarray(off[:3]), np.asarray(off[3:]))
    registration = PairRegistration(
        target=target.lidar,
        source=source.lidar,
        T_target_source=pose,
        fitness=0.9,
        rmse_m=0.05,
        inliers=1000,
        converged=True,
        iterations=5,
        engine="made",
        information=np.diag(SIGMA**-2.0),
    )
    return ViewPair(registration, target.stop, source.stop)


def pairs(text, rng=None, noise=1.0, stops=STOPS):
    """Pairs of views out of a text such as "A1-B3 A2-A3"."""
    return [pair(*each.split("-"), rng, noise, stops=stops) for each in text.split()]


def split(every):
    """Pairs within each stop, and links between stops."""
    within = {stop: tuple(each.registration for each in every if each.stops == {stop}) for stop in STOPS}
    return within, [each for each in every if each.is_link]


def refined(every, root="A"):
    """What the pairs tell together."""
    return refine_linked(root, *split(every), RefineConfig())
