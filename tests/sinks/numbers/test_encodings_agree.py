# SPDX-License-Identifier: Apache-2.0
"""Both encodings of result.mcap draw the same lines, texts and ellipsoids at the same places."""

from __future__ import annotations

import numpy as np
import pytest

from tests.sinks.numbers.readers import mcap_messages, pose_of_message, xyz_of

TOPICS = ("/matches", "/merge_graph", "/fields_of_view", "/uncertainty")
SPHERE, LINES, TEXT = 2, 5, 9


@pytest.fixture(scope="module")
def drawn(numbered_mcap):
    return {encoding: mcap_messages(numbered_mcap(encoding)) for encoding in ("foxglove", "ros2")}


def at(pose):
    return pose_of_message(pose.position, pose.orientation)


def points_at(pose, points):
    places = np.array([xyz_of(point) for point in points])
    return places @ at(pose)[:3, :3].T + at(pose)[:3, 3]


def drawings_of_foxglove(message):
    """Per drawing its frame, segments, texts with their places, and ellipsoids with their sizes."""
    return {
        entity.id: (
            entity.frame_id,
            [points_at(line.pose, line.points) for line in entity.lines if line.points],
            [(text.text, at(text.pose)) for text in entity.texts],
            [(xyz_of(sphere.size), at(sphere.pose)) for sphere in entity.spheres],
        )
        for entity in message.entities
    }


def drawings_of_ros2(message):
    found = {}
    for marker in message.markers:
        _, lines, texts, spheres = found.setdefault(marker.ns, (marker.header.frame_id, [], [], []))
        scale = xyz_of(marker.scale)
        if marker.type == LINES:
            assert scale[0] > 0.0 == scale[1] == scale[2]
            lines.append(points_at(marker.pose, marker.points))
        elif marker.type == TEXT:
            assert scale[0] == scale[1] == 0.0 < scale[2]
            texts.append((marker.text, at(marker.pose)))
        elif marker.type == SPHERE:
            spheres.append((scale, at(marker.pose)))
    return found


@pytest.mark.parametrize("topic", TOPICS)
def test_both_draw_the_same(drawn, topic):
    foxglove = drawings_of_foxglove(drawn["foxglove"][topic][0])
    ros2 = drawings_of_ros2(drawn["ros2"][topic][0])
    assert {*foxglove} == {*ros2}
    for name, (frame, lines, texts, spheres) in foxglove.items():
        other_frame, other_lines, other_texts, other_spheres = ros2[name]
        assert frame == other_frame
        for segments_m, others_m in zip(lines, other_lines, strict=True):
            np.testing.assert_allclose(segments_m, others_m, atol=1e-9)
        for (what, pose), (other, other_pose) in zip([*texts, *spheres], [*other_texts, *other_spheres], strict=True):
            assert what == pytest.approx(other) if isinstance(what, list) else what == other
            np.testing.assert_allclose(pose, other_pose, atol=1e-9)
    shown = {"/uncertainty": 3, "/merge_graph": 2}.get(topic, 1)
    assert any(drawing[shown] for drawing in foxglove.values())
