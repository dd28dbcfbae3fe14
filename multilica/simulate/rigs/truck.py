# SPDX-License-Identifier: Apache-2.0
"""An articulated truck with LiDARs 2.5 to 12 m apart."""

from multilica.simulate.rigs.bodies import articulated_truck
from multilica.simulate.rigs.lidars import FALCON, OS1_128, SIDE_32
from multilica.simulate.rigs.rig import Mount, Rig

# 32-channel LiDARs on the mirrors, 128-channel ones on both roofs, 120-degree solid-state ones on the trailer's walls.
TRUCK = Rig(
    "truck",
    (
        Mount("mirror_left", SIDE_32, (5.5, 1.44, 2.0), (-2.0, 28.0, 80.0)),
        Mount("mirror_right", SIDE_32, (5.5, -1.44, 2.0), (1.0, 30.0, -80.0)),
        Mount("roof", OS1_128, (3.4, 0.0, 2.42), (0.0, 1.0, 0.0)),
        Mount("trailer_left", FALCON, (-0.2, 1.28, 1.7), (0.0, 5.0, 90.0)),
        Mount("trailer_rear", FALCON, (-6.36, 0.0, 1.9), (0.0, 7.0, 180.0)),
        Mount("trailer_right", FALCON, (-0.2, -1.28, 1.7), (0.0, 6.0, -90.0)),
        Mount("trailer_roof", OS1_128, (-2.8, 0.0, 2.36), (0.0, -1.0, 180.0)),
    ),
    articulated_truck(),
)
