# SPDX-License-Identifier: Apache-2.0
"""The viewer shows every tab of a recording without a complaint."""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.experimental import ViewerClient

from multilica import events
from multilica.sinks.files.atomic import partial_path
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.viewer import viewer_picture
from tests.selection import NIGHTLY, RUN_FILES
from tests.sinks.conftest import record
from tests.sinks.made_events import made_events

DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.shows(*RUN_FILES),
    pytest.mark.skipif(not DRIVERS, reason="apt-get install mesa-vulkan-drivers libvulkan1"),
]
PATIENCE_S = 30.0
STEPS = 10 if NIGHTLY else 4


@pytest.fixture(scope="module")
def only_viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerClient]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    binary = str(Path(sys.executable).parent / "rerun")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CI", "1")  # else it counts its runs
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("viewer")))  # where it leaves a folder
        with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=binary) as client:
            yield client


@pytest.fixture
def viewer(only_viewer: ViewerClient) -> Iterator[ViewerClient]:
    """The viewer of the module, without recordings and without what other tests changed."""
    yield only_viewer
    only_viewer.close("all")
    only_viewer.run_command("ui.reset_viewer")


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


def times_of(viewer: ViewerClient, timeline: str) -> list[dict[str, Any]]:
    """Some times, the first and the last among them."""
    (recording,) = viewer.get_state().recordings
    found = next(each for each in recording.timelines if each.name == timeline)
    length = found.end - found.start
    steps = min(STEPS, length + 1)
    assert steps > 3
    times = [found.start + length * part // (steps - 1) for part in range(steps)]
    return [{"timestamp": np.datetime64(at, "ns")} if timeline == "log_time" else {"sequence": at} for at in times]


def go_to(viewer: ViewerClient, timeline: str, at: dict[str, Any]) -> None:
    viewer.set_time(timeline, **at, play_state="paused")
    viewer.take_screenshot(max_size=64)
    (recording,) = viewer.get_state().recordings
    assert (recording.current_timeline, recording.current_time) == (timeline, int(next(iter(at.values()))))


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


@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("outcome", "timeline"),
    [
        *((outcome, "step") for outcome in ("complete", "uncertain", "partial", "failed", "cut off")),
        *((outcome, "log_time") for outcome in ("partial", "cut off")),
        ("drive", "stop"),
    ],
)
def test_no_view_complains_when_stepping_back(viewer, tmp_path, outcome, timeline):
    made = {"cut off": cut_off, "drive": partial(record, at_stops=True)}
    path = made.get(outcome, partial(record, outcome=outcome))(tmp_path / "run.rrd")
    wait_until_shown(viewer, path)
    show_every_view(viewer)
    for at in reversed(times_of(viewer, timeline)):
        go_to(viewer, timeline, at)
        assert not lasting_complaints(viewer), at


def cut_off(path: Path) -> Path:
    """Record a run that is stopped while it merges."""
    with suppress(KeyboardInterrupt), RerunRecording(path) as observe:
        for event in made_events():
            observe(event)
            if isinstance(event, events.MergeStepTaken):
                raise KeyboardInterrupt
    return partial_path(path)


def test_entities_without_a_path_are_noticed(viewer, tmp_path, monkeypatch):
    monkeypatch.setattr("multilica.sinks.rerun.lidars.ROOT_FRAME", "elsewhere")
    wait_until_shown(viewer, record(tmp_path / "run.rrd", "partial"))
    show_every_view(viewer)
    go_to(viewer, "step", times_of(viewer, "step")[STEPS // 3])
    complaining = {view.name for view in viewer.get_state().views if view.reports}
    assert {
        "Rig",
        "Before GICP",
        "rear <- top: 20 of 80 matches kept (green)",
        "rear <- top, competing pose: green agrees there as well",
    } <= complaining


def test_a_picture_leaves_nothing_in_the_temporary_folder(tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setenv("TMPDIR", str(temporary))
    picture = viewer_picture(record(tmp_path / "made.rrd", "complete"), (320, 200))
    assert picture.startswith(b"\x89PNG")
    assert list(temporary.iterdir()) == []


def test_a_recording_that_ends_within_a_message_is_drawn(tmp_path):
    whole = record(tmp_path / "made.rrd", "complete").read_bytes()
    (tmp_path / "cut.rrd").write_bytes(whole[: len(whole) // 2])
    assert viewer_picture(tmp_path / "cut.rrd", (320, 200)).startswith(b"\x89PNG")
