# SPDX-License-Identifier: Apache-2.0
"""Reading for as long as the LiDARs that lack frames can be expected to send some."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing

from multilica.ingest.recording import Message, Recording
from multilica.ingest.sampling import PATIENCE_NS
from multilica.ingest.taken_frames import TakenFrames

__all__ = ["until_full"]


def until_full(recording: Recording, streams: Mapping[str, TakenFrames], start_ns: int) -> Iterator[Message]:
    """Messages from a time on, until each stream has what it wants or those that lack frames have fallen silent.

    Args:
        streams: by topic; the caller lets them take each message before it asks for the next. The silent ones are
            marked as such.
    """
    heard_ns: dict[str, int] = {}
    with closing(recording.messages(streams.keys(), start_ns)) as messages:
        for message in messages:
            lacking = [stream for topic, stream in streams.items() if not stream.is_full and topic != message.topic]
            heard_ns[message.topic] = message.log_time_ns
            silent = [
                stream
                for stream in lacking
                if message.log_time_ns - heard_ns.setdefault(stream.topic, message.log_time_ns) > PATIENCE_NS
            ]
            if len(silent) == len(lacking) and lacking and streams[message.topic].is_full:
                for stream in silent:
                    stream.fell_silent = True
                return
            yield message
