# SPDX-License-Identifier: Apache-2.0
"""Models of LiDARs as their datasheets describe them; `docs/certainty.md` names the datasheets and what is assumed."""

from multilica.simulate.sensors import Accuracy, RasterPattern, RosettePattern, SensorModel, SpinningPattern

# Datasheets of Ouster state 0.01 degrees for both angles; those of other makes are silent about rings.
_OUSTER = Accuracy(ring_elevation_deg=0.01, ring_azimuth_deg=0.01)

# Ouster OS1-64.
OS1_64 = SensorModel(
    SpinningPattern(64, 1024, (-22.5, 22.5)),
    max_range_m=90.0,
    min_range_m=0.3,
    range_step_m=0.001,
    beam_deg=0.13,
    dark_range_m=40.0,
    accuracy=_OUSTER,
)
# Ouster OS1-128.
OS1_128 = SensorModel(
    SpinningPattern(128, 1024, (-22.5, 22.5)),
    max_range_m=90.0,
    min_range_m=0.3,
    range_step_m=0.001,
    beam_deg=0.18,
    dark_range_m=40.0,
    accuracy=_OUSTER,
)
# Ouster OS2-128.
OS2_128 = SensorModel(
    SpinningPattern(128, 1024, (-11.25, 11.25)),
    max_range_m=120.0,
    min_range_m=0.8,
    range_step_m=0.001,
    beam_deg=0.09,
    dark_range_m=80.0,
    accuracy=_OUSTER,
)
# Velodyne VLP-16.
VLP_16 = SensorModel(
    SpinningPattern(16, 1800, (-15.0, 15.0)),
    max_range_m=90.0,
    range_noise_m=0.015,
    range_step_m=0.002,
    beam_deg=0.18,
    dark_range_m=50.0,
)
# 64-channel roof LiDAR, like Hesai Pandar64.
ROOF_64 = SensorModel(
    SpinningPattern(64, 1800, (-25.0, 15.0)),
    max_range_m=110.0,
    min_range_m=0.5,
    range_noise_m=0.015,
    range_step_m=0.004,
    beam_deg=0.18,
    dark_range_m=200.0,
)
# 32-channel side LiDAR with a wide view, like RoboSense RS-Bpearl.
SIDE_32 = SensorModel(
    SpinningPattern(32, 900, (-32.0, 48.0)),
    max_range_m=60.0,
    min_range_m=0.3,
    range_noise_m=0.02,
    dropout=0.03,
    range_step_m=0.005,
    beam_deg=0.18,
    dark_range_m=30.0,
)
# 120-degree solid-state LiDAR, like Seyond Falcon and Livox HAP.
FALCON = SensorModel(
    RasterPattern(104, 640, 120.0, 25.0),
    max_range_m=120.0,
    min_range_m=0.5,
    range_noise_m=0.02,
    range_step_m=0.001,
    beam_deg=0.16,
    dark_range_m=150.0,
)
# Livox Avia.
AVIA = SensorModel(
    RosettePattern(24_000, 70.4, 77.2),
    max_range_m=100.0,
    min_range_m=0.5,
    range_noise_m=0.02,
    dropout=0.03,
    range_step_m=0.001,
    beam_deg=0.16,
    dark_range_m=190.0,
)
# Aeva Aeries II.
AERIES_II = SensorModel(
    RasterPattern(64, 800, 120.0, 19.2),
    max_range_m=120.0,
    min_range_m=0.8,
    range_noise_m=0.016,
    dropout=0.03,
    range_step_m=0.001,
    beam_deg=0.1,
    dark_range_m=150.0,
)
# Narrow solid-state LiDAR of no particular make.
NARROW = SensorModel(RasterPattern(120, 400, 70.0, 30.0), max_range_m=90.0)
# Solid-state LiDARs of no particular make: for all of the road, and for the road far ahead.
SOLID_70 = SensorModel(RasterPattern(96, 400, 70.0, 25.0), max_range_m=150.0, dark_range_m=120.0)
LONG_25 = SensorModel(RasterPattern(75, 250, 25.0, 15.0), max_range_m=200.0, dark_range_m=180.0)
