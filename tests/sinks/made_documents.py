# SPDX-License-Identifier: Apache-2.0
"""The result documents of made-up runs."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

from multilica.config import Stage
from multilica.results.document import ResultDocument
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import made_events


def made_document(outcome: str = "complete", stop_after: int | None = None, until: Stage = "ground") -> dict[str, Any]:
    """Plain values to change; of the first events only if a number of them is given."""
    return copy.deepcopy(_made(outcome, stop_after, until))


def parsed(values: dict[str, Any]) -> ResultDocument:
    return ResultDocument.model_validate(values)


@cache
def _made(outcome: str, stop_after: int | None, until: Stage) -> dict[str, Any]:
    state = RunState()
    for event in list(made_events(outcome, until))[:stop_after]:
        state(event)
    document = state.document
    assert document is not None
    return document.model_dump(mode="json")
