# SPDX-License-Identifier: Apache-2.0
"""Whole documents of every kind, and their readers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import tomli_w
from mcap.writer import Writer

from multilica.config import CalibrationConfig, load_config, with_overrides
from multilica.diagnosis import Explanation, explain
from multilica.exports import FORMATS, read_extrinsics
from multilica.extrinsics import Extrinsics, extrinsics_table, read_extrinsics_table
from multilica.ingest import frames_recorded, live, read_snapshot
from multilica.ingest.transforms import read_prior, read_urdf
from multilica.runs.run_documents import read_run, read_run_document
from multilica.simulate import simulate_snapshot
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.snapshots import write_snapshot_mcap
from tests.ingest.support.recording_writers import make_snapshot
from tests.sinks.made_documents import made_document
from tests.sinks.made_events import made_events


@dataclass(frozen=True)
class Document:
    """A document: its whole content, and what reads it from a file."""

    content: bytes
    read: Callable[[Path], object]


def documents() -> dict[str, Document]:
    """Name -> document."""
    result = json.dumps(made_document()).encode()
    simulation = simulate_snapshot("sides", "street", 1, frames=1)
    names = simulation.snapshot
    truth = tomli_w.dumps(extrinsics_table(simulation.truth)).encode()
    config = tomli_w.dumps(CalibrationConfig().model_dump(mode="json")).encode()
    channels = [{"id": 1, "topic": "/a", "encoding": "cdr", "schemaName": "sensor_msgs/msg/PointCloud2", "schema": ""}]
    return {
        "config.toml": Document(config, load_config),
        "setting.txt": Document(b"preprocess.voxel_size_m=0.05", _set),
        "truth.toml": Document(truth, read_extrinsics_table),
        "prior.toml": Document(truth, lambda path: read_prior(str(path), names)),
        "rig.urdf": Document(_URDF, read_urdf),
        **{
            f"rig{suffix}": Document(_exchanged(name, suffix, simulation.truth), read_extrinsics)
            for name, suffix in _EXCHANGED
        },
        "result.json": Document(result, _saved),
        "attached.json": Document(result, _attached),
        "result.mcap": Document(_recorded("result.mcap"), _explained),
        "result.rrd": Document(_recorded("result.rrd"), _explained),
        "metadata.json": Document(b'["a note", "another note"]', _metadata),
        "bridge.json": Document(json.dumps({"op": "advertise", "channels": channels}).encode(), _advertised),
    }


_EXCHANGED = (
    ("ros2-launch", ".py"),
    ("ros2-launch", ".xml"),
    ("ros2-launch", ".launch.yaml"),
    ("ros2-static", ".sh"),
    ("autoware", ".yaml"),
    ("kitti", ".txt"),
    ("opencalib", ".json"),
    ("csv", ".csv"),
)


def _exchanged(name: str, suffix: str, truth: Extrinsics) -> bytes:
    return FORMATS[name].content(truth, Path(f"rig{suffix}"))


_URDF = b"""<?xml version="1.0"?>
<robot name="car"><link name="base"/><link name="left"/><link name="top"/>
<joint name="a" type="fixed"><parent link="base"/><child link="left"/><origin xyz="0.1 0.2 0.3" rpy="0 0 1.57"/></joint>
<joint name="b" type="fixed"><parent link="base"/><child link="top"/><origin xyz="1 2 3"/></joint></robot>
"""


def _set(path: Path) -> object:
    return with_overrides(CalibrationConfig(), [path.read_bytes().decode("utf-8", "replace")])


def _saved(path: Path) -> object:
    read_run(path)
    return _explained(path)


def _attached(path: Path) -> object:
    with path.with_suffix(".mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_attachment(0, 0, "result.json", "application/json", path.read_bytes())
        writer.finish()
    return read_run_document(path.with_suffix(".mcap"))


def _metadata(path: Path) -> object:
    text = path.read_bytes().decode("utf-8", "replace")
    recording = path.with_suffix(".mcap")
    write_snapshot_mcap(make_snapshot(), recording, metadata={"frames": text, "notes": text})
    frames_recorded([recording])
    return read_snapshot(recording)


def _recorded(name: str) -> bytes:
    """The content of a made-up run's recording or `result.mcap`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        with RerunRecording(path) if path.suffix == ".rrd" else ResultMcap(path) as sink:
            for event in made_events():
                sink(event)
        return path.read_bytes()


def _advertised(path: Path) -> object:
    return live._text(path.read_bytes().decode("utf-8", "replace"))


def _explained(path: Path) -> Explanation:
    return explain(read_run_document(path).document)
