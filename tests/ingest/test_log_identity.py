# SPDX-License-Identifier: Apache-2.0

import pytest

from multilica.ingest.metadata import LogIdentity, identify_log
from multilica.simulate import plan_fleet
from tests.fleet.support.small_fleet import write_ideal_fleet

PLAN = plan_fleet(2, 4, 5, frames=1, keep_every=60, jumps=0, creeps=0, dead=0, broken=0, duplicates=0)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    return write_ideal_fleet(PLAN, tmp_path_factory.mktemp("identity") / "fleet")


@pytest.mark.slow
@pytest.mark.parametrize("log", PLAN.logs, ids=lambda log: log.format)
def test_a_log_says_its_vehicle_and_time(log, fleet):
    found = identify_log(fleet / log.path)
    assert found.vehicle == ("" if log.format == "ros1_bag" else log.vehicle)  # a ROS 1 bag has no place for it
    assert abs(found.time_ns - log.time_ns) < 10**9


@pytest.mark.parametrize("content", [b"", b"text", bytes(1000)])
def test_a_broken_log_says_nothing(content, tmp_path):
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    assert identify_log(path) == identify_log(tmp_path / "none.mcap") == LogIdentity("", None)


@pytest.mark.parametrize(
    ("text", "vehicle"),
    [
        ("rosbag2_bagfile_information:\n  custom_data:\n    vehicle: v7\n", "v7"),
        ("rosbag2_bagfile_information:\n  custom_data:\n    robot_id: 7\n", "7"),
        ("rosbag2_bagfile_information:\n  custom_data: [1]\n", ""),
        ("rosbag2_bagfile_information: 3\n", ""),
        ("a: &x [*x]\n", ""),
        ("[" * 1000, ""),
    ],
)
def test_a_bag_says_its_vehicle_in_its_metadata(text, vehicle, tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text(text)
    assert identify_log(tmp_path / "bag").vehicle == vehicle
