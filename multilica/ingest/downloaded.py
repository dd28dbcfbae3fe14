# SPDX-License-Identifier: Apache-2.0
"""Remote recordings of formats that are read from disk only."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from multilica.errors import MultilicaError
from multilica.ingest.recording import Messages, Recording, Span
from multilica.ingest.remote_file import RemoteFile, SourceFile

__all__ = ["open_on_disk"]


def open_on_disk(file: SourceFile, what: str, open_file: Callable[[Path], Recording]) -> Recording:
    """Open a file of the disk, or a copy of a remote one, which is fetched once.

    Args:
        what: the format, for messages, for instance ``"a ROS 1 bag"``.

    Raises:
        UnreadableSourceError: a remote file is too large to be copied, or cannot be read.
    """
    return Downloaded(file, what, open_file) if isinstance(file, RemoteFile) else open_file(file)


class Downloaded:
    """A copy of a remote recording, which bears the name of the original in all that it says."""

    def __init__(self, file: RemoteFile, what: str, open_file: Callable[[Path], Recording]) -> None:
        self._original = str(file)
        self._copy = file.copy(what)
        with self._original_named():
            self._recording = open_file(self._copy)
        self.format = self._recording.format
        self.topics = self._recording.topics
        self.damage = self._recording.damage
        self.is_indexed = self._recording.is_indexed

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Of the copy."""
        with self._original_named():
            return self._recording.span_ns(topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Of the copy."""
        with self._original_named():
            for message in self._recording.messages(topics, start_ns):
                yield replace(message, origin=self._renamed(message.origin))

    def close(self) -> None:
        """Close the copy, which stays for as long as somebody holds the remote file."""
        self._recording.close()

    @contextmanager
    def _original_named(self) -> Iterator[None]:
        try:
            yield
        except MultilicaError as error:
            error.args = (self._renamed(str(error)),)
            raise

    def _renamed(self, text: str) -> str:
        return text.replace(str(self._copy), self._original)
