# SPDX-License-Identifier: Apache-2.0
"""Errors of poses because LiDARs measured at different times while the vehicle hardly moved."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from multilica.geometry import FloatArray
from multilica.registration.widening import widened_everywhere
from multilica.results import PairRegistration
from multilica.snapshot import LidarScans, Scan

_NS_PER_S = 1e9
# A quarter of the smallest sigma adds 3 % to it; the covariance with the biases of all rings takes time to change.
_LITTLE = 0.25


@dataclass(frozen=True, slots=True)
class SlowMotion:
    """Motion of a vehicle that counts as standing: it rocks, or settles after braking.

    Args:
        speed_m_s, turn_rad_s: of the LiDARs.
        times_s: per LiDAR the mean time of its frames; empty if they have no times.
        span_s: from the first frame of all to the last.
    """

    speed_m_s: float = 0.0
    turn_rad_s: float = 0.0
    times_s: Mapping[str, float] = field(default_factory=dict)
    span_s: float = 0.0

    def covariance(self, target: str, lidar: str) -> FloatArray:
        """Return the (6, 6) covariance that it adds to ``T_target_lidar``: rotation (rad), translation (m).

        The cloud of a LiDAR lies where the vehicle was at the mean time of its frames. The direction of the motion
        counts as unknown.
        """
        return np.diag(np.repeat(self._between(target, lidar), 3) ** 2)

    def added_to(self, covariances: Mapping[str, FloatArray], target: str) -> dict[str, FloatArray]:
        """Return covariances (6, 6) of poses relative to a target with what the motion adds to each."""
        return {name: known + self.covariance(target, name) for name, known in covariances.items()}

    def added_to_pair(self, pair: PairRegistration) -> PairRegistration:
        """Return a registration with what the motion adds to its covariance, unless that is little."""
        if pair.information is None:
            return pair
        off_rad, off_m = self._between(pair.target, pair.source)
        covariance = np.linalg.pinv(pair.information, hermitian=True)
        of_parts = covariance[:3, :3], covariance[3:, 3:]
        least_rad, least_m = (np.sqrt(max(0.0, np.linalg.eigvalsh(each)[0])) for each in of_parts)
        is_little = off_rad < _LITTLE * least_rad and off_m < _LITTLE * least_m
        return pair if is_little else widened_everywhere(pair, off_rad, off_m)

    def _between(self, target: str, lidar: str) -> tuple[float, float]:
        """Return turn (rad) and shift (m) between the mean times of two LiDARs."""
        if not {target, lidar} <= self.times_s.keys():
            return 0.0, 0.0
        # Clocks may differ by more than the frames.
        apart_s = min(abs(self.times_s[target] - self.times_s[lidar]), self.span_s)
        return self.turn_rad_s * apart_s, self.speed_m_s * apart_s


def slow_motion_of(lidars: Sequence[LidarScans], motions: Mapping[str, tuple[float, float]]) -> SlowMotion:
    """Return the motion that most of the LiDARs saw between their first and last frames.

    Args:
        motions: shift (m) and turn (rad) of each LiDAR that can detect motion.
    """
    times_ns = {lidar.name: np.array([_time_ns(scan) for scan in lidar.scans], dtype=np.float64) for lidar in lidars}
    if not times_ns or not all(len(own) and np.all(own > 0) for own in times_ns.values()):
        return SlowMotion()
    begin_ns = min(own.min() for own in times_ns.values())
    relative_s = {name: (own - begin_ns) / _NS_PER_S for name, own in times_ns.items()}
    rates = [
        (shift_m / own_s, turn_rad / own_s)
        for name, (shift_m, turn_rad) in motions.items()
        if (own_s := float(np.ptp(relative_s[name]))) > 0.0
    ]
    speed_m_s, turn_rad_s = np.median(rates, axis=0).tolist() if rates else (0.0, 0.0)
    means_s = {name: float(own.mean()) for name, own in relative_s.items()}
    return SlowMotion(speed_m_s, turn_rad_s, means_s, float(max(own.max() for own in relative_s.values())))


def _time_ns(scan: Scan) -> int:
    return scan.log_time_ns or scan.stamp_ns
