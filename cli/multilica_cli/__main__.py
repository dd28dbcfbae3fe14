# SPDX-License-Identifier: Apache-2.0
"""Start and end of the process."""

import gc
import os
import sys

from multilica_cli.signals import Interrupted, end_on_signals, print_line, unwind_on_signals

_OBJECTS_BEFORE_COLLECTION = 500_000
"""More than the modules of all libraries have: a run leaves a thousand objects to collect, so collections, by default
after each 700 new objects, take time for nothing."""
_SETTINGS_OF_LIBRARIES = {
    "OMP_NUM_THREADS": "1",  # cores are used by worker processes
    "PYDANTIC_DISABLE_PLUGINS": "__all__",  # the search for them reads about every installed package
}


def main() -> None:
    """Handle signals, then import the rest and run the command line."""
    unwind_on_signals()
    gc.set_threshold(_OBJECTS_BEFORE_COLLECTION)
    os.environ |= _SETTINGS_OF_LIBRARIES | os.environ
    try:
        from multilica.allocator import keep_freed_memory
        from multilica_cli.main import run

        keep_freed_memory()
        code = run()
    except Interrupted as stop:
        print_line(f"{stop}")
        code = stop.exit_code
    end_on_signals()
    gc.freeze()  # spares the last walk: what is left ends with the process
    sys.exit(code)


if __name__ == "__main__":
    main()
