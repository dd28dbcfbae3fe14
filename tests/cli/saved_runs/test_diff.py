# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w

from multilica.checks import poses_of
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence
from tests.sinks.made_documents import made_document


@pytest.fixture
def runs(invoke: Invoke, two_lidars: Path) -> tuple[Path, Path]:
    """Two runs on one input, the second with a coarser GICP."""
    options = ("--target", "left", "--quiet")
    invoke("calibrate", two_lidars, "--out", "a", *options)
    invoke("calibrate", two_lidars, "--out", "b", *options, "--set", "fine.voxel_size_m=0.4")
    return Path("a"), Path("b")


@pytest.mark.slow
@pytest.mark.in_turn
def test_two_runs_are_told_apart(runs: tuple[Path, Path], invoke: Invoke) -> None:
    outcome = invoke("diff", *runs)
    assert outcome.code == ExitCode.DIFFERENT
    assert "MOVED" in outcome.out
    assert "The runs first differ at: config\n  fine.voxel_size_m: 0.15 -> 0.4\nafter it: fine, merge" in outcome.out
    assert invoke("diff", *runs, "--within-m", "1", "--within-deg", "10").code == ExitCode.DONE
    document = json.loads(invoke("diff", *runs, "--json").out)
    assert document["moves"]["right"]["moved"] is True
    assert document["moves"]["right"]["sigmas"] > 0.0
    same = invoke("diff", runs[0], runs[0] / "recording.rrd")
    assert same.code == ExitCode.DONE
    assert "Both runs place the same LiDARs at the same places." in same.out


def test_a_missing_run_is_refused(invoke: Invoke) -> None:
    assert_one_sentence(invoke("diff", "nowhere", "nowhere"), ExitCode.INPUT)


def test_a_target_that_a_file_of_poses_lacks_counts(invoke: Invoke, tmp_path: Path) -> None:
    run, poses = tmp_path / "result.json", tmp_path / "poses.toml"
    run.write_text(json.dumps(made_document("complete")))
    known = poses_of(run)
    others = {
        name: RigidTransform("base", name, known.between("top", name).matrix) for name in ("front left/1", "rear")
    }
    poses.write_text(tomli_w.dumps(extrinsics_table(Extrinsics("base", others))))
    for pair in ((run, poses), (poses, run)):
        outcome = invoke("diff", *pair)
        assert outcome.code == ExitCode.DIFFERENT
        assert "top: " in outcome.out
        assert "note: a file of poses has no stages, so only poses are compared" in outcome.out
        assert "at any step" not in outcome.out


def test_what_neither_run_placed_is_told(invoke: Invoke, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(made_document("partial")))
    outcome = invoke("diff", path, path)
    assert outcome.code == ExitCode.DONE
    assert "rear: placed neither in A nor in B. rear is not placed: it shares too few surfaces" in outcome.out
    assert outcome.out.endswith("Both runs place the same LiDARs at the same places; neither places rear.\n")
