# SPDX-License-Identifier: Apache-2.0
"""The result documents of made-up runs."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

from multilica.config import Stage
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory
from tests.sinks.made_events import made_events


def made_document(outcome: str = "complete", stop_after: int | None = None, until: Stage = "ground") -> dict[str, Any]:
    """A document of one's own; of the first events only if a number of them is given."""
    return copy.deepcopy(_made(outcome, stop_after, until))


@cache
def _made(outcome: str, stop_after: int | None, until: Stage) -> dict[str, Any]:
    story = RunStory()
    for event in list(made_events(outcome, until))[:stop_after]:
        story(event)
    document = run_document(story)
    assert document is not None
    return document
