# SPDX-License-Identifier: Apache-2.0
"""The viewer shows every tab of a recording without a complaint."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rerun.experimental import ViewerClient

DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")]
pytestmark = pytest.mark.skipif(not DRIVERS, reason="apt-get install mesa-vulkan-drivers libvulkan1")
PATIENCE_S = 30.0


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> Iterator[ViewerClient]:
    monkeypatch.setenv("CI", "1")  # else it counts its runs
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    binary = str(Path(sys.executable).parent / "rerun")
    with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=binary) as client:
        yield client


def wait_until_shown(viewer: ViewerClient, path: Path) -> None:
    viewer.open(str(path))
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        state = viewer.get_state()
        if state.recordings and not state.loading and any(recording.timelines for recording in state.recordings):
            return
        time.sleep(0.1)
    pytest.fail(f"the viewer did not load {path} within {PATIENCE_S} s")


def show_each_tab(viewer: ViewerClient) -> Iterator[str]:
    """Open each tab, and each tab within it, and name it once it has been painted."""
    blueprint = viewer.get_blueprint().blueprint
    root = str(blueprint["/viewport"]["ViewportBlueprint"]["root_container"])
    yield from show_tabs_below(viewer, blueprint, next(key for key in blueprint if key.endswith(root)))


def show_tabs_below(viewer: ViewerClient, blueprint: dict[str, Any], key: str) -> Iterator[str]:
    container = blueprint[key].get("ContainerBlueprint")
    if container is None:
        return
    contents = container["contents"]
    for child in [contents] if isinstance(contents, str) else contents:  # a single one is no list
        if container["container_kind"] == "Tabs":
            container["active_tab"] = child
            viewer.set_blueprint(blueprint, of="recording")
            viewer.take_screenshot(max_size=64)
            parts = blueprint[f"/{child}"]
            yield next(part["display_name"] for part in parts.values() if "display_name" in part)
        yield from show_tabs_below(viewer, blueprint, f"/{child}")


def lasting_complaints(viewer: ViewerClient) -> list[tuple[str, Any]]:
    """What views still complain of when the chunks that they need have had time to arrive."""
    for _ in range(50):
        complaints = [(view.name, view.reports) for view in viewer.get_state().views if view.reports]
        if not complaints:
            break
        viewer.take_screenshot(max_size=64)
        time.sleep(0.1)
    return complaints


@pytest.mark.parametrize(
    ("outcome", "first", "timeline"), [("complete", "Result", "step"), ("partial", "Not placed: rear", "iteration")]
)
def test_no_view_of_any_tab_complains(viewer, recordings, outcome, first, timeline):
    wait_until_shown(viewer, recordings[outcome])
    state = viewer.get_state()
    recording = next(one for one in state.recordings if one.store_id == state.active_recording)
    last_step = next(timeline.end for timeline in recording.timelines if timeline.name == "step")
    assert (recording.current_timeline, recording.current_time) == ("step", last_step)
    viewer.set_time(timeline, sequence=last_step if timeline == "step" else 0)
    shown = []
    for tab in show_each_tab(viewer):
        shown.append(tab)
        assert not lasting_complaints(viewer), tab
    assert shown[0] == first
    assert {"Coarse + verify", "rear <- top", "Merge", "Log"} <= set(shown)
