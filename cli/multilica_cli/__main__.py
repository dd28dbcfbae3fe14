# SPDX-License-Identifier: Apache-2.0
"""Entry point of `python -m multilica_cli`."""

from multilica_cli.main import main

main()
