# SPDX-License-Identifier: Apache-2.0
"""The way from a running vehicle to a snapshot."""

from contextlib import closing

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnknownNameError, UsageError
from multilica.ingest.live.live_recording import LiveRecording
from multilica.ingest.recording import MessageObserver
from multilica.ingest.remote.address import require_valid, without_secrets
from multilica.ingest.selection.topics import choose_topics, unread_notes
from multilica.ingest.selection.window import collect_frames
from multilica.ingest.snapshot_reader import TakenSnapshot, assemble_snapshot
from multilica.ingest.transforms.static_transforms import read_static_transforms

__all__ = ["listen"]


def listen(url: str, *, config: IngestConfig | None = None, observe: MessageObserver | None = None) -> TakenSnapshot:
    """Take `config.frames` frames of each LiDAR from a vehicle that runs foxglove_bridge or a foxglove-sdk server.

    Stops when all frames have arrived, or after `config.timeout_s` with those that have. Reconnects if the connection
    is lost.

    Args:
        url: ``ws://HOST:PORT`` or ``wss://``.
        config: topics and number of frames; without topics, all point cloud topics that are offered at first.
        observe: called with each chosen topic and 0, then with each message.

    Raises:
        UnreadableSourceError: no such server answers.
        UnfitSnapshotError: there are no point clouds, or no LiDAR sends any; with `config.strict`, any fault.
        UnknownNameError: a topic is not offered in time.
        UsageError: a window is configured, or the address is not valid.
    """
    config = config or IngestConfig()
    report: MessageObserver = observe or (lambda _topic, _count: None)
    require_valid(url)
    label = without_secrets(url)
    if config.start_s or config.start_at or config.window_s or config.window == "auto":
        raise UsageError(f"Found a window for {label}; a live snapshot begins now and takes one scan after the other.")
    with closing(LiveRecording(url, config.frames, config.timeout_s, report)) as recording:
        recording.wait_for(lambda: _is_offered(recording, config))
        given = choose_topics(recording, config.topics, label, config.only)
        for topic in sorted(given):
            report(topic, 0)
        window = collect_frames(recording, given.keys(), config, label)
        if not window.clouds:
            raise UnfitSnapshotError(
                f"{label} sent no readable scan on {', '.join(sorted(given))} within {config.timeout_s:g} s; "
                "check that the LiDARs run, or give a longer --timeout."
            )
        if config.strict and window.faults:
            raise UnfitSnapshotError(f"{label} is refused, as ingest.strict is set: {window.faults[0]}")
        static = read_static_transforms(recording)
        unread = unread_notes(recording)
    silent = tuple(sorted(given.keys() - window.clouds.keys()))
    return TakenSnapshot(assemble_snapshot(label, given, window, static, notes=unread), silent=silent)


def _is_offered(recording: LiveRecording, config: IngestConfig) -> bool:
    try:
        choose_topics(recording, config.topics, "", config.only)
    except (UnknownNameError, UnfitSnapshotError):
        return False
    return True
