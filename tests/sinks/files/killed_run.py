# SPDX-License-Identifier: Apache-2.0
"""A run that stops among its pairs and waits for its end: ``killed_run.py DIRECTORY``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from multilica import events
from multilica.sinks.run_directory import open_run
from tests.sinks.made_events import made_events


def main(directory: Path) -> None:
    told = list(made_events())
    with open_run(directory, told[0].config) as observe:
        for event in told:
            observe(event)
            if isinstance(event, events.PairRegistered) and event.registration.lidars == {"front left/1", "top"}:
                print("reached", flush=True)
                time.sleep(60.0)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
