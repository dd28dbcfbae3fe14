# SPDX-License-Identifier: Apache-2.0
"""Surface matches of a made-up run: the first points of both clouds, 2 cm apart, 1 cm from the plane."""

from __future__ import annotations

import numpy as np

from multilica import events
from multilica.results import SurfaceMatches, SurfaceResiduals

COUNT = 30


def made_surfaces(clouds, registrations, placed):
    for found in registrations.values():
        points = (clouds[name][:COUNT] for name in (found.target, found.source))
        distances = np.full(COUNT, 0.02), np.full(COUNT, 0.01)
        matches = SurfaceMatches(found.target, found.source, found.T_target_source, *points, *distances)
        yield events.SurfacesMatched(matches)
    for name in placed:
        yield events.ResidualsMeasured(SurfaceResiduals(name, clouds[name][:COUNT], np.linspace(0.0, 0.1, COUNT)))
