# SPDX-License-Identifier: Apache-2.0
"""The snapshot of a source, be it recorded or running."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from multilica.config import IngestConfig
from multilica.errors import UsageError
from multilica.ingest.address import is_live, without_secrets
from multilica.ingest.reading import DEFAULT_CONFIG, read_snapshot
from multilica.ingest.recording import MessageObserver
from multilica.ingest.source import PathLike, find_source, locate
from multilica.snapshot import Snapshot

__all__ = ["TakenSnapshot", "take_snapshot"]


@dataclass(frozen=True, slots=True, eq=False)
class TakenSnapshot:
    """A snapshot with what it was taken from.

    Args:
        source_bytes: size of the source; None of a running one.
        silent: topics of a running one that were to be taken, yet sent nothing that can be read.
    """

    snapshot: Snapshot
    source_bytes: int | None = None
    silent: tuple[str, ...] = ()


def take_snapshot(
    sources: Sequence[PathLike], *, config: IngestConfig = DEFAULT_CONFIG, observe: MessageObserver | None = None
) -> TakenSnapshot:
    """Read a recording, or listen to a running vehicle.

    Args:
        sources: as of `read_snapshot`, or a single ``ws://`` or ``wss://``.
        observe: told of each message of a running vehicle.

    Raises:
        MultilicaError: as of `read_snapshot`, or as of `listen`.
        UsageError: a running vehicle among other sources.
    """
    live = [str(source) for source in sources if is_live(source)]
    if not live:
        files = [locate(source) for source in sources]
        snapshot = read_snapshot(files, config=config)
        return TakenSnapshot(snapshot, sum(file.stat().st_size for file in find_source(files).files))
    if len(sources) > 1:
        raise UsageError(f"{without_secrets(live[0])} is given among other sources; give it alone.")
    from multilica.ingest.live import listen

    heard = listen(live[0], config=config, observe=observe)
    return TakenSnapshot(heard.snapshot, silent=heard.silent)
