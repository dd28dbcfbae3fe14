# SPDX-License-Identifier: Apache-2.0
"""Clouds that a node joined from those of several LiDARs, by poses that it was given."""

import re
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, lengths
from multilica.ingest.message_types import Cloud

_LARGER = 1.2
"""A joined cloud has as many times the points of each of its LiDARs, or more."""
_STEPS = 12
_PROBES = 8
_MOST_PAIRS = 3
_MIN_STEP_M = 1e-3
_STEP_TOLERANCE_M = 2e-4
"""Distances between points of 100 m change by a tenth of this where they are moved as float32."""
_MAX_RESIDUAL_M = 2e-3
_MOVED = 1e-3
"""Metres, or radians, beyond which points were moved."""
_NAMES = re.compile(r"concat|merged|fused|combined", re.IGNORECASE)


def merged_topics(clouds: Mapping[str, Sequence[Cloud]]) -> dict[str, list[str]]:
    """Find topics whose clouds hold those of other topics, all points moved by one rigid transform.

    Distances from one point to the next do not change in this, to a tenth of a millimetre, and no two LiDARs
    measure the same ones.

    Args:
        clouds: topic -> its frames.

    Returns:
        topic of joined clouds -> topics of the LiDARs in it.
    """
    found: dict[str, list[str]] = {}
    for topic, frames in clouds.items():
        held = [other for other, parts in clouds.items() if other != topic and _holds(frames, parts)]
        if held:
            found[topic] = held
    return found


def may_be_merged(topic: str) -> bool:
    """Return whether a topic is named like joined clouds, whose points may be thinned out beyond recognition."""
    return _NAMES.search(topic) is not None


def _holds(frames: Sequence[Cloud], parts: Sequence[Cloud]) -> bool:
    """Return whether a frame holds the points of the frame of another topic with the nearest stamp, moved."""
    pairs = [(one.scan, part.scan) for one, part in product(frames, parts)]
    pairs = [(one, part) for one, part in pairs if len(one.points_m) >= _LARGER * len(part.points_m) > 0]
    pairs.sort(key=lambda pair: abs(pair[0].stamp_ns - pair[1].stamp_ns))
    return any(_is_moved_part(one.points_m, part.points_m) for one, part in pairs[:_MOST_PAIRS])


def _is_moved_part(cloud_m: np.ndarray, part_m: np.ndarray) -> bool:
    steps_m, wanted_m = (np.asarray(lengths(np.diff(points_m, axis=0))) for points_m in (cloud_m, part_m))
    order = np.argsort(steps_m)
    pairs = [
        (start, place)
        for start in _probes(wanted_m)
        if (place := _place(steps_m, order, wanted_m[start : start + _STEPS])) is not None
    ]
    if 2 * len(pairs) < _PROBES:
        return False
    inside, own = (
        np.concatenate([points_m[at : at + _STEPS + 1] for at in places]).astype(np.float64)
        for points_m, places in ((cloud_m, [place for _, place in pairs]), (part_m, [start for start, _ in pairs]))
    )
    middle_m, own_middle_m = inside.mean(axis=0), own.mean(axis=0)
    rotation, _ = Rotation.align_vectors(inside - middle_m, own - own_middle_m)
    shift_m = middle_m - rotation.apply(own_middle_m)
    is_rigid = lengths(rotation.apply(own) + shift_m - inside).max() < _MAX_RESIDUAL_M
    return bool(is_rigid and max(np.linalg.norm(shift_m), rotation.magnitude()) > _MOVED)


def _probes(steps_m: FloatArray) -> list[int]:
    """Return the beginnings of up to `_PROBES` rows of points that all differ, spread over the cloud."""
    short = np.concatenate([[0], np.cumsum(steps_m < _MIN_STEP_M)])
    starts = np.flatnonzero(short[_STEPS:] == short[:-_STEPS]) if len(short) > _STEPS else np.empty(0, int)
    return starts[np.linspace(0, len(starts) - 1, _PROBES).astype(int)].tolist() if len(starts) >= _PROBES else []


def _place(steps_m: FloatArray, order: np.ndarray, wanted_m: FloatArray) -> int | None:
    """Return where steps occur in a row among others (N,), which `order` sorts; None if nowhere."""
    rarest = int(np.argmax(wanted_m))
    bounds = wanted_m[rarest] + np.array([-_STEP_TOLERANCE_M, _STEP_TOLERANCE_M])
    first, last = np.searchsorted(steps_m, bounds, sorter=order)
    places = order[first:last] - rarest
    places = places[(places >= 0) & (places + _STEPS <= len(steps_m))]
    rows_m = steps_m[places[:, None] + np.arange(_STEPS)]
    fitting = places[(np.abs(rows_m - wanted_m) < _STEP_TOLERANCE_M).all(axis=1)]
    return int(fitting[0]) if len(fitting) else None
