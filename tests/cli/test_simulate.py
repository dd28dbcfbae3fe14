# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from mcap.reader import make_reader

from multilica import read_extrinsics, read_snapshot
from multilica.simulate import RIGS, SCENES
from tests.cli.support import Invoke, assert_one_sentence

REQUEST = ("simulate", "--rig", "chain", "--scene", "garage", "--seed", "3", "--frames", "1")

DRIVE = ("--rig", "front_back", "--scene", "yard", "--drive", "yard", "--out", "a.mcap")


def test_a_snapshot_lies_beside_its_truth(invoke: Invoke) -> None:
    outcome = invoke(*REQUEST, "--out", "deep/chain.mcap")
    assert outcome.code == 0
    assert outcome.out.splitlines() == ["wrote deep/chain.mcap", "wrote deep/chain.truth.toml"]
    snapshot = read_snapshot("deep/chain.mcap")
    assert set(read_extrinsics(Path("deep/chain.truth.toml")).T_target_source) == set(snapshot.names)
    assert len(list(Path("deep").iterdir())) == 2


def test_thinning_keeps_every_nth_return(invoke: Invoke) -> None:
    invoke(*REQUEST, "--out", "all.mcap")
    invoke(*REQUEST, "--keep-every", "10", "--out", "some.mcap")
    every, some = read_snapshot("all.mcap"), read_snapshot("some.mcap")
    for name in every.names:
        assert some[name].points_count == pytest.approx(every[name].points_count / 10, abs=1)


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_drive_lies_beside_its_truth(invoke: Invoke) -> None:
    """The log holds the frames of all stops and of the way, each point with its time."""
    few = ("--stops", "2", "--frames", "2", "--keep-every", "300", "--sensors", "ideal")
    outcome = invoke(
        "simulate", "--rig", "front_back", "--scene", "yard", "--drive", "turning", *few, "--out", "d.mcap"
    )
    assert outcome.code == 0
    assert outcome.out.splitlines() == ["wrote d.mcap", "wrote d.truth.toml"]
    truth = tomllib.loads(Path("d.truth.toml").read_text())
    assert set(read_extrinsics(Path("d.truth.toml")).T_target_source) == {"front", "rear"}
    first, last = truth["stops"]
    assert first["xyz_m"] == pytest.approx([0.0, 0.0, 0.0])
    assert abs(last["rpy_deg"][2]) > 175.0
    with Path("d.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    topics = {summary.channels[each].topic: n for each, n in summary.statistics.channel_message_counts.items()}
    assert topics == {"/lidar/front/points": 35, "/lidar/rear/points": 35, "/tf_static": 1}
    assert {each.source for each in read_snapshot("d.mcap").static_transforms} == {"front", "rear"}
    assert summary.statistics.message_start_time == first["first_stamp_ns"]
    assert summary.statistics.message_end_time == last["last_stamp_ns"]


def test_help_names_all_rigs_and_scenes(invoke: Invoke) -> None:
    words = set(invoke("simulate", "--help").out.replace(",", " ").replace(".", " ").split())
    assert words >= {*RIGS, *SCENES}


def test_nothing_is_left_of_a_failed_write(invoke: Invoke, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise OSError(28, "No space left on device", str(arguments[1]))

    monkeypatch.setattr("multilica.sinks.snapshots.write_snapshot_mcap", fail)
    outcome = invoke(*REQUEST, "--out", "chain.mcap")
    assert outcome.code == 1
    told = "multilica: System error: No space left on device (chain.mcap); free some space, or write elsewhere.\n"
    assert outcome.err == told
    assert list(Path().iterdir()) == []


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_fleet_lies_in_its_folder(invoke: Invoke) -> None:
    small = ("--vehicles", "2", "--logs", "3", "--frames", "1", "--keep-every", "90", "--workers", "1")
    outcome = invoke("simulate", "--fleet", "logs", *small)
    assert outcome.code == 0
    assert outcome.out.splitlines() == [
        "wrote logs (vehicles: 2, logs: 3, of these broken: 0, duplicates: 0; events: 1)",
        "wrote logs/fleet.truth.json",
    ]
    assert outcome.err.splitlines()[-1] == "3 of 3 logs"
    assert sorted(path.name for path in Path("logs").iterdir()) == ["fleet.truth.json", "v01", "v02"]
    again = invoke("simulate", "--fleet", "logs", *small)
    assert_one_sentence(again, 2)
    assert "logs exists already" in again.err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((), "Missing --rig, --scene, --out"),
        (("--rig", "edgar", "--out", "a.mcap"), "Missing --scene"),
        (("--rig", "edgar", "--scene", "street", "--out", "a.mcap", "--logs", "3"), "--logs is for a fleet"),
        (("--rig", "edgar", "--scene", "yard", "--out", "a.mcap", "--stops", "3"), "--stops is for a drive"),
        (("--fleet", "logs", "--drive", "yard"), "--drive is for a single recording"),
        (("--fleet", "logs", "--rig", "edgar"), "--rig is for a single recording"),
        (("--fleet", "logs", "--disturb", "rain"), "--disturb is for a single recording"),
        (("--fleet", "logs", "--vehicles", "0"), "0 vehicles"),
        (("--fleet", "logs", "--workers", "-1"), "'--workers': Input should be greater than or equal to 1"),
        ((*DRIVE, "--stops", "0"), "'--stops': Input should be greater than or equal to 1"),
        ((*DRIVE, "--parked", "-1"), "'--parked': Input should be greater than or equal to 0"),
        (("--fleet", "s3://bucket/logs"), "--fleet s3://"),
    ],
)
def test_one_recording_or_a_fleet(arguments: tuple[str, ...], named: str, invoke: Invoke) -> None:
    outcome = invoke("simulate", *arguments)
    assert_one_sentence(outcome, 2)
    assert named in outcome.err
    assert list(Path().iterdir()) == []
