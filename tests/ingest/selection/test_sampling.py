# SPDX-License-Identifier: Apache-2.0
"""Some messages of a long recording cost no more than they must."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from multilica.ingest.recording import Messages, RawMessage
from multilica.ingest.selection.sampling import sampled


class Counted:
    """A recording with a message each nanosecond, which counts those that are read."""

    is_indexed = True

    def __init__(self) -> None:
        self.read = 0

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        for time_ns in range(start_ns, 200):
            self.read += 1
            yield RawMessage(next(iter(topics)), "", "", time_ns, b"", "")


@pytest.mark.parametrize(("jump_ns", "read"), [(40, 4), (60, 52)])
def test_what_lies_between_is_read_only_where_it_is_near(jump_ns: int, read: int) -> None:
    recording = Counted()
    found = list(sampled(recording, ["/points"], [0, 50], 100, most=2, jump_ns=jump_ns))
    assert [(index, message.log_time_ns) for index, message in found] == [(0, 0), (0, 1), (1, 50), (1, 51)]
    assert recording.read == read
