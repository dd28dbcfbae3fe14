# SPDX-License-Identifier: Apache-2.0
"""Start and end of the process."""

import gc
import sys

from multilica_cli.signals import Interrupted, end_on_signals, print_line, unwind_on_signals

__all__ = ["main"]


def main() -> None:
    """Handle signals, then import the rest and run the command line."""
    unwind_on_signals()
    try:
        from multilica_cli.main import main as run_command_line

        code = run_command_line()
    except Interrupted as stop:
        print_line(f"{stop}")
        code = stop.exit_code
    end_on_signals()
    gc.freeze()  # spares the last walk: what is left ends with the process
    sys.exit(code)


if __name__ == "__main__":
    main()
