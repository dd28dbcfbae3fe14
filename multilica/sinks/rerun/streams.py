# SPDX-License-Identifier: Apache-2.0
"""Streams of Rerun that leave no thread behind."""

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings


def send_blueprint(stream: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """Send a blueprint as `stream.send_blueprint` does, and disconnect the stream that it is made with.

    Rerun keeps that one with its two threads for the life of the process.
    """
    native = bindings.new_blueprint(
        application_id=rr.get_application_id(recording=stream) or "",
        make_default=False,
        make_thread_default=False,
        default_enabled=True,
    )
    made = rr.RecordingStream._from_native(native)  # noqa: SLF001
    made.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(made)  # noqa: SLF001
    held = made.memory_recording()
    bindings.send_blueprint(held.storage, make_active=True, make_default=True, recording=stream.to_native())
    made.disconnect()


def end_threads() -> None:
    """End the threads of streams that nothing refers to any more."""
    bindings.flush_and_cleanup_orphaned_recordings()
