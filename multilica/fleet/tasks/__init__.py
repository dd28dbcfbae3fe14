# SPDX-License-Identifier: Apache-2.0
"""The work on one log, and where it runs."""
