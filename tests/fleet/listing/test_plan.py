# SPDX-License-Identifier: Apache-2.0
from contextlib import closing

import pytest

from multilica.fleet.plan import Plan
from multilica.fleet.store.store import folder_name, open_store
from multilica.fleet.tasks.guard import LogTaskLimits
from multilica.ingest.metadata import LogIdentity
from tests.fleet.support.requests import log


@pytest.mark.parametrize(
    ("folder", "vehicle"),
    [("Автобус" * 7, ("Автобус" * 7)[:33]), ("bus\033[31m\nx", r"bus\x1b[31m\x0ax"), ("", "unknown")],
)
def test_the_folder_of_a_log_is_a_vehicle_of_bounded_name(tmp_path, folder, vehicle):
    store = open_store(tmp_path / "store", create=True)
    with closing(Plan(tmp_path, store, "c", LogTaskLimits())) as plan:
        plan.add([log(f"{folder}/a.mcap".lstrip("/"), vehicle="", day=None)])
        plan.settle(lambda addresses: [LogIdentity("", None)] * len(addresses))
        assert [*plan.vehicles()] == [vehicle]
    assert len(folder_name(vehicle)) <= 200
