# SPDX-License-Identifier: Apache-2.0
"""Rerun's viewer."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING

from multilica.errors import ViewerError
from multilica.scratch import scratch_folder
from multilica.sinks.rerun.rrd_process import whole_part
from multilica.system_libraries import apt_command

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

_COMMAND = (sys.executable, "-m", "rerun")
# The viewer also listens for data.
_LOOPBACK = ("--bind", "127.0.0.1")
_NO_DRIVER = (
    "pictures without a screen need a Vulkan driver, on Debian and Ubuntu "
    f"`{apt_command(('libudev1', 'libvulkan1', 'mesa-vulkan-drivers'))}`"
)
_TIMEOUT_S = 60.0
_PAUSE_S = 0.4
_SAME_IN_A_ROW = 3
_SMALL_PX = 320


def show_recording(recording: Path) -> None:
    """Open a recording in a window until it is closed.

    Raises:
        ViewerError: there is no screen, or the viewer fails.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewerError(
            f"Cannot open {recording} in a window: neither DISPLAY nor WAYLAND_DISPLAY is set; write a picture with "
            "--png FILE, or open the file with `rerun` on a machine with a screen."
        )
    with whole_part(recording) as whole, _environment() as environment:
        command = [*_COMMAND, *_LOOPBACK, str(whole)]
        code = subprocess.run(command, env=environment, check=False).returncode  # noqa: S603
    if code != 0:
        raise ViewerError(
            f"Rerun's viewer failed on {recording} with exit code {code}; write a picture with --png FILE."
        )


def serve_catalog(datasets: Mapping[str, Path], host: str, port: int) -> None:
    """Serve folders of recordings as a catalog, to which Rerun's viewer connects, until the process is stopped.

    Args:
        datasets: folder of each dataset by name.
        host: address to listen on.

    Raises:
        ViewerError: the server fails.
    """
    folders = [argument for name, path in datasets.items() for argument in ("--dataset", f"{name}={path}")]
    command = [*_COMMAND, "server", "--host", host, "--port", str(port), *folders]
    with (
        _environment(CI="1") as environment,
        subprocess.Popen(command, env=environment, start_new_session=True) as process,  # noqa: S603
    ):
        try:
            code = process.wait()
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
    if code != 0:
        raise ViewerError(f"Rerun's server failed with exit code {code}; is port {port} in use? Choose another --port.")


def viewer_picture(recording: Path, size_px: tuple[int, int]) -> bytes:
    """Draw the first view of a recording as PNG, without a screen.

    Raises:
        ViewerError: the viewer does not start (no Vulkan driver), or does not finish drawing.
    """
    try:
        with whole_part(recording) as whole, _headless_viewer(size_px) as viewer:
            viewer.open(str(whole.resolve()))
            for _ in _polls(0.1):
                if any(one.timelines for one in viewer.get_state().recordings):
                    return _settled_picture(viewer, recording)
    except (ConnectionError, RuntimeError, TimeoutError) as error:
        raise ViewerError(f"Rerun's viewer does not answer ({error}); {_NO_DRIVER}.") from error
    raise ViewerError(f"Rerun's viewer did not load {recording} within {_TIMEOUT_S:.0f} s; is it a recording?")


@contextmanager
def _environment(**variables: str) -> Iterator[dict[str, str]]:
    """Provide the variables of a process of Rerun, which leaves a folder of its own where temporary files are."""
    with scratch_folder() as folder:
        yield {**os.environ, "TMPDIR": str(folder), **variables}


@contextmanager
def _headless_viewer(size_px: tuple[int, int]) -> Iterator[ViewerClient]:
    """Start a viewer on a free port; stop it at the end of the block."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = int(free.getsockname()[1])
    arguments = [*_LOOPBACK, "--headless", "--hide-welcome-screen", "--port", str(port)]
    arguments += ["--window-size", f"{size_px[0]}x{size_px[1]}"]
    # It counts its runs unless CI is set; it starts a process of its own, so both end as a group.
    with (
        _environment(CI="1") as environment,
        tempfile.TemporaryFile() as output,
        subprocess.Popen(  # noqa: S603
            [*_COMMAND, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=environment,
            start_new_session=True,
        ) as process,
    ):
        try:
            yield _connect(process, port, output)
        finally:
            os.killpg(process.pid, signal.SIGTERM)


def _polls(pause_s: float) -> Iterator[None]:
    """Yield until the time is over, with pauses."""
    end_s = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < end_s:
        yield
        time.sleep(pause_s)


def _connect(process: subprocess.Popen[bytes], port: int, output: IO[bytes]) -> ViewerClient:
    from rerun.experimental import ViewerClient

    for _ in _polls(0.1):
        if process.poll() is not None:
            break
        with suppress(ConnectionError):
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
    output.seek(0)
    lines = output.read().decode(errors="replace").split("\n")
    last_line = next((line.strip() for line in reversed(lines) if line.strip()), "nothing")
    raise ViewerError(f"Rerun's viewer does not start without a screen (last line: {last_line}); {_NO_DRIVER}.")


def _settled_picture(viewer: ViewerClient, recording: Path) -> bytes:
    """Return the picture once it stops changing: chunks arrive on demand, messages of the viewer fade."""
    last, same = b"", 0
    for _ in _polls(_PAUSE_S):
        picture = viewer.take_screenshot(max_size=_SMALL_PX)
        same = same + 1 if picture == last else 0
        if same >= _SAME_IN_A_ROW:
            return bytes(viewer.take_screenshot())
        last = picture
    raise ViewerError(f"Rerun's viewer did not finish drawing {recording} within {_TIMEOUT_S:.0f} s.")
