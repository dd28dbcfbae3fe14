# SPDX-License-Identifier: Apache-2.0
"""The viewer shows every tab of a recording without a complaint."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import rerun as rr
from rerun.experimental import ViewerClient

from multilica import events
from multilica.sinks.files.atomic import partial_path
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.scene import RerunScene
from tests.sinks.conftest import record
from tests.sinks.made_events import made_events

DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")]
pytestmark = pytest.mark.skipif(not DRIVERS, reason="apt-get install mesa-vulkan-drivers libvulkan1")
PATIENCE_S = 30.0
STEPS = 10


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


def show_every_view(viewer: ViewerClient) -> None:
    """Replace the tabs by one grid, so that all views are painted at once."""
    blueprint = viewer.get_blueprint(of="recording").blueprint
    views = [key[1:] for key in blueprint if key.startswith("/view/") and key.count("/") == 2]
    root = str(blueprint["/viewport"]["ViewportBlueprint"]["root_container"])
    kept = {key: parts for key, parts in blueprint.items() if not key.startswith("/container/")}
    grid = {"ContainerBlueprint": {"container_kind": "Grid", "contents": views}}
    viewer.set_blueprint(kept | {f"/container/{root}": grid}, of="recording")


def steps_of(viewer: ViewerClient) -> list[int]:
    """Ten steps, the first and the last among them."""
    (recording,) = viewer.get_state().recordings
    timeline = next(timeline for timeline in recording.timelines if timeline.name == "step")
    assert timeline.end > STEPS
    return [timeline.end * part // (STEPS - 1) for part in range(STEPS)]


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


@pytest.mark.parametrize("outcome", ["complete", "uncertain", "partial", "failed", "cut off"])
def test_no_view_complains_when_stepping_back(viewer, tmp_path, outcome):
    path = cut_off(tmp_path / "run.rrd") if outcome == "cut off" else record(tmp_path / "run.rrd", outcome)
    wait_until_shown(viewer, path)
    show_every_view(viewer)
    for step in reversed(steps_of(viewer)):
        viewer.set_time("step", sequence=step, play_state="paused")
        viewer.take_screenshot(max_size=64)
        assert not lasting_complaints(viewer), step


def cut_off(path: Path) -> Path:
    """Record a run that is stopped while it merges."""
    with suppress(KeyboardInterrupt), RerunRecording(path) as observe:
        for event in made_events():
            observe(event)
            if isinstance(event, events.MergeStepTaken):
                raise KeyboardInterrupt
    return partial_path(path)


def test_entities_without_a_first_frame_are_noticed(viewer, tmp_path, monkeypatch):
    def log_late(scene: RerunScene, frame: str, path: str, *parts: rr.AsComponents) -> None:
        scene.shown.add(path)
        scene.log(path, rr.CoordinateFrame(frame), *parts)

    monkeypatch.setattr(RerunScene, "log_in", log_late)
    wait_until_shown(viewer, record(tmp_path / "run.rrd", "partial"))
    show_every_view(viewer)
    viewer.set_time("step", sequence=steps_of(viewer)[3], play_state="paused")
    viewer.take_screenshot(max_size=64)
    complaining = {view.name for view in viewer.get_state().views if view.reports}
    assert {
        "Rig",
        "Before GICP",
        "rear <- top: 20 of 80 matches kept (green)",
        "rear <- top, competing pose",
    } <= complaining
