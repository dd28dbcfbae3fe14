# SPDX-License-Identifier: Apache-2.0
"""A small simulated fleet with real logs, and the tables of a store."""

from functools import partial

import pytest

from multilica.fleet.simulated_logs import write_fleet
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import MEASURED
from multilica.simulate import plan_fleet, simulate_snapshot
from tests.selection import NIGHTLY

# Its LiDARs are placed in all logs in which they return something.
PLAN = plan_fleet(2, 8, 398, frames=2, keep_every=12, jumps=0, creeps=0, dead=1, broken=2, duplicates=1)


def write_ideal_fleet(plan, folder):
    """Write the logs of LiDARs with white noise only, which takes half the time."""
    with pytest.MonkeyPatch.context() as patch:
        ideal = partial(simulate_snapshot, sensors="ideal")
        patch.setattr("multilica.fleet.simulated_logs.simulate_snapshot", ideal)
        write_fleet(plan, folder, workers=1)
    return folder


def link_logs(fleet, folder, logs):
    """Lay some logs into a fleet of their own, at night all; first logs of a vehicle have the same rows there."""
    for log in PLAN.logs if NIGHTLY else logs:
        link = folder / fleet.name / log.path
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(fleet / log.path)
    return folder / fleet.name


def table(store, name="logs"):
    with ask(store, f"FROM {name}") as answer:
        return [
            {key: value for key, value in zip(answer.columns, row, strict=True) if key not in MEASURED}
            for row in answer.rows()
        ]


def tables(store, logs):
    """The rows of the logs of a folder."""
    sources = {f"{logs.name}/{path.relative_to(logs)}" for path in logs.glob("*/*")}
    return [
        sorted((row for row in table(store, name) if row["source"] in sources), key=str) for name in ("logs", "lidars")
    ]
