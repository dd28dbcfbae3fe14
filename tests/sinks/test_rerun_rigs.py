# SPDX-License-Identifier: Apache-2.0
"""Two rigs laid over each other, read back."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilica.errors import UsageError
from multilica.extrinsics import Extrinsics
from multilica.sinks.rerun_reading import read_recorded_cloud, read_recorded_document
from multilica.sinks.rerun_rigs import LaidRig, write_rigs
from multilica.sinks.rerun_viewer import viewer_picture
from tests.sinks.made_events import LIDARS, TARGET, TRUTH
from tests.sinks.recording_reader import Recording, blueprint_names

DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")]
CLOUD = np.random.default_rng(4).normal(scale=5.0, size=(300, 3)).astype(np.float32)


def rigs():
    clouds = dict.fromkeys(LIDARS, CLOUD)
    return [LaidRig(label, Extrinsics(TARGET, TRUTH), clouds) for label in ("A", "B")]


@pytest.fixture
def written(tmp_path):
    write_rigs(tmp_path / "deep" / "both.rrd", rigs(), "# Two runs")
    return tmp_path / "deep" / "both.rrd"


def test_each_rig_has_its_clouds_in_its_own_frames_and_colour(written):
    recording = Recording(written)
    colours = set()
    for label in ("A", "B"):
        (row,) = recording.rows[f"/rigs/{label}/rear/points"]
        assert row["CoordinateFrame:frame"] == [f"{label}/rear"]
        np.testing.assert_array_equal(np.array(row["Points3D:positions"], dtype=np.float32), CLOUD)
        colours.add(row["Points3D:colors"][0])
        (pose,) = recording.rows[f"/rigs/{label}/rear/sensor"]
        np.testing.assert_allclose(pose["Transform3D:translation"][0], TRUTH["rear"].xyz_m, rtol=1e-6)
        assert pose["Transform3D:parent_frame"] == [f"{label}/rig"]
    assert len(colours) == 2
    assert {"display", "A/rig", "B/rig", "A/top", "B/front left/1"} <= recording.frames
    assert recording.rows["/summary"][0]["TextDocument:text"] == ["# Two runs"]


def test_the_blueprint_opens_on_both(written):
    assert any({"Both rigs", "A", "B", "Summary"} <= names for names in blueprint_names(written))


@pytest.mark.skipif(not DRIVERS, reason="apt-get install mesa-vulkan-drivers libvulkan1")
def test_it_is_drawn_without_a_screen_although_it_has_no_timeline(written):
    picture = Image.open(io.BytesIO(viewer_picture(written, (640, 400)))).convert("RGB")
    assert len(picture.getcolors(640 * 400)) > 100


def test_nothing_else_is_left_behind(written):
    assert [path.name for path in written.parent.iterdir()] == ["both.rrd"]


def test_a_directory_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="give another --recording FILE"):
        write_rigs(tmp_path / "file" / "both.rrd", rigs(), "")


def test_clouds_and_document_come_back_from_the_recording_of_a_run(recordings):
    document = read_recorded_document(recordings["partial"])
    assert document["status"] == "partial"
    assert document["timing_s"] == {}
    figures = document["stages"]["preprocess"]
    for lidar in LIDARS:
        assert len(read_recorded_cloud(recordings["partial"], lidar)) == figures[lidar]["points"]
    assert len(read_recorded_cloud(recordings["partial"], "nobody")) == 0
