# SPDX-License-Identifier: Apache-2.0
"""The stages of the preset `paper` without files, as a program with the in- and output of `paper_baseline`."""

from __future__ import annotations

import json
import sys

from multilica.config import preset, with_overrides
from multilica.ingest import read_snapshot
from multilica.pipeline import calibrate


def main(source: str, target: str) -> None:
    """Print the pose of each LiDAR but the target."""
    config = with_overrides(preset("paper"), [f"target={target}", "runtime.workers=1"])
    for place in calibrate(read_snapshot(source), config).placements:
        if place.lidar != target and place.T_target_source is not None:
            print(json.dumps({"lidar": place.lidar, "T_target_source": place.T_target_source.matrix.tolist()}))


if __name__ == "__main__":
    main(*sys.argv[1:])
