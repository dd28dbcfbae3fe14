# SPDX-License-Identifier: Apache-2.0
"""Returns of a LiDAR by their numbers over all frames."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from multilica.snapshot import LidarScans, Scan


@given(counts=st.lists(st.integers(0, 5), min_size=1, max_size=5), data=st.data())
def test_returns_count_over_all_frames(counts, data):
    frames = np.split(np.arange(3.0 * sum(counts)).reshape(-1, 3), np.cumsum(counts)[:-1])
    lidar = LidarScans("top", tuple(Scan(frame) for frame in frames))
    rows = np.array(
        sorted(data.draw(st.sets(st.integers(0, max(0, sum(counts) - 1)) if sum(counts) else st.nothing())))
    )
    assert np.array_equal(lidar.returns_at(rows.astype(np.int64)), lidar.points_m[rows.astype(np.int64)])
