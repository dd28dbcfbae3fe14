# SPDX-License-Identifier: Apache-2.0
"""Report and picture of what a run left on disk."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilica.config import CalibrationConfig
from multilica.errors import SourceNotFoundError, UnreadableSourceError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.runs.run_report import contents_of_run, picture_of_run, recording_of_run
from multilica.sinks.report.contents import contents_of
from multilica.sinks.report.page import report_html
from multilica.sinks.run_directory import open_run
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import TRUTH, made_events

DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")]


def leave_run(folder: Path, outcome: str, *, killed_after: int | None = None, prior: Extrinsics | None = None) -> Path:
    with open_run(folder, CalibrationConfig(target="top")) as run:
        for event in list(made_events(outcome, prior=prior))[:killed_after]:
            run(event)
    if killed_after is not None:
        (folder / "report.html").unlink()  # a killed process writes none
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("runs")
    return {
        "partial": leave_run(folder / "partial", "partial"),
        "killed": leave_run(folder / "killed", "partial", killed_after=26),
    }


@pytest.mark.slow
def test_the_clouds_and_poses_come_back(runs):
    contents = contents_of_run(runs["partial"])
    assert set(contents.document.poses) == {"front left/1", "top"}
    for name, cloud in contents.clouds.items():
        assert cloud.shape == (600, 3)
        assert np.linalg.norm(TRUTH[name].apply(cloud), axis=1).min() < 8.0


@pytest.mark.in_turn
@pytest.mark.slow
def test_scored_points_and_competing_pose_are_read_back(runs):
    state = RunState()
    for event in made_events("partial"):
        state(event)
    first, anew = contents_of(state).scored, contents_of_run(runs["partial"]).scored
    refused = {("rear", "top"), ("rear", "front left/1")}  # the latter was matched as `front left/1 <- rear`
    assert {pair for pair, poses in anew.items() if poses} == refused
    for pair in refused:
        assert len(anew[pair]) == len(first[pair]) == 2
        for one, other in zip(anew[pair], first[pair], strict=True):
            assert max(one.T_target_source.distance_to(other.T_target_source)) < 1e-5
            np.testing.assert_allclose(one.points_m, other.points_m, atol=1e-5)
            np.testing.assert_array_equal(one.labels, other.labels)


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_report_made_anew_tells_the_same(runs):
    anew, first = (
        report_html(contents_of_run(runs["partial"])),
        (runs["partial"] / "report.html").read_text(encoding="utf-8"),
    )
    for words in (
        "<h1>1 of 3 LiDARs is not placed. rear: it shares",
        "What helps",
        "fine: the pair was registered but",
    ):
        assert words in anew
        assert words in first


@pytest.mark.in_turn
@pytest.mark.slow
def test_notes_are_shown_again(tmp_path):
    turned = TRUTH["rear"] @ RigidTransform.from_xyz_rpy("rear", "rear", (0, 0, 0), (0, 0, 2))
    run = leave_run(tmp_path / "run", "complete", prior=Extrinsics("top", TRUTH | {"rear": turned}))
    for page in (report_html(contents_of_run(run)), (run / "report.html").read_text(encoding="utf-8")):
        assert "Note: rear is turned by 115 deg about its z axis" in page


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_killed_run_gets_its_report(runs):
    text = report_html(contents_of_run(runs["killed"]))
    assert "The run was cut off" in text
    assert "ended early" in text
    assert text.count("<img ") == 3  # as recorded, from above, from the side and at an angle


@pytest.mark.slow
@pytest.mark.skipif(not DRIVERS, reason="apt-get install mesa-vulkan-drivers libvulkan1")
def test_the_viewer_draws_the_recording(runs):
    image = Image.open(io.BytesIO(picture_of_run(runs["partial"], (800, 500)))).convert("RGB")
    assert image.size == (800, 500)
    assert len(image.getcolors(800 * 500)) > 200


@pytest.mark.parametrize("size_px", [(0, 100), (100, 10), (100_000, 100)])
def test_odd_sizes_are_refused(size_px, runs):
    with pytest.raises(UsageError, match="expected 64 to 8192 per side"):
        picture_of_run(runs["partial"], size_px)


@pytest.mark.slow
def test_a_recording_is_found_whole_or_cut_off_or_named_itself(runs):
    whole = runs["partial"] / "recording.rrd"
    assert recording_of_run(runs["partial"]) == recording_of_run(whole) == whole
    assert recording_of_run(runs["killed"]).name == "recording.partial.rrd"


@pytest.mark.slow
def test_what_is_no_run_is_told_in_a_sentence(runs, tmp_path):
    with pytest.raises(SourceNotFoundError, match="No run at"):
        recording_of_run(tmp_path / "nowhere")
    (tmp_path / "torn.rrd").write_bytes(b"RRF2 and then nothing")
    with pytest.raises(UnreadableSourceError, match=r"torn\.rrd"):
        report_html(contents_of_run(tmp_path / "torn.rrd"))
    shutil.copy(runs["partial"] / "result.json", tmp_path / "result.json")
    with pytest.raises(SourceNotFoundError, match="no recording"):
        report_html(contents_of_run(tmp_path))


@pytest.mark.parametrize("missing", ["lidars", "pairs", "decisions", "input", "versions"])
def test_a_result_that_is_not_whole_is_told_in_a_sentence(missing, runs, tmp_path):
    shutil.copytree(runs["partial"], tmp_path / "run")
    document = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    del document[missing]
    (tmp_path / "run" / "result.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(UnreadableSourceError, match="is not a whole result"):
        report_html(contents_of_run(tmp_path / "run"))
