# SPDX-License-Identifier: Apache-2.0
"""Models of the rigs' LiDARs."""

from multilica.simulate.sensors import RasterPattern, RosettePattern, SensorModel, SpinningPattern

OS1_64 = SensorModel(SpinningPattern(64, 1024, (-22.5, 22.5)), 90.0, 0.3)  # Ouster OS1-64
OS1_128 = SensorModel(SpinningPattern(128, 1024, (-22.5, 22.5)), 90.0, 0.3)  # Ouster OS1-128
OS2_128 = SensorModel(SpinningPattern(128, 1024, (-11.25, 11.25)), 120.0, 0.8)  # Ouster OS2-128
VLP_16 = SensorModel(SpinningPattern(16, 1800, (-15.0, 15.0)), 90.0, 0.4, 0.015)  # Velodyne VLP-16
ROOF_64 = SensorModel(SpinningPattern(64, 1800, (-25.0, 15.0)), 110.0, 0.5, 0.015)  # 64-channel roof LiDAR
SIDE_32 = SensorModel(SpinningPattern(32, 900, (-32.0, 48.0)), 60.0, 0.3, 0.02, 0.03)  # 32-channel side LiDAR
FALCON = SensorModel(RasterPattern(104, 640, 120.0, 25.0), 120.0, 0.5, 0.02, 0.02)  # Seyond Falcon
AVIA = SensorModel(RosettePattern(24_000, 70.4, 77.2), 100.0, 0.5, 0.02, 0.03)  # Livox Avia
AERIES_II = SensorModel(RasterPattern(64, 800, 120.0, 19.2), 120.0, 0.8, 0.016, 0.03)  # Aeva Aeries II
NARROW = SensorModel(RasterPattern(120, 400, 70.0, 30.0), 90.0, 0.4, 0.018, 0.02)  # narrow solid-state LiDAR
