# SPDX-License-Identifier: Apache-2.0
"""Web servers that drip, break off, redirect in circles or send what is no HTTP: each ends in its own sentence."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from multilica.errors import InputError
from multilica.ingest import inspect_source, read_snapshot
from multilica.ingest.remote import remote_file
from tests.ingest.support.processes import served

SENTENCES = {
    "drip_head": r"did not answer in time",
    "drip": r"did not answer in time",
    "drip_whole": r"sent only \d+ bytes in \d+ s",
    "endless": r"127\.0\.0\.1",
    "reset": r"The connection to the server .* failed",
    "loop": r"redirects without end",
    "nowhere": r"redirects to an address that is not valid",
    "garbage": r"does not answer in valid HTTP",
    "length": r"does not answer in valid HTTP",
    "headers": r"does not answer in valid HTTP",
    "huge": r"127\.0\.0\.1",
    "short": r"The connection to the server .* failed",
}
LIMIT_S = 1


@pytest.fixture(scope="module")
def server() -> Iterator[int]:
    with served("hostile_server.py") as port:
        yield port


@pytest.mark.parametrize("suffix", [".mcap", ".pcd"])
@pytest.mark.parametrize("kind", SENTENCES)
def test_each_ends_in_time_with_its_sentence(
    server: int, kind: str, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote_file, "_READ_S", LIMIT_S)
    monkeypatch.setattr(remote_file, "_SLOWEST_BYTES_PER_S", 1_000_000)
    monkeypatch.setattr(remote_file, "_RETRY_AFTER_S", (0.1,))
    begin_s = time.monotonic()
    with pytest.raises(InputError, match=SENTENCES[kind]) as caught:
        read_snapshot(f"http://127.0.0.1:{server}/{kind}/a{suffix}?token=secret")
    assert time.monotonic() - begin_s < 20.0
    text = str(caught.value)
    assert "secret" not in text
    assert len(text) <= 500
    assert text.isprintable()


def test_inspect_ends_likewise(server: int) -> None:
    with pytest.raises(InputError, match="redirects without end"):
        inspect_source(f"http://127.0.0.1:{server}/loop/a.mcap")
