# SPDX-License-Identifier: Apache-2.0
"""A small simulated fleet with real logs, and the tables of a store."""

from multilica.fleet.simulated_logs import write_fleet
from multilica.fleet.store.query import ask
from multilica.fleet.store.records import MEASURED
from multilica.simulate import plan_fleet

PLAN = plan_fleet(2, 9, 8, frames=2, keep_every=12, jumps=0, creeps=0, dead=1, broken=2, duplicates=1)


def write_small_fleet(folder):
    write_fleet(PLAN, folder, workers=1)
    return folder


def table(store, name="logs"):
    with ask(store, f"FROM {name}") as answer:
        kept = [index for index, column in enumerate(answer.columns) if column not in MEASURED]
        return sorted(([row[index] for index in kept] for row in answer.rows()), key=str)


def tables(store):
    return table(store), table(store, "lidars")
