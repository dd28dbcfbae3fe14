# SPDX-License-Identifier: Apache-2.0
"""Any layout of PointCloud2 gives its points back."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multilica.pointcloud2 import DATATYPES, PointCloud2, PointField, decode_points, encode_points

STRUCT_CODES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 8: "d"}
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}
FLOATS = st.one_of(st.floats(width=32), st.sampled_from([float("nan"), float("inf"), float("-inf"), -0.0]))


@dataclass(frozen=True)
class Case:
    cloud: PointCloud2
    rows: list[dict[str, float]]
    """Every value of every point, as it was written."""


@st.composite
def clouds(draw: st.DrawFn) -> Case:
    names = ["x", "y", "z", *draw(st.lists(st.sampled_from(["intensity", "ring", "t", "rgb"]), unique=True))]
    fields: list[PointField] = []
    offset = 0
    # Nearly every driver puts x, y, z side by side as float32, which chance would hardly ever do.
    is_usual = draw(st.booleans())
    side_by_side = draw(st.permutations("xyz"))
    for name in [*side_by_side, *names[3:]] if is_usual else draw(st.permutations(names)):
        is_packed = is_usual and name in "xyz"
        offset += draw(st.integers(0, 5)) if name == side_by_side[0] or not is_packed else 0
        datatype = 7 if is_packed else draw(st.sampled_from(sorted(DATATYPES)))
        count = draw(st.integers(1, 3)) if name not in "xyz" else draw(st.integers(0, 1))
        fields.append(PointField(name, offset, datatype, count))
        offset += SIZES[datatype] * max(count, 1)
    point_step = offset + draw(st.integers(0, 6))
    width, height = draw(st.integers(0, 5)), draw(st.integers(0, 4))
    row_step = width * point_step + draw(st.sampled_from([0, 0, 0, 1, 4, 9]))
    big_endian = draw(st.booleans())
    data = bytearray(draw(st.binary(min_size=height * row_step, max_size=height * row_step)))
    rows: list[dict[str, float]] = []
    for row in range(height):
        for column in range(width):
            values = {field.name: draw(_values(field.datatype)) for field in fields}
            for field in fields:
                code = (">" if big_endian else "<") + STRUCT_CODES[field.datatype]
                struct.pack_into(code, data, row * row_step + column * point_step + field.offset, values[field.name])
            rows.append(values)
    return Case(PointCloud2(tuple(fields), width, height, point_step, row_step, bytes(data), big_endian), rows)


def _values(datatype: int) -> st.SearchStrategy[float]:
    if datatype in (7, 8):
        return FLOATS
    limits = np.iinfo(DATATYPES[datatype])
    return st.integers(int(limits.min), int(limits.max))


def expected(case: Case) -> tuple[np.ndarray, np.ndarray | None]:
    """Point after point in plain Python: the definition that the vectorised code has to meet."""
    kept = [row for row in case.rows if all(np.isfinite(np.float32(row[axis])) for axis in "xyz")]
    points = np.array([[row[axis] for axis in "xyz"] for row in kept], np.float64).astype(np.float32).reshape(-1, 3)
    has_intensity = any(field.name == "intensity" for field in case.cloud.fields) and case.rows
    intensity = np.array([row["intensity"] for row in kept], np.float64).astype(np.float32) if has_intensity else None
    return points, intensity


def expected_rings(case: Case) -> np.ndarray | None:
    """None if there is no such field, or one of its numbers is none of a ring."""
    kept = [row for row in case.rows if all(np.isfinite(np.float32(row[axis])) for axis in "xyz")]
    if not case.rows or "ring" not in case.rows[0] or not all(row["ring"] in range(2**16) for row in kept):
        return None
    return np.array([row["ring"] for row in kept], np.uint16)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(clouds())
def test_any_layout_gives_its_points_back(case: Case) -> None:
    points, intensity, rings, _ = decode_points(case.cloud)
    expected_points, expected_intensity = expected(case)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, expected_points)
    np.testing.assert_array_equal(intensity, expected_intensity)
    np.testing.assert_array_equal(rings, expected_rings(case))


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(clouds(), st.data())
def test_lying_sizes_are_refused_or_read_inside_the_data(case: Case, data: st.DataObject) -> None:
    lie = data.draw(st.sampled_from(["width", "height", "point_step", "row_step"]))
    size = data.draw(st.one_of(st.integers(0, 200), st.sampled_from([2**31 - 1, 2**32 - 1])))
    cloud = replace(case.cloud, **{lie: size})
    sentence, points = "", np.empty((0, 3))
    try:
        points = decode_points(cloud).points_m
    except ValueError as error:
        sentence = str(error)
    assert "\n" not in sentence
    assert len(points) <= max(len(cloud.data), 1)
    assert np.isfinite(points).all()


@pytest.mark.slow
@given(st.lists(st.tuples(*[st.floats(width=32, allow_nan=False, allow_infinity=False)] * 4)), st.booleans())
def test_encoding_and_decoding_is_exact(rows: list[tuple[float, ...]], with_intensity: bool) -> None:
    table = np.array(rows, np.float32).reshape(-1, 4)
    given_intensity = table[:, 3] if with_intensity else None
    points, intensity, *_ = decode_points(encode_points(table[:, :3], given_intensity))
    np.testing.assert_array_equal(points, table[:, :3])
    if with_intensity and len(table):
        np.testing.assert_array_equal(intensity, table[:, 3])
    else:
        assert intensity is None


@pytest.mark.parametrize(
    ("offsets", "point_step"),
    [((0, 4, 8), 12), ((8, 4, 0), 12), ((0, 4, 8), 26), ((14, 10, 18), 22), ((1, 5, 9), 13), ((0, 8, 4), 16)],
)
def test_large_clouds_are_as_small_ones(offsets: tuple[int, ...], point_step: int) -> None:
    points = np.random.default_rng(0).normal(size=(40_000, 3)).astype(np.float32)
    points[[0, 20_000, 39_999], [0, 1, 2]] = np.nan
    data = np.full((len(points), point_step), 0xFF, np.uint8)
    for axis, offset in enumerate(offsets):
        data[:, offset : offset + 4] = points[:, axis : axis + 1].copy().view(np.uint8)
    fields = tuple(PointField(name, offset, 7) for name, offset in zip("xyz", offsets, strict=True))
    found, *_ = decode_points(PointCloud2(fields, 8_000, 5, point_step, 0, data.reshape(-1)))
    np.testing.assert_array_equal(found, points[np.isfinite(points).all(axis=1)])


XYZ = tuple(PointField(name, 4 * index, 7) for index, name in enumerate("xyz"))


@pytest.mark.parametrize(
    ("cloud", "sentence"),
    [
        (PointCloud2(XYZ, 10, 1, 12, 120, b"\0" * 119), "takes 120 bytes, but has 119"),
        (PointCloud2(XYZ, 2**32 - 1, 2**32 - 1, 2**32 - 1, 0, b"\0" * 64), "but has 64"),
        (PointCloud2(XYZ, 1, 1, 8, 8, b"\0" * 8), "field z at byte 8 of points of 8 bytes"),
        (PointCloud2(XYZ, 5, 1, 0, 0, b""), "of points of 0 bytes"),
        (PointCloud2(XYZ, 2, 2, 12, 20, b"\0" * 96), "a row step of 20 bytes"),
        (PointCloud2(XYZ[:2], 1, 1, 12, 12, b"\0" * 12), "has no field z; its fields are: x, y"),
        (PointCloud2((), 1, 1, 12, 12, b"\0" * 12), "its fields are: none"),
        (PointCloud2((*XYZ[:2], PointField("z", 8, 9)), 1, 1, 12, 12, b"\0" * 12), "unknown datatype 9"),
    ],
)
def test_contradictions_are_named(cloud: PointCloud2, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        decode_points(cloud)


@pytest.mark.parametrize("datatype", [0, 8])
def test_an_intensity_that_cannot_be_read_is_left_out(datatype: int) -> None:
    """Its type is unknown, or it does not lie within the point."""
    cloud = PointCloud2((*XYZ, PointField("intensity", 12, datatype)), 1, 1, 16, 16, b"\0" * 16)
    found = decode_points(cloud)
    assert found.intensity is None
    assert len(found.points_m) == 1


def test_the_points_are_read_from_the_data_without_a_copy_of_it() -> None:
    backing = np.zeros(12, np.uint8)
    cloud = PointCloud2(XYZ, 1, 1, 12, 12, memoryview(backing))
    backing.view("<f4")[:] = [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(decode_points(cloud)[0], [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize("row_step", [1, 12, 24, 48, 1000])
def test_points_without_gaps_ignore_the_row_step(row_step: int) -> None:
    points_m = np.arange(12, dtype=np.float32).reshape(4, 3)
    cloud = PointCloud2(XYZ, 2, 2, 12, row_step, points_m.tobytes())
    np.testing.assert_array_equal(decode_points(cloud)[0], points_m)


def test_a_single_row_ignores_its_row_step() -> None:
    cloud = encode_points(np.ones((3, 3), np.float32))
    np.testing.assert_array_equal(decode_points(replace(cloud, row_step=5))[0], np.ones((3, 3)))
