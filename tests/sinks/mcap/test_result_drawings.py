# SPDX-License-Identifier: Apache-2.0
"""Drawings in result.mcap, in both encodings, with the layout that shows them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from foxglove.messages import SceneUpdate
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from multilica.sinks.drawing import VIOLATE
from multilica.sinks.mcap.result_mcap import DRAWING_TOPICS, ResultMcap, foxglove_layout
from tests.sinks.made_events import TARGET, TRUTH, made_events

DOCUMENTED_LAYOUT = Path(__file__).resolve().parents[3] / "docs" / "reference" / "foxglove-layout.json"
LINE_LIST, SPHERE, TEXT = 5, 2, 9


def write(path: Path, encoding: str) -> Path:
    with ResultMcap(path, encoding) as observe:
        for event in made_events("partial", at_stops=True):
            observe(event)
    return path


@pytest.fixture(scope="module")
def foxglove_file(tmp_path_factory):
    return write(tmp_path_factory.mktemp("drawings") / "foxglove.mcap", "foxglove")


@pytest.fixture(scope="module")
def scenes(foxglove_file) -> dict[str, dict[str, Any]]:
    """Per topic and id the scene entities, decoded by their own schema."""
    found = {}
    with foxglove_file.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(topics=DRAWING_TOPICS):
            pool = descriptor_pool.DescriptorPool()
            for each in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(each)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            found[channel.topic] = {entity.id: entity for entity in kind.FromString(message.data).entities}
    return found


@pytest.fixture(scope="module")
def markers(tmp_path_factory) -> dict[str, list[Any]]:
    with AnyReader([write(tmp_path_factory.mktemp("drawings") / "ros2.mcap", "ros2")]) as reader:
        connections = [one for one in reader.connections if one.topic in DRAWING_TOPICS]
        assert {one.ext.offered_qos_profiles[0].durability for one in connections} == {QosDurability.TRANSIENT_LOCAL}
        return {one.topic: reader.deserialize(raw, one.msgtype).markers for one, _, raw in reader.messages(connections)}


def test_kept_matches_are_short_and_in_the_targets_frame(scenes):
    entity = scenes["/matches"]["rear <- top"]
    assert entity.frame_id == "rear"
    kept, rejected = (np.array([(p.x, p.y, p.z) for p in lines.points]).reshape(-1, 2, 3) for lines in entity.lines)
    assert (len(kept), len(rejected)) == (20, 60)
    lengths_m = [np.linalg.norm(each[:, 1] - each[:, 0], axis=1) for each in (kept, rejected)]
    assert lengths_m[0].max() < 0.2
    assert np.median(lengths_m[1]) > 1.0


def test_the_merge_graph_stands_on_the_rig(scenes):
    graph = scenes["/merge_graph"]
    assert {entity.frame_id for entity in graph.values()} == {TARGET}
    edge = graph["rear <- front left/1"]
    assert [text.text for text in edge.texts] == ["0.10 reject"]
    start = edge.lines[0].points[0]
    waiting = graph["rear"].texts[0].pose.position
    assert (start.x, start.y) == (waiting.x, waiting.y)
    assert [text.text for text in graph["rear"].texts] == ["rear: not placed"]
    for name, entity in graph.items():
        assert all(text.billboard for text in entity.texts)
        colours = [
            tuple(round(255 * getattr(one.color, band)) for band in "rgb") for one in (*entity.texts, *entity.lines)
        ]
        assert len({*colours}) == 1
        assert (colours[0] == VIOLATE) is ("rear" in name)


def test_ellipsoids_have_diameters(scenes):
    sizes = scenes["/uncertainty"]["front left/1"].spheres[0].size
    np.testing.assert_allclose(sorted((sizes.x, sizes.y, sizes.z)), np.array([1e-3, 2e-3, 3e-3]) * 3.0 * 50.0 * 2.0)
    assert set(scenes["/uncertainty"]) == {"front left/1"}


def test_fields_of_view_hang_in_the_lidars_own_frames(scenes):
    assert {entity.id: entity.frame_id for entity in scenes["/fields_of_view"].values()} == {
        name: name for name in TRUTH
    }


def test_markers_draw_what_scene_entities_draw(scenes, markers):
    kinds = {LINE_LIST: "lines", SPHERE: "spheres", TEXT: "texts"}
    for topic, entities in scenes.items():
        drawn = {
            (entity.id, entity.frame_id, kind, len(getattr(entity, kind)))
            for entity in entities.values()
            for kind in kinds.values()
            if getattr(entity, kind)
        }
        assert drawn == {
            (one.ns, one.header.frame_id, kind, sum(m.ns == one.ns and kinds[m.type] == kind for m in markers[topic]))
            for one in markers[topic]
            for kind in [kinds[one.type]]
        }


def test_marker_ids_are_unique_within_a_namespace(markers):
    for found in markers.values():
        assert len({(one.ns, one.id) for one in found}) == len(found)


def test_the_schema_is_that_of_foxglove(foxglove_file):
    with foxglove_file.open("rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
    written = next(one.data for one in schemas if one.name == "foxglove.SceneUpdate")
    assert files_of(written) == files_of(SceneUpdate.get_schema().data)


def files_of(schema):
    """The files of a schema by name, without the names in JSON, which follow from those of the fields."""
    files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
    for message in (message for file in files for message in file.message_type):
        for field in message.field:
            field.ClearField("json_name")
    return {file.name: file for file in files}


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_the_layout_names_every_topic_that_it_shows(tmp_path, encoding):
    with write(tmp_path / "run.mcap", encoding).open("rb") as file:
        reader = make_reader(file)
        topics = {channel.topic for channel in reader.get_summary().channels.values()}
        layout = json.loads(next(one.data for one in reader.iter_attachments() if one.name == "foxglove-layout.json"))
    panels = layout["configById"]
    shown = set(panels["3D!multilica"]["topics"]) | {panels["RosOut!multilica"]["topicToRender"]}
    assert shown | {panels["RawMessages!multilica"]["topicPath"]} == topics - {"/tf", "/tf_static"}
    assert panels["3D!multilica"]["followTf"] == TARGET
    assert panels_in(layout["layout"]) == set(panels)


def test_the_layout_fits_the_schema_of_foxglove():
    schema = json.loads((Path(__file__).parent / "foxglove_layout.schema.json").read_text(encoding="utf-8"))
    layout = json.loads(foxglove_layout("top", {"top": "/lidar/top/points"}, ["/drive/stop_1"]))
    jsonschema.validate(layout, schema)
    layout["configById"]["3D!multilica"]["topics"]["/lidar/top/points"]["colour"] = "red"
    with pytest.raises(jsonschema.ValidationError, match="colour"):
        jsonschema.validate(layout, schema)


def panels_in(node: Any) -> set[str]:
    return {node} if isinstance(node, str) else panels_in(node["first"]) | panels_in(node["second"])


def test_the_documented_layout_is_that_of_the_demo():
    topics = {name: f"/lidar/{name}/points" for name in ("front", "left", "rear", "right")}
    assert DOCUMENTED_LAYOUT.read_text(encoding="utf-8") == foxglove_layout("left", topics)
