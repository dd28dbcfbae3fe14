# SPDX-License-Identifier: Apache-2.0
"""The commands of the cookbook's section on exports."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from multilica import read_extrinsics
from multilica.exports import CLOUD_FORMATS, FORMATS
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import ROOT, Invoke
from tests.exports.made_rigs import made_run, name_frames
from tests.runs.made_runs import made_truth

_PAGE = (ROOT / "docs" / "cookbook.md").read_text(encoding="utf-8")
SECTION = _PAGE.partition("\n## Export for other programs\n")[2].partition("\n## ")[0]
LIDARS = ("front", "left", "rear")
JOINT = (
    '<joint name="{0}" type="fixed"><parent link="base_link"/><child link="lidar_{0}"/><origin xyz="{1} 0 1"/></joint>'
)
KIT = """\
schema = "multilica/extrinsics/1"
target = "sensor_kit_base_link"
[lidars.front]
xyz_m = [0.1, 0.2, 0.3]
rpy_deg = [0, 0, 90]
"""


@pytest.fixture
def folder(invoke: Invoke) -> Path:
    """The directory of the commands, with a run and the files that they read."""
    del invoke
    run = made_run(Path("run"))
    name_frames(run, **{name: f"lidar_{name}" for name in LIDARS})
    points = (Scan(np.eye(3, dtype=np.float32), 1),)
    write_snapshot_mcap(
        Snapshot(tuple(LidarScans(name, points, topic=f"/{name}") for name in LIDARS)), run / "result.mcap"
    )
    joints = "".join(JOINT.format(name, at) for at, name in enumerate(LIDARS))
    Path("car.urdf").write_text(f'<robot name="car">{joints}</robot>', encoding="utf-8")
    Path("kit.toml").write_text(KIT, encoding="utf-8")
    return Path()


def test_it_lists_every_format() -> None:
    cells = re.findall(r"^\| (`[^|]*`) \|", SECTION, re.MULTILINE)
    listed = [name for cell in cells for name in re.findall(r"`([a-z0-9-]+)`", cell)]
    assert [name for name in listed if name != "--to"] == [*FORMATS, *CLOUD_FORMATS]


def test_every_command_does_what_it_says(folder: Path, invoke: Invoke, capsys: pytest.CaptureFixture[str]) -> None:
    (commands,) = re.findall(r"^```console\n(.*?)^```", SECTION, re.MULTILINE | re.DOTALL)
    for line in commands.splitlines():
        words = shlex.split(line.removeprefix("$ "), comments=True)
        assert words.pop(0) == "multilica"
        outcome = invoke(*words)
        assert (outcome.code, outcome.err) == (ExitCode.DONE, "")
        assert Path(words[words.index("--out") + 1]).stat().st_size > 0
    expected = made_truth().between("front", "left").matrix
    for file, ends in (("rig.urdf", ("front", "left")), ("car.urdf", ("lidar_front", "lidar_left"))):
        np.testing.assert_allclose(read_extrinsics(folder / file).between(*ends).matrix, expected, atol=1e-9)
    launch = read_extrinsics(folder / "rig.launch.py")
    np.testing.assert_allclose(launch.between("base_link", "front").xyz_m, [0.0, 0.0, 1.0], atol=1e-9)
    kit = read_extrinsics(folder / "sensor_kit_calibration.yaml")
    np.testing.assert_allclose(kit.between("sensor_kit_base_link", "front").xyz_m, [0.1, 0.2, 0.3], atol=1e-9)
    (example,) = re.findall(r"^```python\n(.*?)^```", SECTION, re.MULTILINE | re.DOTALL)
    exec(compile(example, "cookbook.md", "exec"), {})  # noqa: S102
    assert capsys.readouterr().out == "[0. 0. 1.]\n"
    assert read_extrinsics("rig.csv").members == {"base_link", *(f"lidar_{name}" for name in LIDARS)}
