# SPDX-License-Identifier: Apache-2.0
"""Stores with made-up rows."""

import hashlib
from datetime import UTC, datetime

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.fleet.store.records import LidarRow, LogRow
from multilica.fleet.store.store import open_store
from tests.fleet.support.requests import DAY_NS, START_NS

NOMINAL = {"front": ((2.0, 0.1, -0.3), (1.0, -2.0, 40.0)), "rear": ((-3.0, 0.0, 0.2), (0.0, 1.0, 179.0))}
SIGMA_MM, SIGMA_DEG = (4.0, 3.0, 2.0), (0.02, 0.03, 0.01)
COVARIANCE = tuple(np.diag(np.concatenate([np.deg2rad(SIGMA_DEG), np.array(SIGMA_MM) / 1e3]) ** 2).ravel().tolist())


def key_of(source):
    return hashlib.sha256(source.encode()).hexdigest()[:32]


def lidar_row(key, time_ns, source, lidar, *, shift_mm=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0), **changes):
    """A placed LiDAR, moved from its nominal pose along and about the target's axes."""
    xyz_m, rpy_deg = NOMINAL.get(lidar, NOMINAL["front"])
    rotation = Rotation.from_rotvec(turn_deg, degrees=True) * Rotation.from_euler("xyz", rpy_deg, degrees=True)
    x_m, y_m, z_m = np.array(xyz_m) + np.array(shift_mm) / 1e3
    qx, qy, qz, qw = rotation.as_quat()
    pose = {"x_m": x_m, "y_m": y_m, "z_m": z_m, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
    values = {"how": "verified", "status": "placed", "covariance": COVARIANCE, **pose, **changes}
    return LidarRow(key, time_ns, source, lidar, "top", **values)


def lost_row(key, time_ns, source, lidar):
    """A LiDAR without a pose."""
    text = f"{lidar} is not placed: it returned nothing."
    return LidarRow(key, time_ns, source, lidar, "top", "calibrated", "not_placed", "dead_sensor", text)


def add_log(store, vehicle, day, lidars, *, state="verified", source=None, **changes):
    """Add a log with `lidars(key, time_ns, source)` as its rows."""
    time_ns = None if day is None else START_NS + day * DAY_NS
    source = source or f"{vehicle}/{day}.mcap"
    key = key_of(source)
    rows = lidars(key, time_ns, source)
    recording = f"{store.run_folder(vehicle, time_ns, key)}/recording.rrd" if state == "calibrated" else ""
    if recording:
        store.write(recording, b"recording")
    values = {
        "finished_at": datetime.now(UTC),
        "lidars": len(rows),
        "placed": sum(row.x_m is not None for row in rows),
        "recording": recording,
    }
    store.finish(LogRow(key, vehicle, time_ns, source, key, 1000, state, **(values | changes)), rows)
    return key


def made_store(folder, vehicles=3, logs=10, *, names=("front", "rear")):
    """Make a store: `v01`'s front jumps by 40 mm before log 5, `v02`'s last two logs lack rear, `v03` has a bad log."""
    store = open_store(folder, create=True)
    noise = np.random.default_rng(7)
    for number in range(1, vehicles + 1):
        vehicle = f"v{number:02}"
        for log in range(logs):

            def rows(key, time_ns, source, number=number, log=log):
                found = [LidarRow(key, time_ns, source, "top", "top", "verified", "placed", x_m=0.0)]
                for lidar in names:
                    jump_mm = 40.0 * (number == 1 and log >= 5 and lidar == "front")
                    moved = {
                        "shift_mm": np.array([jump_mm, 0.0, 0.0]) + noise.normal(size=3),
                        "turn_deg": noise.normal(0.0, 0.01, 3),
                    }
                    lost = number == 2 and log >= logs - 2 and lidar == "rear"
                    how = "calibrated" if log == 0 else "verified"
                    found.append(
                        lost_row(key, time_ns, source, lidar)
                        if lost
                        else lidar_row(key, time_ns, source, lidar, how=how, **moved)
                    )
                return found

            add_log(store, vehicle, 30 * log + number, rows, state="calibrated" if log in (0, logs - 1) else "verified")
    add_log(
        store,
        "v03",
        None,
        lambda *_: [],
        state="failed",
        source="v03/broken.bag",
        reason="unreadable",
        reason_text="v03/broken.bag is empty.",
    )
    return store
