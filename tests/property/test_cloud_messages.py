# SPDX-License-Identifier: Apache-2.0
"""Any layout of points, put into a message by the libraries of others, gives its points back."""

from __future__ import annotations

from dataclasses import replace

import foxglove.messages as fox
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multilica.errors import UnreadableSourceError
from multilica.ingest.message_types import Cloud, decode_cloud
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import PointCloud2
from tests.ingest.support.recording_writers import CLOUD, header, ros1_types, ros2_types
from tests.property.test_pointcloud2 import Case, clouds, expected

STAMP_NS = 1_700_000_000_123_456_789
KINDS = fox.PackedElementFieldNumericType
FOXGLOVE_KINDS = {
    1: KINDS.Int8, 2: KINDS.Uint8, 3: KINDS.Int16, 4: KINDS.Uint16,
    5: KINDS.Int32, 6: KINDS.Uint32, 7: KINDS.Float32, 8: KINDS.Float64,
}  # fmt: skip
STORES = {"cdr": ros2_types(), "ros1": ros1_types()}


def decoded(message_type: str, encoding: str, data: bytes) -> Cloud:
    return decode_cloud(RawMessage("/a", message_type, encoding, 5, memoryview(data), "A scan"))


def assert_found(found: Cloud, case: Case) -> None:
    points, intensity = expected(case)
    np.testing.assert_array_equal(found.scan.points_m, points)
    np.testing.assert_array_equal(found.scan.intensity, intensity)
    assert (found.scan.stamp_ns, found.frame_id) == (STAMP_NS, "roof")


def ros_message(cloud: PointCloud2, encoding: str, *, little_endian: bool = True) -> bytes:
    store = STORES[encoding]
    field = store.types["sensor_msgs/msg/PointField"]
    message = store.types[CLOUD](
        header=header(store, "/roof", STAMP_NS),
        height=cloud.height,
        width=cloud.width,
        fields=[
            field(name=each.name, offset=each.offset, datatype=each.datatype, count=each.count) for each in cloud.fields
        ],
        is_bigendian=cloud.big_endian,
        point_step=cloud.point_step,
        row_step=cloud.row_step,
        data=np.frombuffer(cloud.data, np.uint8),
        is_dense=False,
    )
    if encoding == "ros1":
        return bytes(store.serialize_ros1(message, CLOUD))
    return bytes(store.serialize_cdr(message, CLOUD, little_endian=little_endian))


@pytest.mark.slow
@pytest.mark.parametrize("encoding", STORES)
@settings(max_examples=60, deadline=None)
@given(case=clouds())
def test_ros_messages(encoding: str, case: Case) -> None:
    assert_found(decoded(CLOUD, encoding, ros_message(case.cloud, encoding)), case)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(case=clouds())
def test_messages_of_machines_of_the_other_byte_order(case: Case) -> None:
    assert_found(decoded(CLOUD, "cdr", ros_message(case.cloud, "cdr", little_endian=False)), case)


@pytest.mark.slow
@pytest.mark.parametrize("encoding", STORES)
@settings(max_examples=60, deadline=None)
@given(case=clouds(), data=st.data())
def test_messages_that_were_cut_off(encoding: str, case: Case, data: st.DataObject) -> None:
    message = ros_message(case.cloud, encoding)
    # The last byte says whether any point is invalid, which the points say themselves.
    whole = len(message) - 1
    with pytest.raises(UnreadableSourceError, match="A scan cannot be unpacked: it ends too early"):
        decoded(CLOUD, encoding, message[: data.draw(st.integers(0, whole - 1))])


@pytest.mark.parametrize("encoding", STORES)
def test_an_impossible_number_of_fields(encoding: str) -> None:
    message = bytearray(ros_message(PointCloud2((), 0, 1, 1, 1, b"\7" * 65536), encoding))
    place = {"cdr": 32, "ros1": 29}[encoding]
    assert message[place : place + 4] == b"\0\0\0\0"
    message[place : place + 4] = b"\xff" * 4
    with pytest.raises(UnreadableSourceError, match="claims points of 4294967295 fields; the limit is 1024"):
        decoded(CLOUD, encoding, bytes(message))


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(clouds())
def test_foxglove_messages(case: Case) -> None:
    row = one_row(case)
    cloud = row.cloud
    fields = [
        fox.PackedElementField(name=each.name, offset=each.offset, type=FOXGLOVE_KINDS[each.datatype])
        for each in cloud.fields
    ]
    stamp = fox.Timestamp(STAMP_NS // 10**9, STAMP_NS % 10**9)
    message = fox.PointCloud(
        timestamp=stamp, frame_id="roof", point_stride=cloud.point_step, fields=fields, data=bytes(cloud.data)
    )
    assert_found(decoded("foxglove.PointCloud", "protobuf", message.encode()), row)


def one_row(case: Case) -> Case:
    """The first row, in the byte order that Foxglove has."""
    cloud = case.cloud
    width = 0 if cloud.big_endian or not cloud.height else cloud.width
    data = cloud.data[: width * cloud.point_step]
    return Case(replace(cloud, width=width, height=1, big_endian=False, data=data), case.rows[:width])
