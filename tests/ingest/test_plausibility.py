# SPDX-License-Identifier: Apache-2.0
"""Recordings that are readable and wrong: copies, other units, map coordinates, mirrored clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from multilica.geometry import Float32Array
from multilica.ingest import read_snapshot
from multilica.ingest.plausibility import plausibility_notes
from multilica.results.building import provenance_of
from multilica.simulate import simulate_snapshot
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.selection import NIGHTLY, some_of

SCENES = ("street", "parking", "garage", "tunnel", "open_field", "fence_field")
Change = Callable[[Float32Array], Float32Array]


@cache
def simulated(rig: str, scene: str) -> Snapshot:
    return simulate_snapshot(rig, scene, 3, frames=1, sensors="real" if NIGHTLY else "ideal").snapshot


def changed(snapshot: Snapshot, change: Change, only: str = "") -> Snapshot:
    lidars = [
        replace(lidar, scans=tuple(Scan(change(scan.points_m), scan.stamp_ns) for scan in lidar.scans))
        if only in ("", lidar.name)
        else lidar
        for lidar in snapshot.lidars
    ]
    return replace(snapshot, lidars=tuple(lidars))


def notes_of(snapshot: Snapshot) -> list[str]:
    return plausibility_notes(snapshot.lidars, snapshot.static_transforms)


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("rig", "scene"),
    some_of([(rig, scene) for rig in ("sides", "edgar", "truck", "helipr", "ring6") for scene in SCENES], 10),
)
def test_a_plausible_recording_has_no_note(rig: str, scene: str) -> None:
    assert notes_of(simulated(rig, scene)) == []


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda points: points * np.float32(1000.0), "they may be in millimetres"),
        (lambda points: points * np.float32(1e6), "they may be in another unit"),
        (lambda points: points * np.float32(1.0 / 0.3048), "the points may be in feet"),
        (lambda points: points + np.float32([691_000.0, 5_334_000.0, 520.0]), "they may be in map coordinates"),
    ],
)
@pytest.mark.parametrize("scene", ["street", "parking", "garage"])
def test_another_unit_is_told(scene: str, change: Change, text: str) -> None:
    (note,) = notes_of(changed(simulated("sides", scene), change))
    assert text in note
    assert note.endswith(".")


def test_one_lidar_in_millimetres_is_named() -> None:
    snapshot = changed(simulated("sides", "street"), lambda points: points * np.float32(1000.0), "left")
    (note,) = notes_of(snapshot)
    assert note.startswith("The points of left are at a median range of")


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("scene", ["street", "garage"])
def test_a_mirrored_cloud_is_told_by_the_static_transforms(scene: str, axis: int) -> None:
    sign = np.ones(3, np.float32)
    sign[axis] = -1.0
    snapshot = changed(simulated("edgar", scene), lambda points: points * sign, "left")
    assert any("the points of left fit those of the other LiDARs better" in note for note in notes_of(snapshot))
    assert notes_of(replace(snapshot, static_transforms=())) == []


def test_a_copy_under_another_name_is_told_wherever_notes_go(tmp_path: Path) -> None:
    snapshot = simulated("sides", "street")
    left = snapshot["left"]
    copied = replace(snapshot, lidars=(*snapshot.lidars, LidarScans("again", left.scans, topic="/again")))
    write_snapshot_mcap(copied, tmp_path / "a.mcap")
    found = read_snapshot(tmp_path / "a.mcap")
    (note,) = [note for note in found.notes if "identical" in note]
    assert note.startswith("again and left have identical points in 1 of 1 frames: one LiDAR may be recorded under two")
    assert note in provenance_of(found).input.notes
