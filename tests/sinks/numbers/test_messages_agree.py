# SPDX-License-Identifier: Apache-2.0
"""Messages of result.mcap hold the numbers of the result, in both encodings."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.sinks.made_events import TRUTH, made_events
from tests.sinks.made_scans import STAMP_NS
from tests.sinks.numbers import made_numbers as made
from tests.sinks.numbers.expected import (
    LARGEST_AFTER_DEG,
    LARGEST_AFTER_MM,
    LARGEST_BEFORE_DEG,
    LARGEST_BEFORE_MM,
    POSED,
    farthest,
)
from tests.sinks.numbers.readers import (
    assert_pose,
    mcap_messages,
    pose_of,
    pose_of_message,
    turn_of_rpy_deg,
    xyz_of,
)

SHOWN_FRAME = {made.FRONT: made.FRONT, made.REAR: f"uncertain/{made.REAR}"}


@pytest.fixture(params=["foxglove", "ros2"], scope="module")
def messages(request, numbered_mcap):
    return mcap_messages(numbered_mcap(request.param))


def transforms_of(messages):
    """Each transform by parent and child: p_parent = T @ p_child."""
    if "/tf" in messages:
        return {
            (one.parent_frame_id, one.child_frame_id): pose_of_message(one.translation, one.rotation)
            for one in messages["/tf"][0].transforms
        }
    return {
        (one.header.frame_id, one.child_frame_id): pose_of_message(one.transform.translation, one.transform.rotation)
        for one in messages["/tf_static"][0].transforms
    }


def test_transforms_place_the_children_in_their_parents(messages):
    transforms = transforms_of(messages)
    assert {*transforms} == {("base", made.TOP), *((made.TOP, SHOWN_FRAME[lidar]) for lidar in POSED)}
    for lidar in POSED:
        np.testing.assert_allclose(transforms[made.TOP, SHOWN_FRAME[lidar]], TRUTH[lidar].matrix, atol=1e-9)
    base = pose_of((0.0, 0.0, made.GROUND_HEIGHT_M), turn_of_rpy_deg(made.GROUND_RPY_DEG))
    np.testing.assert_allclose(transforms["base", made.TOP], base, atol=1e-9)


def test_metrics_hold_poses_fitness_and_times(messages):
    (message,) = messages["/metrics"]
    metrics = json.loads(getattr(message, "data", message))
    assert (metrics["placed"], metrics["uncertain"]) == (2, 1)
    lidars = {each["name"]: each for each in metrics["lidars"]}
    for lidar in POSED:
        assert_pose(lidars[lidar], TRUTH[lidar].matrix)
        assert lidars[lidar]["fitness"] == made.POSE_FITNESS[lidar]
        assert lidars[lidar]["rmse_m"] == pytest.approx(made.POSE_RMSE_MM[lidar] / 1000.0)
    assert {each["name"]: each["duration_s"] for each in metrics["stages"]} == made.SECONDS


def test_the_schema_of_the_metrics_names_what_they_hold(numbered_mcap):
    with numbered_mcap("foxglove").open("rb") as file:
        ((schema, _, message),) = make_reader(file).iter_messages(topics=["/metrics"])
    declared, metrics = json.loads(schema.data)["properties"], json.loads(message.data)
    assert {*metrics} == {*declared}
    for name in ("lidars", "stages"):
        for entry in metrics[name]:
            assert {*entry} == {*declared[name]["items"]["properties"]}


def test_messages_are_numbered_in_order(numbered_mcap):
    with numbered_mcap("foxglove").open("rb") as file:
        sequences = [message.sequence for _, _, message in make_reader(file).iter_messages()]
    assert sequences == [*range(len(sequences))]


def test_clouds_have_their_points_where_their_fields_say(messages):
    expected = {each.cloud.lidar: each.cloud.points_m for each in made_events() if hasattr(each, "cloud")}
    clouds = {topic: each for topic, (each, *_) in messages.items() if topic.startswith("/lidar/")}
    assert len(clouds) == len(expected)
    for topic, cloud in clouds.items():
        step = cloud.point_stride if hasattr(cloud, "point_stride") else cloud.point_step
        offsets = {field.name: field.offset for field in cloud.fields}
        assert (step, offsets) == (12, {"x": 0, "y": 4, "z": 8})
        points_m = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, 3)
        stamp = (
            (cloud.timestamp.seconds, cloud.timestamp.nanos)
            if hasattr(cloud, "timestamp")
            else (cloud.header.stamp.sec, cloud.header.stamp.nanosec)
        )
        assert stamp == divmod(STAMP_NS, 10**9)
        assert getattr(cloud, "is_dense", True)
        name = next(name for name in expected if name.replace(" ", "_")[:4] in topic)
        np.testing.assert_array_equal(points_m, expected[name].astype("<f4"))


def ellipsoids_of(messages):
    """Per LiDAR pose and whole axes of its ellipsoid, and the text beside it."""
    (message,) = messages["/uncertainty"]
    found = {}
    if hasattr(message, "entities"):
        for entity in message.entities:
            (sphere,) = entity.spheres
            text = "".join(text.text for text in entity.texts)
            found[entity.id] = (sphere.pose.position, sphere.pose.orientation, sphere.size, text)
        return found
    texts = {marker.ns: marker.text for marker in message.markers if marker.text}
    for marker in message.markers:
        if not marker.text:
            pose = marker.pose
            found[marker.ns] = (pose.position, pose.orientation, marker.scale, texts.get(marker.ns, ""))
    return found


def test_ellipsoids_are_the_covariance_of_the_position(messages):
    ellipsoids = ellipsoids_of(messages)
    sigmas, enlarged = map(float, re.search(r"\((\d+) sigma x (\d+)\)", ellipsoids[made.REAR][3]).groups())
    assert {*ellipsoids} == {*POSED}
    for lidar, (position, orientation, size, _) in ellipsoids.items():
        pose = pose_of_message(position, orientation)
        half_m = np.array(xyz_of(size)) / 2.0 / (sigmas * enlarged)
        covariance = pose[:3, :3] @ np.diag(half_m**2) @ pose[:3, :3].T
        np.testing.assert_allclose(covariance, made.covariance_of(lidar)[3:, 3:], rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], TRUTH[lidar].xyz_m, atol=1e-9)


def edge_labels_of(messages):
    """Text and place by pair."""
    (message,) = messages["/merge_graph"]
    if hasattr(message, "entities"):
        texts = [(entity.id, text.text, text.pose) for entity in message.entities for text in entity.texts]
    else:
        texts = [(marker.ns, marker.text, marker.pose) for marker in message.markers if marker.text]
    return {name: (text, xyz_of(pose.position)) for name, text, pose in texts if "<-" in name}


def test_edges_of_the_graph_have_the_fitness_of_their_pair(messages):
    labels = edge_labels_of(messages)
    assert len(labels) == len(made.PAIR_FITNESS)
    for name, (text, xyz_m) in labels.items():
        first, second = name.split(" <- ")
        assert float(text.split()[0]) == pytest.approx(made.PAIR_FITNESS[first, second], abs=0.005001)
        start_m, end_m = TRUTH[first].xyz_m, TRUTH[second].xyz_m
        np.testing.assert_allclose(xyz_m, start_m + 0.4 * (end_m - start_m), atol=1e-6)


def test_lines_of_the_log_have_the_figures(messages):
    text = "\n".join(getattr(line, "message", "") or line.msg for line in messages["/log"])
    read = ", ".join(f"{lidar} with 1,200 points in 2 frame(s)" for lidar in (made.FRONT, made.REAR, made.TOP))
    assert f"calibrating 3 LiDARs of drive.mcap: {read}" in text
    assert (
        "2 distinct poses, clique 0 has the most evidence: -0.9; 90 points agree, 1 lie in proven-empty space" in text
    )
    for (target, source), fitness in made.PAIR_FITNESS.items():
        rmse_m = made.PAIR_RMSE_MM[target, source] / 1000.0
        assert f"{target} <- {source} from clique 0: fitness {fitness:.3f}, RMSE {rmse_m:.3f} m after" in text
    assert (
        f"refined over 2 pairs: largest disagreement {LARGEST_BEFORE_MM:.1f} mm, {LARGEST_BEFORE_DEG:.3f} deg before, "
        f"{LARGEST_AFTER_MM:.1f} mm, {LARGEST_AFTER_DEG:.3f} deg after"
    ) in text
    assert f"{made.TOP} <- {made.REAR} does not fit the others: 0.021 m off" in text
    assert f"the target is {made.GROUND_HEIGHT_M:.3f} m above ground" in text
    for snapshot in made.DEVIATIONS:
        lidar, off_mm, off_deg = farthest(snapshot)
        assert f"snapshot {snapshot}: agrees: {lidar} is off most, by {off_mm:.1f} mm, {off_deg:.3f} deg" in text
