# SPDX-License-Identifier: Apache-2.0
"""Acceptance of registrations: verdicts, cycles, symmetric scenes."""
