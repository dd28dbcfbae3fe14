# SPDX-License-Identifier: Apache-2.0
"""Clouds and documents read from recordings."""

from __future__ import annotations

from multilica.sinks.rerun.reading import read_recorded_cloud, read_recorded_document
from tests.sinks.made_events import LIDARS


def test_clouds_and_document_are_read_back(recordings):
    document = read_recorded_document(recordings["partial"])
    assert document.status == "partial"
    assert document.timing_s == {}
    figures = document.stages.preprocess
    for lidar in LIDARS:
        assert len(read_recorded_cloud(recordings["partial"], lidar)) == figures[lidar].points
    assert len(read_recorded_cloud(recordings["partial"], "nobody")) == 0
