# SPDX-License-Identifier: Apache-2.0
"""The metadata records of an MCAP file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Metadata

from multilica.ingest.containers.exact_reader import ExactReader
from multilica.ingest.containers.mcap_records import RECORD_HEAD
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.formats import FORMATS, named_format
from multilica.ingest.remote.remote_file import SourceFile

_MAX_BYTES = 1 << 20
"""Limit of a record; those of a vehicle or a snapshot take a few hundred bytes."""
_MAX_RECORDS = 100


def mcap_metadata(path: SourceFile) -> Iterator[Metadata]:
    """Yield the records that the summary lists; none of every other file, and of a file that cannot be read."""
    with suppress(DamagedRecordingError), damage_named(str(path)):
        if named_format(path) is not FORMATS["mcap"] or not (path.exists() and path.is_file()):
            return
        with closing(ExactReader(path)) as stream:
            summary = make_reader(stream).get_summary()
            for index in (summary.metadata_indexes if summary else [])[:_MAX_RECORDS]:
                if index.length <= _MAX_BYTES:
                    stream.seek(index.offset + RECORD_HEAD.size)
                    record = stream.read(index.length - RECORD_HEAD.size)
                    yield Metadata.read(ReadDataStream(BytesIO(record)))
