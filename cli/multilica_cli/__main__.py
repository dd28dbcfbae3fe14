# SPDX-License-Identifier: Apache-2.0
"""`python -m multilica_cli`: the same as `multilica`."""

from multilica_cli.main import main

main()
