# SPDX-License-Identifier: Apache-2.0
"""Three LiDARs of 16 rings, of which the roof's two see nearly the same."""

import pytest

from multilica.config import CalibrationConfig
from multilica.pipeline import calibrate
from multilica.simulate import RIGS, simulate_snapshot
from multilica.simulate.models import VLP_16
from multilica.simulate.rigs import Mount, Rig, car

_RIG = Rig(
    "sparse",
    (
        Mount("left", VLP_16, (0.2, 0.5, 1.85), (-8.0, 3.0, 4.0)),
        Mount("right", VLP_16, (0.2, -0.5, 1.85), (7.0, 2.0, -3.0)),
        Mount("front", VLP_16, (2.4, 0.05, 0.7), (1.0, 1.0, 2.0)),
    ),
    car(1.6, 1.2, 1.0),
)


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "seed"), [("street", 9313), ("parking", 9301)])
@pytest.mark.in_turn
def test_rings_that_meet_turn_no_lidar(monkeypatch, scene, seed):
    """Where rings meet, the front one is placed 45 mm off in the street, and 95 mm in the other scene."""
    monkeypatch.setitem(RIGS, "sparse", _RIG)
    made = simulate_snapshot("sparse", scene, seed, frames=3)
    result = calibrate(made.snapshot, CalibrationConfig(target="left"))
    for name in ("right", "front"):
        off_m, off_rad = result.poses[name].distance_to(made.truth.between("left", name))
        assert off_m < 0.02
        assert off_rad < 0.005
