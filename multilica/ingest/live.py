# SPDX-License-Identifier: Apache-2.0
"""From a running vehicle to a snapshot."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.ingest.address import require_valid, without_secrets
from multilica.ingest.choice import choose_topics, unread_notes
from multilica.ingest.live_recording import LiveRecording
from multilica.ingest.reading import DEFAULT_CONFIG, assemble_snapshot
from multilica.ingest.recording import MessageObserver
from multilica.ingest.static_transforms import read_static_transforms
from multilica.ingest.window import collect_frames
from multilica.snapshot import Snapshot

__all__ = ["LiveSnapshot", "listen"]


@dataclass(frozen=True, slots=True, eq=False)
class LiveSnapshot:
    """What was heard.

    Args:
        silent: topics that were to be taken, yet sent nothing that can be read.
    """

    snapshot: Snapshot
    silent: tuple[str, ...] = ()


def listen(url: str, *, config: IngestConfig = DEFAULT_CONFIG, observe: MessageObserver | None = None) -> LiveSnapshot:
    """Take `config.frames` frames of each LiDAR of a vehicle that runs foxglove_bridge or a server of foxglove-sdk.

    Ends when all frames are there, or after `config.timeout_s` with those that are. A lost connection is made again.

    Args:
        url: ``ws://HOST:PORT`` or ``wss://``.
        config: which topics, how many frames; all point cloud topics that are offered at first, if it names none.
        observe: told of each topic that is waited for, then of each message.

    Raises:
        UnreadableSourceError: no such server answers.
        UnfitSnapshotError: no point clouds are offered, or no LiDAR sends any; any is at fault where `config.strict`.
        UnknownNameError: a topic is not offered before time is up.
        UsageError: the window is to be chosen, or the address is not valid.
    """
    require_valid(url)
    label = without_secrets(url)
    if config.start_s or config.start_at or config.window_s or config.window == "auto":
        raise UsageError(
            f"Found a window to choose with {label}; a live snapshot begins now and takes one scan after the other."
        )
    with closing(LiveRecording(url, config.frames, config.timeout_s, observe or _ignore)) as recording:
        recording.wait_for(lambda: _is_offered(recording, config))
        given = choose_topics(recording, config.topics, label, config.only)
        for topic in sorted(given):
            (observe or _ignore)(topic, 0)
        window = collect_frames(recording, given.keys(), config, label)
        if not window.clouds:
            raise UnfitSnapshotError(_silence(given, config, label))
        if config.strict and window.faults:
            raise UnfitSnapshotError(f"{label} is refused, for ingest.strict is set: {window.faults[0]}")
        static = read_static_transforms(recording)
        unread = unread_notes(recording)
    silent = tuple(sorted(given.keys() - window.clouds.keys()))
    return LiveSnapshot(assemble_snapshot(label, given, window, static, notes=unread), silent)


def _is_offered(recording: LiveRecording, config: IngestConfig) -> bool:
    try:
        choose_topics(recording, config.topics, "", config.only)
    except (UnknownNameError, UnfitSnapshotError):
        return False
    return True


def _silence(given: dict[str, str], config: IngestConfig, label: str) -> str:
    return (
        f"{label} sent no scan that can be read on {', '.join(sorted(given))} within {config.timeout_s:g} s; "
        "check that the LiDARs run, or give a longer --timeout."
    )


def _ignore(topic: str, count: int) -> None:
    del topic, count
