# SPDX-License-Identifier: Apache-2.0
"""The opening of a source with the readers of its files."""

from contextlib import ExitStack, closing
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from multilica.errors import UnreadableSourceError
from multilica.ingest.containers.combined_recordings import JoinedRecording, SplitRecording
from multilica.ingest.containers.ouster_recording import with_turns
from multilica.ingest.formats import Content, FileFormat, detect_format
from multilica.ingest.locate import Source, locate
from multilica.ingest.point_files.cloud_files import CloudFiles
from multilica.ingest.recording import Recording
from multilica.ingest.remote.remote_file import SourceFile, path_on_disk


def open_source(source: Source) -> Recording:
    """Open the files of a source as one recording; raise UnreadableSourceError if none can be read."""
    if source.frames:
        return CloudFiles(source.frames)
    if source.recorders:
        return _open_recorders(source.recorders)
    files = source.recordings
    is_whole_file = len(files) == 1 and not source.missing
    return with_turns(_open_file(files[0]) if is_whole_file else _open_parts(files, source.missing))


def _open_file(file: SourceFile) -> Recording:
    found = detect_format(file)
    reader = _reader(found)
    if found.content is Content.FILE:
        return cast(Recording, reader.open_packed(path_on_disk(file, "a compressed file"), str(file), _open_unpacked))
    path = file if found.reads_ranges else path_on_disk(file, found.title)
    return cast(Recording, reader.open_file(path, str(file)))


def _open_unpacked(path: Path, where: str) -> Recording:
    found = detect_format(path)
    if found.content is not Content.RECORDING:
        raise UnreadableSourceError(f"{where} does not unpack to a recording; unpack it with `zstd -d`.")
    return cast(Recording, _reader(found).open_file(path, where))


def _reader(found: FileFormat) -> Any:  # noqa: ANN401 - a module
    return import_module(f"multilica.ingest.{found.reader}")


def _open_recorders(sources: tuple[Source, ...]) -> Recording:
    with ExitStack() as opened:
        parts = []
        for source in sources:
            parts.append((locate(source.label), open_source(source)))
            opened.enter_context(closing(parts[-1][1]))
        joined = JoinedRecording(parts)
        opened.pop_all()
    return joined


def _open_parts(files: tuple[SourceFile, ...], missing: tuple[str, ...]) -> Recording:
    parts: list[Recording] = []
    errors: list[UnreadableSourceError] = []
    for file in files:
        try:
            parts.append(_open_file(file))
        except UnreadableSourceError as error:
            errors.append(error)
    if not parts:
        raise errors[0]
    damage = str(errors[0]).rstrip(".") if errors else ""
    if missing:
        damage = f"the bag lacks {missing[0]}, which its metadata.yaml names"
    return SplitRecording(parts, damage)
