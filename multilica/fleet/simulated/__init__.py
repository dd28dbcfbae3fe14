# SPDX-License-Identifier: Apache-2.0
"""Simulated logs of a fleet, with their truth."""
